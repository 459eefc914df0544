"""Mitsuba accepts every plugin and parameter of the whitelist, and leaves none unused."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.scenes.scene_text import Read
from twinlens.camera import Camera, Rig
from twinlens.scenes import Scene, load_scene
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.plugins import (
    AREA_LIGHTS,
    DIELECTRICS,
    INTEGRATORS,
    LIGHTS,
    MATERIALS,
)

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
    "p0": "[0, 0, -1]",
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
NEEDS = {
    "twosided": ["bsdf"],
    "mask": ["bsdf", "opacity"],
    "blendbsdf": ["bsdfs", "weight"],
}
NEEDS |= {"bumpmap": ["bsdf", "bump"], "normalmap": ["bsdf", "normalmap"]}


PAIRS = {"alpha_u": "alpha_v", "alpha_v": "alpha_u", "k": "eta"}
CONDUCTORS = ("conductor", "roughconductor")


def line(key: str) -> str:
    return f"{key} = {'3' if key in WHOLE else VALUES.get(key, '0.4')}"


def cases(plugins: dict[str, dict[str, Any]]) -> list[Any]:
    return [
        pytest.param(kind, key, id=f"{kind}-{key}")
        for kind, keys in plugins.items()
        for key in [None, *keys]
    ]


def lines(kind: str, key: str | None) -> str:
    """The TOML of a plugin with its required keys, `key`, and the key that `key` requires."""
    keys = [*NEEDS.get(kind, [])]
    keys += [key] if key and key not in keys else []
    keys += [PAIRS[key]] if key in PAIRS else []
    keys += ["k"] if key == "eta" and kind in CONDUCTORS else []
    return "\n".join([f"type = '{kind}'", *map(line, keys)])


@pytest.mark.parametrize(("kind", "key"), cases(MATERIALS))
def test_mitsuba_accepts_the_material(
    read_scene: Read, kind: str, key: str | None
) -> None:
    build(read_scene(f"[materials.m]\n{lines(kind, key)}"))


NUMBERS_ONLY = {
    *("alpha", "specular", "eta", "k", "int_ior", "ext_ior", "scale", "sample_visible"),
    *("nonlinear", "material", "distribution", "bsdf", "bsdfs", "normalmap", "bump"),
}
MAPPED = [
    pytest.param(kind, key, id=f"{kind}-{key}")
    for kind, keys in MATERIALS.items()
    for key in keys
    if key not in NUMBERS_ONLY and key not in PAIRS and key not in NEEDS.get(kind, [])
]


@pytest.mark.parametrize(("kind", "key"), MAPPED)
def test_a_texture_may_replace_a_colour(read_scene: Read, kind: str, key: str) -> None:
    build(read_scene(f"[materials.m]\n{lines(kind, None)}\n{key} = {NOISE}"))


@pytest.mark.parametrize(
    ("kind", "key"), [c for c in cases(LIGHTS) if c.values[0] != "envmap"]
)
def test_mitsuba_accepts_the_light(
    read_scene: Read, kind: str, key: str | None
) -> None:
    build(
        read_scene(
            f"[lights.l]\n{lines(kind, key)}",
            ('[lights.sky]\ntype = "constant"\nradiance = 1.0', ""),
        )
    )


@pytest.mark.parametrize(("kind", "key"), cases(AREA_LIGHTS))
def test_mitsuba_accepts_the_area_light(
    read_scene: Read, kind: str, key: str | None
) -> None:
    table = ", ".join(lines(kind, key).split("\n"))
    build(read_scene(f"emitter = {{ {table} }}"))


@pytest.mark.parametrize(("kind", "key"), cases(INTEGRATORS))
def test_mitsuba_accepts_the_integrator(
    read_scene: Read, kind: str, key: str | None
) -> None:
    build(read_scene(f"[integrator]\n{lines(kind, key)}"))


@pytest.mark.parametrize(("kind", "key"), cases(ANALYTIC_SHAPES))
def test_mitsuba_accepts_the_shape(
    read_scene: Read, kind: str, key: str | None
) -> None:
    extra = f"\n{line(key)}" if key else ""
    build(read_scene(f"[objects.s]\nshape = '{kind}'\nmaterial = 'grey'{extra}"))


FRONTAL = (
    "position = [0, -3, 1]\nlook_at = [0, 0, 0.5]",
    "position = [0, -3, 0]\nlook_at = [0, 0, 0]",
)
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


def photograph(read_scene: Read, texture: str) -> np.ndarray[Any, Any]:
    scene = read_scene(WALL % texture, FRONTAL)
    camera = Camera.from_fov(32, 32, fov_x_deg=40)
    image: np.ndarray[Any, Any] = rendering.render(
        scene, Rig([camera], [scene.world_from_left]), spp=4, seed=1
    )[0]
    return image.mean(axis=2)


def test_the_top_of_a_texture_is_up_and_its_left_is_left(read_scene: Read) -> None:
    upright = photograph(read_scene, "range = [0.1, 0.9]")
    assert upright[2].mean() > 2 * upright[-3].mean()
    sideways = photograph(read_scene, "range = [0.1, 0.9], along = 'u'")
    assert sideways[:, -3].mean() > 2 * sideways[:, 2].mean()


def test_repeat_repeats(read_scene: Read) -> None:
    twice = photograph(
        read_scene, "range = [0.1, 0.9], along = 'u', repeat = [2, 1]"
    ).mean(axis=0)
    assert (np.diff(twice) < 0).sum() >= 1  # it falls back once in the middle
    np.testing.assert_allclose(
        twice[3:13],
        twice[3:13].mean() + (twice[19:29] - twice[19:29].mean()),
        rtol=0.25,
    )


def below_a_sky(read_scene: Read, folder: Path) -> Scene:
    """The minimal scene, lit by the upper half of an EXR file."""
    sky = np.zeros((16, 32, 3), np.float32)
    sky[:8] = 1.0
    OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": sky}).write(
        str(folder / "sky.exr")
    )
    light = "[lights.sky]\ntype = 'envmap'\nfilename = 'sky.exr'"
    return read_scene(
        "", ('[lights.sky]\ntype = "constant"\nradiance = 1.0', light), FRONTAL
    )


def test_one_thread_reads_exr_files(read_scene: Read, tmp_path: Path) -> None:
    """In processes of their own: where Mitsuba has one thread, its reader of EXR files never returns."""
    below_a_sky(read_scene, tmp_path)
    (tmp_path / "sky.xml").write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/></sensor>'
        '<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter><shape type="sphere"/></scene>'
    )
    code = """if True:
        import sys
        from twinlens.rendering import build, use_threads
        from twinlens.scenes import load_scene
        use_threads(1)
        assert len(build.build(load_scene(sys.argv[1])).bodies) == 1
    """
    for file in ("scene.toml", "sky.xml"):
        command = [sys.executable, "-c", code, str(tmp_path / file)]
        subprocess.run(
            command,
            check=True,
            timeout=100,
        )


def test_the_top_of_an_environment_map_is_up(read_scene: Read, tmp_path: Path) -> None:
    scene = below_a_sky(read_scene, tmp_path)
    camera = Camera.from_fov(32, 32, fov_x_deg=18)
    ball = rendering.render(
        scene, Rig([camera], [scene.world_from_left]), spp=16, seed=1
    )[0].mean(axis=2)
    assert ball[6, 16] > 2 * ball[-7, 16]


def test_a_checked_mitsuba_file_is_seen_from_its_own_sensor(tmp_path: Path) -> None:
    """A unit sphere in front of the file's camera is where its look-at says: its near pole at distance 3 - 1."""
    path = tmp_path / "s.xml"
    path.write_text(
        '<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">'
        '<lookat origin="0, -3, 0" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>'
        '<emitter type="constant"/><shape type="sphere"/></scene>'
    )
    scene = load_scene(path)
    camera = Camera.from_fov(33, 33, fov_x_deg=scene.fov_x_deg)
    (truth,) = rendering.ground_truth(scene, Rig([camera], [scene.world_from_left]))
    assert truth.depth[16, 16] == pytest.approx(2.0, rel=1e-6)
    assert np.isinf(truth.depth[0, 0])


def test_the_indices_of_dielectrics_are_those_of_mitsuba() -> None:
    mi = pytest.importorskip("twinlens.rendering.backends").mitsuba()
    for name, index in DIELECTRICS.items():
        by_name, by_number = (
            mi.load_dict({"type": "dielectric", "int_ior": value, "ext_ior": 3.0})
            for value in (name.replace("_", " "), index)
        )
        assert mi.traverse(by_name)["eta"] == mi.traverse(by_number)["eta"], name
