"""`pinhole`: from a box without a barrier to a hole of 0.07 mm. Sharpness, light and noise; which hole is the best.

Sharpness is MTF50 by the slanted edge of ISO 12233. Two models of the hole stand side by side: "far field", the traced
picture as `twinlens.diffract` blurs it, whose pattern is spread over a pixel once more; and "Fresnel", the sharp
picture convolved with Fresnel's pattern, exact for one plane target: both three times finer than the pixels, which are
summed of them afterwards, so that the pixel's box is in the picture once, as in theory. Two rows of light: "sensor",
the level and noise that the radiometry of `Sensor` gives; "plate", the light that finds its way through a real hole.

Rules for the best diameter: 1.9 sqrt(f lambda) (Rayleigh, On pinhole photography, 1891), and sqrt(2.44 f lambda), where
the hole is as wide as its own Airy disk.
"""

import math
import warnings
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import BareAperture, Camera, Pinhole, Rig
from twinlens.camera.diffraction import diffract
from twinlens.optics.diffraction import FresnelWarning
from twinlens.rendering import render
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.bootstrap import Interval, log_slope, mean_of, over_scenes, paired_difference, unsigned
from twinlens.studies.edge_target import (
    DEPTH,
    FILM,
    PITCH,
    WAVELENGTH,
    edge_camera,
    edge_scene,
    theoretical_best,
    theory,
)
from twinlens.studies.film_levels import light_of, signal_to_noise, white_rate
from twinlens.studies.fresnel import fresnel_kernel, through_hole
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, agrees, is_above
from twinlens.studies.plate import film_light
from twinlens.studies.slanted_edge import frequency_at
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table

Float = NDArray[np.float64]

DIAMETERS_MM = (2.0, 1.4, 1.0, 0.6, 0.5, 0.4, 0.35, 0.32, 0.3, 0.29, 0.28, 0.26, 0.23, 0.2, 0.15, 0.1, 0.07)
BOX_MM = 100.0
"""A box without a barrier: a hole twice as wide as the box is deep."""
PLATES_MM = (2.5, 5.0, 10.0, BOX_MM)
"""Holes wide enough for light paths to find, and so narrow that the square law is off by 1 %; and the open box."""
SHOWN_MM = (BOX_MM, 2.0, 1.0, 0.6, 0.35, 0.15, 0.07)
RAYLEIGH_MM = 1e3 * 1.9 * math.sqrt(FILM * WAVELENGTH)
AIRY_MM = 1e3 * math.sqrt(2.44 * FILM * WAVELENGTH)
CONTRASTS = (0.5, 0.1)
_MODELS = ("far field", "Fresnel")
_LIGHTS = ("sensor", "plate")
_EDGE_SPP, _PLATE_SPP = 64, 1024
_FINER = 3
"""Times finer than its pixels is the sharp picture that Fresnel's pattern blurs."""
_TOLERANCE, _RULE_TOLERANCE = 0.02, 0.15
"""Of the best hole against wave optics: a slanted edge is good for 1 %, and the parabola through three holes for half
of that (of theory's own values at these holes it finds 0.2273 and 0.2884 mm, for 0.2277 and 0.2899). Against the rules
of thumb, which leave out the pixel and the target."""
_LIGHT_TOLERANCE = 0.02
"""1 % for the cosines of a hole of a fifth of the film distance, and two deviations of what 1500 light paths tell."""
_NEAR_BEST_MM, _SHOT_MM = 0.23, 0.2
"""Below the second a hole gives so few electrons that reading them out adds as much noise as counting them."""


def measure(setup: Setup) -> Measured:
    """A row for every seed, hole and model; and a bundled scene as every hole shows it."""
    rows: list[Row] = []
    for done, seed in enumerate(setup.seeds):
        setup.progress(0.8 * done / len(setup.seeds), "edge")
        rows += [*_edges(seed), *_lights(seed)]
    setup.progress(0.8, "pictures")
    pictures = tuple(_pictures(setup, name) for name in setup.scenes)
    return Measured(rows, pictures, {"film_m": FILM, "pitch_m": PITCH, "wavelength_m": WAVELENGTH, "depth_m": DEPTH})


def _edges(seed: int) -> list[Row]:
    """Sharpness, a row for each hole and model."""
    camera = edge_camera()
    scene, rig = edge_scene(), Rig((camera,), (np.eye(4),))
    fine = Rig((edge_camera(_FINER),), (np.eye(4),))
    sharp = _grey(render(scene, fine, Pinhole(), _EDGE_SPP // 4, stream(seed, 0))[0])
    rows: list[Row] = []
    for k, millimetres in enumerate(DIAMETERS_MM):
        hole = BareAperture(1e-3 * millimetres, FILM)
        traced = render(scene, rig, hole, _EDGE_SPP, stream(seed, 1, k))[0]
        far = _grey(_diffracted(traced, camera, hole))
        near = _binned(through_hole(sharp, _fine_kernel(millimetres)))
        for model, picture in zip(_MODELS, (far, near), strict=True):
            mtf50, mtf10 = (frequency_at(picture, contrast) / (1e3 * PITCH) for contrast in CONTRASTS)
            rows.append(
                _row(seed, model, millimetres, mtf50=mtf50, mtf10=mtf10, predicted_mtf50=theory(millimetres, 0.5))
            )
    return rows


def _lights(seed: int) -> list[Row]:
    """Light and noise, a row for each hole, and each that light paths go through."""
    camera = edge_camera()
    fixed = 0.5 / white_rate(camera, max(DIAMETERS_MM))
    unit = light_of(camera, BareAperture(1e-3, FILM), seed, len(DIAMETERS_MM) + 1)
    rows: list[Row] = []
    for k, millimetres in enumerate((BOX_MM, *DIAMETERS_MM)):
        hole = BareAperture(1e-3 * millimetres, FILM)
        noise = signal_to_noise(camera, hole, Exposure(fixed), stream(seed, 2, k))
        rows.append(_row(seed, _LIGHTS[0], millimetres, light=light_of(camera, hole, seed, k) / unit, snr=noise))
    square_law = (0.5e-3 / FILM) ** 2  # E / (pi L) of a hole of 1 mm
    for k, millimetres in enumerate(PLATES_MM):
        found = film_light(1e-3 * millimetres, FILM, _PLATE_SPP, stream(seed, 6, k))
        rows.append(_row(seed, _LIGHTS[1], millimetres, light=found / square_law))
    return rows


def _row(seed: int, model: str, millimetres: float, **known: float) -> Row:
    measured = dict.fromkeys(("mtf50", "mtf10", "predicted_mtf50", "light", "snr"), math.nan)
    place: Row = {"scene": "edge", "seed": seed, "model": model, "diameter_mm": millimetres}
    rules = {"predicted_light": millimetres**2, "rayleigh_mm": RAYLEIGH_MM, "airy_mm": AIRY_MM}
    return {**place, **measured, **known, **rules}


@lru_cache(maxsize=len(DIAMETERS_MM))
def _fine_kernel(millimetres: float) -> Float:
    """Fresnel's pattern at the fine picture's points, no wider than that picture."""
    half = _FINER * edge_camera().width // 2
    return fresnel_kernel(1e-3 * millimetres, FILM, DEPTH, WAVELENGTH, PITCH / _FINER, sub=1, most_px=half)


def _binned(fine: Float) -> Float:
    """Means of `_FINER` x `_FINER` points."""
    height, width = (side // _FINER for side in fine.shape)
    means: Float = fine.reshape(height, _FINER, width, _FINER).mean(axis=(1, 3))
    return means


def _grey(image: NDArray[Any]) -> Float:
    return np.asarray(image[..., 1], np.float64)


def _diffracted(image: NDArray[np.float32], camera: Camera, hole: BareAperture) -> NDArray[np.float32]:
    """As the hole's Airy pattern blurs it; that this is not Fresnel's is what the study shows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FresnelWarning)
        return diffract(image, camera, hole, (WAVELENGTH,) * 3)


def _pictures(setup: Setup, name: str) -> Picture:
    """The scene as each hole shows it, exposed alike bright."""
    stage = Stage.of(name, setup.width, setup.height)
    eye = Rig((stage.camera,), stage.rig.world_from_cams[:1])
    images, captions = [], []
    for k, millimetres in enumerate(SHOWN_MM):
        hole = BareAperture(1e-3 * millimetres, FILM)
        radiance = render(stage.scene, eye, hole, setup.spp, stream(0, 4, k))
        seen = radiance[0] if millimetres == BOX_MM else _coloured(radiance[0], stage.camera, hole)
        photo = Sensor.preset("ideal").expose(seen, camera=stage.camera, lens=hole, seed=stream(0, 5, k))
        images.append(photo.image.astype(np.uint8))
        captions.append("no barrier" if millimetres == BOX_MM else f"{millimetres:g} mm")
    return Picture(f"holes-{name}", f"{name} through a bare hole, {1e3 * FILM:g} mm from the film", tuple(images),
                   tuple(captions), columns=4)  # fmt: skip


def _coloured(image: NDArray[np.float32], camera: Camera, hole: BareAperture) -> NDArray[np.float32]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FresnelWarning)
        return diffract(image, camera, hole)


def conclude(table: Table) -> list[Finding]:
    """The best hole by each model, beside the rules; the law of light; what the smallest hole costs in noise."""
    fresnel, sensor = table.where(model=_MODELS[1]), table.where(model=_LIGHTS[0])
    return [
        _best_hole(fresnel, "mtf50", 0.5, "The sharpest hole, of the highest MTF50, is {} wide"),
        _best_hole(fresnel, "mtf10", 0.1, "The hole of the finest detail, of the highest MTF10, is {} wide"),
        _rule(fresnel, "mtf50", AIRY_MM, "It is sharpest near sqrt(2.44 f lambda), as wide as its Airy disk"),
        _rule(fresnel, "mtf10", RAYLEIGH_MM, "Detail is finest near Rayleigh's 1.9 sqrt(f lambda)"),
        _far_from_true(table),
        *_square_law(table.where(model=_LIGHTS[1])),
        _radiometry(table),
        _exponent(
            sensor.where(lambda row: float(row["diameter_mm"]) >= _SHOT_MM),
            "snr",
            1.0,
            0.05,
            f"At one exposure signal to noise grows as A^p, as photons arrive, down to {_SHOT_MM:g} mm: p = {{}}",
        ),
    ]


def _square_law(plates: Table) -> list[Finding]:
    """What light paths say, with no radiometry of a camera: the square law, and half of it in the open box."""
    growth = "Behind a hole in a real plate, from {:g} to {:g} mm, path-traced light grows as A^p, p = {{}}"
    narrow = sorted(PLATES_MM)[:-1]
    share = over_scenes(plates.where(diameter_mm=BOX_MM), lambda unit: unit.numbers("light") / BOX_MM**2)
    text = "Without a barrier, a hole twice as wide as the box is deep, the film gets {} of what the square law says"
    return [
        _exponent(plates, "light", 2.0, _LIGHT_TOLERANCE, growth.format(narrow[0], narrow[-1])),
        Finding(text, share, agrees(share, 0.5, _LIGHT_TOLERANCE), "", 0.5, _LIGHT_TOLERANCE),
    ]


def _radiometry(table: Table) -> Finding:
    """The sensor's radiometry, which is a formula, against light paths: in the open box, where cosines weigh most."""
    open_box = table.where(diameter_mm=BOX_MM)
    ratio = over_scenes(open_box, lambda unit: _only(unit, _LIGHTS[0]) / _only(unit, _LIGHTS[1]))
    text = "There the sensor's radiometry gives {} times the light of the paths"
    return Finding(text, ratio, agrees(ratio, 1.0, _LIGHT_TOLERANCE), "", 1.0, _LIGHT_TOLERANCE)


def _only(rows: Table, model: str) -> float:
    return float(rows.where(model=model).numbers("light").mean())


def _best(rows: Table, measure_of: str) -> Interval:
    """The diameter of the highest frequency, by a parabola through the three logarithms around each seed's best, mm."""

    def peak(unit: Table) -> float:
        known = unit.where(lambda row: math.isfinite(float(row[measure_of])))
        x, y = np.log(known.numbers("diameter_mm")), np.log(known.numbers(measure_of))
        order = np.argsort(x)
        x, y = x[order], y[order]
        k = int(np.clip(np.argmax(y), 1, len(x) - 2))
        a, b, _ = np.polyfit(x[k - 1 : k + 2], y[k - 1 : k + 2], 2)
        return math.exp(-b / (2 * a)) if a < 0 else math.exp(x[k])

    return over_scenes(rows, peak)


def _best_hole(rows: Table, measure_of: str, contrast: float, text: str) -> Finding:
    """Beside the peak of Hopkins's transfer function, found with no picture."""
    best, expected = _best(rows, measure_of), theoretical_best(contrast)
    return Finding(text, best, agrees(best, expected, _TOLERANCE), "mm", expected, _TOLERANCE)


def _rule(rows: Table, measure_of: str, rule: float, text: str) -> Finding:
    best = _best(rows, measure_of)
    return Finding(f"{text}: {{}}", best, agrees(best, rule, _RULE_TOLERANCE), "mm", rule, _RULE_TOLERANCE)


def _far_from_true(table: Table) -> Finding:
    """How much of the best hole's MTF50 the far-field pattern loses: what diffract's warning is about."""
    rows = table.where(diameter_mm=_NEAR_BEST_MM)
    peak = {model: mean_of(rows.where(model=model), "mtf50").value for model in _MODELS}
    loss = paired_difference(rows, "mtf50", "model", _MODELS[1], _MODELS[0])
    said, way = unsigned(loss, "low", "high")
    text = (
        f"The far-field pattern underrates the best holes: at {_NEAR_BEST_MM:g} mm it has an MTF50 of "
        f"{peak[_MODELS[0]]:.3g} cycles/mm, which is {{}} too {way}"
    )
    return Finding(text, said, is_above(loss), "cycles/mm")


def _exponent(rows: Table, name: str, expected: float, tolerance: float, text: str) -> Finding:
    holes = rows.where(lambda row: float(row["diameter_mm"]) < BOX_MM)
    slope = over_scenes(holes, log_slope("diameter_mm", name))
    return Finding(text, slope, agrees(slope, expected, tolerance), "", expected, tolerance)


_HOLES = {"model": _MODELS}
_SENSOR = {"diameter_mm": DIAMETERS_MM, "model": _LIGHTS[0]}
_MARKS = (("rayleigh_mm", "1.9 sqrt(f lambda)"), ("airy_mm", "sqrt(2.44 f lambda)"))
STUDY: Study = Study(
    name="pinhole",
    question="How large should the hole of a pinhole camera be?",
    columns=(
        Column("model", "", "model of the hole, or source of the light"),
        Column("diameter_mm", "mm", "diameter of the hole"),
        Column("mtf50", "cycles/mm", "sharpness on the film, MTF50"),
        Column("mtf10", "cycles/mm", "finest detail on the film, MTF10"),
        Column("predicted_mtf50", "cycles/mm", "Hopkins's transfer function"),
        Column("light", "", "light on the film, square law through 1 mm = 1"),
        Column("predicted_light", "", "square of the diameter"),
        Column("snr", "", "signal to noise at one exposure"),
        Column("rayleigh_mm", "mm", "1.9 sqrt(f lambda)"),
        Column("airy_mm", "mm", "sqrt(2.44 f lambda)"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("sharpness", "Sharpness of a bare hole", "diameter_mm", "mtf50", by="model", log_x=True, log_y=True,
               where=_HOLES, marks=_MARKS, also=("predicted_mtf50",), residual_of="predicted_mtf50"),
        Figure("detail", "Finest detail of a bare hole", "diameter_mm", "mtf10", by="model", log_x=True, log_y=True,
               where=_HOLES, marks=_MARKS),
        Figure("light", "Light on the film against the square law", "diameter_mm", "light", by="model", kind="scatter",
               log_x=True, log_y=True, also=("predicted_light",), residual_of="predicted_light",
               where={"model": _LIGHTS}),
        Figure("noise", "Signal to noise at one exposure", "diameter_mm", "snr", log_x=True, log_y=True,
               where=_SENSOR, marks=_MARKS),
    ),
    defaults=Setup(("tabletop", "staircase"), (), (0, 1, 2), spp=64),
)  # fmt: skip
