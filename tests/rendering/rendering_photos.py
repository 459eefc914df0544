"""Scenes of emitters only, whose images have closed forms, and one general scene to compare cameras."""

import numpy as np

from twinlens.camera import Camera
from twinlens.geometry import look_at
from twinlens.scenes import Scene, SceneObject

POSE = look_at(
    [0.7, -1.3, 0.4], [-0.6, 2.0, 0.9], [0.2, 0.1, 1.0]
)  # nothing is aligned with the world's axes
MATERIALS = {
    "black": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
    "chalk": {"type": "diffuse"},
    "check": {
        "type": "diffuse",
        "reflectance": {"type": "checkerboard", "to_uv": np.diag([9.0, 9.0, 1.0, 1.0])},
    },
    "brass": {"type": "roughconductor", "alpha": 0.3},
    "white": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.8}},
    "grey": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.1}},
    "paint": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}},
    "silver": {
        "type": "conductor",
        "specular_reflectance": {"type": "rgb", "value": 0.8},
    },
    "glass": {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0},
    "net": {
        "type": "mask",
        "opacity": 0.5,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
    },
    "hole": {
        "type": "mask",
        "opacity": 0.0,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
    },
}
LIGHT = {"type": "area", "radiance": {"type": "rgb", "value": 1.0}}
FACING = np.diag(
    [-1.0, 1.0, -1.0, 1.0]
)  # Mitsuba's flat shapes look along +z: this one looks at the camera


def camera(width=40, height=6, fx=60.0, **changes) -> Camera:
    return Camera(width, height, fx, fx, 0.5 * (width - 1), 0.5 * (height - 1)).replace(
        **changes
    )


def half_plane(z: float, x: float | None = None, y: float | None = None) -> Scene:
    """Light of radiance 1 from all points with cam x < `x` (or y < `y`) of the plane at depth z; black elsewhere."""
    side = 50.0
    middle = (x - side, 0.0, z) if x is not None else (0.0, y - side, z)
    return _scene([_lamp("rectangle", middle, side)])


def dot(z: float, radius: float) -> Scene:
    """A disk of light on the axis."""
    return _scene([_lamp("disk", (0.0, 0.0, z), radius)])


def room() -> Scene:
    """Balls and a tilted chequered card before a wall, from near to far, under a grey sky and a small lamp."""
    tilt = np.array([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1.0]])
    objects = [
        SceneObject(
            "wall",
            {"type": "rectangle"},
            "check",
            _at((0, 0, 5)) @ FACING @ np.diag([3.0, 2.0, 1, 1]),
        ),
        SceneObject(
            "card",
            {"type": "rectangle"},
            "check",
            _at((-0.5, 0.1, 2.5)) @ tilt @ FACING * _scale(0.6),
        ),
        SceneObject(
            "ball", {"type": "sphere"}, "brass", _at((0.5, 0.2, 1.8)) * _scale(0.25)
        ),
        SceneObject(
            "far ball", {"type": "sphere"}, "chalk", _at((0.4, -0.6, 4.0)) * _scale(0.5)
        ),
        _lamp("disk", (0.0, -0.6, 3.0), 0.1),
    ]
    return _scene(
        objects,
        {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.3}}},
    )


def rolled(angle: float) -> np.ndarray:
    """The pose, turned about its optical axis."""
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return POSE @ turn


def painted_edge(z: float, x: float | None = None, y: float | None = None) -> Scene:
    """Paint of reflectance 0.8 where `half_plane` has light, and 0.1 elsewhere, under a uniform sky of radiance 1."""
    side = 50.0
    first, second = (
        ((x + sign * side, 0.0, z) if x is not None else (0.0, y + sign * side, z))
        for sign in (-1, 1)
    )
    halves = [
        SceneObject(
            name,
            {"type": "rectangle"},
            name,
            _at(middle) @ FACING @ np.diag([side, side, 1, 1]),
        )
        for name, middle in (("white", first), ("grey", second))
    ]
    return _scene(
        halves, {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    )


def guided() -> dict[str, Scene]:
    """A chequered wall; a mirror that shows paint behind the camera; a net and a hole before paint; a pane of glass
    between black cloth and paint behind the camera."""
    wall = SceneObject(
        "wall",
        {"type": "rectangle"},
        "check",
        _at((0, 0, 5)) @ FACING @ np.diag([3.0, 2.0, 1, 1]),
    )
    behind = SceneObject(
        "behind", {"type": "rectangle"}, "paint", _at((0, 0, -2)) * _scale(9.0)
    )
    mirror = SceneObject(
        "mirror", {"type": "rectangle"}, "silver", _at((0, 0, 3)) @ FACING * _scale(4.0)
    )
    net = SceneObject(
        "net", {"type": "rectangle"}, "net", _at((0, 0, 2)) @ FACING * _scale(4.0)
    )
    hole = SceneObject(
        "hole", {"type": "rectangle"}, "hole", _at((0, 0, 2)) @ FACING * _scale(4.0)
    )
    paint = SceneObject(
        "paint", {"type": "rectangle"}, "paint", _at((0, 0, 4)) @ FACING * _scale(4.0)
    )
    pane = SceneObject(
        "pane", {"type": "rectangle"}, "glass", _at((0, 0, 2)) @ FACING * _scale(4.0)
    )
    cloth = SceneObject(
        "cloth", {"type": "rectangle"}, "black", _at((0, 0, 4)) @ FACING * _scale(4.0)
    )
    return {
        "wall": _scene([wall]),
        "mirror": _scene([behind, mirror]),
        "net": _scene([net, paint]),
        "hole": _scene([hole, paint]),
        "pane": _scene([behind, pane, cloth]),
    }


def _lamp(kind: str, middle, size: float) -> SceneObject:
    return SceneObject(
        "lamp", {"type": kind}, "black", _at(middle) @ FACING * _scale(size), LIGHT
    )


def _at(xyz) -> np.ndarray:
    """The pose of something at camera coordinates xyz, axes parallel to the camera's."""
    placed = np.eye(4)
    placed[:3, 3] = xyz
    return POSE @ placed


def _scale(size: float) -> np.ndarray:
    """Elementwise factors that scale a pose's axes and leave its place."""
    factors = np.ones((4, 4))
    factors[:3, :3] = size
    return factors


def _scene(objects, lights=None) -> Scene:
    path = {"type": "path", "max_depth": 4}
    return Scene(
        "light", tuple(objects), MATERIALS, POSE, (0.5, 10.0), lights or {}, path
    )


EDGES = {  # name: (camera, lens parameters or None, depth, axis, position in metres)
    "pinhole x": (camera(), None, 2.0, "x", 0.1234),
    "pinhole y": (camera(6, 40), None, 2.0, "y", -0.0877),
    "off-centre x": (camera(cx=7.0, cy=-3.5), None, 2.0, "x", 0.4567),
    "off-centre y": (camera(6, 40, cx=30.5, cy=33.0), None, 3.0, "y", -0.5),
    "beside the image": (camera(cx=-12.5), None, 2.0, "x", 1.0),
    "in focus": (camera(), (0.3, 2.0), 2.0, "x", 0.1234),
    "far": (camera(), (0.3, 1.0), 2.0, "x", 0.1234),
    "near": (camera(), (0.3, 6.0), 2.0, "x", -0.05),
    "off-centre lens": (camera(cx=30.0, cy=9.0), (0.3, 1.0), 2.0, "x", -0.4),
    "tall pixels x": (camera(fy=97.0), None, 2.0, "x", 0.1234),
    "tall pixels y": (camera(6, 40, fx=97.0, fy=60.0), None, 2.0, "y", -0.0877),
    "odd centre": (camera(cx=17.123, cy=2.87), None, 2.0, "x", 0.1234),
    "focused at infinity": (camera(), (0.2, np.inf), 2.0, "x", 0.1234),
    "tall pixels, far, y": (
        camera(6, 40, fx=97.0, fy=60.0),
        (0.3, 1.0),
        2.0,
        "y",
        -0.0877,
    ),
    "bare hole": (
        camera(),
        (0.2, -4.0),
        2.0,
        "x",
        0.1234,
    ),  # a hole 4 m before the film: k = -1/4
}
DOT = (
    camera(48, 48, 120.0),
    0.5,
    1.0,
    2.5,
)  # camera, aperture diameter, focus distance, depth
SLANT, SLANTED_Z = np.radians(5.0), 2.0
SLANTED_LENSES = {
    "1 px": (0.1, 1.5),
    "3 px": (0.1, 1.0),
    "9 px": (0.3, 1.0),
}  # by the diameter of the blur circle
DISK = (
    camera(48, 48, 120.0),
    (0.25, 1.0),
    2.5,
    0.06,
)  # camera, lens parameters, depth, radius of the light
