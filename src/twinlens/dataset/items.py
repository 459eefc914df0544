"""Quantities of a sample by name, as a training loop selects them; docs/loading.md lists the names."""

import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from twinlens.camera import Camera
from twinlens.dataset.truth_files import SCALARS, VECTORS, read_truth
from twinlens.errors import InputError, unknown

if TYPE_CHECKING:
    from twinlens.dataset.stored import StoredSample


@dataclass(frozen=True)
class _Reader:
    """A sample being read: each truth file once, however many of its arrays are selected."""

    sample: "StoredSample"
    truths: dict[int, dict[str, Any]] = field(default_factory=dict)

    def truth(self, i: int) -> dict[str, Any]:
        if i not in self.truths:
            self.truths[i] = read_truth(self.sample.folder / f"truth{i}.exr")
        return self.truths[i]

    def camera(self, i: int) -> tuple[Camera, Any]:
        rig = self.sample.rig
        if i >= len(rig):
            raise InputError(f"{self.sample.name}: has cameras 0 to {len(rig) - 1}, no camera {i}")
        return rig.cameras[i], rig.world_from_cams[i]


def _truth_array(name: str) -> Callable[[_Reader, int], Any]:
    return lambda reader, i: reader.truth(i)[name]


_OF_SAMPLE: dict[str, Callable[["StoredSample"], Any]] = {
    "name": lambda sample: sample.name,
    "baseline": lambda sample: sample.calibration.baseline,
    "doffs": lambda sample: sample.calibration.doffs,
    "ndisp": lambda sample: sample.ndisp,
}
_OF_VIEW: dict[str, Callable[[_Reader, int], Any]] = {
    "im": lambda reader, i: reader.sample.image(i),
    "disp": lambda reader, i: reader.sample.disparity(i),
    "mask_nonocc": lambda reader, i: reader.sample.mask_nonocc(i),
    "radiance": lambda reader, i: reader.sample.radiance(i),
    "K": lambda reader, i: reader.camera(i)[0].K,
    "world_from_cam": lambda reader, i: reader.camera(i)[1].copy(),
    **{name: _truth_array(name) for name in (*SCALARS, *VECTORS)},
}
_OF_LENS: dict[str, Callable[["StoredSample", int, int], Any]] = {
    "im": lambda sample, k, i: sample.lens(k).image(i),
    "radiance": lambda sample, k, i: sample.lens(k).radiance(i),
    "blur_circle_px": lambda sample, k, i: sample.lens(k).blur_circle_px(i),
}
_NAME = re.compile(r"(?:lens(\d{1,4})\.)?([A-Za-z_]+?)(\d{1,4})(_nonocc)?")
_EXAMPLES = (*_OF_SAMPLE, *(f"{name}0" for name in _OF_VIEW if name != "mask_nonocc"), "mask0_nonocc", "lens1.im0")


def check_name(name: str) -> None:
    """Raise InputError, with the nearest valid name, for a name that is not a quantity."""
    _function(name)


def read_all(names: Iterable[str], sample: "StoredSample") -> dict[str, Any]:
    """The quantities `names` of the sample. Raises InputError for an unknown name, FileError for a missing file."""
    reader = _Reader(sample)
    return {name: _function(name)(reader) for name in names}


def default_names(sample: "StoredSample") -> Iterator[str]:
    """name, all images, and the left disparity and mask if the sample has truth."""
    yield "name"
    i = 0
    while sample.has(f"im{i}.png"):
        yield f"im{i}"
        i += 1
    if sample.has_disparity(0):
        yield from ("disp0", "mask0_nonocc")


def _function(name: str) -> Callable[[_Reader], Any]:
    if name in _OF_SAMPLE:
        return lambda reader: _OF_SAMPLE[name](reader.sample)
    found = _NAME.fullmatch(name)
    lens, quantity, view = (found[1], found[2] + (found[4] or ""), int(found[3])) if found else (None, "", 0)
    if lens is not None and quantity in _OF_LENS:
        return lambda reader: _OF_LENS[quantity](reader.sample, int(lens), view)
    if lens is None and quantity in _OF_VIEW:
        return lambda reader: _OF_VIEW[quantity](reader, view)
    raise unknown("quantity of a sample", name, _EXAMPLES)
