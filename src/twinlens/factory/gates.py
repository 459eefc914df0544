"""Quality gates: what a sample must be to stay in the dataset. What fails is drawn anew, and counted by its reason.

Some gates ask the truth alone and are asked before anything is rendered; the others look at the photographs.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Rig
from twinlens.dataset import Sample
from twinlens.factory.inside import encloses
from twinlens.scenes import Scene
from twinlens.scenes.table import At, Table, boolean, number, whole
from twinlens.sensor import Sensor
from twinlens.truth import Truth

_DARK = 0.02  # of the image's range
_BURNT = 0.98
_LEAST_CONTRAST = 0.004  # of the range, rms between neighbouring 4x4 blocks: noise averages out in them


class Rejected(Exception):  # noqa: N818  no failure: the draw was a bad one
    """A sample that a gate turned away: `reason` is what is counted, `found` what was seen, `remedy` what to change."""

    def __init__(self, reason: str, found: str, remedy: str) -> None:
        super().__init__(f"{reason}: {found}")
        self.reason, self.found, self.remedy = reason, found, remedy


@dataclass(frozen=True)
class Gates:
    """Thresholds, as shares of an image's pixels. A share of 1 (of 0 where it is a least) opens the gate.

    attempts : draws of one sample, at most.
    inside : whether a camera inside a body is refused.
    beyond_ndisp : most that may have disparities outside [0, ndisp), in recipes that name ndisp.
    visible : least that the first view must show and its partner see.
    dark, burnt : most that may be black, or as bright as can be, in any photograph.
    texture : least that must have texture, in any photograph.
    """

    attempts: int = 20
    inside: bool = True
    beyond_ndisp: float = 0.0
    visible: float = 0.2
    dark: float = 0.8
    burnt: float = 0.5
    texture: float = 0.05


def gates_from_table(at: At, value: Any) -> Gates:
    """The `[gates]` of a recipe. Raises InputError naming the key that is unknown or wrong."""
    keys: Table[Any] = Table(at, value)
    parsers = {"attempts": whole(1, 10_000), "inside": boolean}
    shares = {f.name: keys.take(f.name, parsers.get(f.name, number(0.0, 1.0)), f.default) for f in fields(Gates)}
    keys.done()
    return Gates(**shares)


def check_truth(gates: Gates, scene: Scene, rig: Rig, truths: Sequence[Truth], ndisp: int | None) -> None:
    """The gates that need no photograph. Raises Rejected."""
    if gates.inside:
        _check_inside(scene, rig, truths)
    if ndisp is not None:
        _check_disparity(gates, truths, ndisp)
    if len(truths) > 1:
        share = float((truths[0].visible & truths[0].hit).mean())
        if share < gates.visible:
            raise Rejected(
                "too little visible in both views",
                f"{share:.1%} of the first view, at least {gates.visible:.1%} asked",
                "rig.baseline (smaller), scene.jitter, or gates.visible",
            )


def _check_inside(scene: Scene, rig: Rig, truths: Sequence[Truth]) -> None:
    """A camera is inside a body that surrounds it and is all that it sees; a room that shows furniture is none."""
    for i, (truth, pose) in enumerate(zip(truths, rig.world_from_cams, strict=True)):
        seen = np.unique(truth.object_id)
        if seen.size != 1 or seen[0] == 0:
            continue
        name = truth.object_names[seen[0] - 1]
        if encloses(scene, name, pose[:3, 3]):
            raise Rejected(
                "camera inside an object", f"camera {i} in {name!r}", "scene.jitter, rig.baseline, or gates.inside"
            )


def _check_disparity(gates: Gates, truths: Sequence[Truth], ndisp: int) -> None:
    for i, truth in enumerate(truths[:2]):
        known = truth.disparity[np.isfinite(truth.disparity)]
        if not known.size:
            continue
        share = float(((known < 0) | (known >= ndisp)).mean())
        if share > gates.beyond_ndisp:
            raise Rejected(
                "disparity beyond ndisp",
                f"view {i} has {known.min():.4g} to {known.max():.4g} px, and ndisp is {ndisp}",
                "ndisp (larger), rig.baseline (smaller), scene.depth_range (farther), or gates.beyond_ndisp",
            )


def check_photographs(gates: Gates, sample: Sample, sensor: Sensor) -> None:
    """The gates that look at the pictures, of every lens and eye. Raises Rejected."""
    for k, shot in enumerate(sample.shots):
        for i, image in enumerate(shot.images):
            grey = _grey(image, sensor)
            for name, (measure, is_least, reason, remedy) in _PICTURE_GATES.items():
                share, bound = measure(grey), getattr(gates, name)
                if (share < bound) if is_least else (share > bound):
                    asked = f"at {'least' if is_least else 'most'} {bound:.1%} asked"
                    raise Rejected(reason, f"{share:.1%} of view {i}, lens {k}, {asked}", f"{remedy}, or gates.{name}")


def _grey(image: NDArray[Any], sensor: Sensor) -> NDArray[np.float32]:
    """The picture's mean channel in 0..1, (H, W)."""
    black, white = 0.0, float(np.iinfo(image.dtype).max)
    if sensor.output == "raw":
        black, white = sensor.black_level, float(sensor.largest_dn)
    grey = image.mean(axis=-1, dtype=np.float32) if image.ndim == 3 else image.astype(np.float32)
    return np.asarray((grey - black) / (white - black), dtype=np.float32)


def _dark(grey: NDArray[np.float32]) -> float:
    return float((grey <= _DARK).mean())


def _burnt(grey: NDArray[np.float32]) -> float:
    return float((grey >= _BURNT).mean())


def _textured(grey: NDArray[np.float32]) -> float:
    """The share of 4x4 blocks that differ from their right or lower neighbour by more than noise would."""
    height, width = (side // 4 * 4 for side in grey.shape)
    if height < 8 or width < 8:
        return 1.0  # too small to tell
    blocks = grey[:height, :width].reshape(height // 4, 4, width // 4, 4).mean(axis=(1, 3))
    right, down = np.diff(blocks, axis=1)[:-1], np.diff(blocks, axis=0)[:, :-1]
    return float((np.hypot(right, down) > _LEAST_CONTRAST).mean())


_PICTURE_GATES: dict[str, tuple[Callable[[NDArray[np.float32]], float], bool, str, str]] = {
    "dark": (_dark, False, "black image", "exposure (longer), the scene's lights"),
    "burnt": (_burnt, False, "burnt image", "exposure (shorter)"),
    "texture": (_textured, True, "too little texture", "scenes or families, lenses (smaller aperture)"),
}
