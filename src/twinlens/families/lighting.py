"""Lights: area lamps, sun and sky, and environment maps. Every setup casts visible shadows."""

import math

import numpy as np

from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.patterns import Image
from twinlens.families.poses import turn_x, turn_z
from twinlens.families.sky import clear_sky
from twinlens.families.view import View, rasterize
from twinlens.geometry import Float, look_at
from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin

_BLACK: Plugin = {"type": "diffuse", "reflectance": Bitmap(np.zeros((2, 2, 3), dtype=np.float32))}
_UPRIGHT = turn_x(90.0)  # environment maps have y up, these worlds z
WARM, NEUTRAL, COOL = np.array([1.0, 0.84, 0.66]), np.array([1.0, 0.96, 0.91]), np.array([0.84, 0.93, 1.0])


def panel(
    scene: Composition,
    name: str,
    place: Float,
    target: Float,
    size: tuple[float, float],
    radiance: Float,
    weight: float = 1.0,
) -> None:
    """Add a rectangular lamp of `size` metres at `place` that faces `target`; `weight` is its share of samples."""
    steep = abs(place[2] - target[2]) > 0.95 * np.linalg.norm(place - target)
    pose = look_at(place, target, [0.0, 1.0, 0.0] if steep else [0.0, 0.0, 1.0])
    emitter(scene, name, rectangle(*size), pose, radiance, weight)


def emitter(scene: Composition, name: str, mesh: Mesh, pose: Float, radiance: Float, weight: float = 1.0) -> None:
    """Add a mesh that emits light, of radiance (3,)."""
    r, g, b = (float(c) for c in radiance)
    area = {"type": "area", "radiance": Color((r, g, b)), "sampling_weight": float(weight)}
    scene.add(name, mesh, _BLACK, pose, area)


def rectangle(width: float, height: float) -> Mesh:
    """A flat rectangle facing +z."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) * [width, height, 1]
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return Mesh(corners, faces, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]))


def out_of_view(view: View, spot: Float, side: float, front: float) -> Float:
    """`spot` (3,) moved towards the camera, at most to y = `front`, until a level square lamp there is not visible.

    `side` is the lamp's in metres; 0.3 m are added because the right camera sees more on its side.
    """
    lamp = rectangle(side + 0.3, side + 0.3)
    while spot[1] > front and np.isfinite(rasterize(view, [(lamp.vertices + spot, lamp.faces)], 64).depth).any():
        spot = spot - [0.0, min(0.2, spot[1] - front), 0.0]
    return spot


def from_direction(azimuth_deg: float, elevation_deg: float) -> Float:
    """The unit vector (3,) towards a light: azimuth from +x to +y, elevation above the horizon."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def environment(scene: Composition, pixels: Image, turn_deg: float = 0.0, weight: float = 1.0) -> None:
    """Set the environment map (H, W, 3), its top row straight up: a light and the background."""
    scene.lights["environment"] = {
        "type": "envmap",
        "bitmap": Bitmap(pixels),
        "to_world": turn_z(turn_deg) @ _UPRIGHT,
        "sampling_weight": float(weight),
    }


def user_environment(scene: Composition, rng: Rng) -> bool:
    """Light the scene with one of the user's environment maps at a random angle; False where there is none."""
    drawn = scene.request.assets.hdri(rng)
    if drawn is None:
        return False
    pixels = drawn[1]
    mean = max(float(pixels.mean()), 1e-9)
    environment(scene, np.minimum(pixels / mean, 2e3).astype(np.float32), float(rng.uniform(0, 360)))
    return True


def key_and_fill(scene: Composition, rng: Rng, middle: Float, radius: float) -> None:
    """A hard or soft key light from one side, a weak fill light from the other, and dim ambient light.

    They light a sphere of `radius` metres around `middle` (3,), seen from -y.
    """
    side = one_of(rng, [-1.0, 1.0])
    tone, other = one_of(rng, [(WARM, COOL), (NEUTRAL, NEUTRAL), (COOL, WARM), (WARM, NEUTRAL)])
    spread = log_uniform(rng, 0.18, 1.2) * radius
    far = 4.5 * radius
    key = from_direction(-90.0 + side * rng.uniform(55, 98), rng.uniform(28, 58))
    strength = 11.0 * (1.2 * radius / spread) ** 2 * rng.uniform(0.8, 1.25)
    panel(scene, "key-light", middle + far * key, middle, (2 * spread, 2 * spread), strength * tone)
    fill = from_direction(-90.0 - side * rng.uniform(25, 80), rng.uniform(20, 50))
    level = rng.uniform(0.3, 1.2)
    panel(scene, "fill-light", middle + far * fill, middle, (2.4 * radius, 2.4 * radius), level * other, 0.35)
    ambient = np.asarray(rng.uniform(0.1, 0.25) * (0.5 * other + 0.5), dtype=np.float32)
    environment(scene, np.tile(ambient, (4, 8, 1)), weight=0.35)


def daylight(scene: Composition, rng: Rng, middle: Float, radius: float) -> None:
    """A clear sky, and the sun at one side of the camera, which looks from -y.

    The sun is a distant square, larger than the real sun so that shadows have soft edges. When high, it lights a level
    surface about four times as strongly as the sky does; when low, less.
    """
    side = one_of(rng, [-1.0, 1.0])
    azimuth, elevation = -90.0 + side * float(rng.uniform(40, 95)), float(rng.uniform(22, 55))
    environment(scene, clear_sky(float(rng.uniform(2.2, 5.0)), elevation), azimuth, 0.5)
    far = 40.0 * radius
    half = far * math.tan(math.radians(rng.uniform(0.6, 1.6)))
    low = math.exp(-elevation / 14)
    tone = np.array([1.0, 0.95 - 0.35 * low, 0.88 - 0.6 * low])
    radiance = 4.0 * math.pi * (1 - 0.6 * low) * far**2 / (2 * half) ** 2
    sun = middle + far * from_direction(azimuth, elevation)
    panel(scene, "sun", sun, middle, (2 * half, 2 * half), radiance * tone)
