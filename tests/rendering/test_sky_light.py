"""A sky's rotation, scale and visibility, measured on rendered images.

Mitsuba places the pixels of a map up to half a pixel off their centres: 0.35 degrees in maps of 512x256 pixels.
"""

import math

import numpy as np
import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.geometry import look_at
from twinlens.scenes import Color, Mesh, Scene, SceneObject, Sky

HEIGHT, WIDTH = 256, 512
HALF_PIXEL = math.pi / WIDTH
ALBEDO = 0.5
CORNERS = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
SQUARE = Mesh(CORNERS, np.array([[0, 1, 2], [0, 2, 3]], np.uint32))
GREY = {"type": "diffuse", "reflectance": Color((ALBEDO,) * 3)}
WHITE = np.ones((4, 8, 3), np.float32)
GLOW = {"type": "area", "radiance": Color((7.0,) * 3)}
ABOVE = look_at([0, 0, 2], [0, 0, 0], [0, 1, 0])


def scene_of(*objects, pose=ABOVE):
    return Scene("test", objects, {"grey": GREY}, pose, (0.5, 3.0))


class Patch:
    """A black panorama with a bright patch of 8x8 pixels.

    The middle column is towards -y, the column at a quarter of the width towards +x; the sky is turned about z.
    """

    def __init__(self, row, column, turn_deg, radiance=1000.0):
        self.pixels = np.zeros((HEIGHT, WIDTH, 3), np.float32)
        self.pixels[row : row + 8, column : column + 8] = radiance
        self.elevation = math.pi / 2 - (row + 4) * math.pi / HEIGHT
        in_map = math.pi / 2 - (column + 4) * 2 * math.pi / WIDTH
        self.azimuth = in_map + math.radians(turn_deg)
        across = math.cos(self.elevation)
        self.solid_angle = 128 * math.pi**2 / (HEIGHT * WIDTH) * across
        x = across * math.cos(self.azimuth)
        y = across * math.sin(self.azimuth)
        self.towards = np.array([x, y, math.sin(self.elevation)])


@pytest.mark.parametrize(("row", "column", "turn", "normal"), [
    (28, 252, 0.0, (0, 0, 1)), (80, 160, 25.0, (0, 0, 1)), (108, 380, 200.0, (1, 0, 0)), (70, 252, 155.0, (0, 1, 0)),
    (150, 252, -90.0, (-1, 0, 0)),
])  # fmt: skip
def test_a_patch_lights_a_diffuse_plane_by_the_cosine(row, column, turn, normal):
    """L = albedo / pi * scale * radiance * solid angle * cos(angle of incidence)."""
    patch = Patch(row, column, turn)
    up = [0.0, 1.0, 0.0] if normal[2] else [0.0, 0.0, 1.0]
    facing = look_at([0, 0, 0], normal, up)
    plane = scene_of(SceneObject("plane", SQUARE, "grey", facing))
    scene = plane.lit_by(Sky(patch.pixels, turn_deg=turn, scale=1.7))
    pose = look_at(np.array(normal, float), [0, 0, 0], up)
    rig = tl.Rig([tl.Camera.from_fov(8, 8, 20)], [pose])
    measured = tl.render(scene, rig, spp=64, seed=1)[0]
    cosine = patch.towards @ normal
    expected = ALBEDO / math.pi * 1.7 * 1000.0 * patch.solid_angle * cosine
    assert expected > 0
    steepness = max(math.tan(math.acos(cosine)), math.tan(patch.elevation))
    bound = HALF_PIXEL * steepness + 0.005
    assert measured.mean() == pytest.approx(expected, rel=bound)


@pytest.fixture(scope="module")
def hidden():
    """Images and truth of a square and a lamp before a uniform sky of radiance 1 that is visible, or hidden."""
    small = Mesh(CORNERS * 0.2 + [0, 0.6, 0.1], SQUARE.faces)
    lamp = SceneObject("lamp", small, "grey", emitter=GLOW)
    board = SceneObject("board", Mesh(CORNERS * 0.5, SQUARE.faces), "grey")
    rig = tl.Rig([tl.Camera.from_fov(48, 48, 60)], [ABOVE])
    made = {}
    for visible in (True, False):
        lit = scene_of(board, lamp).lit_by(Sky(WHITE, visible=visible))
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
    """The lamp reflects the sky, too."""
    (black, _), truth = hidden[False]
    lamp = truth.object_id == 2
    assert lamp.any()
    assert np.median(black[lamp]) == pytest.approx(7.0 + ALBEDO, rel=0.02)


def test_without_lamps_the_objects_stay_and_are_dark():
    scene = scene_of(SceneObject("glow", SQUARE, "grey", emitter=GLOW))
    dark = scene.lit_by(Sky(WHITE), lamps=False)
    assert dark.objects[0].emitter is None
    rig = tl.Rig([tl.Camera.from_fov(8, 8, 20)], [ABOVE])
    assert tl.render(dark, rig, spp=64)[0].mean() == pytest.approx(ALBEDO, rel=0.02)


XML = """<scene version="3.0.0">
 <sensor type="perspective"><float name="fov" value="20"/><float name="near_clip" value="0.5"/>
  <float name="far_clip" value="3"/>
  <transform name="to_world"><lookat origin="0,0,2" target="0,0,0" up="0,1,0"/></transform>
 </sensor>
 <emitter type="constant"><rgb name="radiance" value="9"/></emitter>
 <shape type="rectangle"><bsdf type="diffuse"><rgb name="reflectance" value="0.5"/></bsdf></shape>
</scene>"""
GROUP = '<shape type="shapegroup" id="g"><shape type="sphere"/></shape><shape type="instance"><ref id="g"/></shape>'


def test_a_mitsuba_file_is_lit_by_a_sky_in_place_of_its_own_unless_it_has_instances(
    tmp_path,
):
    path = tmp_path / "scene.xml"
    path.write_text(XML)
    scene = tl.load_scene(path)
    lit = scene.lit_by(Sky(0.4 * WHITE))
    rig = tl.Rig([tl.Camera.from_fov(8, 8, 20)], [scene.world_from_left])
    assert tl.render(lit, rig, spp=64)[0].mean() == pytest.approx(0.5 * 0.4, rel=0.01)
    assert np.allclose(tl.ground_truth(lit, rig)[0].depth, 2.0)
    path.write_text(XML.replace("</scene>", f"{GROUP}</scene>"))
    scene = tl.load_scene(path)
    tl.render(scene, rig, spp=1)
    message = r"scene\.xml: has instances; a sky can light only Mitsuba files"
    with pytest.raises(InputError, match=message) as caught:
        tl.render(scene.lit_by(Sky(WHITE)), rig, spp=1)
    assert "\n" not in str(caught.value)
