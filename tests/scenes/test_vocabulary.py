"""Mitsuba accepts every plugin and parameter of the whitelist, and leaves none unused."""

import subprocess
import sys

import numpy as np
import OpenEXR
import pytest

from twinlens.camera import Camera, Rig
from twinlens.rendering import ground_truth, render
from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import build
from twinlens.scenes import load_scene
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.plugins import (
    AREA_LIGHTS,
    DIELECTRICS,
    INTEGRATORS,
    LIGHTS,
    MATERIALS,
)

DIFFUSE = "{ type = 'diffuse' }"
NOISE = "{ type = 'value_noise', cells = 4, size = 16, range = [0.2, 0.8] }"
VALUES = {
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
    "bumpmap": ["bsdf", "bump"],
    "normalmap": ["bsdf", "normalmap"],
}
PAIRS = {"alpha_u": "alpha_v", "alpha_v": "alpha_u", "k": "eta"}
CONDUCTORS = ("conductor", "roughconductor")
TABLES = {
    "[materials.m]\n{}": MATERIALS,
    "[lights.l]\n{}": LIGHTS,
    "[objects.lamp]\nshape = 'sphere'\nmaterial = 'grey'\n[objects.lamp.emitter]\n{}": AREA_LIGHTS,
    "[integrator]\n{}": INTEGRATORS,
}
SHAPE = "[objects.s]\nshape = '{}'\nmaterial = 'grey'\n{}"


def line(key):
    return f"{key} = {'3' if key in WHOLE else VALUES.get(key, '0.4')}"


def lines(kind, key=None):
    """The TOML of a plugin with its required keys, `key`, and the key that `key` requires."""
    keys = [*NEEDS.get(kind, []), key, PAIRS.get(key)]
    if key == "eta" and kind in CONDUCTORS:
        keys.append("k")
    used = dict.fromkeys(key for key in keys if key)
    return "\n".join([f"type = '{kind}'", *map(line, used)])


def texts():
    """Each plugin without its optional keys, and with each of them."""
    for table, plugins in TABLES.items():
        for kind, keys in plugins.items():
            if kind != "envmap":  # needs a file
                yield from (table.format(lines(kind, key)) for key in [None, *keys])
    for kind, keys in ANALYTIC_SHAPES.items():
        yield SHAPE.format(kind, "")
        yield from (SHAPE.format(kind, line(key)) for key in keys)


@pytest.mark.parametrize("text", list(texts()))
def test_mitsuba_accepts_every_plugin_and_key(read_scene, text):
    build(read_scene(text, without="lights" if "[lights" in text else "nothing"))


WITHOUT_TEXTURE = """
alpha specular eta k int_ior ext_ior scale sample_visible nonlinear material distribution bsdf bsdfs normalmap bump
alpha_u alpha_v
"""
MAPPED = [
    (kind, key)
    for kind, keys in MATERIALS.items()
    for key in set(keys).difference(WITHOUT_TEXTURE.split(), NEEDS.get(kind, []))
]


@pytest.mark.parametrize(("kind", "key"), sorted(MAPPED))
def test_a_texture_may_replace_a_colour(read_scene, kind, key):
    build(read_scene(f"[materials.m]\n{lines(kind)}\n{key} = {NOISE}"))


FRONTAL = "camera.position = [0, -3, 0]\ncamera.look_at = [0, 0, 0]\n"
WALL = """
[objects.wall]
shape = "rectangle"
euler_deg = [90, 0, 0]
material = "painted"
translate = [0, -0.6, 0]
[materials.painted]
type = "diffuse"
reflectance = { type = "gradient", size = 64, range = [0.1, 0.9], %s }
"""


def photograph(scene, fov_x_deg=40, spp=4):
    rig = Rig([Camera.from_fov(32, 32, fov_x_deg)], [scene.world_from_left])
    return render(scene, rig, spp=spp, seed=1)[0].mean(axis=2)


def test_the_top_of_a_texture_is_up_and_its_left_is_left(read_scene):
    upright = photograph(read_scene(FRONTAL + WALL % "along = 'v'"))
    assert upright[2].mean() > 2 * upright[-3].mean()
    sideways = photograph(read_scene(FRONTAL + WALL % "along = 'u'"))
    assert sideways[:, -3].mean() > 2 * sideways[:, 2].mean()


def test_repeat_repeats(read_scene):
    image = photograph(read_scene(FRONTAL + WALL % "along = 'u', repeat = [2, 1]"))
    columns = image.mean(axis=0)
    assert (np.diff(columns) < 0).any()  # it falls back once in the middle
    first, second = columns[3:13], columns[19:29]
    expected = first.mean() + (second - second.mean())
    np.testing.assert_allclose(first, expected, rtol=0.25)


@pytest.fixture
def below_a_sky(read_scene, tmp_path):
    """The minimal scene, lit by the upper half of an EXR file."""
    sky = np.zeros((16, 32, 3), np.float32)
    sky[:8] = 1.0
    file = OpenEXR.File({"type": OpenEXR.scanlineimage}, {"RGB": sky})
    file.write(str(tmp_path / "sky.exr"))
    light = "lights.sky.type = 'envmap'\nlights.sky.filename = 'sky.exr'\n"
    return read_scene(FRONTAL + light, without="lights")


XML = """<scene version="3.0.0"><sensor type="perspective"><float name="fov" value="40"/><transform name="to_world">
<lookat origin="0, -3, 0" target="0, 0, 0" up="0, 0, 1"/></transform></sensor>
<emitter type="envmap"><string name="filename" value="sky.exr"/></emitter><shape type="sphere"/></scene>"""


def test_one_thread_reads_exr_files(below_a_sky, tmp_path):
    """In a process of its own: where Mitsuba has one thread, its reader of EXR files never returns."""
    (tmp_path / "sky.xml").write_text(XML)
    code = """if True:
        import sys
        from twinlens.rendering import build, use_threads
        from twinlens.scenes import load_scene
        use_threads(1)
        for path in sys.argv[1:]:
            assert len(build.build(load_scene(path)).bodies) == 1
    """
    files = [str(tmp_path / name) for name in ("scene.toml", "sky.xml")]
    subprocess.run([sys.executable, "-c", code, *files], check=True, timeout=100)


def test_the_top_of_an_environment_map_is_up(below_a_sky):
    ball = photograph(below_a_sky, fov_x_deg=18, spp=16)
    assert ball[6, 16] > 2 * ball[-7, 16]


def test_a_checked_mitsuba_file_is_seen_from_its_own_sensor(below_a_sky, tmp_path):
    """A unit sphere in front of the file's camera is where its look-at says: its near pole at distance 3 - 1."""
    path = tmp_path / "s.xml"
    path.write_text(XML)
    scene = load_scene(path)
    camera = Camera.from_fov(33, 33, fov_x_deg=scene.fov_x_deg)
    (truth,) = ground_truth(scene, Rig([camera], [scene.world_from_left]))
    assert truth.depth[16, 16] == pytest.approx(2.0, rel=1e-6)
    assert np.isinf(truth.depth[0, 0])


def test_the_indices_of_dielectrics_are_those_of_mitsuba():
    mi = mitsuba()

    def index_of(int_ior):
        glass = mi.load_dict({"type": "dielectric", "int_ior": int_ior, "ext_ior": 3.0})
        return mi.traverse(glass)["eta"]

    for name, index in DIELECTRICS.items():
        assert index_of(name.replace("_", " ")) == index_of(index), name
