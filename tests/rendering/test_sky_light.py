"""A sky's rotation, scale and visibility, measured on rendered images.

Mitsuba places the pixels of a map up to half a pixel off their centres: 0.35 degrees in maps of 512x256 pixels.
"""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.geometry import look_at
from twinlens.scenes import Color, Mesh, SceneObject, Sky

HEIGHT, WIDTH = 256, 512
HALF_PIXEL = math.pi / WIDTH
ALBEDO = 0.5
SQUARE = Mesh(
    np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]),
    np.array([[0, 1, 2], [0, 2, 3]], np.uint32),
)
GREY = {"type": "diffuse", "reflectance": Color((ALBEDO,) * 3)}


def patch(row, column, radiance=1000.0):
    """A black panorama with a bright patch of 8x8 pixels, and its azimuth, elevation and solid angle.

    The middle column is towards -y, the column at a quarter of the width towards +x.
    """
    pixels = np.zeros((HEIGHT, WIDTH, 3), np.float32)
    pixels[row : row + 8, column : column + 8] = radiance
    azimuth = math.pi / 2 - (column + 4) * 2 * math.pi / WIDTH
    elevation = math.pi / 2 - (row + 4) * math.pi / HEIGHT
    return (
        pixels,
        azimuth,
        elevation,
        128 * math.pi**2 / (HEIGHT * WIDTH) * math.cos(elevation),
    )


def plane(normal, **sky):
    """A square of 2x2 m at the origin with this normal, under a sky; and a small camera 1 m in front of it."""
    up = [0.0, 1.0, 0.0] if abs(normal[2]) > 0.9 else [0.0, 0.0, 1.0]
    pose = look_at([0, 0, 0], normal, up)
    scene = tl.Scene(
        "plane",
        (SceneObject("plane", SQUARE, "grey", pose),),
        {"grey": GREY},
        np.eye(4),
        (0.5, 2.0),
    )
    camera = tl.Camera.from_fov(8, 8, 20)
    return scene.lit_by(Sky(**sky)), tl.Rig(
        [camera], [look_at(np.array(normal, float), [0, 0, 0], up)]
    )


@pytest.mark.parametrize(("row", "column", "turn", "normal"), [
    (28, 252, 0.0, (0, 0, 1)), (80, 160, 25.0, (0, 0, 1)), (108, 380, 200.0, (1, 0, 0)), (70, 252, 155.0, (0, 1, 0)),
    (150, 252, -90.0, (-1, 0, 0)),
])  # fmt: skip
def test_a_patch_lights_a_diffuse_plane_by_the_cosine(row, column, turn, normal):
    """L = albedo / pi * scale * radiance * solid angle * cos(angle of incidence)."""
    pixels, azimuth, elevation, solid_angle = patch(row, column)
    a = azimuth + math.radians(turn)
    towards = np.array(
        [
            math.cos(elevation) * math.cos(a),
            math.cos(elevation) * math.sin(a),
            math.sin(elevation),
        ]
    )
    scene, rig = plane(normal, pixels=pixels, turn_deg=turn, scale=1.7)
    measured = tl.render(scene, rig, spp=64, seed=1)[0]
    expected = ALBEDO / math.pi * 1.7 * 1000.0 * solid_angle * (towards @ normal)
    assert expected > 0
    tangent = math.tan(math.acos(towards @ normal))
    bound = HALF_PIXEL * max(tangent, math.tan(elevation)) + 0.005
    assert measured.mean() == pytest.approx(expected, rel=bound)


@pytest.mark.parametrize(
    ("row", "column", "turn"), [(96, 240, 0.0), (120, 80, 128.0), (140, 280, -17.0)]
)
def test_the_camera_sees_a_patch_where_its_direction_projects(row, column, turn):
    pixels, azimuth, elevation, _ = patch(row, column)
    a = azimuth + math.radians(turn)
    towards = np.array(
        [
            math.cos(elevation) * math.cos(a),
            math.cos(elevation) * math.sin(a),
            math.sin(elevation),
        ]
    )
    scene, _ = plane((0, 0, 1), pixels=pixels, turn_deg=turn)
    camera = tl.Camera.from_fov(64, 48, 70)
    pose = look_at([0.0, 0, 50], [math.cos(a + 0.2), math.sin(a + 0.2), 50.0])
    seen = tl.render(scene, tl.Rig([camera], [pose]), spp=64, seed=1)[0].sum(axis=-1)
    rays = camera.unproject(camera.pixel_grid())
    weight = seen * np.linalg.norm(rays, axis=-1) ** -3  # solid angle of a pixel
    centre = np.einsum(
        "ij,ijk->k", weight, rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    )
    cosine = centre / np.linalg.norm(centre) @ pose[:3, :3].T @ towards
    assert math.acos(min(cosine, 1.0)) < 1.1 * HALF_PIXEL


@pytest.fixture(scope="module")
def hidden():
    """Images and truth of a square and a lamp before a uniform sky of radiance 1 that is visible, or hidden."""
    lamp = SceneObject(
        "lamp",
        Mesh(SQUARE.vertices * 0.2 + [0, 0.6, 0.1], SQUARE.faces),
        "grey",
        emitter={"type": "area", "radiance": Color((7.0,) * 3)},
    )
    board = SceneObject("board", Mesh(SQUARE.vertices * 0.5, SQUARE.faces), "grey")
    scene = tl.Scene(
        "open",
        (board, lamp),
        {"grey": GREY},
        look_at([0, 0, 2], [0, 0, 0], [0, 1, 0]),
        (1.0, 3.0),
    )
    rig = tl.Rig([tl.Camera.from_fov(48, 48, 60)], [scene.world_from_left])
    white = np.ones((4, 8, 3), np.float32)
    made = {}
    for visible in (True, False):
        lit = scene.lit_by(Sky(white, visible=visible))
        images = [
            tl.render(lit, rig, spp=16, seed=3, denoise=denoise)[0]
            for denoise in (False, True)
        ]
        made[visible] = images, tl.ground_truth(lit, rig)[0]
    return made


def test_a_hidden_sky_is_black_and_still_lights_the_scene(hidden):
    (seen, _), truth = hidden[True]
    (black, denoised), same = hidden[False]
    assert np.array_equal(truth.depth, same.depth)
    around = ~np.isfinite(truth.depth)
    inner = ~around & (seen == black).all(axis=-1)
    assert inner.sum() > 0.9 * (~around).sum()  # all but the pixels at edges
    background = (black == 0).all(axis=-1)
    assert background.sum() > 0.95 * around.sum()
    assert (seen[background] == 1.0).all()
    assert (denoised[background] == 0.0).all()


def test_a_hidden_sky_hides_no_lamp(hidden):
    (black, _), truth = hidden[False]
    lamp = truth.object_id == 2
    assert lamp.any()
    assert np.median(black[lamp]) == pytest.approx(
        7.0 + ALBEDO, rel=0.02
    )  # it also reflects the sky


def test_without_lamps_the_objects_stay_and_are_dark():
    scene, rig = plane((0, 0, 1), pixels=np.ones((4, 8, 3), np.float32))
    glowing = SceneObject(
        "glow", SQUARE, "grey", emitter={"type": "area", "radiance": Color((7.0,) * 3)}
    )
    scene = tl.Scene("glow", (glowing,), {"grey": GREY}, np.eye(4), (0.5, 2.0))
    dark = scene.lit_by(Sky(np.ones((4, 8, 3), np.float32)), lamps=False)
    assert dark.objects[0].emitter is None
    assert tl.render(dark, rig, spp=64)[0].mean() == pytest.approx(ALBEDO, rel=0.02)


@pytest.mark.parametrize(("changes", "message"), [
    ({"pixels": np.zeros((4, 8, 3))}, "some light"), ({"pixels": np.full((4, 8, 3), np.nan)}, "finite"),
    ({"pixels": np.full((4, 8, 3), -1.0)}, ">= 0"), ({"pixels": np.ones((2, 8, 3))}, r"shape \(2, 8, 3\)"),
    ({"scale": 0.0}, "scale"), ({"turn_deg": math.inf}, "turn_deg"),
])  # fmt: skip
def test_an_impossible_sky_is_refused(changes, message):
    with pytest.raises(InputError, match=message):
        Sky(**{"pixels": np.ones((4, 8, 3), np.float32), **changes})


XML = """<scene version="3.0.0">
 <sensor type="perspective"><float name="fov" value="20"/><float name="near_clip" value="0.5"/>
  <float name="far_clip" value="3"/>
  <transform name="to_world"><lookat origin="0,0,2" target="0,0,0" up="0,1,0"/></transform>
 </sensor>
 <emitter type="constant"><rgb name="radiance" value="9"/></emitter>
 <shape type="rectangle"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
</scene>"""


def test_a_mitsuba_file_is_lit_by_a_sky_in_place_of_its_own(tmp_path):
    (tmp_path / "scene.xml").write_text(XML)
    scene = tl.load_scene(tmp_path / "scene.xml").lit_by(
        Sky(np.full((4, 8, 3), 0.4, np.float32))
    )
    rig = tl.Rig([tl.Camera.from_fov(8, 8, 20)], [scene.world_from_left])
    assert tl.render(scene, rig, spp=64)[0].mean() == pytest.approx(0.5 * 0.4, rel=0.01)
    assert np.allclose(tl.ground_truth(scene, rig)[0].depth, 2.0)


def test_a_mitsuba_file_with_instances_cannot_have_a_sky(tmp_path):
    group = '<shape type="shapegroup" id="g"><shape type="sphere"/></shape><shape type="instance"><ref id="g"/></shape>'
    (tmp_path / "scene.xml").write_text(XML.replace("</scene>", f"{group}</scene>"))
    scene = tl.load_scene(tmp_path / "scene.xml")
    rig = tl.Rig([tl.Camera.from_fov(8, 8, 20)], [scene.world_from_left])
    tl.render(scene, rig, spp=1)
    with pytest.raises(
        InputError,
        match=r"scene\.xml: has instances; a sky can light only Mitsuba files",
    ) as caught:
        tl.render(scene.lit_by(Sky(np.ones((4, 8, 3), np.float32))), rig, spp=1)
    assert "\n" not in str(caught.value)
