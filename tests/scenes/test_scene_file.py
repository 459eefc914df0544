"""Every mistake in a scene.toml is a one-line error with file, key and what is allowed."""

import string
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.scenes.scene_text import MINIMAL, Read
from twinlens.errors import FileError, InputError
from twinlens.rendering import check_lit
from twinlens.scenes import Sky, load_scene
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.objects import ANALYTIC_SHAPES
from twinlens.scenes.plugins import LIGHTS, MATERIALS
from twinlens.scenes.scene_file import SceneFile
from twinlens.schema import read


def test_the_minimal_scene_is_read_as_written(read_scene: Read, tmp_path: Path) -> None:
    scene = read_scene()
    assert scene.name == tmp_path.name
    assert [thing.name for thing in scene.objects] == ["ball"]
    assert scene.objects[0].shape == {"type": "sphere", "radius": 0.5}
    assert scene.depth_range == (1.0, 9.0)
    assert scene.world_from_left[:3, 3].tolist() == [0, -3, 1]
    assert scene.files == (tmp_path / "scene.toml",)


MISTAKES = [
    (
        "",
        [("[camera]", "[camera]\nfov_x_degg = 40")],
        "camera: unknown key 'fov_x_degg'; did you mean 'fov_x_deg'",
    ),
    (
        "",
        [("[camera]", "[camera]\nfov_x_deg = nan")],
        "camera.fov_x_deg: must be a finite number, got nan",
    ),
    (
        "",
        [("[camera]", "[camera]\nbaseline = -0.1")],
        "camera.baseline: must be > 0, got -0.1",
    ),
    (
        "",
        [("position = [0, -3, 1]", "position = [0, -3]")],
        "camera.position: must be a list of exactly 3 values",
    ),
    ("", [("position = [0, -3, 1]", "")], "camera: missing key 'position'"),
    (
        "",
        [("position = [0, -3, 1]", "position = [0, 0, 0.5]")],
        "camera: position and look_at must differ",
    ),
    (
        "",
        [("[1.0, 9.0]", "[9.0, 1.0]")],
        "camera.depth_range: must be [near, far] with near < far",
    ),
    ("", [('"diffuse"', '"difuse"')], "materials.grey.type: must be one of"),
    ("", [('"diffuse"', '"../../evil"')], "materials.grey.type: must be one of"),
    (
        "",
        [("reflectance = 0.5", "reflectanse = 0.5")],
        "materials.grey: unknown key 'reflectanse'; did you mean",
    ),
    (
        "",
        [("reflectance = 0.5", "reflectance = 1.5")],
        "materials.grey.reflectance: must lie in [0, 1], got 1.5",
    ),
    (
        "",
        [("reflectance = 0.5", "reflectance = [0.1, 0.2]")],
        "reflectance: must be a list of exactly 3 values",
    ),
    (
        "",
        [("reflectance = 0.5", 'reflectance = "#12345"')],
        "materials.grey.reflectance: must be a colour",
    ),
    (
        "",
        [("reflectance = 0.5", 'reflectance = "oak"')],
        "materials.grey.reflectance: unknown texture 'oak'",
    ),
    (
        "",
        [("reflectance = 0.5", "reflectance = true")],
        "materials.grey.reflectance: must be a number, got True",
    ),
    (
        "",
        [('"constant"', '"area"')],
        "lights.sky.type: must be one of spot",
    ),
    (
        "",
        [("radiance = 1.0", "radiance = -1.0")],
        "lights.sky.radiance: must be >= 0, got -1.0",
    ),
    (
        "",
        [('shape = "sphere"', 'shape = "spere"')],
        "got 'spere'; did you mean 'sphere'?",
    ),
    ("", [("radius = 0.5", "radius = 0")], "objects.ball.radius: must be > 0, got 0"),
    (
        "",
        [("radius = 0.5", "raduis = 0.5")],
        "objects.ball: unknown key 'raduis'; did you mean 'radius'",
    ),
    (
        "",
        [('material = "grey"', 'material = "gray"')],
        "objects.ball.material: unknown material 'gray'; did you mean",
    ),
    ("scale = [1, 1, 2]", [], "objects.ball: a sphere needs a uniform scale"),
    ("scale = 0", [], "objects.ball.scale: must be > 0, got 0"),
    (
        "rotate = { axis = [0, 0, 0], deg = 3 }",
        [],
        "objects.ball.rotate.axis: must not be zero",
    ),
    (
        "rotate = { axis = [0, 0, 1], deg = 3 }\neuler_deg = [0, 0, 3]",
        [],
        "'rotate' and 'euler_deg' exclude",
    ),
    (
        "matrix = [[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]\nscale = 2",
        [],
        "'matrix' and 'scale' exclude each other",
    ),
    (
        "matrix = [[-1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]",
        [],
        "objects.ball: matrix must be 4 rows of 4",
    ),
    ("look_at = [0, 0, 0]", [], "objects.ball: look_at: the target"),
    (
        "instances = []",
        [],
        "objects.ball.instances: must be a list of at least 1 value",
    ),
    (
        "instances = [{ translate = [0, 0] }]",
        [],
        "objects.ball.instances[0].translate: must be a list of exactly 3",
    ),
    (
        "instances = [{}]\nemitter = { radiance = 1 }",
        [],
        "with instances cannot have an emitter",
    ),
    ("merge = true", [], "objects.ball: 'merge' joins the instances of a mesh"),
    ("uv_scale = 2", [], "objects.ball: unknown key 'uv_scale'"),
    (
        "emitter = { type = 'spot' }",
        [],
        "objects.ball.emitter.type: must be one of area, directionalarea, got 'spot'",
    ),
    (
        "[objects.b]\nmaterial = 'grey'",
        [],
        "objects.b: needs exactly one of 'shape' (a name) and 'file'",
    ),
    (
        "[objects.b]\nshape = 'rounded_box'\nextents = 1\nradius = 0.6\nmaterial = 'grey'",
        [],
        "objects.b: radius must be at most half",
    ),
    (
        "[objects.b]\nshape = 'box'\nmaterial = 'grey'",
        [],
        "objects.b: missing key 'extents'",
    ),
    (
        "[objects.b]\nshape = 'lathe'\nprofile = [[0, 0], [-1, 1]]\nmaterial = 'grey'",
        [],
        "profile: radii must be >= 0",
    ),
    (
        "[objects.b]\nshape='tube'\npoints=[[0,0,0],[0,0,0]]\nradius=1\nmaterial='grey'",
        [],
        "two neighbours are equal",
    ),
    (
        "[materials.m]\ntype = 'blendbsdf'",
        [],
        "materials.m: missing keys 'bsdfs', 'weight'",
    ),
    (
        "[materials.m]\ntype = 'conductor'\nmaterial = '../../etc/x'",
        [],
        "materials.m.material: unknown conductor",
    ),
    (
        "[materials.m]\ntype = 'roughconductor'\nalpha = 0.1\nalpha_u = 0.2\nalpha_v = 0.2",
        [],
        "'alpha' excludes 'alpha_u'",
    ),
    (
        "[materials.m]\ntype = 'dielectric'\nint_ior = 'glas'",
        [],
        "materials.m.int_ior: unknown dielectric 'glas'",
    ),
    ("[textures]\nt = 3", [], "textures.t: must be a table"),
    (
        "[lights.e]\ntype = 'sunsky'",
        [],
        "lights: at most one of constant, envmap, sunsky",
    ),
    ("[lights.e]\ntype = 'envmap'", [], "lights.e: missing key 'filename'"),
    (
        "[lights.e]\ntype = 'spot'\nbeam_width = 30",
        [],
        "lights.e: beam_width must not be wider",
    ),
    (
        "[lights.e]\ntype = 'directional'\ndirection = [0, 0, 0]",
        [],
        "lights.e: direction must not be zero",
    ),
    (
        "[integrator]\ntype = 'ptracer'",
        [],
        "integrator.type: must be one of path, direct, got 'ptracer'",
    ),
    (
        "[integrator]\nmax_depth = 2.5",
        [],
        "integrator.max_depth: must be a whole number",
    ),
    ("[extra]\na = 1", [], "unknown key 'extra'"),
]


@pytest.mark.parametrize(
    ("extra", "changes", "message"), MISTAKES, ids=[m[2][:50] for m in MISTAKES]
)
def test_a_mistake_is_named(
    read_scene: Read,
    tmp_path: Path,
    extra: str,
    changes: list[tuple[str, str]],
    message: str,
) -> None:
    with pytest.raises(InputError) as caught:
        read_scene(extra, *changes)
    printed = str(caught.value)
    assert printed.startswith(f"{tmp_path / 'scene.toml'}: ")
    assert message in printed
    assert "\n" not in printed


def test_a_scene_without_light_is_rendered_under_a_sky_only(read_scene: Read) -> None:
    scene = read_scene("", ('[lights.sky]\ntype = "constant"\nradiance = 1.0', ""))
    with pytest.raises(InputError, match="has no light"):
        check_lit(scene)
    check_lit(scene.lit_by(Sky(np.ones((4, 8, 3), np.float32))))
    check_lit(read_scene())


def test_syntax_errors_say_the_line(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_text("[camera]\nposition = [1, 2\n")
    with pytest.raises(FileError, match=r"s\.toml: not valid TOML: .*line 2") as caught:
        load_scene(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "twice", ["up = [0, 0, 1]\nup = [0, 0, 1]", "baseline = 1\nbaseline.x = 1"]
)
def test_a_key_defined_twice_is_an_error(read_scene: Read, twice: str) -> None:
    with pytest.raises(
        FileError, match=r"not valid TOML: the key is defined twice \(at line 4"
    ):
        read_scene("", ("[camera]", f"[camera]\n{twice}"))


def test_a_byte_order_mark_is_ignored(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text(MINIMAL, encoding="utf-8-sig")
    assert load_scene(path).materials.keys() == {"grey"}


def test_bytes_that_are_not_utf8_are_an_error(tmp_path: Path) -> None:
    path = tmp_path / "s.toml"
    path.write_bytes(b"description = '\xff'")
    with pytest.raises(FileError, match="'utf-8' codec can't decode"):
        load_scene(path)


OUR_KEYS = """
type material emitter instances merge translate rotate euler_deg look_at scale matrix shape file uv_scale uv_offset
twosided camera materials lights objects textures integrator description position up fov_x_deg baseline depth_range
"""
KNOWN_ANYWHERE = {
    *(
        key
        for table in (*MATERIALS.values(), *LIGHTS.values(), *ANALYTIC_SHAPES.values())
        for key in table
    ),
    *OUR_KEYS.split(),
}


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
@given(
    key=st.text(string.ascii_letters + "_-.0123456789", min_size=1, max_size=16),
    value=st.sampled_from(
        ["1", "0.5", "'x'", "true", "[1, 2, 3]", "{ type = 'diffuse' }", "inf", "nan"]
    ),
    table=st.sampled_from(["camera", "materials.grey", "lights.sky", "objects.ball"]),
)
def test_every_unknown_key_is_an_error(
    tmp_path: Path, key: str, value: str, table: str
) -> None:
    if key in KNOWN_ANYWHERE:
        return
    path = tmp_path / "scene.toml"
    path.write_text(MINIMAL.replace(f"[{table}]", f'[{table}]\n"{key}" = {value}'))
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


@settings(max_examples=150, deadline=None)
@given(
    value=JSON,
    where=st.sampled_from(
        ["camera", "materials", "lights", "objects", "integrator", "textures"]
    ),
)
def test_any_value_in_any_place_is_an_input_error(value: object, where: str) -> None:
    if where in ("textures", "integrator", "lights") and value == {}:
        return  # every key has a default there
    data = tomllib.loads(MINIMAL) | {
        where: {"x": value} if where in ("materials", "objects", "textures") else value
    }
    with pytest.raises(InputError, match=r"^f\.toml: ") as caught:
        read(SceneFile, data, "f.toml", context=SceneContext(Path()))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("number", [10**400, -(10**400)])
def test_huge_whole_numbers_are_an_input_error(read_scene: Read, number: int) -> None:
    with pytest.raises(InputError, match="radius"):
        read_scene("", ("radius = 0.5", f"radius = {number}"))


def test_an_empty_file_lists_all_missing_keys(tmp_path):
    (tmp_path / "scene.toml").touch()
    with pytest.raises(
        InputError, match=r"scene\.toml: missing keys 'objects', 'camera'$"
    ):
        load_scene(tmp_path / "scene.toml")
