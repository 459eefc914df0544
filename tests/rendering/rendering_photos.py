"""Scenes of emitters only, whose images have closed forms, and one general scene to compare cameras."""

import contextlib

import numpy as np

import twinlens as tl
from twinlens.camera import Camera, Rig
from twinlens.geometry import look_at
from twinlens.scenes import Scene, SceneObject
from twinlens.scenes.placement import translation

POSE = look_at([0.7, -1.3, 0.4], [-0.6, 2.0, 0.9], [0.2, 0.1, 1.0])
"""Nothing is aligned with the world's axes."""

FACING = np.diag([-1.0, 1.0, -1.0, 1.0])
"""Mitsuba's flat shapes look along +z: this pose turns them to the camera."""


def rgb(value):
    return {"type": "rgb", "value": value}


def diffuse(reflectance):
    return {"type": "diffuse", "reflectance": rgb(reflectance)}


def mask(opacity):
    return {"type": "mask", "opacity": opacity, "bsdf": diffuse(0.0)}


CHECK = {"type": "checkerboard", "to_uv": np.diag([9.0, 9.0, 1.0, 1.0])}
MATERIALS = {
    "black": diffuse(0.0),
    "chalk": {"type": "diffuse"},
    "check": {"type": "diffuse", "reflectance": CHECK},
    "brass": {"type": "roughconductor", "alpha": 0.3},
    "white": diffuse(0.8),
    "grey": diffuse(0.1),
    "paint": diffuse(0.5),
    "silver": {"type": "conductor", "specular_reflectance": rgb(0.8)},
    "glass": {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "net": mask(0.5),
    "hole": mask(0.0),
}
LIGHT = {"type": "area", "radiance": rgb(1.0)}


def camera(width=40, height=6, fx=60.0, **changes) -> Camera:
    centre = 0.5 * (width - 1), 0.5 * (height - 1)
    return Camera(width, height, fx, fx, *centre).replace(**changes)


def rig_of(*cameras: Camera) -> Rig:
    """Cameras in one place."""
    return Rig(cameras, [POSE] * len(cameras))


def half_plane(z: float, x: float | None = None, y: float | None = None) -> Scene:
    """Light of radiance 1 from all points with cam x < `x` (or y < `y`) of the plane at depth z; black elsewhere."""
    side = 50.0
    middle = (x - side, 0.0, z) if x is not None else (0.0, y - side, z)
    return scene_of([lamp("rectangle", middle, side)])


def room() -> Scene:
    """Balls and a tilted chequered card before a wall, from near to far, under a grey sky and a small lamp."""
    tilt = np.array([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1.0]])
    wall = at((0, 0, 5)) @ FACING @ np.diag([3.0, 2.0, 1, 1])
    card = at((-0.5, 0.1, 2.5)) @ tilt @ FACING @ scaled(0.6)
    ball = at((0.5, 0.2, 1.8)) @ scaled(0.25)
    far_ball = at((0.4, -0.6, 4.0)) @ scaled(0.5)
    objects = [
        SceneObject("wall", {"type": "rectangle"}, "check", wall),
        SceneObject("card", {"type": "rectangle"}, "check", card),
        SceneObject("ball", {"type": "sphere"}, "brass", ball),
        SceneObject("far ball", {"type": "sphere"}, "chalk", far_ball),
        lamp("disk", (0.0, -0.6, 3.0), 0.1),
    ]
    return scene_of(objects, sky=0.3)


def rolled(angle: float) -> np.ndarray:
    """The pose, turned about its optical axis."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return POSE @ turn


def painted_edge(z: float, x: float) -> Scene:
    """Paint of reflectance 0.8 where `half_plane` has light, and 0.1 elsewhere, under a uniform sky of radiance 1."""
    side = 50.0
    halves = [
        card("white", "white", (x - side, 0.0, z), side),
        card("grey", "grey", (x + side, 0.0, z), side),
    ]
    return scene_of(halves, sky=1.0)


def guided() -> dict[str, Scene]:
    """A chequered wall; a mirror that shows paint behind the camera; a net and a hole before paint; a pane of glass
    between black cloth and paint behind the camera."""
    wall_pose = at((0, 0, 5)) @ FACING @ np.diag([3.0, 2.0, 1, 1])
    wall = SceneObject("wall", {"type": "rectangle"}, "check", wall_pose)
    behind_pose = at((0, 0, -2)) @ scaled(9.0)
    behind = SceneObject("behind", {"type": "rectangle"}, "paint", behind_pose)
    paint = card("paint", "paint", (0, 0, 4), 4.0)
    cloth = card("cloth", "black", (0, 0, 4), 4.0)
    mirror = card("mirror", "silver", (0, 0, 3), 4.0)
    net = card("net", "net", (0, 0, 2), 4.0)
    hole = card("hole", "hole", (0, 0, 2), 4.0)
    pane = card("pane", "glass", (0, 0, 2), 4.0)
    return {
        "wall": scene_of([wall]),
        "mirror": scene_of([behind, mirror]),
        "net": scene_of([net, paint]),
        "hole": scene_of([hole, paint]),
        "pane": scene_of([behind, pane, cloth]),
    }


def lamp(kind: str, middle, size: float) -> SceneObject:
    placed = at(middle) @ FACING @ scaled(size)
    return SceneObject("lamp", {"type": kind}, "black", placed, LIGHT)


def card(name: str, material: str, middle, size: float) -> SceneObject:
    """A square that faces the camera."""
    placed = at(middle) @ FACING @ scaled(size)
    return SceneObject(name, {"type": "rectangle"}, material, placed)


def at(xyz) -> np.ndarray:
    """The pose of something at camera coordinates xyz, axes parallel to the camera's."""
    return POSE @ translation(xyz)


def scaled(size: float) -> np.ndarray:
    return np.diag([size, size, size, 1.0])


def scene_of(objects, sky: float = 0.0) -> Scene:
    """Objects under a uniform sky."""
    lights = {"sky": {"type": "constant", "radiance": rgb(sky)}} if sky else {}
    path = {"type": "path", "max_depth": 4}
    return Scene("light", tuple(objects), MATERIALS, POSE, (0.5, 10.0), lights, path)


def lens_of(parameters):
    """(diameter, focus distance) of a thin lens, or a bare hole if the distance to the film is negative."""
    if parameters is None:
        return tl.Pinhole()
    diameter, distance = parameters
    if distance > 0:
        return tl.ThinLens(diameter, distance)
    return tl.BareAperture(diameter, -distance)


@contextlib.contextmanager
def threads(count: int):
    """Render with this number of threads inside."""
    import drjit

    before = drjit.thread_count()
    drjit.set_thread_count(count)
    yield
    drjit.set_thread_count(before)


EDGE = 0.1234
EDGES = {  # name: (camera, lens parameters or None, depth, axis, position in metres)
    "pinhole x": (camera(), None, 2.0, "x", EDGE),
    "pinhole y": (camera(6, 40), None, 2.0, "y", -0.0877),
    "off-centre x": (camera(cx=7.0, cy=-3.5), None, 2.0, "x", 0.4567),
    "off-centre y": (camera(6, 40, cx=30.5, cy=33.0), None, 3.0, "y", -0.5),
    "beside the image": (camera(cx=-12.5), None, 2.0, "x", 1.0),
    "in focus": (camera(), (0.3, 2.0), 2.0, "x", EDGE),
    "far": (camera(), (0.3, 1.0), 2.0, "x", EDGE),
    "near": (camera(), (0.3, 6.0), 2.0, "x", -0.05),
    "off-centre lens": (camera(cx=30.0, cy=9.0), (0.3, 1.0), 2.0, "x", -0.4),
    "tall pixels x": (camera(fy=97.0), None, 2.0, "x", EDGE),
    "tall, far, y": (camera(6, 40, 97.0, fy=60.0), (0.3, 1.0), 2.0, "y", -0.0877),
    "odd centre": (camera(cx=17.123, cy=2.87), None, 2.0, "x", EDGE),
    "focused at infinity": (camera(), (0.2, np.inf), 2.0, "x", EDGE),
    "bare hole": (camera(), (0.2, -4.0), 2.0, "x", EDGE),  # k = -1/4
}


def profile(camera, lens, z, axis, position):
    """What a row of pixels sees of the half plane of light: a step at the edge's image, each point of which a lens
    spreads evenly over a disk of diameter A f |1/z - 1/focus|, averaged over the pixel's width."""
    size = camera.width
    f = camera.fx
    centre = camera.cx
    if axis == "y":
        size = camera.height
        f = camera.fy
        centre = camera.cy
    edge = f * position / z + centre
    diameter, focus = lens or (0.0, z)
    blur = diameter * f * abs(1 / z - 1 / focus)
    if blur < 1e-9:
        return np.clip(edge + 0.5 - np.arange(size), 0, 1)
    inside = np.arange(size)[:, None] - 0.5 + (np.arange(400) + 0.5) / 400
    s = np.clip((edge - inside) / (blur / 2), -1, 1)
    return (0.5 + (np.arcsin(s) + s * np.sqrt(1 - s * s)) / np.pi).mean(axis=1)


def along(image, axis):
    """(mean, spread) along an edge."""
    grey = image.mean(axis=-1)
    lines = 0 if axis == "x" else 1
    return grey.mean(axis=lines), np.ptp(grey, axis=lines).max()
