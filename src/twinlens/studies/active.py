"""`active`: a depth camera with and without its projector, against ambient light, distance, power and texture.

The camera is `layouts.depth_camera`. Light adds: each scene is rendered once under its ambient light and once under the
dots alone, and the images are scaled and summed. Powers are absolute: W/m^2 between 800 and 900 nm. The wall is a matte
plane at right angles to the axes. Ambient light is even daylight; the light of other scenes is scaled so that their
left image is as bright, in the mean, as the wall's.
"""

import itertools
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twinlens.camera import Pinhole, Rig, layouts
from twinlens.dataset.pictures import colourise
from twinlens.matching import parse_method
from twinlens.rendering import ground_truth, render
from twinlens.scenes import Scene, SceneObject, load_scene
from twinlens.scoring import evaluate
from twinlens.scoring.regions import textureless
from twinlens.sensor import Sensor
from twinlens.studies.findings import (
    BLOCK_PIXELS,
    Finding,
    Needs,
    bounded,
    compared,
    open_claim,
)
from twinlens.studies.intervals import mean_of, paired_difference
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study, sweep
from twinlens.studies.stage import Image, glowing, plane_texture, stream
from twinlens.studies.table import Column, Row, Table, Value

SENSOR = Sensor(pinhole_f_number=2.0, longest_exposure=1 / 30, largest_gain=16.0)
_NOISELESS = SENSOR.replace(shot_noise=False, read_noise=0.0, prnu=0.0, dsnu=0.0)
NDISP = 128
WALL, GREY = "wall", 0.5
SUN_W, SUN_KLUX = 94.5, 109.0
"""W/m^2 at 800 to 900 nm, and kilolux, of the global daylight of ASTM G173-03."""
OFFICE_KLUX, DISTANCE_M, POWER_W, CONTRAST = 0.5, 1.0, 0.36, 0.0
SWEEPS: Mapping[str, tuple[float, ...]] = {
    "ambient": (0.005, 0.05, 0.5, 5.0, 30.0, SUN_KLUX),
    "distance": (0.5, 1.0, 2.0, 4.0),
    "power": (0.03, 0.09, 0.36),
    "texture": (0.0, 0.05, 0.2),
}
PASSIVE, ACTIVE = "passive", "active"
_CHANNELS = 3  # share the light
_LEAST_WRONG, _MOST_WRONG = 60.0, 2.0
NEEDS = Needs(region_pixels=400 * BLOCK_PIXELS)
"""The standard error of a share of 2 % of 400 independent blocks is 0.7 %."""
_PROJECTED = 1e-9  # of a scene's own light, beside the dots


@dataclass(frozen=True, eq=False)
class Lit:
    """A scene as the pair sees it: radiance by an irradiance of 1 W/m^2 on the wall, and by 1 W of dots."""

    ambient: list[Image]
    dots: list[Image]
    truth: Image
    visible: Image
    rig: Rig

    def pictures(
        self, klux: float, power: float, sensor: Sensor, seed: int
    ) -> list[Image]:
        """The exposed images of both cameras."""
        daylight = klux * SUN_W / SUN_KLUX
        light = [
            daylight * ambient + power * dots
            for ambient, dots in zip(self.ambient, self.dots, strict=True)
        ]
        shots = sensor.expose_rig(light, rig=self.rig, lens=Pinhole(), seed=seed)
        return [shot.image for shot in shots]


@dataclass(frozen=True)
class Case:
    """Values of all quantities, of which the one named `swept` differs from the standard case."""

    swept: str
    klux: float = OFFICE_KLUX
    distance: float = DISTANCE_M
    power: float = POWER_W
    contrast: float = CONTRAST

    @property
    def columns(self) -> dict[str, Value]:
        """The case as columns of the table."""
        return {
            "swept": self.swept,
            "daylight_klux": self.klux,
            "distance_m": self.distance,
            "power_w": self.power,
            "contrast": self.contrast,
        }


def measure(setup: Setup) -> Measured:
    """A row for every case, with and without the projector, and every matcher; textureless pixels only."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    for name, seed in sweep(replace(setup, scenes=(WALL, *setup.scenes)), setup.seeds):
        rendered: dict[tuple[float, float], Lit] = {}
        for case in _cases(name):
            key = case.distance, case.contrast
            if key not in rendered:
                rendered[key] = _lit_scene(setup, name, case, seed)
            lit = rendered[key]
            case_rows, shown = _matched(setup, lit, case, seed)
            rows += [
                {"scene": name, "seed": seed, **case.columns, **row}
                for row in case_rows
            ]
            is_standard = (case.swept, case.klux) == ("ambient", OFFICE_KLUX)
            if seed == setup.seeds[0] and is_standard:
                pictures.append(_picture(name, setup, lit, shown))
    notes: dict[str, Any] = {
        "sensor": "machine_vision, f/2, at most 1/30 s and gain 16",
        "ndisp": NDISP,
        "sun_w_m2": SUN_W,
        "sun_klux": SUN_KLUX,
        "reflectance": GREY,
    }
    return Measured(rows, tuple(pictures), notes)


def _standard(name: str) -> Case:
    """The standard case; only the wall has a distance and a contrast."""
    if name == WALL:
        return Case("")
    return Case("", distance=math.nan, contrast=math.nan)


def _cases(name: str) -> Iterator[Case]:
    """Each sweep of the scene: the standard case with one quantity changed."""
    standard = _standard(name)
    fields = {"ambient": "klux", "texture": "contrast"}
    for swept, values in SWEEPS.items():
        field = fields.get(swept, swept)
        if math.isnan(getattr(standard, field)):
            continue
        for value in values:
            yield replace(standard, swept=swept, **{field: value})


def _matched(
    setup: Setup, lit: Lit, case: Case, seed: int
) -> tuple[list[Row], list[Image]]:
    """A row for each light and matcher; the left image of each light, each followed by its disparity maps."""
    noiseless = lit.pictures(case.klux, 0.0, _NOISELESS, 0)
    where = textureless(noiseless[0])
    if case.swept == "texture":
        where = np.ones_like(where)
    rows: list[Row] = []
    shown: list[Image] = []
    for number, (light, power) in enumerate(((PASSIVE, 0.0), (ACTIVE, case.power))):
        pair = lit.pictures(case.klux, power, SENSOR, stream(seed, 3, number))
        shown.append(pair[0])
        for method in setup.methods:
            disparity = parse_method(method).match(*pair, num_disparities=NDISP)
            shown.append(disparity)
            line = f"{method}, {light}"
            labels: Row = {"light": light, "method": method, "line": line}
            rows.append({**labels, **_scores(disparity, lit, where)})
    return rows, shown


def _lit_scene(setup: Setup, name: str, case: Case, seed: int) -> Lit:
    if name == WALL:
        return _wall(setup, case.distance, case.contrast, seed)
    return _scene(setup, name, seed)


def _wall(setup: Setup, distance: float, contrast: float, seed: int) -> Lit:
    rig = layouts.depth_camera(setup.width, setup.height, power=1.0)
    camera = rig.cameras[0]
    pose, texture = plane_texture(
        camera, rig.baseline(), distance, seed, scale_px=1.0, contrast=contrast
    )
    shape = {"type": "rectangle"}
    glow = glowing(WALL, [(WALL, shape, pose, texture)], distance)
    paint = {"paint": {"type": "diffuse", "reflectance": texture}}
    painted = replace(
        glow, objects=(SceneObject(WALL, shape, "paint", pose),), materials=paint
    )
    visible = Rig([camera.replace(band="rgb")] * 2, rig.world_from_cams)
    ambient = render(glow, visible, Pinhole(), setup.spp, stream(seed, 0))
    dots = render(painted, rig, Pinhole(), setup.spp, stream(seed, 1))
    # A matte wall that reflects all of 1 W/m^2 has the radiance 1/pi.
    per_irradiance = [image / (_CHANNELS * math.pi) for image in ambient]
    return _lit(painted, rig, per_irradiance, list(dots))


def _scene(setup: Setup, name: str, seed: int) -> Lit:
    scene = load_scene(name)
    rig = layouts.depth_camera(
        setup.width, setup.height, scene.world_from_left, power=1.0
    )
    dark_rig, seeds = rig.with_projectors([]), (stream(seed, 0), stream(seed, 1))
    ambient = render(scene, dark_rig, Pinhole(), setup.spp, seeds[0], denoise=True)
    dark_scene = scene.with_ambient(_PROJECTED)
    dots = render(dark_scene, rig, Pinhole(), setup.spp, seeds[1])
    scale = GREY / (_CHANNELS * math.pi) / float(ambient[0].mean())
    return _lit(scene, rig, [scale * image for image in ambient], list(dots))


def _lit(scene: Scene, rig: Rig, ambient: list[Image], dots: list[Image]) -> Lit:
    truth = ground_truth(scene, rig, objects=False)[0]
    return Lit(ambient, dots, truth.disparity, truth.visible, rig)


def _scores(disparity: Image, lit: Lit, where: Image) -> Row:
    """Of the pixels of the region that both cameras see: wrong ones by more than 2 px, and ones without disparity."""
    regions = {"plain": where & lit.visible}
    scores = evaluate(disparity, lit.truth, lit.visible, NDISP, regions=regions)
    region = scores.regions["plain"]
    return {
        "bad2": region["bad2.0"],
        "holes": region["invalid"],
        "unknown_or_wrong": region["totbad2.0"],
        "pixels": int(regions["plain"].sum()),
    }


def _picture(name: str, setup: Setup, lit: Lit, shown: list[Image]) -> Picture:
    finite = lit.truth[np.isfinite(lit.truth)]
    span = 0.0, 1.1 * float(finite.max())
    images = [
        image if image.dtype == np.uint8 else colourise(image, *span) for image in shown
    ]
    shown_of_light = ("left image", *setup.methods)
    captions = [
        f"{light}, {what}"
        for light, what in itertools.product((PASSIVE, ACTIVE), shown_of_light)
    ]
    return Picture(
        name,
        f"{name}, {OFFICE_KLUX:g} klux of daylight",
        tuple(images),
        tuple(captions),
        columns=len(images) // 2,
    )


def conclude(table: Table) -> list[Finding]:
    """Passive and active errors indoors, and the effect of the sun."""
    findings: list[Finding] = []
    for name in table.values("scene"):
        findings += _of_scene(str(name), table.where(scene=name))
    return findings


def _of_scene(name: str, table: Table) -> list[Finding]:
    rows = table.where(swept="ambient")
    indoors = rows.where(daylight_klux=OFFICE_KLUX)
    place = f"On textureless surfaces of the {name}, indoors,"
    text = f"{place} ZNCC without the projector has at least {_LEAST_WRONG:g} % wrong pixels"
    passive = indoors.where(light=PASSIVE, method="zncc")
    findings = [_wrong(text, passive, _LEAST_WRONG, math.inf)]
    text = f"{place} the depth camera has at most {_MOST_WRONG:g} % wrong pixels"
    active = indoors.where(light=ACTIVE, method="depth_camera")
    findings.append(_wrong(text, active, -math.inf, _MOST_WRONG))
    text = f"In the sun, the depth camera finds fewer pixels of the {name} than indoors"
    klux = (OFFICE_KLUX, SUN_KLUX)
    dots = rows.where(light=ACTIVE, method="depth_camera", daylight_klux=klux)
    if not len(dots):
        return [*findings, open_claim(text)]
    lost = paired_difference(
        dots, "unknown_or_wrong", "daylight_klux", SUN_KLUX, OFFICE_KLUX
    )
    least = _least_pixels(dots)
    sun = compared(text, lost, "fewer", "more", "", needs=NEEDS, region_pixels=least)
    return [*findings, sun]


def _wrong(text: str, rows: Table, low: float, high: float) -> Finding:
    """The claim that the mean share of wrong pixels (%) is between low and high; open without rows."""
    if not len(rows):
        return open_claim(text)
    wrong = mean_of(rows, "bad2")
    return bounded(
        text, wrong, low, high, "%", result="{}", needs=NEEDS, region_pixels=_least_pixels(rows)
    )  # fmt: skip


def _least_pixels(rows: Table) -> float:
    """The pixels of the smallest region."""
    return float(rows.numbers("pixels").min(initial=math.inf))


LAW = (
    "On a surface without texture all windows look alike, and no passive matcher can find the disparity. A "
    "projector of random dots adds texture. Its irradiance is proportional to its power and falls with the square "
    "of the distance; daylight adds light, whose shot noise hides the dots, and shortens the exposure, so that "
    "fewer photons of the dots are collected."
)
STUDY = Study(
    name="active",
    question="When does a projector of dots help a depth camera?",
    columns=(
        Column("swept", "", "what is varied"),
        Column("daylight_klux", "klux", "ambient daylight"),
        Column("distance_m", "m", "distance of the wall"),
        Column("power_w", "W", "power of the projector"),
        Column("contrast", "", "contrast of the wall"),
        Column("light", "", "light"),
        Column("method", "", "matcher"),
        Column("line", "", "matcher and light"),
        Column("bad2", "%", "wrong by > 2 px"),
        Column("holes", "%", "unknown"),
        Column("unknown_or_wrong", "%", "wrong by > 2 px or unknown"),
        Column("pixels", "px", "pixels of the region"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("ambient", "Textureless surfaces in daylight", "daylight_klux", "unknown_or_wrong", by="line",
               panel="scene", log_x=True, where={"swept": "ambient"}),
        Figure("distance", "A wall without texture, indoors, against its distance", "distance_m", "unknown_or_wrong",
               by="line", log_x=True, where={"swept": "distance"}),
        Figure("power", "Textureless surfaces indoors against the power of the projector", "power_w",
               "unknown_or_wrong", by="line", panel="scene", log_x=True, where={"swept": "power"}),
        Figure("texture", "A wall with texture, indoors, with and without projector", "contrast", "unknown_or_wrong",
               by="line", where={"swept": "texture"}),
    ),
    law=LAW, docs="docs/study_results.md#active", lesson="docs/course/13_hard_cases.py",
    defaults=Setup(("room",), ("zncc", "depth_camera"), (0, 1, 2), width=848, height=480, spp=32),
)  # fmt: skip
