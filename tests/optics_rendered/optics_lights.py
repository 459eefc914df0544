"""Scenes of lights on a black background, and measurements of their images: centroids, moments, diameters."""

import numpy as np

import twinlens as tl
from twinlens.scenes import Scene, SceneObject

BLACK = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
FACING = np.diag(
    [1.0, -1.0, -1.0, 1.0]
)  # Mitsuba's flat shapes look along +z: turned towards the camera
HERE = np.eye(4)


def lamps(places, radius, radiance=1.0) -> Scene:
    """Disks of light of `radius` metres that face the camera, centred on camera points `places`."""
    light = {"type": "area", "radiance": {"type": "rgb", "value": radiance}}
    objects = []
    for i, place in enumerate(places):
        pose = FACING @ np.diag([radius, radius, 1.0, 1.0])
        pose[:3, 3] = place
        objects.append(SceneObject(f"lamp {i}", {"type": "disk"}, "black", pose, light))
    return Scene(
        "lamps",
        tuple(objects),
        {"black": BLACK},
        HERE,
        (0.2, 20.0),
        {},
        {"type": "path", "max_depth": 2},
    )


def sky(radiance=1.0) -> Scene:
    """A uniform sky."""
    lights = {
        "sky": {"type": "constant", "radiance": {"type": "rgb", "value": radiance}}
    }
    return Scene(
        "sky",
        (),
        {"black": BLACK},
        HERE,
        (0.2, 20.0),
        lights,
        {"type": "path", "max_depth": 2},
    )


def chequered_room() -> Scene:
    """A tilted chequered card and a ball before a chequered wall, under a sky and a small lamp."""
    check = {
        "type": "diffuse",
        "reflectance": {"type": "checkerboard", "to_uv": np.diag([9.0, 9.0, 1.0, 1.0])},
    }
    wall = FACING @ np.diag([3.0, 3.0, 1.0, 1.0])
    wall[2, 3] = 5.0
    tilt = np.array([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1.0]])
    card = tilt @ FACING @ np.diag([0.6, 0.6, 1.0, 1.0])
    card[:3, 3] = (-0.5, 0.1, 2.5)
    ball = np.diag([0.25, 0.25, 0.25, 1.0])
    ball[:3, 3] = (0.5, 0.2, 1.8)
    lamp = FACING @ np.diag([0.3, 0.3, 1.0, 1.0])
    lamp[:3, 3] = (0.3, -0.5, 3.0)
    glow = {"type": "area", "radiance": {"type": "rgb", "value": [2.0, 1.5, 1.0]}}
    objects = (
        SceneObject("wall", {"type": "rectangle"}, "check", wall),
        SceneObject("card", {"type": "rectangle"}, "check", card),
        SceneObject("ball", {"type": "sphere"}, "chalk", ball),
        SceneObject("lamp", {"type": "disk"}, "black", lamp, glow),
    )
    lights = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 0.4}}}
    materials = {"check": check, "chalk": {"type": "diffuse"}, "black": BLACK}
    return Scene(
        "room",
        objects,
        materials,
        HERE,
        (1.0, 6.0),
        lights,
        {"type": "path", "max_depth": 5},
    )


def square_camera(side: int, fx: float, **changes) -> tl.Camera:
    middle = 0.5 * (side - 1)
    return tl.Camera(side, side, fx, fx, middle, middle).replace(**changes)


def grey(image: np.ndarray) -> np.ndarray:
    return np.asarray(image, dtype=np.float64).mean(axis=-1)


def centroid(image: np.ndarray) -> np.ndarray:
    """The centroid (u, v) of a grey image."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(u * image).sum(), (v * image).sum()]) / image.sum()


def spread(image: np.ndarray) -> float:
    """Mean squared distance from the centroid, px^2, without the blur by pixels of width 1."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    cu, cv = centroid(image)
    return float((((u - cu) ** 2 + (v - cv) ** 2) * image).sum() / image.sum()) - 2 / 12


def disk_diameter(image: np.ndarray, own: float) -> float:
    """The diameter of a uniform disk whose image is widened by a light of diameter `own` (px).

    A uniform disk of diameter D has the mean squared radius D^2/8; those of convolved shapes add.
    """
    return float(np.sqrt(max(0.0, 8 * spread(image) - own**2)))
