"""`aperture`: the best f-number for stereo, from f/1 to f/32, given blur, diffraction and noise.

Images are exposed for the same time or to the same brightness, with and without diffraction. Two theories (`theory`)
predict the best f-number: for the median error, and for the share of wrong pixels.
"""

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.camera.film import diffract
from twinlens.rendering import NoisyImage, render_measured
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
    Model,
)
from twinlens.studies.findings import Finding, predicted
from twinlens.studies.intervals import (
    Interval,
    brief,
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
GRAIN_AT = (
    5.6  # the f-number whose image is sharp enough to measure the texture's grain
)
LINEAR = SENSOR.replace(output="linear", bits=16)
_CROP, _ZOOM = 40, 3
_SQUARE_LAW_AT = 11.0  # the f-number to whose level the square law is scaled
ALLOWED_STOPS = (
    1.5  # the Cramer-Rao bound, (N/N0 + N0/N) / 2 of its minimum, is 1.14 there
)
PATHS_ALLOWED = (
    0.5  # rendering noise over sensor noise: increases the total noise by 12 %
)
_LAW_FROM, _LAW_TO = 2.8, 16.0


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, f-number, exposure, diffraction and matcher; crops along the sweep."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    scales = {}
    for name, seed in sweep(setup, setup.seeds):
        model = Model.of(
            Stage.of(
                name, setup.width, setup.height, pixel_pitch_um=theory.PIXEL_PITCH_UM
            )
        )
        lenses = [model.full_size(model.lens(number)) for number in F_NUMBERS]
        scene, rig = model.stage.scene, model.stage.rig
        pairs = [
            render_measured(
                scene, rig, lens, setup.spp, stream(seed, 0, k), denoise=True
            )[0]
            for k, lens in enumerate(lenses)
        ]
        rows += _rows(setup, model, pairs, seed)
        if seed == setup.seeds[0]:
            scales[name] = model.scale
            pictures.append(
                _crops(model, [[view.image for view in pair] for pair in pairs])
            )
    notes = {"f_numbers": F_NUMBERS, "pixel_pitch_um": theory.PIXEL_PITCH_UM, "blur_px": theory.BLUR_PX,
             "scales": scales, "exposed_at_f": EXPOSED_AT, "theory_block_size": SIDE}  # fmt: skip
    models = ", ".join(f"{name} 1:{1 / scale:.0f}" for name, scale in scales.items())
    return Measured(rows, tuple(pictures), notes, {"models": models})


def _rows(
    setup: Setup, model: Model, pairs: Sequence[Sequence[NoisyImage]], seed: int
) -> list[dict[str, Any]]:
    stage = model.stage
    grid = [[view.image for view in pair] for pair in pairs]
    sharp, lens = grid[F_NUMBERS.index(SHARP_AT)], model.lens(SHARP_AT)
    evidence = Evidence.of(stage, lens, model.blur(lens), sharp)
    grain = theory.grain_px(grid[F_NUMBERS.index(GRAIN_AT)][0])
    fixed = automatic(stage, model.lens(EXPOSED_AT), grid[F_NUMBERS.index(EXPOSED_AT)])
    rows: list[dict[str, Any]] = []
    for k, number in enumerate(F_NUMBERS):
        lens, traced = model.lens(number), grid[k]
        blur, paths = (
            model.blur(lens),
            _rms([view.error for view in pairs[k]]) / _rms(traced),
        )
        for diffraction, radiance in (
            ("without", traced),
            ("with", diffracted(stage, lens, traced)),
        ):
            for mode, exposure in zip(
                MODES, (fixed, automatic(stage, lens, radiance)), strict=True
            ):
                diffracts = diffraction == "with"
                wrong, path_noise = evidence.expected(
                    lens, exposure, blur, diffracts, paths
                )
                photo = LINEAR.expose(
                    radiance[0],
                    camera=stage.camera,
                    lens=lens,
                    seed=0,
                    exposure=exposure,
                )
                case = {
                    "scene": stage.scene.name, "seed": seed, "f_number": number, "exposure": mode,
                    "diffraction": diffraction, "level": float(photo.image.mean()) / 65535.0,
                    "predicted": theory.predicted_error(stage, lens, exposure, radiance[0], blur, grain, diffracts),
                    "predicted_wrong": wrong, "path_noise": path_noise,
                }  # fmt: skip
                pictures = stage.expose(
                    radiance,
                    lens,
                    stream(seed, 1, k, MODES.index(mode)),
                    SENSOR,
                    exposure,
                )
                for method in setup.methods:
                    scores = stage.score(stage.match(pictures, method), pictures)
                    a50 = scores.regions["nonocc"]["A50"]
                    rows.append(
                        {**case, "method": method, **score_columns(scores), "a50": a50}
                    )
    _add_curves(rows)
    return rows


def _rms(images: Radiance) -> float:
    return math.sqrt(
        np.mean([np.square(image, dtype=float).mean() for image in images])
    )


def _add_curves(rows: list[dict[str, Any]]) -> None:
    """Add to the rows of a scene and seed the f-numbers that the theories predict, and the square law of light."""
    for mode, diffraction in itertools.product(MODES, ("without", "with")):
        curve = [
            row
            for row in rows
            if (row["exposure"], row["diffraction"]) == (mode, diffraction)
        ]
        at = {row["f_number"]: row for row in curve}
        best, best_wrong = (
            log_parabola_minimum(
                np.array(list(at)), np.array([row[column] for row in at.values()])
            )
            for column in ("predicted", "predicted_wrong")
        )
        for row in curve:
            law = at[_SQUARE_LAW_AT]["level"] * (_SQUARE_LAW_AT / row["f_number"]) ** 2
            row |= {
                "theory_best": best,
                "theory_best_wrong": best_wrong,
                "square_law": law,
            }


def automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [
        diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance
    ]


def _crops(model: Model, images: Sequence[Radiance]) -> Picture:
    """A crop around the nearest pixel of the middle of the image, through every lens, at equal brightness."""
    stage = model.stage
    side = min(_CROP, *(length // 3 for length in stage.truth.depth.shape))
    inner = stage.truth.depth[side:-side, side:-side]
    y, x = (
        int(k) + side // 2 for k in np.unravel_index(int(np.argmin(inner)), inner.shape)
    )
    parts = []
    for lens, radiance in zip(map(model.lens, F_NUMBERS), images, strict=True):
        picture = stage.expose(diffracted(stage, lens, radiance), lens, 0, SENSOR)[0]
        parts.append(
            picture[y : y + side, x : x + side]
            .repeat(_ZOOM, axis=0)
            .repeat(_ZOOM, axis=1)
        )
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
        return 2.0 * math.log2(
            log_parabola_minimum(np.array(F_NUMBERS), errors)
            / float(unit.numbers(self.theory)[0])
        )

    def range(self, rows: Table) -> str:
        numbers = rows.numbers(self.theory)
        return f"f/{numbers.min():.2g} to f/{numbers.max():.2g}"


WRONG = Aim("totbad2", "theory_best_wrong")
MEDIAN = Aim("a50", "theory_best")


def conclude(table: Table) -> list[Finding]:
    """The square law of light; best f-numbers for wrong pixels and median error against theory; rendering noise."""
    without, with_diffraction = (
        {mode: table.where(exposure=mode, diffraction=each) for mode in MODES}
        for each in ("without", "with")
    )
    fall = log_slope("f_number", "level")
    bright = without[MODES[0]].where(
        lambda row: _LAW_FROM <= float(row["f_number"]) <= _LAW_TO
    )  # not saturated
    law = "At a fixed exposure the mean level is proportional to A^p with p = {}"
    findings = [
        predicted(law, over_scenes(bright, lambda unit: -fall(unit)), 2.0, 0.01),
        *(_optimum(part, f"{method}, {mode}")
          for mode, rows in with_diffraction.items() for (method,), part in rows.groups("method")),
        *(_medians(rows, mode) for mode, rows in with_diffraction.items()),
    ]  # fmt: skip
    for mode, rows in without.items():
        ratio = over_scenes(rows, lambda unit: unit.numbers("path_noise").mean())
        text = f"At {mode}, the rendering noise is less than {PATHS_ALLOWED} of the sensor noise"
        holds = ratio.value < PATHS_ALLOWED and not ratio.high >= PATHS_ALLOWED
        findings.append(
            Finding(
                f"{text}, averaged over the sweep",
                ratio,
                holds,
                result="{} times the sensor noise",
            )
        )
    return findings


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
    )  # fmt: skip


def _medians(rows: Table, mode: str) -> Finding:
    near = {
        str(method): is_near(part, MEDIAN) for (method,), part in rows.groups("method")
    }
    verdicts = [
        f"{words} for {', '.join(methods)}"
        for words, verdict in (
            ("within", True),
            ("outside in some scene", False),
            ("too flat to decide", None),
        )
        if (methods := [method for method, found in near.items() if found is verdict])
    ]
    decided = [found for found in near.values() if found is not None]
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
    if far and is_above(cost_over_best(rows.where(scene=far), aim)):
        return False
    return not far if is_above(cost_over_best(rows, aim, steps=2)) else None


def cost_over_best(rows: Table, aim: Aim, steps: int = 0) -> Interval:
    """The mean error above the least one: at theory's f-number, or at the better of those `steps` from the best one.

    The best f-number is cross-validated: found on the scene's other seeds, if there are any.
    """

    def cost(unit: Table) -> float:
        own, theory = unit.rows[0], float(unit.numbers(aim.theory)[0])
        others = rows.where(lambda row: row["seed"] != own["seed"], scene=own["scene"])
        best = aim.best(others if len(others) else unit)
        at = F_NUMBERS.index(best)
        places = [
            F_NUMBERS[k] for k in (at - steps, at + steps) if 0 <= k < len(F_NUMBERS)
        ]
        if not steps:
            places = [min(F_NUMBERS, key=lambda number: abs(math.log(number / theory)))]
        return min(aim.mean_at(unit, number) for number in places) - aim.mean_at(
            unit, best
        )

    return over_scenes(rows, cost)


def _theory(name: str, title: str, y: str, by: str = "scene", **more: Any) -> Figure:
    return Figure(name, f"{title}, with diffraction", "f_number", y, by=by, panel="exposure", log_x=True, best="least",
                  where={"diffraction": "with"}, **more)  # fmt: skip


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
    defaults=Setup(
        ("staircase", "cards", "tabletop"),
        ("sad", "ssd", "ncc", "zncc", "census", "rank", "birchfield_tomasi", "sgm"), (0, 1),
        width=240, height=180,
    ),
)  # fmt: skip
