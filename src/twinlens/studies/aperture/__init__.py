"""`aperture`: the best f-number for stereo, from f/1 to f/32, given blur, diffraction and noise.

Images are exposed for the same time or to the same brightness, with and without diffraction. Two theories (`theory`)
predict the best f-number: for the median error, and for the share of wrong pixels.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.camera.film import diffract
from twinlens.rendering import NoisyImage, render_measured
from twinlens.scoring.intervals import Interval, brief
from twinlens.sensor import Exposure, auto_exposure
from twinlens.studies.aperture import theory
from twinlens.studies.aperture.theory import (
    F_NUMBERS,
    MODES,
    SENSOR,
    SHARP_AT,
    SIDE,
    WAVELENGTH,
    Evidence,
    ScaleModel,
)
from twinlens.studies.findings import SHARES, Finding, bounded, predicted
from twinlens.studies.intervals import (
    is_above,
    log_parabola_minimum,
    log_slope,
    over_scenes,
)
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study, sweep
from twinlens.studies.stage import SCORES, Stage, score_columns, stream
from twinlens.studies.table import Column, Row, Table

Radiance = Sequence[NDArray[np.float32]]

EXPOSED_AT = 1.0  # the f-number whose automatic exposure is the fixed exposure
GRAIN_AT = 5.6  # the f-number whose image is sharp enough to measure the grain
LINEAR = SENSOR.replace(output="linear", bits=16)
_CROP, _ZOOM = 40, 3
_SQUARE_LAW_AT = 11.0  # the f-number to whose level the square law is scaled
ALLOWED_STOPS = 1.5  # the Cramer-Rao bound is (N/N0 + N0/N) / 2 = 1.14 times its least
PATHS_ALLOWED = 0.5  # rendering noise over sensor noise: 12 % more noise in total
_LAW_FROM, _LAW_TO = 2.8, 16.0


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, f-number, exposure, diffraction and matcher; crops along the sweep."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    scales = {}
    for name, seed in sweep(setup, setup.seeds):
        pitch = theory.PIXEL_PITCH_UM
        stage = Stage.of(name, setup.width, setup.height, pixel_pitch_um=pitch)
        model = ScaleModel.of(stage)
        pairs = []
        for number, f_number in enumerate(F_NUMBERS):
            lens, draw = model.full_size(model.lens(f_number)), stream(seed, 0, number)
            pair, _ = render_measured(
                stage.scene, stage.rig, lens, setup.spp, draw, denoise=True
            )
            pairs.append(pair)
        rows += _rows(setup, model, pairs, seed)
        if seed == setup.seeds[0]:
            scales[name] = model.scale
            pictures.append(_crops(model, [*map(_images, pairs)]))
    notes = {
        "f_numbers": F_NUMBERS,
        "pixel_pitch_um": theory.PIXEL_PITCH_UM,
        "blur_px": theory.BLUR_PX,
        "scales": scales,
        "exposed_at_f": EXPOSED_AT,
        "theory_block_size": SIDE,
    }
    models = ", ".join(f"{name} 1:{1 / scale:.0f}" for name, scale in scales.items())
    return Measured(rows, tuple(pictures), notes, {"models": models})


def _rows(
    setup: Setup, model: ScaleModel, pairs: Sequence[Sequence[NoisyImage]], seed: int
) -> list[dict[str, Any]]:
    stage = model.stage
    grid = [_images(pair) for pair in pairs]
    theories = _Theories.of(model, grid)
    fixed = automatic(stage, model.lens(EXPOSED_AT), grid[F_NUMBERS.index(EXPOSED_AT)])
    rows: list[dict[str, Any]] = []
    for number, f_number in enumerate(F_NUMBERS):
        lens, traced = model.lens(f_number), grid[number]
        # The noise of the renderer in units of the image, which the theory adds to that of the sensor.
        paths = _rms([view.error for view in pairs[number]]) / _rms(traced)
        for diffracts in (False, True):
            radiance = diffracted(stage, lens, traced) if diffracts else traced
            exposures = (fixed, automatic(stage, lens, radiance))
            for mode, exposure in zip(MODES, exposures, strict=True):
                case = {
                    "scene": stage.scene.name,
                    "seed": seed,
                    "f_number": f_number,
                    "exposure": mode,
                    "diffraction": "with" if diffracts else "without",
                    "level": _level(stage, lens, exposure, radiance[0]),
                }
                case |= theories.columns(lens, exposure, radiance[0], diffracts, paths)
                # With and without diffraction from the same random stream.
                noise = stream(seed, 1, number, MODES.index(mode))
                pictures = stage.expose(radiance, lens, noise, SENSOR, exposure)
                rows += [
                    case | _scores(stage, pictures, method) for method in setup.methods
                ]
    _add_curves(rows)
    return rows


class _Theories(NamedTuple):
    """What both theories know of a scene: its scale model, the evidence of its sharp images, and their grain."""

    model: ScaleModel
    evidence: Evidence
    grain: float

    @classmethod
    def of(cls, model: ScaleModel, grid: Sequence[Radiance]) -> "_Theories":
        """From the images of all f-numbers."""
        sharp, lens = grid[F_NUMBERS.index(SHARP_AT)], model.lens(SHARP_AT)
        evidence = Evidence.of(model.stage, lens, model.blur(lens), sharp)
        grain = theory.grain_px(grid[F_NUMBERS.index(GRAIN_AT)][0])
        return cls(model, evidence, grain)

    def columns(
        self,
        lens: ThinLens,
        exposure: Exposure,
        left: NDArray[np.float32],
        diffracts: bool,
        paths: float,
    ) -> dict[str, float]:
        """The predicted error, share of wrong pixels, and noise of the renderer over that of the sensor."""
        stage, blur = self.model.stage, self.model.blur(lens)
        wrong, path_noise = self.evidence.expected(
            lens, exposure, blur, diffracts, paths
        )
        error = theory.predicted_error(
            stage, lens, exposure, left, blur, self.grain, diffracts
        )
        return {"predicted": error, "predicted_wrong": wrong, "path_noise": path_noise}


def _images(pair: Sequence[NoisyImage]) -> list[NDArray[np.float32]]:
    """The images of both views."""
    return [view.image for view in pair]


def _scores(stage: Stage, pictures: tuple[Any, Any], method: str) -> dict[str, Any]:
    """The columns of a matcher's disparity map."""
    scores = stage.score(stage.match(pictures, method), pictures)
    a50 = scores.regions["nonocc"]["A50"]
    return {"method": method, **score_columns(scores), "a50": a50}


def _level(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32]
) -> float:
    """The mean linear level of the left image, in fractions of full scale."""
    photo = LINEAR.expose(
        image, camera=stage.camera, lens=lens, seed=0, exposure=exposure
    )
    return float(photo.image.mean()) / 65535.0


def _rms(images: Radiance) -> float:
    squares = [np.square(image, dtype=float).mean() for image in images]
    return math.sqrt(np.mean(squares))


def _add_curves(rows: list[dict[str, Any]]) -> None:
    """Add to the rows of a scene and seed the f-numbers that the theories predict, and the square law of light."""
    for mode, diffraction in itertools.product(MODES, ("without", "with")):
        curve = [
            row
            for row in rows
            if (row["exposure"], row["diffraction"]) == (mode, diffraction)
        ]
        by_f_number = {row["f_number"]: row for row in curve}  # one row of each
        level = by_f_number[_SQUARE_LAW_AT]["level"]
        best = _minimum(by_f_number, "predicted")
        best_wrong = _minimum(by_f_number, "predicted_wrong")
        for row in curve:
            row["theory_best"] = best
            row["theory_best_wrong"] = best_wrong
            row["square_law"] = level * (_SQUARE_LAW_AT / row["f_number"]) ** 2


def _minimum(by_f_number: Mapping[float, Mapping[str, Any]], column: str) -> float:
    values = [row[column] for row in by_f_number.values()]
    return log_parabola_minimum(np.array(list(by_f_number)), np.array(values))


def automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [
        diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance
    ]


def _crops(model: ScaleModel, images: Sequence[Radiance]) -> Picture:
    """A crop around the nearest pixel of the middle of the image, through every lens, at equal brightness."""
    stage = model.stage
    side = min(_CROP, *(length // 3 for length in stage.truth.depth.shape))
    inner = stage.truth.depth[side:-side, side:-side]
    row, column = np.unravel_index(int(np.argmin(inner)), inner.shape)
    y, x = int(row) + side // 2, int(column) + side // 2
    parts = []
    for f_number, radiance in zip(F_NUMBERS, images, strict=True):
        lens = model.lens(f_number)
        picture = stage.expose(diffracted(stage, lens, radiance), lens, 0, SENSOR)[0]
        crop = picture[y : y + side, x : x + side]
        parts.append(crop.repeat(_ZOOM, axis=0).repeat(_ZOOM, axis=1))
    title = f"{stage.scene.name}: the same crop from f/1 to f/32"
    return Picture(
        f"crops-{stage.scene.name}",
        title,
        tuple(parts),
        tuple(f"f/{number:g}" for number in F_NUMBERS),
    )


class Aim(NamedTuple):
    """A column of errors, and the column of the f-number that theory predicts for them."""

    errors: str
    theory: str

    def mean_at(self, rows: Table, f_number: float) -> float:
        return float(rows.where(f_number=f_number).numbers(self.errors).mean())

    def best(self, rows: Table) -> float:
        return min(F_NUMBERS, key=lambda number: self.mean_at(rows, number))

    def stops_from_theory(self, unit: Table) -> float:
        """Stops from theory's f-number to the best one of a scene and seed; positive if narrower."""
        errors = np.array([self.mean_at(unit, number) for number in F_NUMBERS])
        best = log_parabola_minimum(np.array(F_NUMBERS), errors)
        return 2.0 * math.log2(best / float(unit.numbers(self.theory)[0]))

    def range(self, rows: Table) -> str:
        numbers = rows.numbers(self.theory)
        return f"f/{numbers.min():.2g} to f/{numbers.max():.2g}"


WRONG = Aim("totbad2", "theory_best_wrong")
MEDIAN = Aim("a50", "theory_best")


def conclude(table: Table) -> list[Finding]:
    """The square law of light; best f-numbers for wrong pixels and median error against theory; rendering noise."""
    without = table.where(diffraction="without")
    with_diffraction = table.where(diffraction="with")
    findings = [_square_law(without.where(exposure=MODES[0]))]
    for mode in MODES:
        for (method,), rows in with_diffraction.where(exposure=mode).groups("method"):
            findings.append(_optimum(rows, f"{method}, {mode}"))
    medians = [_medians(with_diffraction.where(exposure=mode), mode) for mode in MODES]
    noise = [_rendering_noise(without.where(exposure=mode), mode) for mode in MODES]
    return [*findings, *medians, *noise]


def _square_law(rows: Table) -> Finding:
    """The exponent of the level in the aperture, where the image is neither saturated nor dark."""
    bright = rows.where(lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO)
    fall = log_slope("f_number", "level")
    exponent = over_scenes(bright, lambda unit: -fall(unit))
    text = "At a fixed exposure the mean level is proportional to A^p with p = {}"
    return predicted(text, exponent, 2.0, 0.01)


def _rendering_noise(rows: Table, mode: str) -> Finding:
    ratio = over_scenes(rows, lambda unit: unit.numbers("path_noise").mean())
    text = f"At {mode}, the rendering noise is less than {PATHS_ALLOWED} of the sensor noise, averaged over the sweep"
    return bounded(
        text, ratio, -math.inf, PATHS_ALLOWED, result="{} times the sensor noise"
    )


def _optimum(rows: Table, label: str) -> Finding:
    best = WRONG.best(rows)
    end = ", an end of the sweep" if best in (F_NUMBERS[0], F_NUMBERS[-1]) else ""
    cost, near = cost_over_best(rows, WRONG).value, is_near(rows, WRONG)
    flat = (
        "; the curve is too flat compared with its noise to decide"
        if near is None
        else ""
    )
    return Finding(
        f"{label}: in every scene the f-number with the fewest wrong pixels is within {ALLOWED_STOPS} stops of theory",
        over_scenes(rows, WRONG.stops_from_theory), bool(near), "stops", decided=near is not None,
        result=f"fewest at f/{best:g}{end}; theory {WRONG.range(rows)}; mean distance {{}} (positive: narrower); "
        f"theory's f-number has {brief(abs(cost))} percentage points {'fewer' if cost < 0 else 'more'} wrong "
        f"pixels{flat}",
        needs=SHARES,
    )  # fmt: skip


def _medians(rows: Table, mode: str) -> Finding:
    near = {
        str(method): is_near(part, MEDIAN) for (method,), part in rows.groups("method")
    }
    verdicts = []
    for words, verdict in (
        ("within", True),
        ("outside in some scene", False),
        ("too flat to decide", None),
    ):
        methods = [method for method in near if near[method] is verdict]
        if methods:
            verdicts.append(f"{words} for {', '.join(methods)}")
    decided = [verdict for verdict in near.values() if verdict is not None]
    distance = over_scenes(
        rows,
        lambda unit: [
            MEDIAN.stops_from_theory(part) for _, part in unit.groups("method")
        ],
    )
    return Finding(
        f"At {mode}, for every matcher and scene, the f-number with the least median error is within {ALLOWED_STOPS} "
        "stops of the Cramer-Rao bound's",
        distance, bool(decided) and all(decided), "stops", decided=bool(decided),
        result=f"bound {MEDIAN.range(rows)}; mean distance {{}} (positive: narrower); {'; '.join(verdicts)}",
        needs=SHARES,
    )  # fmt: skip


def is_near(rows: Table, aim: Aim) -> bool | None:
    """Whether a matcher's best f-number is within ALLOWED_STOPS of theory's in each scene; None if undecided.

    It is undecided if the errors two stops from the best f-number are not significantly above the least error, and
    neither are those at theory's f-number in the scenes where it is too far.
    """
    stops = {
        scene: over_scenes(part, aim.stops_from_theory).value
        for (scene,), part in rows.groups("scene")
    }
    far = [scene for scene, distance in stops.items() if abs(distance) > ALLOWED_STOPS]
    if far and _is_cost(cost_over_best(rows.where(scene=far), aim)):
        return False
    return not far if _is_cost(cost_over_best(rows, aim, steps=2)) else None


def _is_cost(cost: Interval) -> bool:
    """Whether a cost is positive, by the interval of a sufficient number of scenes or seeds, or of a single one.

    A single measurement has no interval; it serves to count the seeds that support a claim.
    """
    return is_above(cost) and (cost.units == 1 or cost.units >= SHARES.units)


def cost_over_best(rows: Table, aim: Aim, steps: int = 0) -> Interval:
    """The mean error above the least one: at theory's f-number, or at the better of those `steps` from the best one.

    The best f-number is cross-validated: found on the scene's other seeds, if there are any.
    """

    def cost(unit: Table) -> float:
        scene, seed = unit.rows[0]["scene"], unit.rows[0]["seed"]
        further = rows.where(lambda row: row["seed"] != seed, scene=scene)
        best = aim.best(further if len(further) else unit)
        if steps:
            index = F_NUMBERS.index(best)
            candidates = [
                F_NUMBERS[number]
                for number in (index - steps, index + steps)
                if 0 <= number < len(F_NUMBERS)
            ]
        else:
            theory = float(unit.numbers(aim.theory)[0])
            candidates = [min(F_NUMBERS, key=lambda f: abs(math.log(f / theory)))]
        least = min(aim.mean_at(unit, f_number) for f_number in candidates)
        return least - aim.mean_at(unit, best)

    return over_scenes(rows, cost)


def _theory(name: str, title: str, y: str, by: str = "scene", **more: Any) -> Figure:
    return Figure(name, f"{title}, with diffraction", "f_number", y, by=by, panel="exposure", log_x=True, best="least",
                  where={"diffraction": "with"}, **more)  # fmt: skip


LAW = (
    "A lens of aperture A blurs a point at depth z by c = A f |1/z - 1/z_focus| pixels, where f is in pixels. "
    "Diffraction adds the Airy disk, whose diameter 2.44 λ N grows with the f-number N. The light on the film is "
    "proportional to 1/N². A wide aperture has much blur and little noise, a narrow one much diffraction and, at "
    "a fixed exposure, much noise: the best f-number for stereo is between them. It is predicted for the share of "
    "wrong pixels, by the 9x9 windows that noise shifts by more than 2 pixels, and for the median error, by the "
    "Cramer-Rao bound."
)
STUDY = Study(
    name="aperture",
    question="Which f-number is best for stereo, given blur, diffraction and noise?",
    columns=(
        Column("f_number", "", "f-number"),
        Column("exposure", "", "exposure"),
        Column("diffraction", "", "diffraction"),
        Column("method", "", "matcher"),
        Column("level", "", "mean linear level"),
        Column("square_law", "", "A², scaled to the level at f/11"),
        Column("predicted", "a.u.", "predicted error"),
        Column("theory_best", "", "f-number of the least predicted error"),
        Column("predicted_wrong", "%", "predicted wrong by > 2 px"),
        Column("theory_best_wrong", "", "f-number of the fewest predicted wrong pixels"),
        Column("path_noise", "", "rendering noise over sensor noise, before diffraction"),
        *SCORES,
        Column("a50", "px", "median error"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        *(Figure(name + suffix, f"Wrong pixels at {mode}, {diffraction} diffraction", "f_number", "totbad2",
                 by="method", panel="scene", log_x=True, best="least", marks=(("theory_best_wrong", "theory"),),
                 where={"exposure": mode, "diffraction": diffraction})
          for diffraction, suffix in (("with", ""), ("without", "-without"))
          for name, mode in zip(("fixed", "equal"), MODES, strict=True)),
        _theory("median", "Median error and its theory", "a50", by="method", log_y=True,
                marks=(("theory_best", "theory"),)),
        _theory("predicted-wrong", "Predicted wrong pixels", "predicted_wrong"),
        _theory("predicted", "Cramer-Rao bound of the error", "predicted", log_y=True),
        Figure("light", "Mean level at a fixed exposure", "f_number", "level", by="scene", log_x=True, log_y=True,
               also=("square_law",), residual_of="square_law",
               where={"exposure": MODES[0], "diffraction": "without", "f_number": F_NUMBERS[:9]}),
    ),
    law=LAW, docs="docs/study_results.md#aperture", lesson="docs/course/05_aperture_and_depth_of_field.py",
    defaults=Setup(
        ("staircase", "cards", "tabletop"),
        ("sad", "ssd", "ncc", "zncc", "census", "rank", "birchfield_tomasi", "sgm"), (0, 1),
        width=240, height=180,
    ),
)  # fmt: skip
