"""`MapFolder`: a benchmark's disparity maps as PFM files, one folder per sample."""

import hashlib
import os
import re
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import read_pfm, write_pfm
from twinlens.errors import OutputError


class MapFolder:
    """Maps as <folder>/<sample>/<method>.pfm; see `file_name` for names that are no safe file names.

    Pass `keep` to `run_benchmark` as on_map, `drop` as on_drop, and the object itself to the report as maps.
    """

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def path(self, method: str, sample: str) -> Path:
        """Path of that map, whether it exists or not."""
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
            raise OutputError(f"{path}: cannot be removed ({error.strerror or error})") from error

    def get(self, key: tuple[str, str], /) -> NDArray[np.floating[Any]] | None:
        """The map of (method, sample), or None; FileError if the file is damaged."""
        path = self.path(*key)
        return read_pfm(path) if path.is_file() else None


def file_name(name: str) -> str:
    """A safe file name: `name` itself if it is plain, else its plain characters and eight digits of its SHA-256.

    >>> file_name("sad-9"), file_name("../x")[:2], file_name("../x") == file_name("./x")
    ('sad-9', 'x-', False)
    """
    if re.fullmatch(r"[A-Za-z0-9_][A-Za-z0-9_.=-]{0,60}", name):
        return name
    plain = re.sub(r"[^A-Za-z0-9_=-]+", "-", name).strip("-")[:40] or "name"
    return f"{plain}-{hashlib.sha256(name.encode('utf-8', 'surrogatepass')).hexdigest()[:8]}"
