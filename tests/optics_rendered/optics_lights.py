"""Scenes of lights and of a chequered room, and measurements of images: centroids, moments, diameters."""

import numpy as np

import twinlens as tl
from twinlens.scenes import Scene, SceneObject

FACING = np.diag([1.0, -1.0, -1.0, 1.0])
"""Mitsuba's flat shapes look along +z: this pose turns them to the camera."""

HERE = np.eye(4)


def rgb(value):
    return {"type": "rgb", "value": value}


def diffuse(reflectance):
    return {"type": "diffuse", "reflectance": rgb(reflectance)}


def glow(radiance):
    return {"type": "area", "radiance": rgb(radiance)}


BLACK = diffuse(0.0)


def facing(place, half: float) -> np.ndarray:
    """The pose of a flat shape of this half width that faces the camera."""
    pose = FACING @ np.diag([half, half, 1.0, 1.0])
    pose[:3, 3] = place
    return pose


def scene_of(*objects, sky_radiance: float = 0.0, depth: int = 2, **materials) -> Scene:
    """Objects in black or in `materials`, under a uniform sky."""
    lights = {}
    if sky_radiance:
        lights["sky"] = {"type": "constant", "radiance": rgb(sky_radiance)}
    materials["black"] = BLACK
    path = {"type": "path", "max_depth": depth}
    return Scene("test", objects, materials, HERE, (0.2, 20.0), lights, path)


def wall_of(material, z: float, half: float = 9.0, **options) -> Scene:
    """A wall that faces the camera at a distance z, under a uniform sky of radiance 1."""
    pose = facing((0.0, 0.0, z), half)
    wall = SceneObject("wall", {"type": "rectangle"}, "paint", pose)
    return scene_of(wall, sky_radiance=1.0, paint=material, **options)


def lamps(places, radius, radiance=1.0) -> Scene:
    """Disks of light of `radius` metres that face the camera, centred on camera points `places`."""
    objects = []
    for i, place in enumerate(places):
        pose = facing(place, radius)
        light = glow(radiance)
        disk = SceneObject(f"lamp {i}", {"type": "disk"}, "black", pose, light)
        objects.append(disk)
    return scene_of(*objects)


def sky(radiance=1.0) -> Scene:
    """A uniform sky."""
    return scene_of(sky_radiance=radiance)


def chequered_room(depth: int = 5, **surface) -> Scene:
    """A tilted chequered card and a ball before a chequered wall, under a sky and a small lamp.

    surface : a material of the card and the ball.
    """
    texture = {"type": "checkerboard", "to_uv": np.diag([9.0, 9.0, 1.0, 1.0])}
    tilt = np.array([[0.8, 0, 0.6, 0], [0, 1, 0, 0], [-0.6, 0, 0.8, 0], [0, 0, 0, 1.0]])
    card = tilt @ facing((0.0, 0.0, 0.0), 0.6)
    card[:3, 3] = (-0.5, 0.1, 2.5)
    ball = np.diag([0.25, 0.25, 0.25, 1.0])
    ball[:3, 3] = (0.5, 0.2, 1.8)
    wall = facing((0.0, 0.0, 5.0), 3.0)
    lamp = facing((0.3, -0.5, 3.0), 0.3)
    paint_of_card, paint_of_ball = list(surface) * 2 or ("check", "chalk")
    return scene_of(
        SceneObject("wall", {"type": "rectangle"}, "check", wall),
        SceneObject("card", {"type": "rectangle"}, paint_of_card, card),
        SceneObject("ball", {"type": "sphere"}, paint_of_ball, ball),
        SceneObject("lamp", {"type": "disk"}, "black", lamp, glow([2.0, 1.5, 1.0])),
        sky_radiance=0.4,
        depth=depth,
        check={"type": "diffuse", "reflectance": texture},
        chalk={"type": "diffuse"},
        **surface,
    )


def square_camera(side: int, fx: float, **changes) -> tl.Camera:
    middle = 0.5 * (side - 1)
    return tl.Camera(side, side, fx, fx, middle, middle).replace(**changes)


def grey(image: np.ndarray) -> np.ndarray:
    return np.asarray(image, dtype=np.float64).mean(axis=-1)


def block_means(image: np.ndarray) -> np.ndarray:
    """Means over 4 x 4 pixels."""
    return grey(image).reshape(image.shape[0] // 4, 4, -1, 4).mean(axis=(1, 3))


def error_over_noise(a: list, b: list) -> float:
    """The mean squared difference of the means of two pairs of independent images, over its expectation from noise."""
    noise = sum(np.mean((first - second) ** 2) / 4 for first, second in (a, b))
    return float(np.mean((np.mean(a, axis=0) - np.mean(b, axis=0)) ** 2) / noise)


def centroid(image: np.ndarray) -> np.ndarray:
    """The centroid (u, v) of a grey image."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    return np.array([(u * image).sum(), (v * image).sum()]) / image.sum()


def spread(image: np.ndarray) -> float:
    """Mean squared distance from the centroid, px^2, without the blur by pixels of width 1."""
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    cu, cv = centroid(image)
    return float((((u - cu) ** 2 + (v - cv) ** 2) * image).sum() / image.sum()) - 2 / 12


def disk_diameter(image: np.ndarray, light_px: float) -> float:
    """The diameter of a uniform disk whose image is widened by a light of diameter `own` (px).

    A uniform disk of diameter D has the mean squared radius D^2/8; those of convolved shapes add.
    """
    return float(np.sqrt(max(0.0, 8 * spread(image) - light_px**2)))
