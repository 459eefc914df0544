"""`aperture`: f/1 to f/32. Wide lenses blur what is out of focus, narrow ones diffract and starve: which is the best?

Each scene's lenses are photographed from one set of light paths (`render_lens_grid`); its radiances are then exposed
(a) all for the same time, where shot noise grows as the hole shrinks, and (b) each to the same brightness; with and
without diffraction.

Theory beside it. Near its best, a matcher errs as the Cramer-Rao bound of a shift: sigma / sqrt(mean squared slope). A
texture of grain s (a Gaussian's standard deviation, measured on the sharp picture) that a blur of variance b^2 widens
keeps slopes of variance ~ 1/(s^2 + b^2)^2, with b^2 = (c/4)^2 of the blur disk, c = A fx |1/z - k|, and
(0.45 lambda N/p)^2 of the Airy pattern (the Gaussian of least squares: Zhang, Zerubia and Olivo-Marin, Gaussian
approximations of fluorescence microscope point-spread function models, Applied Optics 46(10), 2007: 0.225 lambda/NA).
Noise: signal S electrons have sqrt(S + r^2)/S relative to them. The mean over a scene's true depths of
(s^2 + b^2) sigma/S is smallest at the predicted f-number.
"""

import math
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import ThinLens
from twinlens.diffraction import diffract
from twinlens.matching import grey
from twinlens.rendering import render_lens_grid
from twinlens.sensor import Exposure, Sensor, auto_exposure
from twinlens.studies.bootstrap import bootstrap, mean_of
from twinlens.studies.pictures import crop
from twinlens.studies.stage import Stage, stream
from twinlens.studies.study import Figure, Finding, Measured, Picture, Setup, Study
from twinlens.studies.table import Column, Row, Table

Float = NDArray[np.float64]
Radiance = list[NDArray[np.float32]]

F_NUMBERS = (1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0, 22.0, 32.0)
FILM_WIDTH = 13.2e-3
"""A sensor of the 1-inch type, metres; the pixel pitch follows from the image's width."""
WAVELENGTH = 549e-9
SENSOR = Sensor.preset("machine_vision", wavelengths=(WAVELENGTH,) * 3)
LINEAR = Sensor.preset("machine_vision", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3)
EXPOSED_AT = 2.8
"""The fixed exposure is the automatic one of this f-number."""
_CROP, _ZOOM = 40, 3
_AIRY_GAUSSIAN = 0.45
_MODES = ("fixed exposure", "equal brightness")


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, f-number, exposure, diffraction and matcher; crops along the sweep."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    saved: dict[str, dict[str, float]] = {}
    for done, name in enumerate(setup.scenes):
        setup.progress(done / len(setup.scenes), name)
        pitch_um = 1e6 * FILM_WIDTH / setup.width
        stage = Stage.of(name, setup.width, setup.height, pixel_pitch_um=pitch_um)
        lenses = [lens_of(stage, number) for number in F_NUMBERS]
        begun = time.perf_counter()
        grid = render_lens_grid(stage.scene, stage.rig, lenses, setup.spp, stream(setup.seeds[0], 0))
        saved[name] = _saved(stage, setup, time.perf_counter() - begun)
        part = _sweep(setup, stage, lenses, grid.images, done)
        rows += part
        pictures.append(_crops(stage, lenses, grid.images))
    setup.progress(1.0, "")
    notes = {"f_numbers": F_NUMBERS, "film_width_m": FILM_WIDTH, "exposed_at_f": EXPOSED_AT}
    return Measured(rows, tuple(pictures), notes | {"lens_grid": saved})


def lens_of(stage: Stage, f_number: float) -> ThinLens:
    """Of working f-number v/A, focused at the middle of the scene's disparities."""
    return ThinLens(stage.camera.film_distance / f_number, stage.middle_focus)


def _saved(stage: Stage, setup: Setup, seconds: float) -> dict[str, float]:
    """What one set of light paths cost, beside as many direct photographs as there are lenses."""
    begun = time.perf_counter()
    stage.photograph(lens_of(stage, EXPOSED_AT), setup.spp, stream(setup.seeds[0], 9))
    direct = time.perf_counter() - begun
    return {"grid_s": round(seconds, 2), "direct_s_estimated": round(direct * len(F_NUMBERS), 2)}


def _sweep(
    setup: Setup, stage: Stage, lenses: Sequence[ThinLens], images: Sequence[Radiance], done: int
) -> list[Row]:  # fmt: skip
    grain = grain_px(images[len(images) // 2][0])
    fixed = _automatic(stage, lenses[F_NUMBERS.index(EXPOSED_AT)], images[F_NUMBERS.index(EXPOSED_AT)])
    rows: list[Row] = []
    for k, (number, lens, sharp) in enumerate(zip(F_NUMBERS, lenses, images, strict=True)):
        share = (done + k / len(F_NUMBERS)) / len(setup.scenes)
        setup.progress(share, f"{stage.scene.name} f/{number:g}")
        for diffraction, radiance in (("without", sharp), ("with", _diffracted(stage, lens, sharp))):
            for mode in _MODES:
                exposure = fixed if mode == _MODES[0] else _automatic(stage, lens, radiance)
                predicted = predicted_error(stage, lens, exposure, radiance[0], grain, diffraction == "with")
                for seed in setup.seeds:
                    case = (number, mode, diffraction, predicted)
                    rows += _photograph(setup, stage, lens, radiance, exposure, seed, case)
    return rows


def _photograph(
    setup: Setup, stage: Stage, lens: ThinLens, radiance: Radiance, exposure: Exposure, seed: int,
    case: tuple[float, str, str, float],
) -> list[Row]:  # fmt: skip
    number, mode, diffraction, predicted = case
    draw = stream(seed, 1, F_NUMBERS.index(number), _MODES.index(mode))
    pictures = stage.expose(radiance, lens, draw, SENSOR, exposure)
    level = float(stage.expose(radiance, lens, draw, LINEAR, exposure)[0].mean()) / 65535.0
    place: dict[str, float | str] = {
        "scene": stage.scene.name, "seed": seed, "f_number": number, "exposure": mode, "diffraction": diffraction,
        "level": level, "predicted": predicted,
    }  # fmt: skip
    return [{**place, "method": method, **scores} for method, scores in stage.errors(pictures, setup.methods).items()]


def _automatic(stage: Stage, lens: ThinLens, radiance: Radiance) -> Exposure:
    return auto_exposure(radiance, sensor=SENSOR, cameras=stage.rig.cameras, lens=lens)


def _diffracted(stage: Stage, lens: ThinLens, radiance: Radiance) -> Radiance:
    return [diffract(image, stage.camera, lens, (WAVELENGTH,) * 3) for image in radiance]


def grain_px(image: NDArray[np.float32]) -> float:
    """The texture's grain: s of the Gaussian whose smoothed white noise has this picture's variance and slopes, pixels.

    s^2 = var(I) / (2 var(dI/du)), over patches of 16 pixels, so that shading does not count as texture.
    """
    flat = grey(image).astype(np.float64)
    slopes = np.diff(flat, axis=1)
    patches = [
        (flat[y : y + 16, x : x + 16].var(), slopes[y : y + 16, x : x + 15].var())
        for y in range(0, flat.shape[0] - 15, 16)
        for x in range(0, flat.shape[1] - 15, 16)
    ]
    variance, steepness = np.mean(patches, axis=0)
    return math.sqrt(variance / (2.0 * steepness))


def predicted_error(
    stage: Stage, lens: ThinLens, exposure: Exposure, image: NDArray[np.float32], grain: float, diffracts: bool
) -> float:
    """The theory of the module's first lines, in arbitrary units: mean over the picture of (s^2 + b^2) sigma / S."""
    known = np.isfinite(stage.truth.depth)
    spread = (stage.blur(lens)[known] / 4.0) ** 2
    number = stage.camera.film_distance / lens.aperture_diameter
    if diffracts:
        spread = spread + (_AIRY_GAUSSIAN * WAVELENGTH * number / (1e-6 * stage.camera.pixel_pitch_um)) ** 2
    rate = SENSOR.level_rate(image, camera=stage.camera, lens=lens).mean(axis=-1)[known]
    wells = np.minimum(rate * exposure.time * SENSOR.full_well, SENSOR.full_well)
    step = SENSOR.full_well / 255.0 / exposure.gain
    noise = np.sqrt(wells + SENSOR.read_noise**2 + step**2 / 12.0)
    lit = wells > 0
    return float(np.mean((grain**2 + spread[lit]) * noise[lit] / wells[lit]))


def _crops(stage: Stage, lenses: Sequence[ThinLens], images: Sequence[Radiance]) -> Picture:
    """The nearest edge of the scene's middle, through every lens, exposed alike bright, with diffraction."""
    depth = np.where(np.isfinite(stage.truth.depth), stage.truth.depth, np.inf)
    inner = depth[_CROP:-_CROP, _CROP:-_CROP]
    y, x = np.unravel_index(int(np.argmin(inner)), inner.shape)
    parts = []
    for lens, radiance in zip(lenses, images, strict=True):
        seen = _diffracted(stage, lens, radiance)
        picture = stage.expose(seen, lens, 0, SENSOR)[0]
        parts.append(crop(picture, int(x) + _CROP // 2, int(y) + _CROP // 2, _CROP, _CROP, _ZOOM))
    captions = tuple(f"f/{number:g}" for number in F_NUMBERS)
    title = f"{stage.scene.name}: the same crop from f/1 to f/32"
    return Picture(f"crops-{stage.scene.name}", title, tuple(parts), captions)


def conclude(table: Table) -> list[Finding]:
    """The best f-number of each matcher beside the predicted one; the square law of light."""
    findings = [_square_law(table)]
    for mode in _MODES:
        rows = table.where(exposure=mode, diffraction="with")
        predicted = _best(rows, "predicted")
        findings += [
            _optimum(rows.where(method=method), f"{method}, {mode}", predicted) for method in rows.values("method")
        ]
    return findings


def _best(rows: Table, name: str) -> float:
    """The f-number at the least of the sweep's means, by a parabola through it and its neighbours in log N."""
    numbers = sorted({float(number) for number in rows.numbers("f_number")})
    means = [mean_of(rows.where(f_number=number), name).value for number in numbers]
    k = int(np.argmin(means))
    if k in (0, len(means) - 1):
        return numbers[k]
    a, b, _ = np.polyfit(np.log(numbers[k - 1 : k + 2]), means[k - 1 : k + 2], 2)
    return float(math.exp(-b / (2 * a))) if a > 0 else numbers[k]


def _optimum(rows: Table, text: str, predicted: float) -> Finding:
    units = [np.array([math.log(_best(unit, "totbad2"))]) for _, unit in rows.groups("scene", "seed")]
    best = bootstrap(lambda values: math.exp(float(values.mean())), units)
    stops = 2.0 * math.log2(best.value / predicted)
    return Finding(f"{text}: the best f-number, within two stops of theory", best, abs(stops) <= 2.0, "", predicted)


def _square_law(table: Table) -> Finding:
    """Mean level against A, at the fixed exposure, where nothing burns out: the exponent."""
    rows = table.where(exposure=_MODES[0], diffraction="without")
    rows = rows.where(lambda row: float(row["f_number"]) >= 2 * EXPOSED_AT and float(row["f_number"]) <= 16)
    slopes = [
        np.array([-np.polyfit(np.log(unit.numbers("f_number")), np.log(unit.numbers("level")), 1)[0]])
        for _, unit in rows.groups("scene", "seed")
    ]
    slope = bootstrap(lambda values: float(values.mean()), slopes)
    text = "At a fixed exposure the picture's mean level grows as A^p; p"
    return Finding(text, slope, abs(slope.value / 2 - 1) <= 0.01, "", 2.0, 0.01)


_ALL = ("f_number", "totbad2")
STUDY = Study(
    name="aperture",
    question="Which f-number is best for stereo, when blur, diffraction and noise are weighed?",
    columns=(
        Column("f_number", "", "f-number"),
        Column("exposure", "", "exposure"),
        Column("diffraction", "", "diffraction"),
        Column("method", "", "matcher"),
        Column("level", "", "mean level of the linear picture"),
        Column("predicted", "a.u.", "predicted error"),
        Column("totbad2", "%", "wrong by > 2 px or unknown"),
        Column("totbad1", "%", "wrong by > 1 px or unknown"),
        Column("avgerr", "px", "mean error"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("wrong", "Wrong pixels from f/1 to f/32, with diffraction", *_ALL, by="method", panel="exposure",
               log_x=True, where={"diffraction": "with"}),
        Figure("without", "Wrong pixels from f/1 to f/32, without diffraction", *_ALL, by="method", panel="exposure",
               log_x=True, where={"diffraction": "without"}),
        Figure("predicted", "What theory expects of a matcher's error", "f_number", "predicted", by="diffraction",
               panel="exposure", log_x=True, log_y=True),
        Figure("light", "Mean level at a fixed exposure", "f_number", "level", by="scene", log_x=True, log_y=True,
               where={"exposure": "fixed exposure", "diffraction": "without"}),
    ),
    defaults=Setup(("staircase", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1), width=640, height=480, spp=32),
)  # fmt: skip
