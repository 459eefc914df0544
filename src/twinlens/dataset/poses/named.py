"""A rig with image names, and helpers shared by the file formats of other programs."""

from collections.abc import Sequence
from dataclasses import dataclass

from twinlens.camera import Rig
from twinlens.dataset.files import read_bytes
from twinlens.errors import FileError, InputError

HALF_PIXEL = 0.5
"""Added to cx and cy for programs that count pixels from the image's corner, where the first centre is 0.5."""


@dataclass(frozen=True, eq=False)
class NamedRig:
    """A rig and one image name per camera."""

    rig: Rig
    names: tuple[str, ...]


def image_names(rig: Rig, names: Sequence[str] | None) -> tuple[str, ...]:
    """The given names, or im0.png, im1.png ...; InputError unless there is one per camera, different and printable."""
    chosen = tuple(f"im{i}.png" for i in range(len(rig))) if names is None else tuple(names)
    if len(chosen) != len(rig) or len(set(chosen)) != len(chosen):
        raise InputError(f"a rig of {len(rig)} cameras needs as many different image names, got {list(chosen)}")
    for name in chosen:
        if not name or name != name.strip() or not name.isprintable():
            raise InputError(f"an image name must be one printable line without spaces around it, got {name!r}")
    return chosen


def read_text(path: object) -> str:
    """The UTF-8 text of a file, or FileError."""
    try:
        return read_bytes(str(path)).decode("utf-8")
    except UnicodeDecodeError:
        raise FileError(f"{path}: not a text file") from None
