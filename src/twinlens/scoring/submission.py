"""Folders and zip files of disparity maps: `MapFolder` of a benchmark, `Submission` of maps from other programs.

docs/benchmark.md lists the names and formats of maps, and what is refused. A zip is never unpacked to disk.
"""

import hashlib
import os
import re
import stat
import struct
import unicodedata
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import read_pfm, write_pfm
from twinlens.dataset.codecs.pfm import decode_disparity
from twinlens.errors import FileError, InputError, OutputError, file_hint

SCALES = (1, 2, 4)
"""Ratios of the truth's size to a map's; the protocol decides which of them it accepts."""
MAX_FILES = 100_000
_COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
SLACK_BYTES = 65536
"""Of a file beyond four bytes a pixel: headers, and chunks of an incompressible PNG."""
PNG_SIZE, PNG_KIND = slice(16, 24), slice(24, 26)
"""Places in the header of a PNG (ISO 15948, IHDR): width and height; bit depth and colour type."""
GREY_16 = b"\x10\x00"
Samples = Mapping[str, Sequence[str]]
"""Name of each sample -> its aliases."""


class MapFolder:
    """Maps as <folder>/<sample>/<method>.pfm; see `file_name` for names that are no safe file names.

    Pass `keep` to `run_benchmark` as on_map, `drop` as on_drop, and the object itself to the report as maps.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def path(self, method: str, sample: str) -> Path:
        """Path of a map, whether it exists or not."""
        return self.folder / file_name(sample) / f"{file_name(method)}.pfm"

    def keep(self, method: str, sample: str, disp: NDArray[np.floating[Any]]) -> None:
        """Write one map, (H, W) pixels, +inf unknown; OutputError if it cannot be written."""
        write_pfm(self.path(method, sample), disp)

    def drop(self, method: str, sample: str) -> None:
        """Remove that map if it exists; OutputError if it cannot be removed."""
        path = self.path(method, sample)
        try:
            path.unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(
                f"{path}: cannot be removed ({error.strerror or error})"
            ) from error

    def get(self, key: tuple[str, str], /) -> NDArray[np.floating[Any]] | None:
        """The map of (method, sample), None if it is missing; FileError if the file is damaged."""
        path = self.path(*key)
        return read_pfm(path) if path.is_file() else None


def file_name(name: str) -> str:
    """A safe file name: `name` itself if it is plain, else its plain characters and eight digits of its SHA-256."""
    if re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.=-]{0,60}", name):
        return name
    plain = re.sub(r"[^A-Za-z0-9_=-]+", "-", name).strip("-")[:40] or "name"
    return f"{plain}-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"


@dataclass(frozen=True)
class Submission:
    """The maps of one method, `name` on the board, in a folder or .zip; FileError if that is missing or refused."""

    path: Path
    name: str

    def __post_init__(self) -> None:
        _ = self.files

    @cached_property
    def files(self) -> Mapping[str, int]:
        """Every file that is not hidden: relative name with slashes -> size in bytes."""
        is_folder = self.path.is_dir()
        sizes = _folder_files(self.path) if is_folder else self._zip_files()
        visible = {name: size for name, size in sizes.items() if not _is_hidden(name)}
        spellings: dict[str, str] = {}
        for name in visible:
            spelling = unicodedata.normalize("NFC", name).casefold()
            first = spellings.setdefault(spelling, name)
            if first != name:
                raise FileError(
                    f"{self.path}: {first} and {name} are the same name on some systems; remove one"
                )
        return visible

    @cached_property
    def spec(self) -> str:
        """SHA-256 of the maps' names and contents (for a zip, of its checksums)."""
        digest = hashlib.sha256()
        maps = sorted(name for name in self.files if name.endswith((".pfm", ".png")))
        for name in maps:
            line = f"{name} {self.files[name]}\n"
            digest.update(line.encode("utf-8", "surrogatepass"))
            if self.path.is_dir():
                with (self.path / name).open("rb") as file:
                    digest.update(hashlib.file_digest(file, "sha256").digest())
            else:
                digest.update(self._archive.getinfo(name).CRC.to_bytes(4, "big"))
        return f"submission {digest.hexdigest()}"

    def map_of(
        self, sample: str, shape: tuple[int, ...], aliases: Sequence[str] = ()
    ) -> NDArray[np.float32]:
        """The sample's map, float32 pixels, +inf unknown; FileError for a missing or damaged map, or another size.

        shape: that of the truth, (H, W). The map may also have 1/2 or 1/4 of its height and width.
        """
        name = self.find(sample, aliases)
        if name is None:
            best = aliases[0] if aliases else sample
            raise FileError(
                f"{self.path}: no map of {sample!r}: expected {best}.pfm, {best}.png or {best}/disp0.pfm"
            )
        return self._decoded(name, shape)

    def confidence_of(
        self, sample: str, shape: tuple[int, ...], aliases: Sequence[str] = ()
    ) -> NDArray[np.float32] | None:
        """The confidence beside the sample's map, `<map>-confidence.pfm`; None without one.

        shape: that of the map. FileError for a damaged file, another size, and NaN.
        """
        name = _confidence_name(self.find(sample, aliases) or "")
        if name not in self.files:
            return None
        confidence = self._decoded(name, shape)
        if confidence.shape != shape:
            raise FileError(f"{self.path}: {name}: differs in size from the map")
        return confidence

    def _decoded(self, name: str, shape: tuple[int, ...]) -> NDArray[np.float32]:
        where = f"{self.path}: {name}"
        if self.path.is_dir():
            where = str(self.path / name)
        data = self._read(name, 4 * shape[0] * shape[1] + SLACK_BYTES, where)
        if name.endswith(".png") and len(data) > PNG_SIZE.stop:
            # Checked before decoding: a small file may decode to a very large image.
            width, height = struct.unpack(">II", data[PNG_SIZE])
            _check_size((height, width), shape, where)
        disparity = decode_disparity(data, where)
        _check_size(disparity.shape, shape, where)
        return disparity

    def missing_files(self, samples: Samples) -> list[str]:
        """Recommended names of the maps that are missing."""
        missing = (names for names in samples.items() if self.find(*names) is None)
        return [f"{aliases[0] if aliases else name}.pfm" for name, aliases in missing]

    def check_unambiguous(self, samples: Samples) -> None:
        """Raise InputError if one file matches two samples, as of equal names in two datasets."""
        owners: dict[str, str] = {}
        for sample, aliases in samples.items():
            file = self.find(sample, aliases)
            if file is not None and owners.setdefault(file, sample) != sample:
                both = f"{owners[file]!r} and {sample!r}"
                raise InputError(
                    f"{self.path}: {file} matches both {both}: score each dataset separately"
                )

    def unmatched_files(self, samples: Samples) -> tuple[str, ...]:
        """Maps that belong to no sample, sorted.

        Other files in a sample's folder belong to it, except for the maps of lenses that it does not have.
        """
        maps = {self.find(name, aliases) for name, aliases in samples.items()}
        used = maps | {_confidence_name(name) for name in maps if name}
        stems: set[str] = set()
        for sample, aliases in samples.items():
            stems |= {sample, file_name(sample), *aliases}
        folders = {stem.partition("/")[0] for stem in stems}
        top = "" if self._top_folder.rstrip("/") in folders else self._top_folder

        def belongs(name: str) -> bool:
            lens = re.match(r"[^/]+/lens-\d+(?=[./])", name)
            if lens is not None:
                return lens[0] in stems
            folder, slash, _ = name.partition("/")
            return folder in folders if slash else name.rpartition(".")[0] in stems

        return tuple(
            name
            for name in sorted(self.files.keys() - used)
            if not belongs(name.removeprefix(top)) and self._is_map(name)
        )

    def _is_map(self, name: str) -> bool:
        """Whether the file is a PFM, or a 16-bit grey PNG by its header."""
        if not name.endswith(".png"):
            return name.endswith(".pfm")
        try:
            with self._open(name) as file:
                return file.read(PNG_KIND.stop)[PNG_KIND] == GREY_16
        except Exception:  # zipfile and zlib raise many types for damaged data
            return False

    def find(self, sample: str, aliases: Sequence[str] = ()) -> str | None:
        """The file name of the sample's map, the first that exists; None if there is none."""
        for name in (sample, file_name(sample), *aliases):
            for top in ("", self._top_folder):
                file = self._map_of_stem(top + name)
                if file is not None:
                    return file
        return None

    def _map_of_stem(self, stem: str) -> str | None:
        """The map <stem>.* or <stem>/disp0.*, or else the only PFM file of the folder <stem>."""
        for ending in (".pfm", ".png", "/disp0.pfm", "/disp0.png"):
            if stem + ending in self.files:
                return stem + ending
        inside = rf"{re.escape(stem)}/[^/]+(?<!-confidence)\.pfm"
        of_later_lens = r"/lens-0*[1-9]\d*\.pfm$"
        maps = [
            name
            for name in self.files
            if re.fullmatch(inside, name) and not re.search(of_later_lens, name)
        ]
        return maps[0] if len(maps) == 1 else None

    @cached_property
    def _top_folder(self) -> str:
        """The single folder that contains everything, with a slash; "" if there is none."""
        tops = {name.partition("/")[0] for name in self.files}
        return f"{tops.pop()}/" if len(tops) == 1 else ""

    @cached_property
    def _archive(self) -> zipfile.ZipFile:
        """The zip, which stays open: opening it reads its whole list of members."""
        try:
            return zipfile.ZipFile(self.path)
        except FileNotFoundError:
            raise FileError(
                f"{self.path}: no such file or folder{file_hint(self.path)}"
            ) from None
        except Exception as error:
            raise FileError(
                f"{self.path}: neither a folder nor a readable zip ({error})"
            ) from None

    def _zip_files(self) -> dict[str, int]:
        members = self._archive.infolist()
        sizes: dict[str, int] = {}
        if len(members) > MAX_FILES:
            raise FileError(
                f"{self.path}: contains {len(members)} files, more than {MAX_FILES}"
            )
        for member in members:
            name = member.filename
            if _leaves_folder(name):
                raise FileError(
                    f"{self.path}: contains {name!r}, a name that leaves the archive"
                )
            if stat.S_ISLNK(member.external_attr >> 16):
                raise FileError(f"{self.path}: {name} is a link")
            if member.flag_bits & 1:
                raise FileError(f"{self.path}: {name} is encrypted")
            if member.compress_type not in _COMPRESSIONS:
                # zipfile decompresses these members whole, even if fewer bytes are requested.
                raise FileError(
                    f"{self.path}: {name} uses a compression other than deflate"
                )
            if name in sizes:
                raise FileError(f"{self.path}: {name} occurs twice")
            if not member.is_dir():
                sizes[name] = member.file_size
        return sizes

    def _open(self, name: str) -> IO[bytes]:
        if self.path.is_dir():
            return (self.path / name).open("rb")
        return self._archive.open(name)

    def _read(self, name: str, limit: int, where: str) -> bytes:
        """The file's bytes; FileError if it states, or has, more than `limit`."""
        size, data = self.files[name], b""
        try:
            if size <= limit:
                with self._open(name) as file:
                    data = file.read(limit + 1)
        except Exception as error:  # zipfile, zlib and other decoders raise many types for damaged data
            raise FileError(f"{where}: cannot be read ({error})") from None
        if max(size, len(data)) > limit:
            raise FileError(
                f"{where}: more than {limit} bytes, too large for a map of the truth's size"
            )
        return data


def open_submission(
    path: str | os.PathLike[str], name: str | None = None
) -> Submission:
    """The submission in a folder or .zip; its default name is the folder's, or the file's without .zip."""
    source = Path(path)
    if name is None:
        name = source.absolute().name
        if name.lower().endswith(".zip") and not source.is_dir():
            name = name[: -len(".zip")]
    return Submission(source, name)


def _leaves_folder(name: str) -> bool:
    """Whether a member of this name would be written outside the folder in which a zip is unpacked."""
    if name.startswith("/") or "\\" in name or ":" in name:
        return True
    return ".." in PurePosixPath(name).parts


def _is_hidden(name: str) -> bool:
    parts = name.split("/")
    return any(part.startswith(".") or part == "__MACOSX" for part in parts)


def _confidence_name(map_name: str) -> str:
    return f"{map_name.rpartition('.')[0]}-confidence.pfm"


def _check_size(shape: tuple[int, ...], truth: tuple[int, ...], where: str) -> None:
    allowed = [tuple(np.multiply(scale, shape)) for scale in SCALES]
    if truth not in allowed:
        raise FileError(
            f"{where}: is {shape[1]} x {shape[0]}; the truth is {truth[1]} x {truth[0]}"
        )


def _folder_files(folder: Path) -> dict[str, int]:
    sizes = {}
    inside = folder.resolve()
    for depth in ("*", "*/*", "*/*/*", "*/*/*/*"):
        for path in sorted(folder.glob(depth)):
            if not path.is_file():
                continue
            if not path.resolve().is_relative_to(inside):
                raise FileError(f"{path}: is a link that leaves {folder}")
            sizes[path.relative_to(folder).as_posix()] = path.stat().st_size
    return sizes
