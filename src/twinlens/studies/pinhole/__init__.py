"""`pinhole`: sharpness, light and noise behind a bare hole, from an open box down to 0.07 mm; the best diameter.

Sharpness is the MTF50 of a slanted edge by two models. "far field": the traced image, blurred by `twinlens.diffract`.
"Fresnel": the sharp image, three times finer than the pixels, convolved with Fresnel's pattern and binned. Light is
measured in two ways: "sensor", by the radiometry of `Sensor`; "plate", by paths traced through a hole in a plate.

Rules for the best diameter: 1.9 sqrt(f lambda) (Rayleigh, On pinhole photography, 1891), and sqrt(2.44 f lambda), at
which the hole is as wide as its Airy disk.
"""

import math
import warnings
from functools import lru_cache
from typing import Any

import numpy as np

from twinlens.camera import BareAperture, Pinhole, Rig
from twinlens.camera.film import diffract
from twinlens.geometry import Float
from twinlens.optics.diffraction import FresnelWarning
from twinlens.rendering import render
from twinlens.scoring.intervals import Interval
from twinlens.sensor import Sensor
from twinlens.studies.findings import Finding, compared, power_law, predicted
from twinlens.studies.intervals import (
    log_parabola_minimum,
    over_scenes,
    paired_difference,
)
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study
from twinlens.studies.pinhole import film
from twinlens.studies.pinhole.film import (
    DEPTH,
    FILM,
    PITCH,
    WAVELENGTH,
    edge_camera,
    exposed_rate,
    predicted_best,
)
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table

DIAMETERS_MM = (
    2.0,
    1.4,
    1.0,
    0.6,
    0.5,
    0.4,
    0.35,
    0.32,
    0.3,
    0.29,
    0.28,
    0.26,
    0.23,
    0.2,
    0.15,
    0.1,
    0.07,
)
BOX_MM = 100.0  # the open box: a hole twice as wide as the box is deep
PLATES_MM = (2.5, 5.0, 10.0, BOX_MM)
"""Wide enough for light paths; the square law holds within 1 % but for the box."""
SHOWN_MM = (BOX_MM, 2.0, 1.0, 0.6, 0.35, 0.15, 0.07)
RAYLEIGH_MM = 1e3 * 1.9 * math.sqrt(FILM * WAVELENGTH)
AIRY_MM = 1e3 * math.sqrt(2.44 * FILM * WAVELENGTH)
MODELS = ("far field", "Fresnel")
LIGHTS = ("sensor", "plate")
_EDGE_SPP, _PLATE_SPP = 64, 1024
_FINER = 3  # oversampling of the sharp image
_TOLERANCE = 0.02  # 1 % for the slanted edge, 0.5 % for the parabola
_RULE_TOLERANCE = 0.15  # the rules ignore pixel and target distance
_LIGHT_TOLERANCE = 0.02  # 1 % for the cosines at the widest hole, two standard deviations of 1500 light paths
_NEAR_BEST_MM = 0.23
_SHOT_MM = 0.2  # below it, read noise adds as much as shot noise


def measure(setup: Setup) -> Measured:
    """A row for every seed, hole and model; images of bundled scenes through every hole."""
    rows: list[Row] = []
    with warnings.catch_warnings():  # the far-field pattern is compared with Fresnel's
        warnings.simplefilter("ignore", FresnelWarning)
        for done, seed in enumerate(setup.seeds):
            setup.progress(0.8 * done / len(setup.seeds), "edge")
            rows += [*_edges(seed), *_lights(seed)]
        setup.progress(0.8, "pictures")
        pictures = tuple(_pictures(setup, name) for name in setup.scenes)
    notes = {
        "film_m": FILM,
        "pitch_m": PITCH,
        "wavelength_m": WAVELENGTH,
        "depth_m": DEPTH,
    }
    return Measured(rows, pictures, notes)


def _hole(millimetres: float) -> BareAperture:
    return BareAperture(1e-3 * millimetres, FILM)


def _edges(seed: int) -> list[Row]:
    """Sharpness: a row for each hole and model."""
    camera = edge_camera()
    scene, rig = film.edge_scene(), Rig((camera,), (np.eye(4),))
    fine = Rig((edge_camera(_FINER),), (np.eye(4),))
    (sharp,) = render(scene, fine, Pinhole(), _EDGE_SPP // 4, stream(seed, 0))
    sharp_green = sharp[..., 1].astype(np.float64)
    binning = camera.height, _FINER, camera.width, _FINER
    rows: list[Row] = []
    for number, millimetres in enumerate(DIAMETERS_MM):
        hole = _hole(millimetres)
        (traced,) = render(scene, rig, hole, _EDGE_SPP, stream(seed, 1, number))
        far = diffract(traced, camera, hole, (WAVELENGTH,) * 3)[..., 1]
        near = film.convolved(sharp_green, _fine_kernel(millimetres))
        near = near.reshape(binning).mean(axis=(1, 3))
        theory = film.predicted_frequency(millimetres, 0.5)
        for model, picture in zip(MODELS, (far.astype(float), near), strict=True):
            measured = {
                "mtf50": film.frequency_at(picture, 0.5) / (1e3 * PITCH),
                "mtf10": film.frequency_at(picture, 0.1) / (1e3 * PITCH),
                "predicted_mtf50": theory,
            }
            rows.append(_row(seed, model, millimetres, **measured))
    return rows


def _lights(seed: int) -> list[Row]:
    """Light and noise: a row for each hole, and for each plate."""
    camera = edge_camera()
    fixed = film.half_of_white(camera, _hole(max(DIAMETERS_MM)))
    unit = exposed_rate(camera, _hole(1.0), stream(seed, 3, len(DIAMETERS_MM) + 1))
    rows: list[Row] = []
    for number, millimetres in enumerate((BOX_MM, *DIAMETERS_MM)):
        hole = _hole(millimetres)
        levels = film.exposed(camera, hole, fixed, stream(seed, 2, number))
        is_saturated = levels.max() >= 65535
        snr = math.nan if is_saturated else float(levels.mean() / levels.std())
        light = exposed_rate(camera, hole, stream(seed, 3, number)) / unit
        rows.append(_row(seed, LIGHTS[0], millimetres, light=light, snr=snr))
    square_law = (0.5e-3 / FILM) ** 2  # E / (pi L) of a hole of 1 mm
    for number, millimetres in enumerate(PLATES_MM):
        draw = stream(seed, 6, number)
        light = film.film_light(1e-3 * millimetres, FILM, _PLATE_SPP, draw)
        rows.append(_row(seed, LIGHTS[1], millimetres, light=light / square_law))
    return rows


def _row(seed: int, model: str, millimetres: float, **measured: float) -> Row:
    return {
        "scene": "edge",
        "seed": seed,
        "model": model,
        "diameter_mm": millimetres,
        **measured,
        "predicted_light": millimetres**2,
        "rayleigh_mm": RAYLEIGH_MM,
        "airy_mm": AIRY_MM,
    }


@lru_cache(maxsize=len(DIAMETERS_MM))
def _fine_kernel(millimetres: float) -> Float:
    """Fresnel's pattern sampled for the fine image, no wider than that image."""
    half = _FINER * edge_camera().width // 2
    return film.fresnel_kernel(
        1e-3 * millimetres, FILM, DEPTH, WAVELENGTH, PITCH / _FINER, sub=1, most_px=half
    )


def _pictures(setup: Setup, name: str) -> Picture:
    """The scene through each hole, with automatic exposure."""
    stage = Stage.of(name, setup.width, setup.height)
    rig = Rig((stage.camera,), stage.rig.world_from_cams[:1])
    images, captions = [], []
    for k, millimetres in enumerate(SHOWN_MM):
        hole = _hole(millimetres)
        radiance = render(
            stage.scene, rig, hole, setup.spp, stream(0, 4, k), denoise=True
        )[0]
        if millimetres != BOX_MM:
            radiance = diffract(radiance, stage.camera, hole)
        photo = Sensor.preset("ideal").expose(
            radiance, camera=stage.camera, lens=hole, seed=stream(0, 5, k)
        )
        images.append(photo.image.astype(np.uint8))
        captions.append("open box" if millimetres == BOX_MM else f"{millimetres:g} mm")
    title = f"{name} through a bare hole, {1e3 * FILM:g} mm from the film"
    return Picture(f"holes-{name}", title, tuple(images), tuple(captions), columns=4)


def conclude(table: Table) -> list[Finding]:
    """The best hole by wave optics and by the rules; the far-field error; the law of light; noise."""
    fresnel = table.where(model=MODELS[1])
    sensor, plates = (table.where(model=light) for light in LIGHTS)
    best50, best10 = _best(fresnel, "mtf50"), _best(fresnel, "mtf10")
    unsaturated = sensor.where(
        lambda row: _SHOT_MM <= float(row["diameter_mm"]) < BOX_MM
    )
    narrow = PLATES_MM[:-1]
    share = over_scenes(
        plates.where(diameter_mm=BOX_MM), lambda unit: unit.numbers("light") / BOX_MM**2
    )
    ratio = over_scenes(table.where(diameter_mm=BOX_MM), _sensor_over_plate)
    return [
        predicted("The hole with the highest MTF50 is {} wide", best50, predicted_best(0.5), _TOLERANCE, "mm"),
        predicted("The hole with the highest MTF10 is {} wide", best10, predicted_best(0.1), _TOLERANCE, "mm"),
        predicted("The highest MTF50 follows the rule sqrt(2.44 f lambda), the width of the Airy disk: {}",
                  best50, AIRY_MM, _RULE_TOLERANCE, "mm"),
        predicted("The highest MTF10 follows Rayleigh's rule 1.9 sqrt(f lambda): {}",
                  best10, RAYLEIGH_MM, _RULE_TOLERANCE, "mm"),
        far_field_error(table),
        power_law(f"Path-traced light behind a hole in a plate, {narrow[0]:g} to {narrow[-1]:g} mm, is proportional to "
                  "A^p with p = {}", plates.where(diameter_mm=narrow), "diameter_mm", "light", 2.0, _LIGHT_TOLERANCE),
        predicted("In an open box, twice as wide as deep, the film gets {} of the light of the square law",
                  share, 0.5, _LIGHT_TOLERANCE),
        predicted("In the open box the sensor's radiometry gives {} times the path-traced light",
                  ratio, 1.0, _LIGHT_TOLERANCE),
        power_law(f"At a fixed exposure, signal to noise of holes of {_SHOT_MM:g} mm or more is proportional to A^p "
                  "(shot noise) with p = {}", unsaturated, "diameter_mm", "snr", 1.0, 0.05),
    ]  # fmt: skip


def _sensor_over_plate(rows: Table) -> float:
    sensor, plate = (
        rows.where(model=light).numbers("light").mean() for light in LIGHTS
    )
    return float(sensor / plate)


def _best(rows: Table, measure_of: str) -> Interval:
    """The diameter (mm) of the highest frequency, by a parabola in log-log through the best hole and its neighbours."""
    return over_scenes(
        rows,
        lambda unit: log_parabola_minimum(
            unit.numbers("diameter_mm"), -np.log(unit.numbers(measure_of))
        ),
    )


def far_field_error(table: Table) -> Finding:
    """The MTF50 that the far-field pattern loses near the best hole, which `diffract` warns about."""
    loss = paired_difference(
        table.where(diameter_mm=_NEAR_BEST_MM), "mtf50", "model", MODELS[1], MODELS[0]
    )
    text = f"The far-field pattern underestimates the MTF50 of a hole of {_NEAR_BEST_MM:g} mm"
    return compared(text, loss, "too low", "too high", "", unit="cycles/mm")


def _figure(name: str, title: str, y: str, **more: Any) -> Figure:
    return Figure(name, title, "diameter_mm", y, log_x=True, log_y=True, **more)


_MARKS = (("rayleigh_mm", "1.9 sqrt(f lambda)"), ("airy_mm", "sqrt(2.44 f lambda)"))
LAW = (
    "A large hole of diameter A blurs by geometry: its image of a far point is as wide as the hole. A small hole "
    "blurs by diffraction: at the film distance f and the wavelength λ the Airy disk is 2.44 λ f / A wide. The "
    "sharpest image is where both are nearly equal, about A = sqrt(2.44 λ f), or Rayleigh's 1.9 sqrt(λ f). "
    "Hopkins's transfer function predicts the best hole for each measure of sharpness. The light on the film is "
    "proportional to A²."
)
STUDY = Study(
    name="pinhole",
    question="Which hole diameter is best for a pinhole camera?",
    columns=(
        Column("model", "", "diffraction model or light source"),
        Column("diameter_mm", "mm", "diameter of the hole"),
        Column("mtf50", "cycles/mm", "sharpness on the film, MTF50"),
        Column("mtf10", "cycles/mm", "resolution on the film, MTF10"),
        Column("predicted_mtf50", "cycles/mm", "Hopkins's transfer function"),
        Column("light", "", "light on the film, relative to a hole of 1 mm"),
        Column("predicted_light", "", "square of the diameter"),
        Column("snr", "", "signal to noise at a fixed exposure"),
        Column("rayleigh_mm", "mm", "1.9 sqrt(f lambda)"),
        Column("airy_mm", "mm", "sqrt(2.44 f lambda)"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        _figure("sharpness", "Sharpness of a bare hole", "mtf50", by="model", where={"model": MODELS}, marks=_MARKS,
                also=("predicted_mtf50",), residual_of="predicted_mtf50"),
        _figure("detail", "Resolution of a bare hole", "mtf10", by="model", where={"model": MODELS}, marks=_MARKS),
        _figure("light", "Light on the film and the square law", "light", by="model", kind="scatter",
                also=("predicted_light",), residual_of="predicted_light", where={"model": LIGHTS}),
        _figure("noise", "Signal to noise at a fixed exposure", "snr", marks=_MARKS,
                where={"diameter_mm": DIAMETERS_MM, "model": LIGHTS[0]}),
    ),
    law=LAW, docs="docs/study_results.md#pinhole", lesson="docs/course/03_size_of_the_hole.py",
    defaults=Setup(("tabletop", "staircase"), (), (0, 1, 2)),
)  # fmt: skip
