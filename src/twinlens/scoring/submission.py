"""Maps that something else made: a folder or a zip of PFM or PNG files, read with suspicion and scored like a method.

For a sample named S the map is the first there is of S.pfm, S.png, S/disp0.pfm, S/disp0.png, or the only .pfm of S/
(Middlebury's disp0METHOD.pfm, twinlens's own maps/), at the top or below the one folder that holds everything. S may
also be an alias: the photographs of one sample through several lenses are S/lens-0, S/lens-1, ... PFM holds pixels,
+inf unknown; PNG is 16-bit grey holding round(256 d), 0 unknown, as KITTI 2015 has it.

Of a zip only the files asked for are unpacked, never to the disk, and never more bytes of one than a map of the truth's
size can need; names that leave the archive, links, encrypted and doubled names (also those that some computers cannot
tell apart: cases, composed accents) are refused before anything is read, and so is every compression but deflate,
because Python's zipfile unpacks the others whole, however little is asked of them.
Hidden files and the folder __MACOSX, which a Mac puts into its zips, are not there.
"""

import contextlib
import hashlib
import os
import re
import stat
import struct
import unicodedata
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import IO, Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs.pfm import decode_pfm
from twinlens.dataset.codecs.png import decode_png
from twinlens.errors import FileError
from twinlens.scoring.maps import file_name

KITTI_SCALE = 256.0
SLACK_BYTES = 65536
"""What a file may hold beyond four bytes a pixel: headers, and the chunks of a PNG that did not compress."""
MAX_FILES = 100_000
PNG_SIZE = slice(16, 24)
PNG_KIND = slice(24, 26)
GREY_16 = b"\x10\x00"
"""Where a PNG says its depth and kind of colour, and what it says there of 16-bit grey (ISO 15948, IHDR)."""
COMPRESSIONS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)


@dataclass(frozen=True)
class Submission:
    """The maps of one method in a folder or a .zip. `name` is what the board calls it.

    Raises
    ------
    FileError
        No such file or folder, no zip, or a zip that asks for harm.
    """

    path: Path
    name: str

    def __post_init__(self) -> None:
        _ = self.files

    @cached_property
    def files(self) -> Mapping[str, int]:
        """Every file below that is not hidden: its name, with slashes, and its size in bytes."""
        found = _folder_files(self.path) if self.path.is_dir() else _zip_files(self.path)
        seen = {name: size for name, size in found.items() if not _is_hidden(name)}
        _check_alike(self.path, seen)
        return seen

    @cached_property
    def spec(self) -> str:
        """A SHA-256 of the maps' names and contents (of a zip: its checksums): other maps are another method."""
        digest = hashlib.sha256()
        names = [name for name in sorted(self.files) if name.endswith((".pfm", ".png"))]
        for name, fingerprint in zip(names, self._fingerprints(names), strict=True):
            digest.update(f"{name} {self.files[name]}\n".encode("utf-8", "surrogatepass"))
            digest.update(fingerprint)
        return f"submission {digest.hexdigest()}"

    def file_of(self, sample: str, aliases: Sequence[str] = ()) -> str:
        """The name of the map of that sample, or FileError saying what was looked for."""
        found = self._found(sample, aliases)
        if found is not None:
            return found
        best = aliases[0] if aliases else sample
        raise FileError(f"{self.path}: no map of {sample!r}: expected {best}.pfm, {best}.png or {best}/disp0.pfm")

    def _found(self, sample: str, aliases: Sequence[str]) -> str | None:
        tops = {name.partition("/")[0] for name in self.files}
        above = ("", f"{tops.pop()}/") if len(tops) == 1 else ("",)
        names = (sample, file_name(sample), *aliases)
        stems = dict.fromkeys(f"{top}{name}" for name in names for top in above)
        return next((found for stem in stems if (found := self._named(stem)) is not None), None)

    def strangers(self, samples: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
        """The maps that lie under a name of no sample, sorted; `samples`: each one's name and its aliases.

        Most often a name is misspelt. What else lies in a sample's own folder, or is no map (a picture), is no mistake.
        """
        used = {file for name, aliases in samples.items() if (file := self._found(name, aliases)) is not None}
        names = {each for name, aliases in samples.items() for each in (name, file_name(name), *aliases)}
        folders = {name.partition("/")[0] for name in names}
        tops = {name.partition("/")[0] for name in self.files}
        top = f"{tops.pop()}/" if len(tops) == 1 and not tops <= folders else ""
        unused = sorted(self.files.keys() - used)
        strange = [name for name in unused if not _is_of_one_of(name.removeprefix(top), names, folders)]
        with self._opener() as opened:
            return tuple(name for name in strange if _is_map(name, opened))

    @contextlib.contextmanager
    def _opener(self) -> Iterator[Callable[[str], IO[bytes]]]:
        """What opens files by their names. A zip is opened once for all: each opening reads its whole list."""
        if self.path.is_dir():
            yield lambda name: (self.path / name).open("rb")
        else:
            with _archive(self.path) as archive:
                yield archive.open

    def _named(self, stem: str) -> str | None:
        for name in (f"{stem}.pfm", f"{stem}.png", f"{stem}/disp0.pfm", f"{stem}/disp0.png"):
            if name in self.files:
                return name
        inside = [name for name in self.files if re.fullmatch(rf"{re.escape(stem)}/[^/]+\.pfm", name)]
        # Beside the maps of other lenses, which are named so, a nameless one is the first lens's.
        alone = [name for name in inside if not re.search(r"/lens-0*[1-9]\d*\.pfm$", name)]
        return alone[0] if len(alone) == 1 else None

    def map_of(self, sample: str, shape: tuple[int, int], aliases: Sequence[str] = ()) -> NDArray[np.float32]:
        """The map of that sample, (H, W) float32 pixels, +inf unknown.

        Raises
        ------
        FileError
            Missing, damaged, NaN in it, or another size than `shape` (H, W); the message names the file.
        """
        name = self.file_of(sample, aliases)
        where = f"{self.path}: {name}" if not self.path.is_dir() else str(self.path / name)
        data = self._read(name, 4 * shape[0] * shape[1] + SLACK_BYTES, where)
        # A PNG's own width and height come first: a small file may ask for a large picture.
        if name.endswith(".png") and len(data) > PNG_SIZE.stop:
            width, height = struct.unpack(">II", data[PNG_SIZE])
            _check_size((height, width), shape, where)
        disp = _decoded(data, name, where)
        _check_size(disp.shape, shape, where)
        return disp

    def _read(self, name: str, limit: int, where: str) -> bytes:
        """At most `limit` bytes: what states more is not opened, and what states less is not believed."""
        too_much = FileError(f"{where}: more than {limit} bytes, no map of this truth's size needs them")
        if self.files[name] > limit:
            raise too_much
        try:
            with self._opener() as opened, opened(name) as file:
                data = file.read(limit + 1)
        except FileError:
            raise
        # zipfile answers damage with exceptions of its own, of zlib, and of the standard library's other decoders.
        except Exception as error:
            raise FileError(f"{where}: cannot be read ({error})") from None
        if len(data) > limit:
            raise too_much
        return data

    def _fingerprints(self, names: Iterable[str]) -> Iterator[bytes]:
        if not self.path.is_dir():
            with _archive(self.path) as archive:
                yield from (archive.getinfo(name).CRC.to_bytes(4, "big") for name in names)
            return
        for name in names:
            with (self.path / name).open("rb") as file:
                yield hashlib.file_digest(file, "sha256").digest()


def open_submission(path: str | os.PathLike[str], name: str | None = None) -> Submission:
    """The submission in a folder or .zip; its name is the folder's, or the file's without .zip, unless given."""
    place = Path(path)
    return Submission(place, name if name is not None else _own_name(place))


def _own_name(place: Path) -> str:
    name = place.absolute().name
    return name[: -len(".zip")] if name.lower().endswith(".zip") and not place.is_dir() else name


def _is_of_one_of(name: str, names: Set[str], folders: Set[str]) -> bool:
    """Whether a file, named from the top, lies where a sample's things do: beside one of `names`, or in its folder.

    A folder of several lenses holds one map a lens: one of a lens that the sample has not is of no sample.
    """
    folder, slash, _ = name.partition("/")
    lens = re.match(r"[^/]+/lens-\d+(?=[./])", name)
    if lens is not None:
        return lens[0] in names
    return folder in folders if slash else name.rpartition(".")[0] in names


def _is_map(name: str, opened: Callable[[str], IO[bytes]]) -> bool:
    """Whether the file is a PFM, or a PNG as maps are: 16-bit grey, by its first bytes. Nothing more is read."""
    if not name.endswith(".png"):
        return name.endswith(".pfm")
    with contextlib.suppress(Exception), opened(name) as file:  # as in _read: damage is no map that anybody can name
        return file.read(PNG_KIND.stop)[PNG_KIND] == GREY_16
    return False


def _is_hidden(name: str) -> bool:
    return any(part.startswith(".") or part == "__MACOSX" for part in name.split("/"))


def _check_alike(path: Path, names: Iterable[str]) -> None:
    """Two names that a Mac or Windows would take for one: which of the maps is meant nobody can say."""
    seen: dict[str, str] = {}
    for name in names:
        plain = unicodedata.normalize("NFC", name).casefold()
        if plain in seen:
            raise FileError(f"{path}: {seen[plain]} and {name} are one name on some computers; remove one")
        seen[plain] = name


def _check_size(found: tuple[int, ...], wanted: tuple[int, int], where: str) -> None:
    if found != wanted:
        raise FileError(f"{where}: is {found[1]} x {found[0]}; the truth is {wanted[1]} x {wanted[0]}")


def _folder_files(folder: Path) -> dict[str, int]:
    found = {}
    for place in (place for depth in ("*", "*/*", "*/*/*", "*/*/*/*") for place in sorted(folder.glob(depth))):
        if place.is_file():
            if not place.resolve().is_relative_to(folder.resolve()):
                raise FileError(f"{place}: is a link that leaves {folder}")
            found[place.relative_to(folder).as_posix()] = place.stat().st_size
    return found


def _archive(path: Path) -> zipfile.ZipFile:
    try:
        return zipfile.ZipFile(path)
    except FileNotFoundError:
        raise FileError(f"{path}: no such file or folder") from None
    except Exception as error:
        raise FileError(f"{path}: neither a folder nor a readable zip ({error})") from None


def _zip_files(path: Path) -> dict[str, int]:
    with _archive(path) as archive:
        members = archive.infolist()
    if len(members) > MAX_FILES:
        raise FileError(f"{path}: {len(members)} files, more than {MAX_FILES}")
    found: dict[str, int] = {}
    for member in members:
        _check_member(path, member, found)
        if not member.is_dir():
            found[member.filename] = member.file_size
    return found


def _check_member(path: Path, member: zipfile.ZipInfo, seen: Mapping[str, Any]) -> None:
    name = member.filename
    parts = PurePosixPath(name).parts
    if name.startswith("/") or "\\" in name or ":" in name or ".." in parts:
        raise FileError(f"{path}: holds {name!r}, a name that leaves the archive")
    if stat.S_ISLNK(member.external_attr >> 16):
        raise FileError(f"{path}: {name} is a link")
    if member.flag_bits & 1:
        raise FileError(f"{path}: {name} is encrypted")
    if member.compress_type not in COMPRESSIONS:
        raise FileError(f"{path}: {name} is compressed by another method than deflate, which every zip program knows")
    if name in seen:
        raise FileError(f"{path}: {name} is there twice")


def _decoded(data: bytes, name: str, where: str) -> NDArray[np.float32]:
    if name.endswith(".pfm"):
        disp = decode_pfm(data, where)
    else:
        codes = decode_png(data, where)
        if codes.dtype != np.uint16 or codes.ndim != 2:
            raise FileError(f"{where}: a disparity PNG is 16-bit grey, round(256 d), 0 unknown")
        disp = np.where(codes == 0, np.inf, codes / KITTI_SCALE).astype(np.float32)
    if disp.ndim != 2:
        raise FileError(f"{where}: holds colours; a disparity map has one number a pixel")
    return disp
