"""Mitsuba itself takes every plugin and every parameter the whitelist names, and nothing it names is left unused."""

from typing import Any

import numpy as np
import pytest
from scene_text import Read

from twinlens.camera import Camera, Rig
from twinlens.scenes.plugins import AREA_EMITTERS, BSDFS, EMITTERS, INTEGRATORS, SHAPES

rendering = pytest.importorskip("twinlens.rendering")
build = pytest.importorskip("twinlens.rendering.build").build

DIFFUSE = "{ type = 'diffuse' }"
NOISE = "{ type = 'value_noise', cells = 4, size = 16, range = [0.2, 0.8] }"
VALUES: dict[str, str] = {
    "material": "'Au'",
    "eta": "1.5",
    "k": "2.0",
    "distribution": "'ggx'",
    "bsdf": DIFFUSE,
    "bsdfs": f"[{DIFFUSE}, {{ type = 'plastic' }}]",
    "bump": NOISE,
    "normalmap": "{ type = 'value_noise', cells = 4, size = 16, colors = ['#8080ff', '#8f80f0'] }",
    "int_ior": "'water_ice'",
    "ext_ior": "1.0",
    "sample_visible": "false",
    "nonlinear": "true",
    "flip_normals": "true",
    "hide_emitters": "true",
    "center": "[0, 0, 1]",
    "p0": "[0, 0, 1]",
    "p1": "[0, 1, 1]",
    "position": "[0, 0, 3]",
    "direction": "[0, 0.1, -1]",
    "sun_direction": "[0, 0.5, 1]",
    "turbidity": "3.0",
    "cutoff_angle": "30",
    "beam_width": "20",
    "sun_aperture": "1.0",
    "scale": "0.5",
    "albedo": "0.3",
}
WHOLE = {"max_depth", "rr_depth", "shading_samples", "emitter_samples", "bsdf_samples"}
NEEDS = {"twosided": ["bsdf"], "mask": ["bsdf", "opacity"], "blendbsdf": ["bsdfs", "weight"]}
NEEDS |= {"bumpmap": ["bsdf", "bump"], "normalmap": ["bsdf", "normalmap"]}


PAIRS = {"alpha_u": "alpha_v", "alpha_v": "alpha_u", "k": "eta"}
CONDUCTORS = ("conductor", "roughconductor")


def line(key: str) -> str:
    return f"{key} = {'3' if key in WHOLE else VALUES.get(key, '0.4')}"


def cases(plugins: dict[str, dict[str, Any]]) -> list[Any]:
    return [pytest.param(kind, key, id=f"{kind}-{key}") for kind, keys in plugins.items() for key in [None, *keys]]


def lines(kind: str, key: str | None) -> str:
    """The TOML of a plugin with what it needs, the key asked for, and that key's companion."""
    keys = [*NEEDS.get(kind, [])]
    keys += [key] if key and key not in keys else []
    keys += [PAIRS[key]] if key in PAIRS else []
    keys += ["k"] if key == "eta" and kind in CONDUCTORS else []
    return "\n".join([f"type = '{kind}'", *map(line, keys)])


@pytest.mark.parametrize(("kind", "key"), cases(BSDFS))
def test_mitsuba_knows_the_material(read: Read, kind: str, key: str | None) -> None:
    build(read(f"[materials.m]\n{lines(kind, key)}"))


NUMBERS_ONLY = {
    *("alpha", "specular", "eta", "k", "int_ior", "ext_ior", "scale", "sample_visible"),
    *("nonlinear", "material", "distribution", "bsdf", "bsdfs", "normalmap", "bump"),
}
MAPPED = [
    pytest.param(kind, key, id=f"{kind}-{key}")
    for kind, keys in BSDFS.items()
    for key in keys
    if key not in NUMBERS_ONLY and key not in PAIRS and key not in NEEDS.get(kind, [])
]


@pytest.mark.parametrize(("kind", "key"), MAPPED)
def test_a_texture_may_stand_where_a_colour_may(read: Read, kind: str, key: str) -> None:
    build(read(f"[materials.m]\n{lines(kind, None)}\n{key} = {NOISE}"))


@pytest.mark.parametrize(("kind", "key"), [c for c in cases(EMITTERS) if c.values[0] != "envmap"])
def test_mitsuba_knows_the_light(read: Read, kind: str, key: str | None) -> None:
    build(read(f"[lights.l]\n{lines(kind, key)}", ('[lights.sky]\ntype = "constant"\nradiance = 1.0', "")))


@pytest.mark.parametrize(("kind", "key"), cases(AREA_EMITTERS))
def test_mitsuba_knows_the_light_of_an_object(read: Read, kind: str, key: str | None) -> None:
    table = ", ".join(lines(kind, key).split("\n"))
    build(read(f"emitter = {{ {table} }}"))


@pytest.mark.parametrize(("kind", "key"), cases(INTEGRATORS))
def test_mitsuba_knows_the_integrator(read: Read, kind: str, key: str | None) -> None:
    build(read(f"[integrator]\n{lines(kind, key)}"))


@pytest.mark.parametrize(("kind", "key"), cases(SHAPES))
def test_mitsuba_knows_the_shape(read: Read, kind: str, key: str | None) -> None:
    extra = f"\n{line(key)}" if key else ""
    build(read(f"[objects.s]\nshape = '{kind}'\nmaterial = 'grey'{extra}"))


FRONTAL = ("position = [0, -3, 1]\nlook_at = [0, 0, 0.5]", "position = [0, -3, 0]\nlook_at = [0, 0, 0]")
WALL = """
[objects.wall]
shape = "rectangle"
euler_deg = [90, 0, 0]
material = "painted"
translate = [0, -0.6, 0]
[materials.painted]
type = "diffuse"
reflectance = { type = "gradient", size = 64, %s }
"""


def photograph(read: Read, texture: str) -> np.ndarray[Any, Any]:
    scene = read(WALL % texture, FRONTAL)
    camera = Camera.from_fov(32, 32, fov_x_deg=40)
    image: np.ndarray[Any, Any] = rendering.render(scene, Rig([camera], [scene.world_from_left]), spp=4, seed=1)[0]
    return image.mean(axis=2)


def test_the_top_of_a_texture_is_up_and_its_left_is_left(read: Read) -> None:
    upright = photograph(read, "range = [0.1, 0.9]")
    assert upright[2].mean() > 2 * upright[-3].mean()
    sideways = photograph(read, "range = [0.1, 0.9], along = 'u'")
    assert sideways[:, -3].mean() > 2 * sideways[:, 2].mean()


def test_repeat_repeats(read: Read) -> None:
    twice = photograph(read, "range = [0.1, 0.9], along = 'u', repeat = [2, 1]").mean(axis=0)
    assert (np.diff(twice) < 0).sum() >= 1  # it falls back once in the middle
    np.testing.assert_allclose(twice[3:13], twice[3:13].mean() + (twice[19:29] - twice[19:29].mean()), rtol=0.25)
