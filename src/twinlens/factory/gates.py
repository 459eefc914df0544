"""Quality gates of samples. A draw that fails is repeated, and counted by its reason.

Some gates need only the ground truth and are evaluated before rendering; the others need the images.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample
from twinlens.geometry import Float, transform_points
from twinlens.scenes import Mesh, Scene
from twinlens.schema import Fraction, Positive, StrictModel
from twinlens.sensor import Sensor
from twinlens.sensor.picture import BAYER

_DARK = 0.02  # of the image's range
_BURNT = 0.98

WINDOW = 16
_LEAST_CONTRAST = 0.01  # of the range, rms: about two grey levels of eight bits
_CHANCE = 3.0  # standard deviations of the correlation of noise
_LEAST_KNOWN = 0.5  # of a window's pixels, for it to be evaluated

Grey = NDArray[np.float32]


class Rejected(Exception):  # noqa: N818  no failure: the draw was a bad one
    """A gate has rejected a draw: `reason` is counted, `measured` says by how much, `remedy` what to change.

    `noisy`: the measurement depends on image noise, which differs in another draw.
    `depends_on`: the recipe's object whose size, beside that of what it rests on, decides; None if other draws matter.
    """

    def __init__(
        self,
        reason: str,
        measured: str,
        remedy: str,
        noisy: bool = False,
        depends_on: str | None = None,
    ) -> None:
        super().__init__(f"{reason}: {measured}")
        self.reason = reason
        self.measured = measured
        self.remedy = remedy
        self.noisy = noisy
        self.depends_on = depends_on

    def record(self, attempt: int) -> dict[str, Any]:
        """The entry of the `attempt`-th draw among the rejections of a sample."""
        return {"attempt": attempt, "reason": self.reason, "found": self.measured}


class Gates(StrictModel):
    """Thresholds, mostly as shares of an image's pixels.

    attempts : maximum number of draws of one sample.
    inside : whether to reject a camera inside a body.
    beyond_ndisp : maximum share of disparities outside [0, ndisp), for recipes with ndisp.
    visible : minimum share of the first view that its partner sees too.
    dark, burnt : maximum share of a photograph that is black, or saturated.
    texture : minimum share of 16x16 windows whose texture both views show, through every lens.
    noise : maximum ratio of the renderer's noise to the sensor's, in any view through any lens.
    """

    attempts: int = Field(20, ge=1, le=10_000)
    inside: bool = True
    beyond_ndisp: Fraction = 0.0
    visible: Fraction = 0.2
    dark: Fraction = 0.8
    burnt: Fraction = 0.5
    texture: Fraction = 0.1
    noise: Positive | None = None


def check_truth(
    gates: Gates, scene: Scene, rig: Rig, truths: Sequence[Truth], ndisp: int | None
) -> None:
    """The gates that need no images. Raises Rejected."""
    if gates.inside:
        _check_outside_of_bodies(scene, rig, truths)
    if ndisp:
        _check_disparities(gates, truths[:2], ndisp)
    if len(truths) > 1:
        share = float((truths[0].visible & truths[0].hit).mean())
        if share < gates.visible:
            raise Rejected(
                "too little visible in both views",
                f"{share:.1%} of the first view, minimum {gates.visible:.1%}",
                "rig.baseline (smaller), rig.fov_x_deg or [camera] (a wider view), scene.jitter, or gates.visible",
            )


def _check_outside_of_bodies(scene: Scene, rig: Rig, truths: Sequence[Truth]) -> None:
    for i, (truth, pose) in enumerate(zip(truths, rig.world_from_cams, strict=True)):
        # A body that encloses the camera is all that it sees; in a room there is more to see.
        seen = np.unique(truth.object_id)
        if len(seen) > 1 or seen[0] == 0:
            continue
        name = truth.object_names[seen[0] - 1]
        if encloses(scene, name, pose[:3, 3]):
            remedy = "scene.jitter, rig.baseline, or gates.inside"
            raise Rejected("camera inside an object", f"camera {i} in {name!r}", remedy)


def _check_disparities(gates: Gates, truths: Sequence[Truth], ndisp: int) -> None:
    for i, truth in enumerate(truths):
        disparities = truth.disparity[np.isfinite(truth.disparity)]
        beyond = (disparities < 0) | (disparities >= ndisp)
        if disparities.size and beyond.mean() > gates.beyond_ndisp:
            raise Rejected(
                "disparity beyond ndisp",
                f"view {i} has {disparities.min():.4g} to {disparities.max():.4g} px, and ndisp is {ndisp}",
                "ndisp (larger), rig.baseline (smaller), scene.depth_range (farther), or gates.beyond_ndisp",
            )


# Unlikely to be parallel to a face or to meet an edge, where a crossing would count twice or not at all.
_DIRECTION = np.array([0.30151134, 0.90453403, 0.30151134])


def encloses(scene: Scene, name: str, point: Float) -> bool:
    """Whether `point` (3,), in world coordinates, is inside the body that the ground truth calls `name`.

    Only spheres, cubes and meshes have an inside. False for scenes from Mitsuba files, whose shapes are not read.
    """
    for body in scene.objects:
        poses = {
            f"{body.name}[{i}]": pose @ body.world_from_object
            for i, pose in enumerate(body.instances)
        }
        pose = (poses or {body.name: body.world_from_object}).get(name)
        if pose is None:
            continue
        here, shape = transform_points(np.linalg.inv(pose), point), body.shape
        if isinstance(shape, Mesh):
            # A ray from inside a closed surface leaves it once more than it enters it.
            return crossings(shape.vertices, shape.faces, here) % 2 == 1
        if (to_world := shape.get("to_world")) is not None:
            here = transform_points(np.linalg.inv(to_world), here)
        if shape["type"] == "cube":
            return bool(np.abs(here).max() < 1)
        if shape["type"] == "sphere":
            centre = np.asarray(shape.get("center", (0, 0, 0)), dtype=np.float64)
            return bool(np.linalg.norm(here - centre) < float(shape.get("radius", 1.0)))
        return False
    return False


def crossings(vertices: Float, faces: NDArray[np.uint32], origin: Float) -> int:
    """How many triangles a ray from `origin` (3,) crosses. Source: Moeller and Trumbore 1997."""
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    ab, ac = b - a, c - a
    # Moeller and Trumbore solve origin + t direction = a + u ab + v ac for (t, u, v) by Cramer's rule.
    across = np.cross(_DIRECTION, ac)
    det = np.einsum("nc,nc->n", ab, across)
    # Triangles along the ray have det = 0: their u and v are infinite or NaN, and never count.
    with np.errstate(divide="ignore", invalid="ignore"):
        to = origin - a
        u = np.einsum("nc,nc->n", to, across) / det
        turned = np.cross(to, ab)
        v = turned @ _DIRECTION / det
        t = np.einsum("nc,nc->n", ac, turned) / det
        is_crossed = (u >= 0) & (v >= 0) & (u + v < 1) & (t > 0)
    return int(np.count_nonzero(is_crossed))


def check_photographs(gates: Gates, sample: Sample, sensor: Sensor) -> None:
    """The gates that need the images of every lens and view. Raises Rejected."""
    for k, shot in enumerate(sample.shots):
        ratio = max(shot.record.get("light_paths_over_sensor", [0.0]))
        if gates.noise is not None and ratio > gates.noise:
            raise Rejected(
                "too much renderer noise",
                f"{ratio:.2g} x sensor noise in the images of lens {k}, maximum {gates.noise:g}",
                "spp or noise (more samples), or gates.noise",
            )
        cameras = sample.rig.cameras
        greys = [
            grey(image, sensor.for_band(camera.band))
            for image, camera in zip(shot.images, cameras, strict=True)
        ]
        for i, picture in enumerate(greys):
            place = f"view {i}, lens {k}"
            _check_share("black", "dark", gates.dark, picture <= _DARK, place)
            _check_share("burnt", "burnt", gates.burnt, picture >= _BURNT, place)
        if sample.truths and gates.texture > 0:
            share = textured(greys, sample.rig.nominal, sample.truths)
            if share < gates.texture:
                raise Rejected(
                    "too little texture",
                    f"{share:.1%} of the images of lens {k}, minimum {gates.texture:.1%}",
                    "scenes or families, lenses (smaller aperture), exposure (less noise), or gates.texture",
                    noisy=True,
                )


def _check_share(
    kind: str, gate: str, most: float, bad: NDArray[np.bool_], place: str
) -> None:
    """Raise Rejected if more than the share `most` of the pixels is bad."""
    share = float(bad.mean())
    if share > most:
        raise Rejected(
            f"{kind} image",
            f"{share:.1%} of {place}, maximum {most:.1%}",
            f"exposure, the scene's lights, or gates.{gate}",
            noisy=True,
        )


def grey(image: NDArray[Any], sensor: Sensor) -> Grey:
    """The mean channel of an image in 0..1, (H, W); for a raw mosaic the mean of 2x2 pixels, which have all colours."""
    black, white = 0.0, float(np.iinfo(image.dtype).max)
    if sensor.output == "raw":
        black, white = sensor.black_level, float(sensor.largest_dn)
    mean: NDArray[Any] = image.astype(np.float32)
    if image.ndim == 3:
        mean = image.mean(axis=-1, dtype=np.float32)
    if sensor.output == "raw" and sensor.filters in BAYER:
        below = np.pad(mean, ((0, 1), (0, 1)), mode="reflect")
        left, right = below[:, :-1], below[:, 1:]
        mean = (left[:-1] + left[1:] + right[:-1] + right[1:]) / 4
    return np.asarray((mean - black) / (white - black), dtype=np.float32)


def textured(greys: Sequence[Grey], rig: Rig, truths: Sequence[Truth]) -> float:
    """The share of textured windows among those of the first view that its partner sees at least half of.

    A single camera is its own partner, and its noise counts as texture. 1 if there is no such window.
    """
    partner = rig.partner(0)
    if partner is None:
        return textured_windows(greys[0], greys[0], np.ones(greys[0].shape, bool))
    seen, camera = truths[0].visible & truths[0].hit, rig.cameras[partner]
    # Each pixel of the first view gets the value of its partner's nearest pixel; a visible point may round out of it.
    pixels = rig.project(partner, truths[0].position[seen])
    u, v = np.floor(pixels + 0.5).astype(int).T
    u, v = u.clip(0, camera.width - 1), v.clip(0, camera.height - 1)
    warped = np.zeros(seen.shape, np.float32)
    warped[seen] = greys[partner][v, u]
    return textured_windows(greys[0], warped, seen)


def textured_windows(left: Grey, right: Grey, seen: NDArray[np.bool_]) -> float:
    """The share of windows in which two images of the same points covary.

    Noise resembles texture in one image but is independent between views. The covariance of two images is the variance
    of their common signal; that of noise is about 1/sqrt(n) of the images' variance over n pixels. It must exceed a
    minimum contrast and three such standard deviations. docs/recipes.md gives the shares of windows that pass.
    """
    weight = _sums(seen.astype(np.float64))
    judged = weight >= _LEAST_KNOWN * WINDOW**2
    if not judged.any():
        return 1.0
    a, b = (
        np.where(seen, picture, 0.0).astype(np.float64) for picture in (left, right)
    )
    # Means over the pixels of each window that both views see.
    count = weight[judged]
    mean_a, mean_b, ab, aa, bb = (
        _sums(product)[judged] / count for product in (a, b, a * b, a * a, b * b)
    )
    # Cov(a, b) = E[ab] - E[a] E[b] is the variance of what the images share.
    shared = ab - mean_a * mean_b
    # That of independent noise has the standard deviation sqrt(Var(a) Var(b) / n). Rounding may make it negative.
    variances = (aa - mean_a**2) * (bb - mean_b**2)
    chance = np.sqrt(np.maximum(variances, 0.0) / count)
    least = np.maximum(_LEAST_CONTRAST**2, _CHANCE * chance)
    return float((shared > least).mean())


def _sums(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sums over the windows that tile an image, without incomplete ones at the right and lower border."""
    rows, columns = (side // WINDOW for side in values.shape)
    cut = values[: rows * WINDOW, : columns * WINDOW]
    return np.asarray(cut.reshape(rows, WINDOW, columns, WINDOW).sum(axis=(1, 3)))
