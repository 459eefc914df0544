"""The family "flying": bodies in the air at evenly spread disparities, before a wall or the open sky."""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from twinlens.families import lighting
from twinlens.families.composition import Composition, Viewpoint, similarity
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.kinds import KINDS, draw_body
from twinlens.families.materials import body_material
from twinlens.families.surfaces import WALLS, Sheet, surface, wall_colors
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.scene import Mesh

_TRIES = 40  # random places of a body before it is left out
NAMES = frozenset(("backdrop", "moon", "key-light", "fill-light"))
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    rng = scene.rng("view")
    target = np.array([0.0, 1.0, rng.uniform(-0.15, 0.1)])
    scene.look(np.zeros(3), target, rng.uniform(42, 65))
    depth_ratio = scene.depth_ratio(2.5, 8.0)
    _add_bodies(scene, depth_ratio)
    far = scene.visible_range()[0] * depth_ratio
    open_air = scene.rng("open air").random() < 0.4
    if open_air:
        _add_moon(scene, far)
    else:
        _add_wall(scene, far)
    rng = scene.rng("light")
    if scene.assets.hdris and lighting.user_environment(scene, rng):
        return
    if open_air:
        sky = lighting.painted_sky(rng)
        lighting.environment(scene, sky, float(rng.uniform(0, 360)))
    else:
        middle = scene.view.at(0, 0, 0.5 * depth_ratio)
        lighting.key_and_fill(scene, rng, middle, 0.6 * depth_ratio)


def _add_bodies(scene: Composition, depth_ratio: float) -> None:
    """Add bodies at even steps of 1/depth from 1 m to 0.9 `depth_ratio`; their bounding spheres do not overlap."""
    count, view = scene.count, scene.view
    # One step of 1/depth for each body, at a random place within it.
    steps = (np.arange(count) + scene.rng("steps").random(count)) / count
    inverse = 1 + (1 / (0.9 * depth_ratio) - 1) * steps
    taken: list[tuple[Float, float]] = []
    for index, depth in enumerate((1 / inverse).tolist()):
        body = draw_body(scene, ("body", index))
        rng = scene.rng("place", index)
        # The radius of the bounding sphere, a share of the picture's width, and that of the mesh.
        reach = 0.5 * log_uniform(rng, 0.1, 0.34) * view.covered(depth)[0]
        radius = float(np.linalg.norm(body.solid.mesh.vertices, axis=1).max())
        size = reach / radius
        if scene.assets.keep_scale and not body.kind:
            size, reach = body.size, body.size * radius
        centre = _free_place(view, rng, depth + reach, reach, taken)
        if centre is None:
            continue
        taken.append((centre, reach))
        pose = similarity(_random_rotation(rng), centre, size)
        # The body's material is that of `body.size`; it is enlarged together with its texels.
        look = body.material(view.pixel(depth) / size * body.size)
        scene.add(body.name, body.solid.mesh, look, pose)


def _free_place(
    view: Viewpoint,
    rng: Rng,
    depth: float,
    reach: float,
    taken: list[tuple[Float, float]],
) -> Float | None:
    """A centre in the picture for a sphere of radius `reach` beside the spheres that are taken; None without one."""
    for _ in range(_TRIES):
        x, y = rng.uniform(-1, 1, 2) * (1.0, 0.95)
        centre = view.at(float(x), float(y), depth)
        is_free = all(
            np.linalg.norm(centre - other) > reach + radius for other, radius in taken
        )
        if is_free:
            return centre
    return None


def _random_rotation(rng: Rng) -> Float:
    """A uniform random rotation (3, 3). Source: Shoemake, Uniform Random Rotations, Graphics Gems III, 1992."""
    return np.asarray(Rotation.from_quat(np.roll(rng.normal(size=4), -1)).as_matrix())


def _add_wall(scene: Composition, far: float) -> None:
    rng, view = scene.rng("backdrop"), scene.view
    yaw, pitch = np.radians(rng.uniform(-25, 25)), np.radians(rng.uniform(-8, 8))
    # In the camera's frame, x right, y down, z forward: u turned about y by the yaw, v upwards and tilted by the pitch.
    u_in_cam = [math.cos(yaw), 0, math.sin(yaw)]
    v_in_cam = [
        math.sin(yaw) * math.sin(pitch),
        -math.cos(pitch),
        -math.sin(pitch) * math.cos(yaw),
    ]
    world_from_cam = view.world_from_cam[:3, :3]
    u, v = world_from_cam @ u_in_cam, world_from_cam @ v_in_cam
    v = v - (v @ u) * u  # perpendicular to u

    def sheet(distance: float) -> Sheet:
        width, height = 2.2 * view.covered(distance * 1.4)
        centre = view.at(0, 0, distance)
        return Sheet(centre - 0.5 * (width * u + height * v), width * u, height * v)

    distance = scene.backdrop_distance(lambda d: [sheet(d).mesh()], far, 0.8 * far)
    name, tile = one_of(rng, WALLS[1])  # never plain: other scenes have a plain sky
    tile *= 0.25 * view.covered(distance)[0]
    wall, colors = sheet(distance), wall_colors(rng, scene.palette)
    fitted, look = surface(scene, scene.rng("wall"), wall, name, colors, tile)
    scene.add("backdrop", fitted.mesh(), look)


def _add_moon(scene: Composition, far: float) -> None:
    rng, view = scene.rng("moon"), scene.view
    side = one_of(rng, [-1.0, 1.0])
    x, y = side * rng.uniform(0.2, 0.6), rng.uniform(-0.5, 0.3)
    share = rng.uniform(0.16, 0.28)
    solid, turn = KINDS["ball"].make(rng), _random_rotation(rng)

    def size(distance: float) -> float:
        return 2 * share * float(view.covered(distance)[0])

    def pose(distance: float) -> Float:
        return similarity(turn, view.at(x, y, distance), size(distance))

    def meshes(distance: float) -> list[Mesh]:
        return [shapes.transformed(solid.mesh, pose(distance))]

    distance = scene.backdrop_distance(meshes, far, far)
    names = ("granite", "marble", "stripes", "cloudy", "cloudy")
    stream = scene.rng("moon", "texture")
    pixel = view.pixel(distance)
    look = body_material(
        stream, solid, size(distance), pixel, scene.palette, "matte", names
    )
    scene.add("moon", solid.mesh, look, pose(distance))
