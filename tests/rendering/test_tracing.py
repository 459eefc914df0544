"""Surfaces along rays, through glass and mirrors, beside closed forms of planes and of Snell's law."""

import numpy as np
import pytest

import twinlens as tl
from twinlens import geometry
from twinlens.errors import InputError
from twinlens.rendering.build import build
from twinlens.rendering.ground_truth import EXTRA_CHANNELS
from twinlens.rendering.surfaces import surfaces
from twinlens.rendering.tracing import Rays, Stop, intersect, trace_surfaces
from twinlens.scenes import Scene, SceneObject

MATERIALS = {
    "chalk": {"type": "diffuse"},
    "pane": {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "glass": {"type": "dielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "mirror": {"type": "conductor"},
    "net": {"type": "mask", "opacity": 0.75, "bsdf": {"type": "diffuse"}},
}
SINGLE = 3e-8  # relative error of a pose, which Mitsuba has in float32
CAMERA = tl.Camera.from_fov(24, 18, fov_x_deg=40)
INDEX = 1.5


def scene_of(*objects):
    lights = {"sky": {"type": "constant"}}
    return Scene("test", objects, MATERIALS, np.eye(4), (0.5, 10.0), lights)


def plane(name, material, at, towards=(0, 0, -1), size=20.0):
    """A square through `at` with the normal `towards`, and the closed form of distances to it along rays."""
    at, towards = np.array(at, float), np.array(towards, float)
    placed = geometry.look_at(at, at + towards, (0.1, 1, 0.2))
    placed[:3, :3] *= size
    return SceneObject(name, {"type": "rectangle"}, material, placed)


def distance_to_plane(directions, at, towards):
    return np.dot(at, towards) / (directions @ np.array(towards))


def chief_rays():
    directions = CAMERA.unproject(CAMERA.pixel_grid()).reshape(-1, 3)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return Rays.from_point(np.zeros(3), directions)


def snell(sine_in):
    return np.arcsin(sine_in / INDEX)


PANES = {
    "front": ("pane", (0, 0, 2), (0.3, 0.1, -1)),
    "back": ("pane", (0, 0, 3), (-0.2, 0.4, -1)),
    "wall": ("chalk", (0, 0, 5), (0.1, 0.1, -1)),
}


def panes():
    return scene_of(*(plane(name, *values) for name, values in PANES.items()))


def test_a_channel_has_the_distance_to_the_second_surface(monkeypatch):
    """Added in one place, it is in every Truth; two panes of glass stand before a wall."""

    def second_distance(view):
        return view.layers()[1].distance

    monkeypatch.setitem(EXTRA_CHANNELS, "second_distance", second_distance)
    rig = tl.Rig.stereo(CAMERA, 0.1, world_from_left=np.eye(4))
    left, right = tl.ground_truth(panes(), rig)
    directions = chief_rays().direction
    _, at, towards = PANES["back"]
    for truth, centre in ((left, 0.0), (right, 0.1)):
        expected = distance_to_plane(
            directions, np.subtract(at, (centre, 0, 0)), towards
        )
        second = truth.extra["second_distance"]
        assert second.shape == truth.depth.shape
        np.testing.assert_allclose(second.ravel(), expected, rtol=SINGLE)


@pytest.mark.parametrize(
    ("name", "result", "message"),
    [
        ("short", lambda pixels: np.zeros(pixels - 1), r"channel 'short' .* got the shape"),
        ("image", lambda pixels: np.zeros((2, pixels // 2)), r"'image' .* got the shape"),
        ("none", lambda pixels: None, r"'none' .* got NoneType"),
        ("depth", np.zeros, r"channel 'depth' .* another name"),
    ],
)  # fmt: skip
def test_a_function_that_gives_no_channel_is_refused(
    monkeypatch, name, result, message
):
    monkeypatch.setitem(EXTRA_CHANNELS, name, lambda view: result(len(view.rays)))
    rig = tl.Rig.stereo(CAMERA, 0.1, world_from_left=np.eye(4))
    with pytest.raises(InputError, match=message):
        tl.ground_truth(panes(), rig)


def test_all_surfaces_in_order_and_the_first_rough_one():
    built = build(panes())
    rays = chief_rays()
    layers = trace_surfaces(built, rays, Stop.ALL)
    assert [np.unique(layer.body).tolist() for layer in layers] == [[0], [1], [2]]
    for layer, (_, at, towards) in zip(layers, PANES.values(), strict=True):
        expected = distance_to_plane(rays.direction, at, towards)
        np.testing.assert_allclose(layer.distance, expected, rtol=SINGLE)
        np.testing.assert_allclose(layer.position, rays.at(expected), atol=1e-7)
    (first,) = trace_surfaces(built, rays, Stop.FIRST)
    (rough,) = trace_surfaces(built, rays, Stop.ROUGH)
    assert np.array_equal(first.distance, layers[0].distance)
    assert np.array_equal(rough.position, layers[2].position)


def test_panes_let_the_share_of_fresnel_through():
    """A thin pane transmits (1 - R) / (1 + R), with the reflectance R of one of its sides, unpolarised."""
    rays = chief_rays()
    last = trace_surfaces(build(panes()), rays, Stop.ALL)[-1]
    expected = np.ones(len(rays))
    for _, _, normal in (PANES["front"], PANES["back"]):
        cosine = np.abs(rays.direction @ np.array(normal)) / np.linalg.norm(normal)
        inside = np.cos(snell(np.sqrt(1 - cosine**2)))
        across = (cosine - INDEX * inside) / (cosine + INDEX * inside)
        along = (INDEX * cosine - inside) / (INDEX * cosine + inside)
        reflectance = (across**2 + along**2) / 2
        expected *= (1 - reflectance) / (1 + reflectance)
    np.testing.assert_allclose(last.share, expected, rtol=1e-5)


@pytest.mark.parametrize("thickness", [0.002, 0.3])
def test_a_slab_of_glass_shifts_rays_as_snells_law_says(thickness):
    """Rays leave it in parallel: behind it, they are nearer the axis by thickness (tan in - tan inside)."""
    placed = geometry.rigid(np.eye(3), (0, 0, 2 + thickness / 2))
    placed[:3, :3] *= (10, 10, thickness / 2)
    slab = SceneObject("slab", {"type": "cube"}, "glass", placed)
    rays = chief_rays()
    built = build(scene_of(slab, plane("wall", "chalk", (0, 0, 4))))
    layers = trace_surfaces(built, rays, Stop.ALL)
    assert [np.unique(layer.body).tolist() for layer in layers] == [[0], [0], [1]]
    angle = np.arccos(rays.direction[:, 2])
    inside = snell(np.sin(angle))
    radius = (4 - thickness) * np.tan(angle) + thickness * np.tan(inside)
    azimuth = np.arctan2(rays.direction[:, 1], rays.direction[:, 0])
    x = radius * np.cos(azimuth)
    y = radius * np.sin(azimuth)
    np.testing.assert_allclose(layers[-1].position[:, 0], x, atol=2e-6)
    np.testing.assert_allclose(layers[-1].position[:, 1], y, atol=2e-6)
    np.testing.assert_allclose(layers[-1].direction, rays.direction, atol=1e-6)
    in_air = (4 - thickness) / np.cos(angle)
    way = in_air + thickness / np.cos(inside)
    np.testing.assert_allclose(layers[-1].distance, way, rtol=1e-6)


def test_a_mirror_shows_the_mirror_image_of_a_wall():
    """A mirror at 45 degrees folds the axis from z to x: the wall seems to be as far behind it."""
    mirror = plane("mirror", "mirror", (0, 0, 2), (1, 0, -1))
    wall = plane("wall", "chalk", (3, 0, 2), (-1, 0, 0))
    rays = chief_rays()
    (rough,) = trace_surfaces(build(scene_of(mirror, wall)), rays, Stop.ROUGH)
    assert (rough.body == 1).all()
    np.testing.assert_allclose(rough.distance, 5 / rays.direction[:, 2], rtol=SINGLE)
    seen = rays.at(rough.distance)
    mirrored = np.stack([seen[:, 2] - 2, seen[:, 1], seen[:, 0] + 2], axis=1)
    np.testing.assert_allclose(rough.position, mirrored, atol=1e-7)


def test_openings_pass_what_they_do_not_cover_and_rays_end_in_the_sky():
    net = plane("net", "net", (0, 0, 2))
    rays = chief_rays()
    first, sky = trace_surfaces(build(scene_of(net)), rays, Stop.ALL)
    assert first.is_hit.all()
    assert not sky.is_hit.any()
    assert (sky.distance == np.inf).all()
    assert (sky.position == np.inf).all()
    np.testing.assert_allclose(sky.share, 0.25, rtol=1e-6)
    assert np.array_equal(sky.direction, rays.direction)
    (rough,) = trace_surfaces(build(scene_of(net)), rays, Stop.ROUGH)
    assert not rough.is_hit.any()


def test_a_ray_between_mirrors_ends_after_the_most_surfaces():
    front = plane("front", "mirror", (0, 0, 2), (0, 0, -1))
    back = plane("back", "mirror", (0, 0, -1), (0, 0, 1))
    rays = Rays.from_point(np.zeros(3), np.array([[0.0, 0.0, 1.0]]))
    layers = trace_surfaces(build(scene_of(front, back)), rays, Stop.ALL)
    distances = [layer.distance[0] for layer in layers]
    np.testing.assert_allclose(distances, 2 + 3 * np.arange(9), rtol=SINGLE)


def kernels_of(action):
    """Digests of the kernels that an action runs. Build a scene before: twinlens must choose the LLVM of Dr.Jit."""
    import drjit as dr

    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        action()
        return {kernel["hash"] for kernel in dr.kernel_history([dr.KernelType.JIT])}


def test_one_kernel_traces_any_number_of_rays():
    """Each sample has another number of rays that test visibility."""
    built = build(panes())

    def trace(count):
        rays = Rays.from_point(np.zeros(3), np.tile([0.0, 0.1, 1.0], (count, 1)))
        intersect(built, rays)

    first = kernels_of(lambda: trace(1))
    assert first
    for count in (64, 65, 1000, 5000):
        assert kernels_of(lambda n=count: trace(n)) == first


def test_poses_of_shapes_are_read_without_kernels():
    built = build(panes())
    assert kernels_of(lambda: surfaces(built)) == set()
    for quadric, (_, at, towards) in zip(surfaces(built), PANES.values(), strict=True):
        expected = plane("", "", at, towards).world_from_object
        np.testing.assert_allclose(quadric.world_from_local, expected, atol=1e-5)
