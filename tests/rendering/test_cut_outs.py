"""Truth passes what is cut out of a surface: beside a ray caster in NumPy, and beside edges in rendered images."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter

import twinlens as tl
from tests.rendering.cut_out_cases import CORNERS, FACES, UV, Card, blobs, cast, facing
from twinlens.camera.truth import MATERIAL_KINDS
from twinlens.errors import InputError
from twinlens.rendering.build import build
from twinlens.rendering.tracing import Rays, Stop, trace_surfaces
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.scenes.materials import Bitmap, Material, VertexColor, lambert
from twinlens.scenes.plugins import material_of

CAMERA = tl.Camera.from_fov(96, 72, fov_x_deg=40)
BASELINE = 0.2
RIG = tl.Rig.stereo(CAMERA, BASELINE, world_from_left=np.eye(4))
ALONE = tl.Rig((CAMERA,), (np.eye(4),))
ROUNDING = 2e-5  # of an alpha: where it is nearer to the cut, either answer is right
SKY = {"sky": {"type": "constant"}}
DIRECT = {"type": "path", "max_depth": 2}
OPAQUE = np.ones((1, 1))


def scene_of(cards, color=None, **more):
    colors = color or {}
    materials = {card.name: card.material(colors.get(card.name, 0.8)) for card in cards}
    objects = tuple(card.scene_object(card.name) for card in cards)
    return Scene(
        "cards", objects, materials, np.eye(4), (0.5, 10.0), SKY, DIRECT, **more
    )


def wall(z=4.0):
    return Card("wall", facing((0, 0, z), 12.0), OPAQUE)


SCALE = np.diag([2.7, 3.4, 1])
TURN = np.array([[0.8, -0.6, 0.3], [0.6, 0.8, -0.2], [0, 0, 1]])
TILTED = (0.3, -0.2, -1)
TURNED = {"wrap": ("repeat", "clamp"), "to_uv": 2 * TURN}
LEAVES = {
    "cutoff 0.3": Card("leaf", facing((0, 0, 2), 1.2), blobs(9, 16, 1), 0.3),
    "cutoff 0.55, tilted": Card("leaf", facing((0, 0, 2), 1.3, 0.4, TILTED), blobs(64, 48, 2), 0.55),
    "nearest": Card("leaf", facing((0.1, 0, 2), 1.2, 0.2), blobs(12, 10, 3), 0.5, filter="nearest"),
    "mirrored, repeated": Card("leaf", facing((0, 0, 2), 1.2), blobs(8, 6, 4), wrap="mirror", to_uv=SCALE),
    "clamped, turned": Card("leaf", facing((0, 0, 2), 1.2), blobs(20, 20, 5), 0.45, wrap="clamp", to_uv=TURN),
    "repeated, turned": Card("leaf", facing((0, 0, 2), 1.2), blobs(20, 31, 6), 0.55, to_uv=2 * TURN),
    "repeated and clamped": Card("leaf", facing((0, 0, 2), 1.2), blobs(9, 16, 10), **TURNED),
    "mirrored and repeated": Card("leaf", facing((0, 0, 2), 1.2), blobs(7, 8, 11),
                                  wrap=("mirror", "repeat"), to_uv=SCALE),
    "clamped and mirrored": Card("leaf", facing((0, 0, 2), 1.2), blobs(9, 5, 12), filter="nearest",
                                 wrap=("clamp", "mirror"), to_uv=SCALE),
    "blended": Card("leaf", facing((0, 0, 2), 1.2, 1.0), blobs(20, 30, 7), 0.5, "BLEND"),
    "cutoff 0": Card("leaf", facing((0, 0, 2), 1.2), blobs(20, 30, 8), 0.0),
    "cutoff 1": Card("leaf", facing((0, 0, 2), 1.2), np.clip(2 * blobs(20, 30, 9), 0, 1), 1.0, filter="nearest"),
}  # fmt: skip


@pytest.mark.parametrize("name", LEAVES)
def test_truth_of_a_leaf_before_a_wall(name):
    """Object, depth and disparity per pixel, and whether the partner sees the point past or through the leaf."""
    cards = [LEAVES[name], wall()]
    truths = tl.ground_truth(scene_of(cards), RIG)
    for index, truth in enumerate(truths):
        check_view(cards, truth, RIG, index)
        check_objects(cards, truth, RIG, index)


def check_view(cards, truth, rig, index):
    camera, pose = rig.cameras[index], rig.world_from_cams[index]
    rays = camera.rays(camera.pixel_grid()).reshape(-1, 3)
    directions = rays @ pose[:3, :3].T
    centre = np.broadcast_to(pose[:3, 3], directions.shape)
    first, distance, margin = cast(cards, centre, directions)
    sure = margin > ROUNDING
    assert sure.mean() > 0.99
    assert np.array_equal(truth.object_id.ravel()[sure], first[sure] + 1)
    assert (truth.material_kind.ravel()[first >= 0] == 1).all()
    sure &= first >= 0
    depth = distance * rays[:, 2]
    np.testing.assert_allclose(truth.depth.ravel()[sure], depth[sure], rtol=1e-6)
    disparity = camera.fx * BASELINE / depth
    np.testing.assert_allclose(truth.disparity.ravel()[sure], disparity[sure], atol=1e-4)  # fmt: skip

    partner = rig.world_from_cams[1 - index]
    points = centre + distance[:, None] * directions
    with np.errstate(invalid="ignore"):
        offset = points - partner[:3, 3]
        length = np.linalg.norm(offset, axis=1)
        from_partner = offset / length[:, None]
    sure &= np.isfinite(length)
    eye = np.broadcast_to(partner[:3, 3], offset.shape)
    _, reach, margin = cast(cards, eye[sure], from_partner[sure])
    # The point itself may be at a texel's edge, where the partner's ray passes on: it is seen all the same.
    seen = reach >= length[sure] * (1 - 1e-6)
    u = camera.pixel_grid()[..., 0].ravel()[sure]
    u = u - disparity[sure] if index == 0 else u + disparity[sure]
    in_image = (u > -0.5) & (u < camera.width - 0.5)
    in_sure = margin > ROUNDING
    assert in_sure.mean() > 0.99
    expected = seen & in_image
    assert np.array_equal(truth.visible.ravel()[sure][in_sure], expected[in_sure])


def check_objects(cards, truth, rig, index):
    """Amodal masks: the pixels whose rays meet the card's opaque texels, whatever is before it."""
    camera, pose = rig.cameras[index], rig.world_from_cams[index]
    directions = camera.rays(camera.pixel_grid()).reshape(-1, 3) @ pose[:3, :3].T
    centre = np.broadcast_to(pose[:3, 3], directions.shape)
    names = {truth.object_names[body.object_id - 1]: body for body in truth.objects}
    for card in cards:
        first, _, margin = cast([card], centre, directions)
        whole = (first == 0) & (margin > ROUNDING)
        if not whole.any():
            continue
        mask = truth.silhouette(names[card.name]).ravel()
        sure = margin > ROUNDING
        assert np.array_equal(mask[sure], first[sure] == 0)


@pytest.mark.parametrize(
    "name",
    [
        "cutoff 0.3",
        "blended",
        pytest.param("mirrored, repeated", marks=pytest.mark.slow),
        pytest.param("nearest", marks=pytest.mark.slow),
        pytest.param("cutoff 0.55, tilted", marks=pytest.mark.slow),
    ],
)
def test_the_edge_of_truth_is_that_of_the_converged_picture(name):
    """A white leaf before a black wall: its part of each pixel is the pixel's radiance over that of the leaf.

    The centre of a pixel is inside where the part is over half, but for edges that bend within a pixel.
    """
    leaf = LEAVES[name]
    whole = replace(leaf, alpha=OPAQUE)
    scene, without_cut_outs = (
        scene_of([card, wall()], {"leaf": 1.0, "wall": 0.0}) for card in (leaf, whole)
    )
    (image,), (bright,) = (
        tl.render(shown, ALONE, spp=256, seed=1) for shown in (scene, without_cut_outs)
    )
    (truth,), (of_whole,) = (
        tl.ground_truth(shown, ALONE) for shown in (scene, without_cut_outs)
    )
    is_whole = of_whole.object_id == 1
    part = image.mean(axis=-1) / np.median(bright.mean(axis=-1)[is_whole])
    inside = truth.object_id == 1
    assert 0.1 < inside.mean() < 0.9
    if leaf.mode == "MASK":
        # Four standard deviations of 256 samples, and the error of a grid of 64 points.
        covered = [cast([leaf], np.zeros_like(rays), rays)[0] == 0 for rays in points_of_pixels(CAMERA, 8)]  # fmt: skip
        share = np.mean(covered, axis=0).reshape(part.shape)
        assert np.abs(part - share).max() < 4 * 0.5 / 16 + 1 / 16
    is_near = np.abs(part - 0.5) < (0.02 if leaf.mode == "MASK" else 0.05)
    assert ((inside != (part > 0.5)) & ~is_near).mean() < 0.01


CHALK = {"type": "diffuse"}
HOLE = {"type": "mask", "opacity": 0.0, "bsdf": CHALK}
PANE = {"type": "thindielectric"}
FLAT = Bitmap(np.full((2, 2, 3), 0.5, np.float32))


UPRIGHT = Bitmap(np.full((2, 2, 3), [0.5, 0.5, 1.0], np.float32))
BELOW = {
    "diffuse": CHALK,
    "plastic": {"type": "roughplastic", "alpha": 0.3},
    "normal map": {"type": "normalmap", "normalmap": UPRIGHT, "bsdf": CHALK},
    "blend": {"type": "blendbsdf", "weight": 0.4, "bsdf_0": CHALK, "bsdf_1": {"type": "principled"}},
}  # fmt: skip


@pytest.mark.parametrize("opacity", [0.25, 1.0])
@pytest.mark.parametrize("name", BELOW)
def test_both_sides_of_a_mask_are_seen(name, opacity):
    """`twosided` may be around a mask: under a constant sky a white surface is as bright from behind."""
    below = BELOW[name]
    mask = {"type": "mask", "opacity": opacity, "bsdf": below}
    material = material_of({"type": "twosided", "bsdf": mask})
    card = SceneObject("card", {"type": "rectangle"}, "card", np.eye(4))
    scene = Scene("card", (card,), {"card": material}, np.eye(4), (1.0, 9.0), SKY)
    camera = tl.Camera(2, 2, 400.0, 400.0, 0.5, 0.5)
    behind = tl.geometry.rigid(np.eye(3), np.array([0.0, 0.0, -4.0]))
    before = tl.geometry.rigid(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, 4.0]))
    rig = tl.Rig([camera] * 2, [before, behind])
    front, back = np.mean(tl.render(scene, rig, tl.Pinhole(), spp=256, seed=1), (1, 2))
    np.testing.assert_allclose(back, front, rtol=0.05)
    assert 0.4 < front.mean() < 1.1


def test_two_sides_of_glass_are_refused_in_one_line():
    scene = before_a_wall({"type": "twosided", "bsdf": PANE})
    with pytest.raises(InputError, match="'twosided' takes no mask and no glass") as caught:  # fmt: skip
        tl.ground_truth(scene, RIG)
    assert "\n" not in str(caught.value)


def bare(name, material, at, size=1.0):
    return SceneObject(name, {"type": "rectangle"}, material, facing(at, size))


def before_a_wall(material, size=1.0):
    """A sheet at 2 m in front of a wall at 4 m."""
    sheet, back = bare("sheet", "sheet", (0, 0, 2), size), bare("wall", "chalk", (0, 0, 4), 9.0)  # fmt: skip
    materials = {"sheet": material, "chalk": CHALK}
    return Scene("sheet", (sheet, back), materials, np.eye(4), (0.5, 10.0), SKY)


@pytest.mark.parametrize(
    ("material", "is_there", "kind"),
    [
        ({"type": "mask", "opacity": 0.5, "bsdf": CHALK}, True, "diffuse"),
        ({"type": "mask", "opacity": 0.49, "bsdf": CHALK}, False, None),
        ({"type": "mask", "opacity": 0.9, "bsdf": {"type": "conductor"}}, True, "mirror"),
        ({"type": "mask", "opacity": 0.9, "bsdf": {"type": "dielectric"}}, True, "transmissive"),
        ({"type": "mask", "opacity": 0.9, "bsdf": PANE}, True, "transmissive"),
        ({"type": "mask", "opacity": 0.1, "bsdf": PANE}, False, None),
        ({"type": "mask", "opacity": 0.9, "bsdf": {"type": "roughconductor"}}, True, "glossy"),
        ({"type": "null"}, False, None),
        (PANE, True, "transmissive"),
        ({"type": "normalmap", "normalmap": FLAT, "bsdf": HOLE}, False, None),
        ({"type": "bumpmap", "bump": FLAT, "bsdf": HOLE}, False, None),
        ({"type": "blendbsdf", "weight": 0.4, "bsdfs": [CHALK, HOLE]}, True, "diffuse"),
        ({"type": "blendbsdf", "weight": 0.6, "bsdfs": [CHALK, HOLE]}, False, None),
        (lambert(0.5, opacity=0.3, alpha_cutoff=0.3), True, "diffuse"),
        (lambert(0.5, opacity=0.3, alpha_cutoff=0.31), False, None),
        (lambert(0.5, opacity=1.0, alpha_cutoff=1.5), False, None),
        (lambert(0.5, opacity=0.0, alpha_cutoff=0.0), True, "diffuse"),
        (Material(opacity=0.6, transmission=1.0), True, "transmissive"),
        (Material(opacity=0.4, transmission=1.0), False, None),
    ],
)  # fmt: skip
def test_opacity_of_half_or_more_is_a_surface_of_the_kind_below_the_mask(
    material, is_there, kind
):
    """Whatever the mask is around or below; a pane of glass is a surface although it passes light straight on."""
    if isinstance(material, dict) and "bsdfs" in material:
        first, second = material["bsdfs"]
        material = {"type": "blendbsdf", "weight": material["weight"], "bsdf_0": first, "bsdf_1": second}  # fmt: skip
    (truth,) = tl.ground_truth(before_a_wall(material, 9.0), ALONE)
    assert np.unique(truth.object_id).tolist() == [1 if is_there else 2]
    np.testing.assert_allclose(truth.depth, 2.0 if is_there else 4.0, rtol=1e-6)
    expected = MATERIAL_KINDS.index(kind or "diffuse")
    assert np.unique(truth.material_kind).tolist() == [expected]


def test_what_is_behind_many_cut_outs_is_the_first_surface():
    """40 sheets that are not there, in any order of their objects, before a mirror, before a wall behind the camera."""
    places = np.random.default_rng(1).permutation(np.linspace(0.5, 3.5, 40))
    holes = [bare(f"hole{i}", "hole", (0, 0, z), 9.0) for i, z in enumerate(places)]
    mirror = bare("mirror", "mirror", (0, 0, 4), 9.0)
    back = SceneObject("back", {"type": "rectangle"}, "chalk", facing((0, 0, -1), 30, towards=(0, 0, 1)))  # fmt: skip
    materials = {"hole": HOLE, "mirror": {"type": "conductor"}, "chalk": CHALK}
    objects = (*holes, mirror, back)
    scene = Scene("holes", objects, materials, np.eye(4), (0.5, 10.0), SKY)
    directions = CAMERA.rays(CAMERA.pixel_grid()).reshape(-1, 3)
    rays = Rays.from_point(np.zeros(3), directions)
    layers = trace_surfaces(build(scene), rays, Stop.ALL)
    assert [np.unique(layer.body).tolist() for layer in layers] == [[40], [41]]
    np.testing.assert_allclose(layers[0].distance, 4 / directions[:, 2], rtol=1e-6)
    np.testing.assert_allclose(layers[1].distance, 9 / directions[:, 2], rtol=1e-6)
    np.testing.assert_allclose(layers[1].share, 1.0)


def test_light_that_passes_a_thin_veil_is_the_share_of_what_is_behind():
    """Two veils of opacity 0.2 and 0.3 are no surfaces; a net of 0.75 is one, with the wall as its second layer."""
    materials = {
        f"opacity {value}": {"type": "mask", "opacity": value, "bsdf": CHALK}
        for value in (0.2, 0.3, 0.75)
    }
    sheets = [bare(name, name, (0, 0, 1 + i), 9.0) for i, name in enumerate(materials)]
    objects = (*sheets, bare("wall", "chalk", (0, 0, 4), 9.0))
    materials["chalk"] = CHALK
    scene = Scene("veils", objects, materials, np.eye(4), (0.5, 10.0), SKY)
    rays = Rays.from_point(np.zeros(3), np.array([[0.0, 0, 1], [0.1, 0.05, 1]]))
    layers = trace_surfaces(build(scene), rays, Stop.ALL)
    assert [np.unique(layer.body).tolist() for layer in layers] == [[2], [3]]
    np.testing.assert_allclose(layers[0].share, 0.8 * 0.7, rtol=1e-6)
    np.testing.assert_allclose(layers[1].share, 0.8 * 0.7 * 0.25, rtol=1e-6)


def test_opacity_of_vertices_is_cut_between_them():
    """Opacity from 0 to 1 across a square, by vertices: the cut at 0.3 is a straight line, in closed form."""
    color = np.column_stack([np.full((4, 3), 0.8), [0.0, 1.0, 1.0, 0.0]])
    mesh = Mesh(CORNERS, FACES.astype(np.uint32), None, UV, attributes={"color": color})
    vertex = VertexColor("color")
    paint = Material(
        base_color=vertex, opacity=vertex, alpha_cutoff=0.3, two_sided=True
    )
    materials = {"leaf": paint}
    pose = facing((0, 0, 2), 1.0)
    leaf = SceneObject("leaf", mesh, "leaf", pose)
    scene = Scene("vertices", (leaf,), materials, np.eye(4), (0.5, 10.0), SKY)
    (truth,) = tl.ground_truth(scene, ALONE)
    directions = CAMERA.rays(CAMERA.pixel_grid()).reshape(-1, 3)
    points = 2 * directions / directions[:, 2:]
    across = (points - pose[:3, 3]) @ np.linalg.inv(pose[:3, :3]).T
    expected = (np.abs(across) <= 0.5).all(axis=1) & (across[:, 0] + 0.5 >= 0.3)
    assert np.array_equal(truth.object_id.ravel() == 1, expected)


def test_instances_and_round_shapes_have_cut_outs():
    """Copies of a card, in their own axes, before a ball whose texture leaves its upper half."""
    card = LEAVES["cutoff 0.3"]
    poses = [facing((x, 0, 2), 0.6, 0.3 * x) for x in (-0.4, 0.4)]
    placed = SceneObject("leaf", card.scene_object("leaf").shape, "leaf", instances=tuple(poses))  # fmt: skip
    half = np.zeros((2, 1), np.float32)
    half[0] = 1.0
    upper = lambert(0.5, opacity=Bitmap(half, "nearest"), two_sided=True)
    ball = SceneObject("ball", {"type": "sphere"}, "upper", facing((0, 0, 4), 1.0, towards=(0, 1, 0)))  # fmt: skip
    materials = {"leaf": card.material(), "upper": upper}
    scene = Scene("copies", (placed, ball), materials, np.eye(4), (0.5, 10.0), SKY)
    cards = [replace(card, world_from_card=pose, name=f"leaf[{i}]") for i, pose in enumerate(poses)]  # fmt: skip
    (truth,) = tl.ground_truth(scene, ALONE)
    directions = CAMERA.rays(CAMERA.pixel_grid()).reshape(-1, 3)
    first, _, margin = cast(cards, np.zeros_like(directions), directions)
    leaves = truth.object_id.ravel() * (truth.object_id.ravel() < 3)
    sure = margin > ROUNDING
    assert np.array_equal(leaves[sure], first[sure] + 1)
    check_objects(cards, truth, ALONE, 0)
    # The ball's texture has v along its own z axis; its lower half is open, also from inside.
    on_ball = truth.object_id == 3
    assert on_ball.any()
    above = truth.position[on_ball] - (0, 0, 4)
    axis = ball.world_from_object[:3, 2]
    assert (above @ axis > 0).all() or (above @ axis < 0).all()


def leaf_picture(width=48, height=80):
    """A white leaf on a card, alpha 0 around it and in a few holes, with soft borders."""
    x = np.abs(np.linspace(-1, 1, width))[None, :]
    y = np.linspace(-1, 1, height)[:, None]
    outline = 0.9 * np.cos(0.5 * np.pi * y) ** 0.8 - x
    holes = np.sin(9 * y + 4) * np.sin(11 * x) - 0.8
    alpha = np.clip(0.5 + 12 * np.minimum(outline, -holes), 0, 1)
    return np.round(255 * alpha).astype(np.uint8)


def plant(folder, leaves=200):
    """A .glb of one mesh of leaves with alphaMode MASK, a scene of it before a black wall, and its cards."""
    rng = np.random.default_rng(7)
    alpha = leaf_picture()
    cards = []
    for _ in range(leaves):
        at = rng.uniform((-0.9, -0.7, 2.4), (0.9, 0.7, 3.6))
        pose = facing(at, rng.uniform(0.2, 0.4), rng.uniform(0, 6.3), rng.normal(size=3))  # fmt: skip
        cards.append(Card("plant", pose, alpha / 255, 0.4))
    vertices = np.concatenate([
        CORNERS @ card.world_from_card[:3, :3].T + card.world_from_card[:3, 3] for card in cards
    ])  # fmt: skip
    faces = np.concatenate([FACES + 4 * i for i in range(leaves)])
    white = np.full((*alpha.shape, 3), 255, np.uint8)
    texture = Image.fromarray(np.dstack([white, alpha]))
    paint = trimesh.visual.material.PBRMaterial(
        baseColorTexture=texture, alphaMode="MASK", alphaCutoff=0.4, doubleSided=True,
        metallicFactor=0.0, roughnessFactor=1.0,
    )  # fmt: skip
    visual = trimesh.visual.TextureVisuals(uv=np.tile(UV, (leaves, 1)), material=paint)
    trimesh.Trimesh(vertices, faces, visual=visual, process=False).export(folder / "plant.glb")  # fmt: skip
    (folder / "scene.toml").write_text(
        """
[camera]
position = [0, 0, 0]
look_at = [0, 0, 1]
up = [0, -1, 0]
depth_range = [1.0, 8.0]
[integrator]
type = "path"
max_depth = 2
[materials.black]
type = "diffuse"
reflectance = 0.0
[lights.sky]
type = "constant"
[objects.plant]
file = "plant.glb"
up_axis = "z"
[objects.wall]
shape = "box"
extents = [20, 20, 0.1]
translate = [0, 0, 6]
material = "black"
"""
    )
    return tl.load_scene(folder / "scene.toml"), cards


@pytest.mark.slow
def test_masks_truth_and_picture_agree_on_a_plant_of_200_leaves(tmp_path):
    scene, cards = plant(tmp_path)
    camera = tl.Camera.from_fov(192, 144, fov_x_deg=40)
    rig = tl.Rig.stereo(camera, BASELINE, world_from_left=scene.world_from_left)
    np.testing.assert_allclose(scene.world_from_left, np.eye(4), atol=1e-9)
    truths = tl.ground_truth(scene, rig)
    images = tl.render(scene, rig, spp=256, seed=1)
    directions = camera.rays(camera.pixel_grid()).reshape(-1, 3)
    for i, (truth, image) in enumerate(zip(truths, images, strict=True)):
        centre = np.broadcast_to([BASELINE * i, 0, 0], directions.shape)
        first, distance, margin = cast(cards, centre, directions)
        # Cards that meet at one distance are one object, and so are those whose edges a ray grazes.
        sure = (margin > 1e-4).reshape(truth.depth.shape)
        is_plant = (first >= 0).reshape(truth.depth.shape)
        assert sure.mean() > 0.99
        assert 0.2 < is_plant.mean() < 0.8
        assert np.array_equal((truth.object_id == 1)[sure], is_plant[sure])
        mask = truth.silhouette(truth.objects[0])
        assert np.array_equal(mask[sure], is_plant[sure])
        assert truth.objects[0].visible_pixel_count == (truth.object_id == 1).sum()
        both = sure & is_plant
        depth = (distance * directions[:, 2]).reshape(is_plant.shape)
        np.testing.assert_allclose(truth.depth[both], depth[both], rtol=1e-5)
        # The wall is black, and leaves are not: a pixel has light if rays through sixteen points of it meet leaves.
        part = image.mean(axis=-1)
        share = sum(
            (cast(cards, centre, rays)[0] >= 0).reshape(part.shape)
            for rays in points_of_pixels(camera, 4)
        )  # fmt: skip
        assert part[maximum_filter(share, 3) == 0].max() == 0
        assert part[minimum_filter(share, 3) == 16].min() > 0


def points_of_pixels(camera, count):
    """Rays through count^2 points of each pixel, on a grid, as one array (H W, 3) for each point."""
    offsets = (np.arange(count) + 0.5) / count - 0.5
    for x in offsets:
        for y in offsets:
            yield camera.rays(camera.pixel_grid() + np.array([x, y])).reshape(-1, 3)


XML = """
<scene version="3.0.0">
  <sensor type="perspective">
    <float name="fov" value="40"/>
    <transform name="to_world"><lookat origin="0, 0, 0" target="0, 0, 1" up="0, -1, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="24"/></film>
  </sensor>
  <emitter type="constant"/>
  <bsdf type="mask" id="net"><float name="opacity" value="OPACITY"/><bsdf type="diffuse"/></bsdf>
  SHEET
  <shape type="rectangle" id="wall">
    <transform name="to_world"><scale value="9"/><translate z="4"/></transform>
  </shape>
</scene>
"""
PLACED = '<transform name="to_world"><scale value="9"/><translate z="2"/></transform>'
SHEET = f'<shape type="rectangle">{PLACED}<ref id="net"/></shape>'
COPY = f"""
<shape type="shapegroup" id="group"><shape type="rectangle"><ref id="net"/></shape></shape>
<shape type="instance">{PLACED}<ref id="group"/></shape>
"""


@pytest.mark.parametrize("sheet", [SHEET, COPY])
@pytest.mark.parametrize(("opacity", "depth"), [(0.4, 4.0), (0.6, 2.0)])
def test_masks_of_mitsuba_files_are_cut_at_half(tmp_path, sheet, opacity, depth):
    """Also those of instances, whose shape Mitsuba does not give."""
    path = tmp_path / "scene.xml"
    path.write_text(XML.replace("SHEET", sheet).replace("OPACITY", str(opacity)))
    camera = tl.Camera.from_fov(16, 12, fov_x_deg=40)
    (truth,) = tl.ground_truth(tl.load_scene(path), tl.Rig((camera,), (np.eye(4),)))
    np.testing.assert_allclose(truth.depth, depth, rtol=1e-5)
