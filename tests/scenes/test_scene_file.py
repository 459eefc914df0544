"""Every mistake in a scene.toml is a one-line error with file, key and what is allowed."""

import string
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.scenes.scene_text import MINIMAL, changed
from twinlens.errors import FileError, InputError
from twinlens.rendering import check_lit
from twinlens.scenes import Sky, load_scene
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.plugins import LIGHTS, MATERIALS
from twinlens.scenes.scene_file import SceneFile
from twinlens.schema import read


def test_the_minimal_scene_is_read_as_written(read_scene, tmp_path):
    scene = read_scene()
    assert scene.name == tmp_path.name
    (ball,) = scene.objects
    assert ball.name == "ball"
    assert ball.shape == {"type": "sphere", "radius": 0.5}
    assert scene.depth_range == (1.0, 9.0)
    assert scene.world_from_left[:3, 3].tolist() == [0, -3, 1]
    assert scene.files == (tmp_path / "scene.toml",)


MISTAKES = {
    # tables
    "camera.fov_x_degg = 40": "camera: unknown key 'fov_x_degg'; did you mean 'fov_x_deg'",
    "[extra]\na = 1": "unknown key 'extra'",
    "camera.fov_x_deg = nan": "camera.fov_x_deg: must be a finite number, got nan",
    "camera.baseline = -0.1": "camera.baseline: must be > 0, got -0.1",
    "camera.position = [0, -3]": "camera.position: must be a list of exactly 3 values",
    "camera.position = [0, 0, 0.5]": "camera: position and look_at must differ",
    "camera.depth_range = [9.0, 1.0]": "camera.depth_range: must be [near, far] with near < far",
    "textures.t = 3": "textures.t: must be a table",
    "integrator.type = 'ptracer'": "integrator.type: must be one of path, direct, got 'ptracer'",
    "integrator.max_depth = 2.5": "integrator.max_depth: must be a whole number",
    # materials
    "materials.grey.type = '../../evil'": "materials.grey.type: must be one of",
    "materials.grey.reflectance = 1.5": "materials.grey.reflectance: must lie in [0, 1], got 1.5",
    "materials.grey.reflectance = [0.1, 0.2]": "reflectance: must be a list of exactly 3 values",
    "materials.grey.reflectance = '#12345'": "materials.grey.reflectance: must be a colour",
    "materials.grey.reflectance = 'oak'": "materials.grey.reflectance: unknown texture 'oak'",
    "materials.grey.reflectance = true": "materials.grey.reflectance: must be a number, got True",
    "materials.m.type = 'blendbsdf'": "materials.m: missing keys 'bsdfs', 'weight'",
    "[materials.m]\ntype = 'conductor'\nmaterial = '../../etc/x'": "materials.m.material: unknown conductor",
    "[materials.m]\ntype = 'roughconductor'\nalpha = 0.1\nalpha_u = 0.2\nalpha_v = 0.2": "'alpha' excludes 'alpha_u'",
    "[materials.m]\ntype = 'dielectric'\nint_ior = 'glas'": "materials.m.int_ior: unknown dielectric 'glas'",
    # lights
    "lights.sky.type = 'area'": "lights.sky.type: must be one of spot",
    "lights.sky.radiance = -1.0": "lights.sky.radiance: must be >= 0, got -1.0",
    "lights.e.type = 'sunsky'": "lights: at most one of constant, envmap, sunsky",
    "lights.e.type = 'envmap'": "lights.e: missing key 'filename'",
    "[lights.e]\ntype = 'spot'\nbeam_width = 30": "lights.e: beam_width must not be wider",
    "[lights.e]\ntype = 'directional'\ndirection = [0, 0, 0]": "lights.e: direction must not be zero",
    # objects
    "objects.ball.shape = 'spere'": "got 'spere'; did you mean 'sphere'?",
    "objects.ball.radius = 0": "objects.ball.radius: must be > 0, got 0",
    "objects.ball.material = 'gray'": "objects.ball.material: unknown material 'gray'; did you mean",
    "objects.ball.scale = [1, 1, 2]": "objects.ball: a sphere needs a uniform scale",
    "objects.ball.scale = 0": "objects.ball.scale: must be > 0, got 0",
    "objects.ball.rotate = { axis = [0, 0, 0], deg = 3 }": "objects.ball.rotate.axis: must not be zero",
    "objects.ball.rotate = { axis = [0, 0, 1], deg = 3 }\nobjects.ball.euler_deg = [0, 0, 3]":
        "'rotate' and 'euler_deg' exclude",
    "objects.ball.matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\nobjects.ball.scale = 2":
        "'matrix' and 'scale' exclude each other",
    "objects.ball.matrix = [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]": "objects.ball: matrix must be 4 rows of 4",
    "objects.ball.look_at = [0, 0, 0]": "objects.ball: look_at: the target",
    "objects.ball.instances = []": "objects.ball.instances: must be a list of at least 1 value",
    "objects.ball.instances = [{ translate = [0, 0] }]":
        "objects.ball.instances[0].translate: must be a list of exactly 3",
    "objects.ball.instances = [{}]\nobjects.ball.emitter.radiance = 1": "with instances cannot have an emitter",
    "objects.ball.merge = true": "objects.ball: 'merge' joins the instances of a mesh",
    "objects.ball.uv_scale = 2": "objects.ball: unknown key 'uv_scale'",
    "objects.ball.emitter.type = 'spot'":
        "objects.ball.emitter.type: must be one of area, directionalarea, got 'spot'",
    "objects.b.material = 'grey'": "objects.b: needs exactly one of 'shape' (a name) and 'file'",
    "[objects.b]\nshape = 'rounded_box'\nextents = 1\nradius = 0.6\nmaterial = 'grey'":
        "objects.b: radius must be at most half",
    "[objects.b]\nshape = 'lathe'\nprofile = [[0, 0], [-1, 1]]\nmaterial = 'grey'": "profile: radii must be >= 0",
    "[objects.b]\nshape='tube'\npoints=[[0,0,0],[0,0,0]]\nradius=1\nmaterial='grey'": "two neighbours are equal",
    "[objects.b]\nshape = 'box'\nextents = [1, 1e15, 1]\nmaterial = 'grey'":
        "objects.b.extents[1]: must be <= 1e+09, got 1000000000000000",
    f"objects.ball.radius = {10**400}": "radius",
    "[objects.b]\nfile = '../outside.ply'\nmaterial = 'grey'": "objects.b.file: '../outside.ply' leads outside",
    "[objects.b]\nshape = 'cylinder'\nmaterial = 'grey'\n"
    "matrix = [[1, 0, 0.5, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]": "a cylinder needs a uniform scale",
    # lengths of astronomic size
    "objects.ball.translate = [1e30, 0, 0]": "objects.ball.translate[0]: must be <= 1e+09, got 1e+30",
    "objects.ball.scale = 1e308": "objects.ball.scale: must be <= 1e+09",
    "objects.ball.matrix = [[1, 0, 0, -2e9], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]": "objects.ball.matrix[0][3]:",
}  # fmt: skip
"""Lines that change the minimal scene, and a part of the message."""


@pytest.mark.parametrize("text", MISTAKES)
def test_a_mistake_is_named(read_scene, tmp_path, text):
    with pytest.raises(InputError) as caught:
        read_scene(text)
    message = str(caught.value)
    assert message.startswith(f"{tmp_path / 'scene.toml'}: ")
    assert MISTAKES[text] in message
    assert "\n" not in message


def test_a_scene_without_light_is_rendered_under_a_sky_only(read_scene):
    scene = read_scene(without="lights")
    with pytest.raises(InputError, match="has no light"):
        check_lit(scene)
    check_lit(scene.lit_by(Sky(np.ones((4, 8, 3), np.float32))))
    check_lit(read_scene())


BROKEN = {
    b"[camera]\nposition = [1, 2\n": r"s\.toml: not valid TOML: .*line 2",
    b"[camera]\nup = [0, 0, 1]\nup = [0, 0, 1]": r"not valid TOML: the key is defined twice \(.*line 3",
    b"[camera]\nbaseline = 1\nbaseline.x = 1": r"not valid TOML: the key is defined twice \(.*line 3",
    b"description = '\xff'": "'utf-8' codec can't decode",
    b"": r"s\.toml: missing keys 'objects', 'camera'$",
    b"objects = {}\ncamera = {}": r"camera: missing keys 'position', 'look_at', 'depth_range'$",
}


@pytest.mark.parametrize("content", BROKEN)
def test_a_file_that_is_no_scene_is_an_error(tmp_path, content):
    path = tmp_path / "s.toml"
    path.write_bytes(content)
    with pytest.raises(InputError, match=BROKEN[content]) as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)
    assert isinstance(caught.value, FileError) == ("missing" not in str(caught.value))


def test_a_byte_order_mark_is_ignored(tmp_path):
    path = tmp_path / "scene.toml"
    path.write_text(MINIMAL, encoding="utf-8-sig")
    assert load_scene(path).materials.keys() == {"grey"}


OUR_KEYS = """
type material emitter instances merge translate rotate euler_deg look_at scale matrix shape file uv_scale uv_offset
twosided camera materials lights objects textures integrator description position up fov_x_deg baseline depth_range
"""
KEYS_OF_PLUGINS = {
    key for tables in (MATERIALS, LIGHTS, ANALYTIC_SHAPES) for table in tables.values() for key in table
}  # fmt: skip


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    key=st.text(string.ascii_letters + "_-.0123456789", min_size=1, max_size=16),
    value=st.sampled_from(["0.5", "'x'", "[1, 2, 3]", "{ type = 'diffuse' }", "nan"]),
    table=st.sampled_from(["camera", "materials.grey", "lights.sky", "objects.ball"]),
)
def test_every_unknown_key_is_an_error(tmp_path, key, value, table):
    if key in KEYS_OF_PLUGINS or key in OUR_KEYS.split():
        return
    path = tmp_path / "scene.toml"
    path.write_text(changed(f'{table}."{key}" = {value}'))
    with pytest.raises(InputError, match="unknown key"):
        load_scene(path)


JSON = st.recursive(
    st.none() | st.booleans() | st.integers(-5, 5) | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(st.text(max_size=5), inner, max_size=3)
    ),
    max_leaves=6,
)
TABLES = ["camera", "materials", "lights", "objects", "integrator", "textures"]


@settings(max_examples=150, deadline=None)
@given(value=JSON, where=st.sampled_from(TABLES))
def test_any_value_in_any_place_is_an_input_error(value, where):
    if where in ("textures", "integrator", "lights") and value == {}:
        return  # every key has a default there
    is_named = where in ("materials", "objects", "textures")
    data = tomllib.loads(MINIMAL) | {where: {"x": value} if is_named else value}
    with pytest.raises(InputError, match=r"^f\.toml: ") as caught:
        read(SceneFile, data, "f.toml", context=SceneContext(Path()))
    assert "\n" not in str(caught.value)
