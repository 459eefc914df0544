"""`active`: a depth camera with and without its projector, against ambient light, distance, power and texture.

The camera is `layouts.depth_camera`. Light adds: each scene is rendered once under its ambient light and once under the
dots alone, and the images are scaled and summed. Powers are absolute: W/m^2 between 800 and 900 nm. The wall is a matte
plane at right angles to the axes. Ambient light is even daylight; the light of other scenes is scaled so that their
left image is as bright, in the mean, as the wall's.
"""

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
from twinlens.studies.findings import Finding, compared, open_claim
from twinlens.studies.intervals import mean_of, paired_difference
from twinlens.studies.model import Figure, Measured, Picture, Setup, Study, sweep
from twinlens.studies.stage import Image, glowing, plane_texture, stream
from twinlens.studies.table import Column, Row, Table

SENSOR = Sensor(pinhole_f_number=2.0, longest_exposure=1 / 30, largest_gain=16.0)
NDISP = 128
WALL, GREY = "wall", 0.5
SUN_W, SUN_KLUX = (
    94.5,
    109.0,
)  # W/m^2 at 800 to 900 nm, and kilolux, of ASTM G173-03's global daylight
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
            daylight * one + power * other
            for one, other in zip(self.ambient, self.dots, strict=True)
        ]
        return [
            shot.image
            for shot in sensor.expose_rig(
                light, rig=self.rig, lens=Pinhole(), seed=seed
            )
        ]


def measure(setup: Setup) -> Measured:
    """A row for every case, with and without the projector, and every matcher; textureless pixels only."""
    rows: list[Row] = []
    pictures: list[Picture] = []
    for name, seed in sweep(replace(setup, scenes=(WALL, *setup.scenes)), setup.seeds):
        made: dict[tuple[float, float], Lit] = {}
        for swept, klux, distance, power, contrast in _cases(name):
            key = distance, contrast
            if key not in made:
                made[key] = (
                    _wall(setup, *key, seed)
                    if name == WALL
                    else _scene(setup, name, seed)
                )
            lit = made[key]
            case = {"scene": name, "seed": seed, "swept": swept, "daylight_klux": klux, "distance_m": distance,
                    "power_w": power, "contrast": contrast}  # fmt: skip
            plain = textureless(lit.pictures(klux, 0.0, SENSOR.replace(shot_noise=False, read_noise=0.0, prnu=0.0,
                                                                      dsnu=0.0), 0)[0])  # fmt: skip
            where = np.ones_like(plain) if swept == "texture" else plain
            shown: list[Image] = []
            for number, (light, watts) in enumerate(((PASSIVE, 0.0), (ACTIVE, power))):
                left, right = lit.pictures(klux, watts, SENSOR, stream(seed, 3, number))
                shown.append(left)
                for method in setup.methods:
                    found = parse_method(method).match(
                        left, right, num_disparities=NDISP
                    )
                    shown.append(found)
                    rows.append(
                        {
                            **case,
                            "light": light,
                            "method": method,
                            "line": f"{method}, {light}",
                            **_scores(found, lit, where),
                        }
                    )
            if seed == setup.seeds[0] and (swept, klux) == ("ambient", OFFICE_KLUX):
                pictures.append(_picture(name, setup, lit, shown))
    notes: dict[str, Any] = {"sensor": "machine_vision, f/2, at most 1/30 s and gain 16", "ndisp": NDISP,
                             "sun_w_m2": SUN_W, "sun_klux": SUN_KLUX, "reflectance": GREY}  # fmt: skip
    return Measured(rows, tuple(pictures), notes)


def _cases(name: str) -> Iterator[tuple[str, float, float, float, float]]:
    """(swept, klux, distance, power, contrast): one quantity differs from the standard case."""
    wall = name == WALL
    base = {"ambient": OFFICE_KLUX, "distance": DISTANCE_M if wall else math.nan, "power": POWER_W,
            "texture": CONTRAST if wall else math.nan}  # fmt: skip
    for swept, values in SWEEPS.items():
        for value in values if not math.isnan(base[swept]) else ():
            klux, distance, power, contrast = {**base, swept: value}.values()
            yield swept, klux, distance, power, contrast


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
    return _lit(
        painted, rig, [image / (_CHANNELS * math.pi) for image in ambient], list(dots)
    )


def _scene(setup: Setup, name: str, seed: int) -> Lit:
    scene = load_scene(name)
    rig = layouts.depth_camera(
        setup.width, setup.height, scene.world_from_left, power=1.0
    )
    own = render(
        scene,
        rig.with_projectors([]),
        Pinhole(),
        setup.spp,
        stream(seed, 0),
        denoise=True,
    )
    dots = render(
        scene.with_ambient(_PROJECTED), rig, Pinhole(), setup.spp, stream(seed, 1)
    )
    scale = GREY / (_CHANNELS * math.pi) / float(own[0].mean())
    return _lit(scene, rig, [scale * image for image in own], list(dots))


def _lit(scene: Scene, rig: Rig, ambient: list[Image], dots: list[Image]) -> Lit:
    truth = ground_truth(scene, rig, objects=False)[0]
    return Lit(ambient, dots, truth.disparity, truth.visible, rig)


def _scores(found: Image, lit: Lit, where: Image) -> Row:
    """Of the pixels of the region that both cameras see: wrong ones by more than 2 px, and ones without disparity."""
    scores = evaluate(
        found, lit.truth, lit.visible, NDISP, regions={"plain": where & lit.visible}
    )
    region = scores.regions["plain"]
    return {
        "bad2": region["bad2.0"],
        "holes": region["invalid"],
        "unknown_or_wrong": region["totbad2.0"],
        "pixels": int((where & lit.visible).sum()),
    }


def _picture(name: str, setup: Setup, lit: Lit, shown: list[Image]) -> Picture:
    known = lit.truth[np.isfinite(lit.truth)]
    span = 0.0, 1.1 * float(known.max())
    images = [
        image if image.dtype == np.uint8 else colourise(image, *span) for image in shown
    ]
    captions = [
        f"{light}, {what}"
        for light in (PASSIVE, ACTIVE)
        for what in ("left image", *setup.methods)
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
    return [
        finding
        for name in table.values("scene")
        for finding in _of_scene(str(name), table.where(scene=name))
    ]


def _of_scene(name: str, table: Table) -> list[Finding]:
    rows = table.where(swept="ambient")
    indoors = rows.where(daylight_klux=OFFICE_KLUX)
    passive, active = (
        indoors.where(light=PASSIVE, method="zncc"),
        indoors.where(light=ACTIVE, method="depth_camera"),
    )
    place = f"On textureless surfaces of the {name}, indoors,"
    claims = [
        (
            f"{place} ZNCC without the projector has at least {_LEAST_WRONG:g} % wrong pixels",
            passive,
            False,
        ),
        (
            f"{place} the depth camera has at most {_MOST_WRONG:g} % wrong pixels",
            active,
            True,
        ),
    ]
    findings = []
    for text, part, below in claims:
        wrong = mean_of(part, "bad2") if len(part) else None
        if wrong is None:
            findings.append(open_claim(text))
            continue
        holds = wrong.value <= _MOST_WRONG if below else wrong.value >= _LEAST_WRONG
        findings.append(Finding(text, wrong, holds, "%", result="{}"))
    dots = rows.where(
        light=ACTIVE, method="depth_camera", daylight_klux=(OFFICE_KLUX, SUN_KLUX)
    )
    text = f"In the sun, the depth camera finds fewer pixels of the {name} than indoors"
    if len(dots):
        lost = paired_difference(
            dots, "unknown_or_wrong", "daylight_klux", SUN_KLUX, OFFICE_KLUX
        )
        findings.append(compared(text, lost, "fewer", "more", ""))
    else:
        findings.append(open_claim(text))
    return findings


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
    defaults=Setup(("room",), ("zncc", "depth_camera"), (0, 1), width=848, height=480, spp=32),
)  # fmt: skip
