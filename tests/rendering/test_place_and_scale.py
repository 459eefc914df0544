"""Where a scene stands and how large it is: images and truth do not depend on it.

A scene is moved and enlarged as its user would do it: all poses, the heights of bumps, and the power of lights at a
point by the square of the scale, so that surfaces get the same light.
"""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import twinlens as tl
from twinlens.camera import Projector
from twinlens.families import random_scene
from twinlens.geometry import look_at, rigid
from twinlens.rendering.framing import frame_of
from twinlens.scenes import Bitmap, Scene, SceneObject
from twinlens.scenes.materials import Material
from twinlens.scenes.shapes import box, tessellated, transformed

UTM = (408201.5848, 4080928.0166, 31.4)
FAR = (-9.3e6, 2.7e6, 1e7)
BALL = {"type": "sphere"}
CAMERA = tl.Camera.from_fov(40, 30, 60)
RIPPLES = np.sin(np.linspace(0, 60, 64))[None].repeat(64, axis=0).astype(np.float32)
MATERIALS = {
    "paint": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}},
    "black": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
    "mirror": {"type": "conductor", "material": "none"},
}


def materials(scale=1.0):
    bump = {"bump": Bitmap(RIPPLES), "bump_scale": 0.01 * scale}
    ripples = Material(base_color=0.5, two_sided=True, **bump)
    return {**MATERIALS, "ripples": ripples}


def placed(scale, place):
    """world_from_old: a similarity."""
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = place
    return matrix


def moved_pose(pose, scale, place):
    """The pose of a camera or a lamp, which has no size."""
    return rigid(pose[:3, :3], scale * pose[:3, 3] + np.array(place))


def still_life(scale=1.0, place=(0.0, 0.0, 0.0)):
    """A floor with bumps, a ball, a mirror, a mesh in place, two copies of a box; a point, a spot and a sky."""
    world = placed(scale, place)
    floor = np.diag([3.0, 3.0, 1.0, 1.0])
    in_place = transformed(tessellated(BALL), placed(0.2, (0.5, -0.3, 0.2)))
    objects = (
        SceneObject("floor", {"type": "rectangle"}, "ripples", world @ floor),
        SceneObject(
            "ball",
            {"type": "sphere", "center": [-0.4, 0, 0.3], "radius": 0.3},
            "paint",
            world,
        ),
        SceneObject(
            "mirror",
            box(np.array([0.6, 0.05, 0.6])),
            "mirror",
            world @ placed(1.0, (0.3, 0.7, 0.3)),
        ),
        # Its vertices, not its pose, are where it stands.
        SceneObject("mesh", transformed(in_place, world), "paint"),
        SceneObject(
            "pair",
            tessellated({"type": "cube"}),
            "paint",
            placed(0.1, (0, 0, 0.1)),
            instances=(
                world @ placed(1.0, (0.1, -0.5, 0.0)),
                world @ placed(1.0, (0.2, 0.2, 0.0)),
            ),
        ),
    )
    intensity = 2.0 * scale**2
    lamp = moved_pose(look_at([1, -1, 2], [0, 0, 0], [0, 0, 1]), scale, place)
    lights = {
        "point": {
            "type": "point",
            "position": (world @ [-1.0, -0.5, 1.5, 1.0])[:3].tolist(),
            "intensity": intensity,
        },
        "spot": {"type": "spot", "to_world": lamp, "intensity": intensity},
        "sky": {"type": "constant", "radiance": 0.2},
    }
    view = moved_pose(look_at([0, -2.2, 1.2], [0, 0, 0.2], [0, 0, 1]), scale, place)
    depths = (1.5 * scale, 4.0 * scale)
    return Scene("still life", objects, materials(scale), view, depths, lights)


def painted(scene):
    """The matte objects of a scene under its sky: kernels of few materials and lights are compiled quickly."""
    objects = tuple(item for item in scene.objects if item.material == "paint")
    return replace(scene, objects=objects, lights={"sky": scene.lights["sky"]})


def matte_life(scale=1.0, place=(0.0, 0.0, 0.0)):
    """Images without noise take more kernels: of a still life of one material and one light."""
    return painted(still_life(scale, place))


def pair_of(scene, scale=1.0):
    """Two cameras and a projector with an aperture at the scene's view."""
    pose = rigid(np.eye(3), [0.05 * scale, 0.0, 0.0])
    lamp = Projector(
        pose,
        CAMERA,
        np.eye(30, 40),
        power=5.0 * scale**2,
        band="rgb",
        aperture_diameter=0.02 * scale,
        focus_distance=2.2 * scale,
    )
    rig = tl.Rig.stereo(CAMERA, 0.1 * scale, scene.world_from_left)
    return tl.Rig(rig.cameras, rig.world_from_cams, projectors=[lamp])


def smooth_pixels(truth):
    """The pixels whose neighbours are of the same object."""
    height, width = truth.object_id.shape
    around = np.pad(truth.object_id, 1, mode="edge")
    same = np.ones((height, width), dtype=bool)
    for y, x in itertools.product(range(3), repeat=2):
        same &= around[y : y + height, x : x + width] == truth.object_id
    return same


PLACES = [(1.0, FAR), (1e-4, (3.0, 5.0, -7.0)), (1e4, (0.0, 0.0, 0.0))]


@pytest.mark.parametrize(("scale", "place"), PLACES)
def test_truth_is_the_same_at_any_place_and_scale(scale, place):
    here, there = still_life(), still_life(scale, place)
    truths = tl.ground_truth(here, pair_of(here))
    far_truths = tl.ground_truth(there, pair_of(there, scale))
    rounding = 1e-6 * scale + 1e-15 * np.abs(place).max()
    for truth, far in zip(truths, far_truths, strict=True):
        assert (truth.object_id != far.object_id).sum() <= 2
        same = (truth.object_id == far.object_id) & (truth.object_id > 0)
        np.testing.assert_allclose(
            far.depth[same] / scale, truth.depth[same], rtol=1e-6
        )
        positions = scale * truth.position[same] + np.array(place)
        np.testing.assert_allclose(far.position[same], positions, rtol=0, atol=rounding)
        finite = same & np.isfinite(truth.disparity) & np.isfinite(far.disparity)
        assert finite.mean() > 0.5
        disparities = far.disparity[finite], truth.disparity[finite]
        np.testing.assert_allclose(*disparities, rtol=0, atol=1e-3)
        for ours, theirs in zip(far.objects, truth.objects, strict=True):
            assert abs(ours.pixel_count - theirs.pixel_count) <= 2
        lit, far_lit = truth.projections[0].lit, far.projections[0].lit
        assert (lit != far_lit).sum() <= 4


@pytest.mark.parametrize(
    ("made", "scale", "place", "denoise"),
    [
        (still_life, *PLACES[0], False),
        (still_life, *PLACES[1], False),
        (matte_life, *PLACES[0], True),
        pytest.param(still_life, *PLACES[0], True, marks=pytest.mark.slow),
        pytest.param(still_life, *PLACES[2], False, marks=pytest.mark.slow),
    ],
)
def test_images_are_the_same_at_any_place_and_scale(made, scale, place, denoise):
    """With the same random numbers, so that they differ by rounding, and where paths just miss an edge."""
    here, there = made(), made(scale, place)
    smooth = [smooth_pixels(truth) for truth in tl.ground_truth(here, pair_of(here))]
    lens = tl.ThinLens(0.02, 2.2)
    far_lens = tl.ThinLens(0.02 * scale, 2.2 * scale)
    images = tl.render(here, pair_of(here), lens, spp=4, denoise=denoise)
    far_images = tl.render(
        there, pair_of(there, scale), far_lens, spp=4, denoise=denoise
    )
    for image, far, inside in zip(images, far_images, smooth, strict=True):
        close = np.isclose(far, image, rtol=1e-3, atol=1e-3 * image.mean()).all(axis=-1)
        assert close[inside].mean() >= 0.98
        assert far.mean() == pytest.approx(image.mean(), rel=2e-3)


@pytest.mark.parametrize(
    ("place", "radius", "distance"),
    [
        (UTM, 0.5, 3.0),
        ((0, 0, 0), 1.5e-3, 0.01),
        (UTM, 1.5e-3, 0.3),
        (FAR, 40.0, 500.0),
    ],
)
def test_a_contact_shadow_is_that_of_the_closed_form(place, radius, distance):
    """A black ball of radius R on a floor below an even sky hides (R / d)^3 of its light, d from the ball's middle.

    The form factor from a surface element to a sphere above its horizon is (R / d)^2 cos(a), here with cos(a) = R / d.
    """
    middle = np.add(place, [0, 0, radius])
    objects = (
        SceneObject(
            "floor", {"type": "rectangle"}, "paint", placed(20 * radius, place)
        ),
        SceneObject("ball", BALL, "black", placed(radius, middle)),
    )
    eye = np.array(place) + distance * np.array([0, -0.8, 0.6])
    view = look_at(eye, np.array(place), [0, 0, 1])
    sky = {"sky": {"type": "constant", "radiance": 1.0}}
    scene = Scene("ball", objects, MATERIALS, view, (distance / 2, 2 * distance), sky)
    camera = tl.Camera.from_fov(
        48, 36, 2 * math.degrees(math.atan(2 * radius / distance))
    )
    rig = tl.Rig([camera], [view])
    truth = tl.ground_truth(scene, rig)[0]
    (image,) = tl.render(scene, rig, spp=256)
    floor = smooth_pixels(truth) & (truth.object_id == 1)
    away = np.linalg.norm(truth.position[floor] - middle, axis=-1)
    expected = 0.6 * (1 - (radius / away) ** 3)
    dark = expected < 0.3
    assert dark.sum() > 20
    assert image[floor][dark].mean() == pytest.approx(expected[dark].mean(), rel=0.01)
    assert image[floor].mean() == pytest.approx(expected.mean(), rel=0.005)


def ground(size, seen_from, depths=(1.0, 1e4)):
    """A square plane at z = 0 with a ball of 5 cm at its edge, and a default view elsewhere."""
    objects = (
        SceneObject(
            "ground", {"type": "rectangle"}, "paint", placed(size / 2, (0, 0, 0))
        ),
        SceneObject("ball", BALL, "black", placed(0.05, (0, size / 2 - 2, 0.05))),
    )
    view = look_at(seen_from, [0, 0, 0], [0, 1, 0.01])
    sky = {"sky": {"type": "constant", "radiance": 1.0}}
    return Scene("ground", objects, MATERIALS, view, depths, sky)


@pytest.mark.parametrize("distance", [0.7, 30.0, 500.0])
def test_a_rig_far_from_the_default_view_sees_small_things_as_sharply(distance):
    """At the edge of a plane of 10 km, near by and through a long lens."""
    scene = ground(1e4, seen_from=[0.0, 0.0, 5e3])
    at = np.array([0.0, 5e3 - 2, 0.0])
    pose = look_at(at + distance * np.array([0, -0.8, 0.6]), at, [0, 0, 1])
    camera = tl.Camera.from_fov(48, 36, 2 * math.degrees(math.atan(0.1 / distance)))
    rig = tl.Rig.stereo(camera, 1e-3 * distance, pose)
    truth = tl.ground_truth(scene, rig)[0]
    (image, _) = tl.render(scene, rig, spp=256)
    # The plane z = 0 in closed form: the ray o + t d ends at t = -o_z / d_z.
    directions = camera.rays(camera.pixel_grid()) @ pose[:3, :3].T
    depth = -pose[2, 3] / directions[..., 2] * camera.rays(camera.pixel_grid())[..., 2]
    floor = smooth_pixels(truth) & (truth.object_id == 1)
    np.testing.assert_allclose(truth.depth[floor], depth[floor], rtol=1e-7)
    disparity = camera.fx * 1e-3 * distance / depth
    np.testing.assert_allclose(truth.disparity[floor], disparity[floor], atol=1e-3)
    away = np.linalg.norm(truth.position[floor] - np.add(at, [0, 0, 0.05]), axis=-1)
    expected = 0.6 * (1 - (0.05 / away) ** 3)
    dark = expected < 0.3
    assert dark.sum() > 20
    assert image[floor][dark].mean() == pytest.approx(expected[dark].mean(), rel=0.01)


def test_rigs_close_to_the_default_view_share_its_frame():
    scene = still_life()
    rig = pair_of(scene)
    closer = scene.world_from_left.copy()
    closer[:3, 3] += 0.3 * closer[:3, 2]
    other = tl.Rig.stereo(CAMERA, 0.3, closer)
    assert frame_of(scene, rig) == frame_of(scene, other)


def test_an_image_does_not_depend_on_what_was_rendered_before():
    at = np.array([0.0, 5e3 - 2, 0.0])
    near = tl.Rig(
        [CAMERA], [look_at(at + 0.6 * np.array([0, -0.8, 0.6]), at, [0, 0, 1])]
    )
    first, second = (ground(1e4, seen_from=[0.0, 0.0, 5e3]) for _ in range(2))
    far = tl.Rig([CAMERA], [second.world_from_left])
    tl.render(second, far, spp=1)
    tl.ground_truth(second, far)
    np.testing.assert_array_equal(
        tl.render(first, near, spp=4)[0], tl.render(second, near, spp=4)[0]
    )


FILE = """<scene version="3.0.0">
  <sensor type="perspective">
    <float name="fov" value="60"/>
    <float name="near_clip" value="{near}"/> <float name="far_clip" value="{far}"/>
    <transform name="to_world">
      <lookat origin="{eye}" target="{target}" up="0, 0, 1"/>
    </transform>
  </sensor>
  <bsdf type="bumpmap" id="ripples">
    <texture type="bitmap" name="arbitrary"> <string name="filename" value="ripples.png"/> </texture>
    <float name="scale" value="{bump}"/> <bsdf type="diffuse"/>
  </bsdf>
  <shape type="rectangle">
    <transform name="to_world"><scale value="3"/>{world}</transform> <ref id="ripples"/>
  </shape>
  <shape type="sphere">
    <point name="center" x="-0.4" y="0" z="0.3"/> <float name="radius" value="0.3"/>
    <transform name="to_world">{world}</transform> <bsdf type="diffuse"/>
  </shape>
  <shape type="shapegroup" id="group">
    <shape type="cube"><transform name="to_world"><scale value="0.1"/></transform></shape>
  </shape>
  <shape type="instance">
    <ref id="group"/>
    <transform name="to_world"><rotate z="1" angle="30"/><translate x="0.4" z="0.1"/>{world}</transform>
  </shape>
  <emitter type="point"> <point name="position" value="{lamp}"/> <rgb name="intensity" value="{power}"/> </emitter>
  <emitter type="spot">
    <transform name="to_world"><lookat origin="1, -1, 2" target="0, 0, 0" up="0, 0, 1"/>{world}</transform>
    <rgb name="intensity" value="{power}"/>
  </emitter>
  <emitter type="constant"> <rgb name="radiance" value="0.2"/> </emitter>
</scene>"""


@pytest.mark.parametrize(("scale", "place"), [(1.0, UTM), (1e-3, (0.0, 0.0, 0.0))])
def test_a_mitsuba_file_is_the_same_at_any_place_and_scale(tmp_path, scale, place):
    def read(scale, place):
        x, y, z = place

        def at(x, y, z):
            point = scale * np.array([x, y, z]) + place
            return ", ".join(map(repr, point.tolist()))

        text = FILE.format(
            near=1.5 * scale,
            far=4 * scale,
            bump=0.002 * scale,
            power=2.0 * scale**2,
            lamp=at(-1.0, -0.5, 1.5),
            eye=at(0.0, -2.2, 1.2),
            target=at(0.0, 0.0, 0.2),
            world=f'<scale value="{scale}"/><translate x="{x}" y="{y}" z="{z}"/>',
        )
        path = tmp_path / f"{scale}-{x}.xml"
        path.write_text(text)
        return tl.load_scene(path)

    Image.fromarray((127 + 127 * RIPPLES).astype(np.uint8)).save(
        tmp_path / "ripples.png"
    )
    here, there = read(1.0, (0.0, 0.0, 0.0)), read(scale, place)
    rigs = [
        tl.Rig.stereo(CAMERA, 0.1 * size, scene.world_from_left)
        for scene, size in ((here, 1.0), (there, scale))
    ]
    truth = tl.ground_truth(here, rigs[0])[0]
    far_truth = tl.ground_truth(there, rigs[1])[0]
    hit = np.isfinite(truth.depth)
    assert (far_truth.object_id == truth.object_id).mean() > 0.995
    close = np.isclose(
        far_truth.disparity[hit], truth.disparity[hit], rtol=0, atol=1e-3
    )
    assert close.mean() > 0.995
    image = tl.render(here, rigs[0], spp=16)[0]
    far = tl.render(there, rigs[1], spp=16)[0]
    inside = smooth_pixels(truth)
    close = np.isclose(far, image, rtol=1e-3, atol=1e-3 * image.mean()).all(axis=-1)
    assert close[inside].mean() >= 0.98
    assert far.mean() == pytest.approx(image.mean(), rel=2e-3)


def test_a_light_field_is_the_same_at_any_place():
    here, there = (painted(still_life(1.0, place)) for place in ((0.0, 0.0, 0.0), FAR))
    fields = []
    for scene in (here, there):
        rig = tl.light_field_rig(
            CAMERA, tl.ThinLens(0.1, 2.2), 2, scene.world_from_left
        )
        fields.append(tl.render_light_field(scene, rig, spp=4))
    for image, far in zip(*fields, strict=True):
        close = np.isclose(far, image, rtol=1e-3, atol=1e-3 * image.mean())
        assert close.mean() >= 0.98


BUNDLED = tl.bundled_scenes()
RANDOM = [
    (family, seed)
    for family in ("tabletop", "room", "flying", "cards")
    for seed in (5, 6)
]
SMALL = (64, 48)


def turned(turn_deg):
    """world_from_old, a rotation about the vertical axis."""
    turn = math.radians(turn_deg)
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, 1.0]])


def moved_light(light, scale, place, turn):
    """A light turned with the scene."""
    light = dict(light)
    for key in ("direction", "sun_direction"):
        if key in light:
            light[key] = (turn @ np.asarray(light[key], dtype=float)).tolist()
    if "to_world" in light:
        pose = rigid(turn, [0, 0, 0]) @ np.asarray(light["to_world"])
        light["to_world"] = moved_pose(pose, scale, place)
    if "position" in light:
        light["position"] = (scale * turn @ light["position"] + place).tolist()
    assert "intensity" not in light
    return light


def moved(scene, scale, place, turn_deg=0.0):
    """The scene, turned about the vertical axis, then enlarged, then moved."""
    turn = turned(turn_deg)
    world = placed(scale, place) @ rigid(turn, [0, 0, 0])
    objects = []
    for item in scene.objects:
        if item.instances:
            instances = tuple(world @ pose for pose in item.instances)
            objects.append(replace(item, instances=instances))
        else:
            pose = world @ item.world_from_object
            objects.append(replace(item, world_from_object=pose))
    near, far = scene.depth_range
    view = rigid(turn, [0, 0, 0]) @ scene.world_from_left
    sky = scene.sky
    return replace(
        scene,
        objects=tuple(objects),
        materials={
            name: replace(paint, bump_scale=paint.bump_scale * scale)
            if isinstance(paint, Material)
            else paint
            for name, paint in scene.materials.items()
        },
        lights={
            name: moved_light(light, scale, np.array(place), turn)
            for name, light in scene.lights.items()
        },
        sky=sky and replace(sky, turn_deg=sky.turn_deg + turn_deg),
        world_from_left=moved_pose(view, scale, place),
        depth_range=(near * scale, far * scale),
    )


def rig_of(scene, baseline, lit=False):
    """A pair at a scene's view; with a projector beside the left camera if it is to be lit."""
    camera = tl.Camera.from_fov(*SMALL, scene.fov_x_deg)
    rig = tl.Rig.stereo(camera, baseline, scene.world_from_left)
    if not lit:
        return rig
    near, far = scene.depth_range
    dots = np.random.default_rng(0).random((48, 64)) < 0.2
    lamp = Projector(
        rigid(np.eye(3), [baseline / 2, 0, 0]),
        camera,
        dots.astype(np.float32),
        # Less than the 1e9 W that are allowed, also for scenes 1e4 times as large.
        power=0.01 * near * far,
        band="rgb",
    )
    return tl.Rig(rig.cameras, rig.world_from_cams, projectors=[lamp])


def rms_difference(image, other, inside):
    return float(np.sqrt(np.mean((image - other)[inside] ** 2)))


def raw_images(scene, baseline, lens):
    """Pairs with 4 samples through a lens: of all light, of direct light, and of all light with another seed."""
    rig = rig_of(scene, baseline)
    direct = replace(scene, integrator={"type": "path", "max_depth": 2})
    return (
        tl.render(scene, rig, lens, spp=4),
        tl.render(direct, rig, lens, spp=4),
        tl.render(scene, rig, lens, spp=4, seed=1),
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*blocks its light")  # glass before the projector
@pytest.mark.parametrize("name", [*BUNDLED, *RANDOM], ids=str)
def test_scenes_are_the_same_at_any_place_and_scale(name):
    """Bundled and random scenes: truth, raw images through a lens, denoised ones with a projector and a pinhole."""
    is_random = isinstance(name, tuple)
    here = random_scene(*name) if is_random else tl.load_scene(name)
    truths = tl.ground_truth(here, rig_of(here, here.baseline), objects=False)
    smooth = [smooth_pixels(truth) for truth in truths]
    focus = here.depth_range[0] * 1.3
    lens = tl.ThinLens(0.01, focus)
    raw, direct, other_raw = raw_images(here, here.baseline, lens)
    raw_noise = [
        rms_difference(image, other, inside)
        for image, other, inside in zip(raw, other_raw, smooth, strict=True)
    ]
    lit = rig_of(here, here.baseline, lit=True)
    # With 4 samples, means differ by 0.2 % from seed to seed where rounding changes paths.
    clean = tl.render(here, lit, spp=16, denoise=True)
    other_seed = tl.render(here, lit, spp=16, denoise=True, seed=1)
    noise = [
        rms_difference(image, other, inside)
        for image, other, inside in zip(clean, other_seed, smooth, strict=True)
    ]
    for scale, place, turn_deg in (
        (1.0, FAR, 0.0),
        (1e-4, (3.0, 5.0, -7.0), 0.0),
        (1e4, (0.0, 0.0, 0.0), 0.0),
        (1.0, UTM, 65.0),
    ):
        there = moved(here, scale, place, turn_deg)
        baseline = here.baseline * scale
        pair = rig_of(there, baseline)
        far_truths = tl.ground_truth(there, pair, objects=False)
        far_lens = tl.ThinLens(0.01 * scale, focus * scale)
        far_raw, far_direct, _ = raw_images(there, baseline, far_lens)
        far_clean = tl.render(
            there, rig_of(there, baseline, lit=True), spp=16, denoise=True
        )
        for truth, far in zip(truths, far_truths, strict=True):
            other = truth.object_id != far.object_id
            same = ~other & np.isfinite(truth.disparity) & np.isfinite(far.disparity)
            error = np.abs(far.disparity[same] - truth.disparity[same]).max()
            print(
                name,
                scale,
                turn_deg,
                f"ids {other.sum()} disparity {error:.1e} px",
                end=" ",
            )
            assert other.sum() <= 4
            assert error <= 1e-3
            assert (truth.visible != far.visible).sum() <= 4
        for image, far, inside in zip(direct, far_direct, smooth, strict=True):
            mean = image.mean()
            close = np.isclose(far, image, rtol=1e-3, atol=1e-3 * mean).all(axis=-1)
            share = close[inside].mean()
            print("direct light", f"{share:.4f}", end=" ")
            # Turned scenes have other random directions.
            assert turn_deg or share >= 0.95
        for image, far, inside, limit in zip(
            raw, far_raw, smooth, raw_noise, strict=True
        ):
            # Each reflection at a curved surface enlarges the rounding, until a path meets another surface.
            difference = rms_difference(image, far, inside) / limit
            change = far.mean() / image.mean() - 1
            print("raw", f"{difference:.2f} of the noise {change:+.1e}", end=" ")
            assert difference <= (1.5 if turn_deg else 1.0)
            assert abs(change) <= (0.05 if turn_deg else 5e-3)
        for image, far, inside, limit in zip(
            clean, far_clean, smooth, noise, strict=True
        ):
            # A path that rounding changes changes its whole neighbourhood, so that only few pixels keep their value;
            # the images differ less than those of two seeds.
            difference = rms_difference(image, far, inside) / limit
            print("denoised", f"{difference:.2f} of the noise", end=" ")
            assert difference <= (1.5 if turn_deg else 1.0)
            rel = 0.05 if turn_deg else 5e-3
            assert far.mean() == pytest.approx(image.mean(), rel=rel)
        print()
