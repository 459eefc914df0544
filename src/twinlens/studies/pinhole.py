"""`pinhole`: from a box without a barrier to a hole of 0.07 mm. Sharpness, light and noise; which hole is the best.

Sharpness is MTF50 by the slanted edge of ISO 12233. Two models of the hole stand side by side: "far field", the traced
picture convolved with the Airy pattern, which is what `twinlens.diffract` does; and "Fresnel", the sharp picture
convolved with Fresnel's pattern, exact for one plane target. Rules for the best diameter: 1.9 sqrt(f lambda) (Rayleigh,
On pinhole photography, 1891), and sqrt(2.44 f lambda), where the hole is as wide as its own Airy disk.
"""

import math
import warnings
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

from twinlens.camera import BareAperture, Camera, Pinhole, Rig
from twinlens.diffraction import FresnelWarning, diffract
from twinlens.rendering import render
from twinlens.scenes import Scene, SceneObject
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.bootstrap import Interval, log_slope, mean_of, over_scenes, paired_difference
from twinlens.studies.fresnel import fresnel_kernel, through_hole, transfer
from twinlens.studies.model import Figure, Finding, Measured, Picture, Setup, Study, agrees, is_above
from twinlens.studies.slanted_edge import crossing, frequency_at
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Row, Table

Float = NDArray[np.float64]

FILM = 0.05
PITCH = 25e-6
WAVELENGTH = 550e-9
DEPTH = 10.0
SLANT = math.radians(5.0)
DIAMETERS_MM = (2.0, 1.4, 1.0, 0.6, 0.5, 0.4, 0.35, 0.32, 0.29, 0.26, 0.23, 0.2, 0.15, 0.1, 0.07)
BOX_MM = 100.0
"""A box without a barrier: a hole twice as wide as the box is deep."""
SHOWN_MM = (BOX_MM, 2.0, 1.0, 0.6, 0.35, 0.15, 0.07)
RAYLEIGH_MM = 1e3 * 1.9 * math.sqrt(FILM * WAVELENGTH)
AIRY_MM = 1e3 * math.sqrt(2.44 * FILM * WAVELENGTH)
SENSOR = Sensor.preset(
    "machine_vision", filters="mono", output="linear", bits=16, wavelengths=(WAVELENGTH,) * 3, prnu=0.0, dsnu=0.0
)
CONTRASTS = (0.5, 0.1)
_MODELS = ("far field", "Fresnel")
_EDGE_SPP = 64
_TOLERANCE, _RULE_TOLERANCE = 0.05, 0.15
"""Of the best hole against wave optics, and against the rules of thumb, which leave out the pixel and the target."""
_NEAR_BEST_MM, _SHOT_MM = 0.23, 0.2
"""Below the second a hole gives so few electrons that reading them out adds as much noise as counting them."""


def measure(setup: Setup) -> Measured:
    """A row for every seed, hole and model; and a bundled scene as every hole shows it."""
    rows: list[Row] = []
    for done, seed in enumerate(setup.seeds):
        setup.progress(0.8 * done / len(setup.seeds), "edge")
        rows += _edges(seed)
    setup.progress(0.8, "pictures")
    pictures = tuple(_pictures(setup, name) for name in setup.scenes)
    return Measured(rows, pictures, {"film_m": FILM, "pitch_m": PITCH, "wavelength_m": WAVELENGTH, "depth_m": DEPTH})


def _edges(seed: int) -> list[Row]:
    camera = edge_camera()
    rig = Rig((camera,), (np.eye(4),))
    scene = edge_scene()
    sharp = _grey(render(scene, rig, Pinhole(), _EDGE_SPP, stream(seed, 0))[0])
    fixed = 0.5 / _white_rate(camera, max(DIAMETERS_MM))
    unit = _light(camera, BareAperture(1e-3, FILM), seed, len(DIAMETERS_MM) + 1)
    rows: list[Row] = []
    for k, millimetres in enumerate((BOX_MM, *DIAMETERS_MM)):
        hole = BareAperture(1e-3 * millimetres, FILM)
        traced = render(scene, rig, hole, _EDGE_SPP, stream(seed, 1, k))[0]
        far = _grey(_diffracted(traced, camera, hole)) if millimetres < BOX_MM else None
        near = None if far is None else through_hole(sharp, _kernel(hole))
        light = _light(camera, hole, seed, k) / unit
        noise = _signal_to_noise(camera, hole, Exposure(fixed), stream(seed, 2, k))
        for model, picture in zip(_MODELS, (far, near), strict=True):
            sharpness = [math.nan if picture is None else frequency_at(picture, c) / (1e3 * PITCH) for c in CONTRASTS]
            rows.append(
                {"scene": "edge", "seed": seed, "model": model, "diameter_mm": millimetres, "mtf50": sharpness[0],
                 "mtf10": sharpness[1], "predicted_mtf50": theory(millimetres, 0.5),
                 "light": light, "predicted_light": millimetres**2, "snr": noise, "rayleigh_mm": RAYLEIGH_MM,
                 "airy_mm": AIRY_MM}
            )  # fmt: skip
    return rows


def _kernel(hole: BareAperture) -> Float:
    return fresnel_kernel(hole.diameter, FILM, DEPTH, WAVELENGTH, PITCH)


@lru_cache
def theory(millimetres: float, contrast: float) -> float:
    """The frequency (cycles/mm on the film) at which Hopkins's transfer function times the pixel's reads so."""
    if millimetres == BOX_MM:
        return math.nan
    frequency = np.linspace(0.0, 0.5 / PITCH, 2001)
    contrasts = transfer(frequency, 1e-3 * millimetres, FILM, DEPTH, WAVELENGTH) * np.sinc(frequency * PITCH)
    return crossing(frequency, contrasts, contrast) / 1e3


@lru_cache
def theoretical_best(contrast: float) -> float:
    """The diameter (mm) at which `theory` is largest."""
    found = optimize.minimize_scalar(lambda d: -theory(d, contrast), bounds=(0.12, 0.45), method="bounded")
    return float(found.x)


def edge_camera() -> Camera:
    """That looks at the edge: its film is at `FILM`, its pixels are `PITCH` wide."""
    fx = FILM / PITCH
    return Camera(420, 90, fx, fx, 209.5, 44.5)


def edge_scene() -> Scene:
    """A shining half plane at `DEPTH`, its edge near the axis, `SLANT` off the vertical."""
    size = 4.0
    pose = np.eye(4)
    sine, cosine = math.sin(SLANT), math.cos(SLANT)
    turn = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    pose[:3, :3] = turn @ np.diag([size, -size, -1.0])
    pose[:3, 3] = turn @ np.array([-size, 0.0, 0.0]) + np.array([0.0, 0.0, DEPTH])
    glow = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
    half = SceneObject("half", {"type": "rectangle"}, "black", pose, glow)
    black = {"black": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}}
    return Scene("edge", (half,), black, np.eye(4), (5.0, 20.0), integrator={"type": "path", "max_depth": 2})


def _grey(image: NDArray[Any]) -> Float:
    return np.asarray(image[..., 1], np.float64)


def _diffracted(image: NDArray[np.float32], camera: Camera, hole: BareAperture) -> NDArray[np.float32]:
    """As the hole's Airy pattern blurs it; that this is not Fresnel's is what the study shows."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FresnelWarning)
        return diffract(image, camera, hole, (WAVELENGTH,) * 3)


def _white_rate(camera: Camera, millimetres: float) -> float:
    """Shares of white a second that a radiance of 1 gives through this hole."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    return float(SENSOR.level_rate(white, camera=camera, lens=BareAperture(1e-3 * millimetres, FILM)).mean())


def _light(camera: Camera, hole: BareAperture, seed: int, k: int) -> float:
    """Mean level of an evenly lit film over the exposure time, which brings any hole to about a half of white."""
    time = 0.5 / _white_rate(camera, 1e3 * hole.diameter)
    white = np.ones((camera.height, camera.width, 3), np.float32)
    photo = SENSOR.expose(white, camera=camera, lens=hole, seed=stream(seed, 3, k), exposure=Exposure(time))
    return float(photo.image.mean()) / time


def _signal_to_noise(camera: Camera, hole: BareAperture, exposure: Exposure, seed: int) -> float:
    """Mean over standard deviation of an evenly lit film at this exposure; NaN where it burns out."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    image = SENSOR.expose(white, camera=camera, lens=hole, seed=seed, exposure=exposure).image.astype(np.float64)
    return math.nan if image.max() >= 65535 else float(image.mean() / image.std())


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
    fresnel = table.where(model=_MODELS[1])
    return [
        _best_hole(fresnel, "mtf50", 0.5, "The sharpest hole, of the highest MTF50, is {} wide"),
        _best_hole(fresnel, "mtf10", 0.1, "The hole of the finest detail, of the highest MTF10, is {} wide"),
        _rule(fresnel, "mtf50", AIRY_MM, "It is sharpest near sqrt(2.44 f lambda), as wide as its Airy disk"),
        _rule(fresnel, "mtf10", RAYLEIGH_MM, "Detail is finest near Rayleigh's 1.9 sqrt(f lambda)"),
        _far_from_true(table),
        _exponent(fresnel, "light", 2.0, 0.01, "The light on the film grows as A^p, p = {}"),
        _exponent(
            fresnel.where(lambda row: float(row["diameter_mm"]) >= _SHOT_MM),
            "snr",
            1.0,
            0.05,
            f"At one exposure signal to noise grows as A^p, as photons arrive, down to {_SHOT_MM:g} mm: p = {{}}",
        ),
    ]


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
    text = (
        f"The far-field pattern underrates the best holes: at {_NEAR_BEST_MM:g} mm it has an MTF50 of "
        f"{peak[_MODELS[0]]:.3g} cycles/mm, which is {{}} too low"
    )
    return Finding(text, loss, is_above(loss), "cycles/mm")


def _exponent(rows: Table, name: str, expected: float, tolerance: float, text: str) -> Finding:
    holes = rows.where(lambda row: float(row["diameter_mm"]) < BOX_MM)
    slope = over_scenes(holes, log_slope("diameter_mm", name))
    return Finding(text, slope, agrees(slope, expected, tolerance), "", expected, tolerance)


_HOLES = {"diameter_mm": DIAMETERS_MM}
_ONE_MODEL = {**_HOLES, "model": _MODELS[1]}
_MARKS = (("rayleigh_mm", "1.9 sqrt(f lambda)"), ("airy_mm", "sqrt(2.44 f lambda)"))
STUDY = Study(
    name="pinhole",
    question="How large should the hole of a pinhole camera be?",
    columns=(
        Column("model", "", "diffraction"),
        Column("diameter_mm", "mm", "diameter of the hole"),
        Column("mtf50", "cycles/mm", "sharpness on the film, MTF50"),
        Column("mtf10", "cycles/mm", "finest detail on the film, MTF10"),
        Column("predicted_mtf50", "cycles/mm", "Hopkins's transfer function"),
        Column("light", "", "light on the film, through 1 mm = 1"),
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
        Figure("light", "Light on the film against the square law", "diameter_mm", "light", kind="scatter", log_x=True,
               log_y=True, also=("predicted_light",), residual_of="predicted_light", where=_ONE_MODEL),
        Figure("noise", "Signal to noise at one exposure", "diameter_mm", "snr", log_x=True, log_y=True,
               where=_ONE_MODEL, marks=_MARKS),
    ),
    defaults=Setup(("tabletop", "staircase"), (), (0, 1, 2), spp=64),
)  # fmt: skip
