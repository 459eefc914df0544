"""How far off a depth is: what `baseline` and `focal-length` have in common.

planes at many depths -> is the disparity error the same at each? then depth error follows z^2/(f B), by algebra
bundled scenes        -> wrong pixels, and how much of the left view the right one cannot see

The planes' print is the same in pixels at every depth (`targets`), so that nothing but distance differs: what is tested
of z^2 is that the disparity error does not depend on distance, and that rig, truth and matcher turn one into the other.
"""

import math
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Pinhole, Rig
from twinlens.scenes import Scene, load_scene
from twinlens.sensor import Sensor
from twinlens.studies.bootstrap import log_slope, over_scenes
from twinlens.studies.model import Finding, Setup, agrees, sweep
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table
from twinlens.studies.targets import noise_plane

Float = NDArray[np.float64]

DEPTHS = tuple(2.0 ** (k / 2) for k in range(7))
"""Of the planes, metres: 1 to 8."""
PHASES = (0.0, 0.25, 0.5, 0.75)
"""The right principal point is moved by these parts of a pixel: a matcher errs by where between pixels a match is."""
PLANE_SIZE = (160, 120)
_RIM = 12
_PLACE = ("baseline_mm", "fx_px", "z_m")
PLANES, SCENES = "planes", "scenes"
"""The parts of the table."""
TOLERANCE = 0.05
COLUMNS = (
    Column("part", "", "part"),
    Column("method", "", "matcher"),
    Column("baseline_mm", "mm", "baseline"),
    Column("fx_px", "px", "focal length"),
    Column("z_m", "m", "depth"),
    Column("depth_error_mm", "mm", "depth error, robust s.d."),
    Column("predicted_mm", "mm", "z²/(f B) times the disparity error"),
    Column("disparity_error_px", "px", "disparity error, robust s.d."),
    Column("occluded", "%", "hidden from the other eye"),
    Column("totbad2", "%", "wrong by > 2 px or unknown"),
)
SENSOR = Sensor.preset("machine_vision")


def measure_pairs(
    setup: Setup, planes: Sequence[tuple[float, float]], pair_of: Callable[[Scene, float], tuple[float, float]],
    factors: Sequence[float],
) -> list[Row]:  # fmt: skip
    """Planes at every depth by each pair of `planes`, then every scene by the pair that `pair_of` makes of each factor.

    A pair is (baseline in metres, horizontal field of view in degrees).
    """
    rows: list[Row] = []
    for seed in setup.seeds:
        for baseline, fov_x_deg in planes:
            rows += plane_rows(setup, seed, baseline, fov_x_deg)
    for name, factor, seed in sweep(setup, factors, setup.seeds):
        rows += scene_rows(setup, name, seed, *pair_of(load_scene(name), factor))
    return rows


def plane_rows(setup: Setup, seed: int, baseline: float, fov_x_deg: float) -> Iterator[Row]:
    """A row for every depth and matcher, from planes photographed by this pair."""
    fx = Camera.from_fov(setup.width, setup.height, fov_x_deg).fx
    width, height = PLANE_SIZE
    camera = Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1))
    rig = Rig.stereo(camera, baseline, np.eye(4))
    found = {(z, method): errors for z in DEPTHS for method, errors in _plane_errors(setup, rig, z, seed).items()}
    for method in setup.methods:
        typical = math.sqrt(float(np.mean([_spread(found[z, method][1]) ** 2 for z in DEPTHS])))
        for z in DEPTHS:
            metres, pixels = found[z, method]
            yield {
                "scene": "plane", "part": PLANES, "seed": seed, "method": method, "baseline_mm": 1e3 * baseline,
                "fx_px": camera.fx, "z_m": z, "depth_error_mm": 1e3 * _spread(metres),
                "predicted_mm": 1e3 * z**2 / (camera.fx * baseline) * typical,
                "disparity_error_px": _spread(pixels), "occluded": math.nan, "totbad2": math.nan,
            }  # fmt: skip


def scene_rows(setup: Setup, name: str, seed: int, baseline: float, fov_x_deg: float) -> Iterator[Row]:
    """A row for every matcher on a bundled scene."""
    stage = Stage.of(name, setup.width, setup.height, fov_x_deg=fov_x_deg, baseline=baseline)
    radiance = stage.photograph(Pinhole(), setup.spp, stream(seed, 0))
    pictures = stage.expose(radiance, Pinhole(), stream(seed, 1), SENSOR)
    for method, scores in stage.errors(pictures, setup.methods).items():
        yield {
            "scene": name, "part": SCENES, "seed": seed, "method": method, "baseline_mm": 1e3 * baseline,
            "fx_px": stage.camera.fx, "z_m": math.nan, "depth_error_mm": math.nan, "predicted_mm": math.nan,
            "disparity_error_px": math.nan,
            "occluded": hidden_percent(stage), "totbad2": scores["totbad2"],
        }  # fmt: skip


def hidden_percent(stage: Stage) -> float:
    """Of the left pixels whose partner lies inside the right image, how many it does not see."""
    disparity = stage.truth.disparity
    partner = np.arange(stage.camera.width) - disparity
    inside = np.isfinite(disparity) & (partner >= 0) & (partner <= stage.camera.width - 1)
    return 100.0 * float((inside & ~stage.truth.visible).sum() / inside.sum())


def square_law(table: Table, methods: Sequence[str]) -> list[Finding]:
    """For every matcher: the exponent of depth error against z, by least squares of the logarithms; 2 is the law."""
    return [
        exponent(table.where(part=PLANES, method=method), "z_m", "depth_error_mm", 2.0, TOLERANCE,
                 f"{method}: the disparity error does not depend on distance, so depth error grows as z^p, p = {{}}")
        for method in methods
    ]  # fmt: skip


def exponent(rows: Table, x: str, y: str, expected: float, tolerance: float, text: str) -> Finding:
    """The exponent p of y ~ x^p, fitted where all else is equal."""
    slope = log_slope(x, y)
    alike = ["method", *(name for name in _PLACE if name != x and not np.isnan(rows.numbers(name)).any())]
    measured = over_scenes(rows, lambda unit: [slope(part) for _, part in unit.groups(*alike)])
    return Finding(text, measured, agrees(measured, expected, tolerance), "", expected, tolerance)


def law_residual(table: Table) -> Finding:
    """How far the measured depth errors are from z^2/(f B) sigma_d, root mean square over all planes."""

    def logarithms(unit: Table) -> Float:
        return np.log(unit.numbers("depth_error_mm") / unit.numbers("predicted_mm"))

    rms = over_scenes(table.where(part=PLANES), logarithms, lambda values: 100 * math.sqrt(float(np.mean(values**2))))
    text = (
        "Depth errors equal z^2/(f B) times one disparity error for each matcher and pair, all depths together, within "
        f"{{}} rms, where {100 * TOLERANCE:g} % are allowed"
    )
    return Finding(text, rms, rms.value <= 100 * TOLERANCE, "%")


def _plane_errors(setup: Setup, rig: Rig, depth: float, seed: int) -> dict[str, tuple[Float, Float]]:
    """Method -> (depth errors in metres, disparity errors in pixels), over all the phases."""
    place = stream(seed, DEPTHS.index(depth))
    scene = noise_plane(rig, depth, place)
    errors: dict[str, list[tuple[Float, Float]]] = {method: [] for method in setup.methods}
    for k, phase in enumerate(PHASES):
        left = rig.cameras[0]
        stage = Stage(scene, Rig((left, left.replace(cx=left.cx + phase)), rig.world_from_cams))
        draw = stream(seed, DEPTHS.index(depth), k)
        pictures = stage.expose(stage.photograph(Pinhole(), setup.spp, draw), Pinhole(), draw, SENSOR)
        for method in setup.methods:
            errors[method].append(_errors(stage, stage.match(pictures, method), phase))
    return {method: tuple(np.concatenate(part) for part in zip(*each, strict=True)) for method, each in errors.items()}  # type: ignore[misc]


def _errors(stage: Stage, found: NDArray[np.float32], doffs: float) -> tuple[Float, Float]:
    """Depth errors (m) and disparity errors (px) of the pixels inside the rim whose match is no blunder."""
    true, z = stage.truth.disparity.astype(np.float64), stage.truth.depth.astype(np.float64)
    disparity = found.astype(np.float64)
    used = stage.truth.visible & np.isfinite(disparity) & (np.abs(disparity - true) < 1)
    used[:_RIM] = used[-_RIM:] = used[:, :_RIM] = used[:, -_RIM:] = False
    focal_base = stage.camera.fx * stage.rig.baseline(0, 1)
    return focal_base / (disparity[used] + doffs) - z[used], (disparity - true)[used]


def _spread(errors: Float) -> float:
    """1.4826 times the median absolute error: the standard deviation of normal errors, whatever the outliers."""
    return 1.4826 * float(np.median(np.abs(errors))) if errors.size else math.nan
