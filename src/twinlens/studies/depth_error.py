"""`baseline` and `focal-length`: how the depth error depends on distance, baseline and focal length.

A disparity error sigma_d gives the depth error z^2 / (f B) sigma_d (Gallup, Frahm, Mordohai and Pollefeys, Variable
Baseline/Resolution Stereo, CVPR 2008, equation 3). Textured planes test this; scenes give wrong pixels and occlusion.
"""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Camera, Pinhole
from twinlens.geometry import Float, depth_error
from twinlens.scenes import Scene, load_scene
from twinlens.sensor import Sensor
from twinlens.studies.findings import Finding, bounded, power_law
from twinlens.studies.intervals import log_slope, over_scenes
from twinlens.studies.model import Figure, Measured, Setup, Study, sweep
from twinlens.studies.stage import Stage, centred_camera, noise_planes, stream
from twinlens.studies.table import Column, Row, Table

DEPTHS = tuple(2.0 ** (k / 2) for k in range(7))  # of the planes, metres
PLANE_SIZE = (160, 120)
_RIM = 12
PLANES, SCENES = "planes", "scenes"  # values of the column "part"
TOLERANCE = 0.05
SENSOR = Sensor.preset("machine_vision")


@dataclass(frozen=True)
class Sweep:
    """A sweep of the quantity in `column`, `symbol` in formulas. A pair is (baseline in metres, fov_x_deg).

    planes: the pairs that render planes. A bundled scene is rendered by pair(scene, factor) for each of the factors.
    """

    column: str
    symbol: str
    planes: tuple[tuple[float, float], ...]
    factors: tuple[float, ...]
    pair: Callable[[Scene, float], tuple[float, float]]

    def measure(self, setup: Setup) -> Measured:
        """Planes at every depth for each pair, then every bundled scene."""
        rows: list[Row] = []
        for seed, pair in itertools.product(setup.seeds, self.planes):
            rows += plane_rows(setup, seed, *pair)
        for name, factor, seed in sweep(setup, self.factors, setup.seeds):
            baseline, fov_x_deg = self.pair(load_scene(name), factor)
            stage = Stage.of(
                name, setup.width, setup.height, fov_x_deg=fov_x_deg, baseline=baseline
            )
            radiance = stage.photograph(Pinhole(), setup.spp, stream(seed, 0))
            pictures = stage.expose(radiance, Pinhole(), stream(seed, 1), SENSOR)
            case = {
                "scene": name,
                "part": SCENES,
                "seed": seed,
                "baseline_mm": 1e3 * baseline,
                "fx_px": stage.camera.fx,
                "occluded": occluded_percent(stage),
            }
            for method, scores in stage.errors(pictures, setup.methods).items():
                rows.append({**case, "method": method, "totbad2": scores["totbad2"]})
        return Measured(
            rows, notes={"plane_pairs": self.planes, "factors": self.factors}
        )

    def conclude(self, table: Table) -> list[Finding]:
        """Exponents of the depth error in z and in the swept quantity, and the deviation from the formula."""
        planes = table.where(part=PLANES)
        exponents = [
            power_law(f"{method}: the depth error is proportional to z^p with p = {{}}", planes.where(method=method),
                      "z_m", "depth_error_mm", 2.0, TOLERANCE, ["baseline_mm", "fx_px"])
            for method in table.values("method")
        ]  # fmt: skip
        text = f"The depth error is proportional to {self.symbol}^p with p = {{}}"
        fixed = ["method", "z_m", *({"baseline_mm", "fx_px"} - {self.column})]
        swept = power_law(
            text, planes, self.column, "depth_error_mm", -1.0, TOLERANCE, fixed
        )
        rms = over_scenes(
            planes,
            _log_deviations,
            lambda logarithms: 100 * math.sqrt(float(np.mean(logarithms**2))),
        )
        most = f"Depth errors deviate by at most {100 * TOLERANCE:g} % rms"
        text = f"{most} from z^2/(f B) times one disparity error per matcher and camera pair"
        residual = bounded(text, rms, -math.inf, 100 * TOLERANCE, "%", result="{} rms")
        return [*exponents, residual, swept]

    def figures(self, quantity: str) -> tuple[Figure, ...]:
        """The depth error of planes, and the wrong pixels of bundled scenes."""
        return (
            Figure("depth-error", "Depth error of planes and z²/(f B)", "z_m", "depth_error_mm", by="method",
                   panel=self.column, log_x=True, log_y=True, where={"part": PLANES}, residual_of="predicted_mm",
                   also=("predicted_mm",)),
            Figure("wrong", f"Wrong pixels against the {quantity}", self.column, "totbad2", by="method", panel="scene",
                   where={"part": SCENES}),
        )  # fmt: skip


BY_BASELINE = Sweep(
    "baseline_mm", "B", ((0.06, 50.0), (0.12, 50.0), (0.24, 50.0)), (0.25, 0.5, 1.0, 1.5),
    lambda scene, factor: (factor * scene.baseline, scene.fov_x_deg),
)  # fmt: skip
BY_FOCAL_LENGTH = Sweep(
    "fx_px", "f", ((0.12, 80.0), (0.12, 50.0), (0.12, 28.0)), (1.0, 0.8, 0.6, 0.4),
    lambda scene, factor: (scene.baseline, factor * scene.fov_x_deg),
)  # fmt: skip


def _log_deviations(rows: Table) -> Float:
    return np.log(rows.numbers("depth_error_mm") / rows.numbers("predicted_mm"))


def plane_rows(setup: Setup, seed: int, baseline: float, fov_x_deg: float) -> list[Row]:
    """A row for every matcher and depth, from rendered planes."""
    fx = Camera.from_fov(setup.width, setup.height, fov_x_deg).fx
    camera = centred_camera(*PLANE_SIZE, fx)
    errors: dict[tuple[str, float], list[Float]] = {
        case: [] for case in itertools.product(setup.methods, DEPTHS)
    }
    for number, z in enumerate(DEPTHS):
        planes = noise_planes(camera, baseline, z, stream(seed, number))
        for phase, stage in enumerate(planes):
            draw = stream(seed, number, phase)
            radiance = stage.photograph(Pinhole(), setup.spp, draw)
            pictures = stage.expose(radiance, Pinhole(), draw, SENSOR)
            for method in setup.methods:
                errors[method, z].append(_errors(stage, stage.match(pictures, method)))
    deviations = {case: _deviations(parts) for case, parts in errors.items()}
    rows: list[Row] = []
    for (method, z), (metres, pixels) in deviations.items():
        squares = [deviations[method, depth][1] ** 2 for depth in DEPTHS]
        typical = math.sqrt(float(np.mean(squares)))
        rows.append(
            {
                "scene": "plane",
                "part": PLANES,
                "seed": seed,
                "method": method,
                "baseline_mm": 1e3 * baseline,
                "fx_px": fx,
                "z_m": z,
                "depth_error_mm": 1e3 * metres,
                "predicted_mm": 1e3 * float(depth_error(z, fx, baseline, typical)),
                "disparity_error_px": pixels,
            }
        )
    return rows


def _deviations(parts: list[Float]) -> Float:
    """Robust standard deviations (2,) of errors (2, N): 1.4826 times the median magnitude, exact if they are normal."""
    magnitudes = np.abs(np.hstack(parts))
    if not magnitudes.size:
        return np.full(2, math.nan)
    return np.asarray(1.4826 * np.median(magnitudes, axis=1))


def _errors(stage: Stage, matched: NDArray[np.float32]) -> Float:
    """Errors of depth (m) and disparity (px), (2, N), of inner pixels with disparity errors below one pixel."""
    true = stage.truth.disparity.astype(np.float64)
    disparity = matched.astype(np.float64)
    used = stage.truth.visible & np.isfinite(disparity) & (np.abs(disparity - true) < 1)
    used[:_RIM] = used[-_RIM:] = used[:, :_RIM] = used[:, -_RIM:] = False
    fx_baseline = stage.camera.fx * stage.rig.baseline(0, 1)
    depth = fx_baseline / (disparity[used] + stage.rig.doffs())
    return np.stack([depth - stage.truth.depth[used], (disparity - true)[used]])


def occluded_percent(stage: Stage) -> float:
    """Percentage of occluded pixels among the left pixels whose partner is inside the right image."""
    disparity = stage.truth.disparity
    width = stage.camera.width
    partner = np.arange(width) - disparity
    inside = np.isfinite(disparity) & (partner >= 0) & (partner <= width - 1)
    return 100.0 * float((inside & ~stage.truth.visible).sum() / inside.sum())


def occlusion(table: Table) -> Finding:
    """Growth of the occlusion: proportional to B for isolated edges, slower for gaps narrower than the strip."""
    growth = over_scenes(table.where(part=SCENES), log_slope("baseline_mm", "occluded"))
    text = f"The occluded share is proportional to B^p with p between 0 and {1 + TOLERANCE:g}"
    return bounded(text, growth, 0.0, 1 + TOLERANCE, result="p = {}")


_COLUMNS = (
    Column("part", "", "part"),
    Column("method", "", "matcher"),
    Column("baseline_mm", "mm", "baseline"),
    Column("fx_px", "px", "focal length"),
    Column("z_m", "m", "depth"),
    Column("depth_error_mm", "mm", "depth error, robust s.d."),
    Column("predicted_mm", "mm", "z²/(f B) times the disparity error"),
    Column("disparity_error_px", "px", "disparity error, robust s.d."),
    Column("occluded", "%", "occluded in the right view"),
    Column("totbad2", "%", "wrong by > 2 px or unknown"),
)
_DEFAULTS = Setup(
    ("staircase", "tabletop", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1, 2)
)
LAW = (
    "Similar triangles give the depth z = f B / d of a disparity d, with the focal length f in pixels and the "
    "baseline B. An error σ of the disparity therefore gives the depth error z² σ / (f B): four times as large at "
    "twice the distance, half as large with twice the baseline or focal length. A longer baseline hides more of "
    "the scene from one of the cameras, and a longer focal length narrows the view."
)
_LINKS: dict[str, str] = {
    "docs": "docs/study_results.md#baseline-and-focal-length",
    "lesson": "docs/course/08_triangulation.py",
}
BASELINE = Study(
    name="baseline",
    question="How do depth error and occlusion depend on the baseline?",
    columns=_COLUMNS,
    measure=BY_BASELINE.measure,
    conclude=lambda table: [*BY_BASELINE.conclude(table), occlusion(table)],
    figures=(
        *BY_BASELINE.figures("baseline"),
        Figure("occlusion", "Occluded in the right view, of the left pixels inside its frame", "baseline_mm",
               "occluded", by="scene", where={"part": SCENES}),
    ),
    defaults=_DEFAULTS, law=LAW, **_LINKS,
)  # fmt: skip
FOCAL_LENGTH = Study(
    name="focal-length",
    question="How does the depth error depend on the focal length?",
    columns=_COLUMNS,
    measure=BY_FOCAL_LENGTH.measure,
    conclude=BY_FOCAL_LENGTH.conclude,
    figures=BY_FOCAL_LENGTH.figures("focal length"),
    defaults=_DEFAULTS,
    law=LAW,
    **_LINKS,
)
