"""What a sample holds, by name: the arrays and numbers that a training loop asks for, each read when asked.

name                                the sample's
im0 im1 ... radiance0 ...           images, of the first lens
lens1.im0 lens1.radiance0 ...       images of another lens
disp0 disp1 ...                     true disparity, float32, pixels, +inf unknown
mask0_nonocc ...                    255 visible in both, 128 occluded or out of frame, 0 unknown
depth0 position0 normal0 shading_normal0 visible0 object_id0 material_id0 material_kind0 blur_circle_px0 ...
                                    the arrays of truth0.exr; lens1.blur_circle_px0 of another lens
K0 world_from_cam0 ...              (3, 3) and (4, 4), float64
baseline doffs ndisp                of the pair
"""

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
class _Reading:
    """A sample being read: each view's truth file once, however many of its arrays are asked for."""

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


def _of_truth(name: str) -> Callable[[_Reading, int], Any]:
    return lambda reading, i: reading.truth(i)[name]


_VIEWS: dict[str, Callable[[_Reading, int], Any]] = {
    "im": lambda reading, i: reading.sample.image(i),
    "disp": lambda reading, i: reading.sample.disparity(i),
    "mask_nonocc": lambda reading, i: reading.sample.mask_nonocc(i),
    "radiance": lambda reading, i: reading.sample.radiance(i),
    "K": lambda reading, i: reading.camera(i)[0].K,
    "world_from_cam": lambda reading, i: reading.camera(i)[1].copy(),
    **{name: _of_truth(name) for name in (*SCALARS, *VECTORS)},
}
_LENSES: dict[str, Callable[["StoredSample", int, int], Any]] = {
    "im": lambda sample, k, i: sample.lens(k).image(i),
    "radiance": lambda sample, k, i: sample.lens(k).radiance(i),
    "blur_circle_px": lambda sample, k, i: sample.lens(k).blur_circle_px(i),
}
_WHOLE: dict[str, Callable[["StoredSample"], Any]] = {
    "name": lambda sample: sample.name,
    "baseline": lambda sample: sample.calibration.baseline,
    "doffs": lambda sample: sample.calibration.doffs,
    "ndisp": lambda sample: sample.ndisp,
}
_NAME = re.compile(r"(?:lens(\d{1,4})\.)?([A-Za-z_]+?)(\d{1,4})(_nonocc)?")
_EXAMPLES = (*_WHOLE, *(f"{name}0" for name in _VIEWS if name != "mask_nonocc"), "mask0_nonocc", "lens1.im0")


def check_name(name: str) -> None:
    """Raise InputError for a name that no sample could answer, with the nearest that one could."""
    _reader(name)


def read(sample: "StoredSample", name: str) -> Any:
    """What the sample holds under `name`. Raises InputError for a name unknown, FileError for a file that it lacks."""
    return _reader(name)(_Reading(sample))


def read_all(names: Iterable[str], sample: "StoredSample") -> dict[str, Any]:
    """What the sample holds under each of `names`; as `read`."""
    reading = _Reading(sample)
    return {name: _reader(name)(reading) for name in names}


def default_names(sample: "StoredSample") -> Iterator[str]:
    """What every training loop wants: the sample's name, its images, and the left truth where there is one."""
    yield "name"
    i = 0
    while sample.has(f"im{i}.png"):
        yield f"im{i}"
        i += 1
    if sample.has("disp0.pfm") or sample.has("disp0GT.pfm"):
        yield from ("disp0", "mask0_nonocc")


def _reader(name: str) -> Callable[[_Reading], Any]:
    if name in _WHOLE:
        return lambda reading: _WHOLE[name](reading.sample)
    found = _NAME.fullmatch(name)
    lens, quantity, view = (found[1], found[2] + (found[4] or ""), int(found[3])) if found else (None, "", 0)
    if lens is not None and quantity in _LENSES:
        return lambda reading: _LENSES[quantity](reading.sample, int(lens), view)
    if lens is None and quantity in _VIEWS:
        return lambda reading: _VIEWS[quantity](reading, view)
    raise unknown("quantity of a sample", name, _EXAMPLES)
