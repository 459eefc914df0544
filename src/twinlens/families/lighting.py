"""Light: lamps, sun and sky, and environment maps, painted or given; each strong enough to throw a shadow."""

import math

import numpy as np

from twinlens.families.assets import Assets
from twinlens.families.brushes import Image
from twinlens.families.sky import clear_sky
from twinlens.families.stage import Stage
from twinlens.families.view import View, look
from twinlens.geometry import Float, look_at
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin

Rng = np.random.Generator
_BLACK: Plugin = {"type": "diffuse", "reflectance": Bitmap(np.zeros((2, 2, 3), dtype=np.float32))}
_UPRIGHT = rotation(np.array([1.0, 0.0, 0.0]), 90.0)  # environment maps have y up, our worlds z
WARM, NEUTRAL, COOL = np.array([1.0, 0.84, 0.66]), np.array([1.0, 0.96, 0.91]), np.array([0.84, 0.93, 1.0])


def panel(
    stage: Stage,
    name: str,
    place: Float,
    target: Float,
    size: tuple[float, float],
    radiance: Float,
    weight: float = 1.0,
) -> None:
    """A rectangular lamp of `size` metres at `place` that shines towards `target`; `weight`: its share of samples."""
    glow(stage, name, rectangle(*size), look_at(place, target, _up(place, target)), radiance, weight)


def glow(stage: Stage, name: str, mesh: Mesh, pose: Float, radiance: Float, weight: float = 1.0) -> None:
    """A mesh that shines: panels, window panes, lamp shades."""
    emitter = {"type": "area", "radiance": _color(radiance), "sampling_weight": float(weight)}
    stage.add(name, mesh, _BLACK, pose, emitter)


def rectangle(width: float, height: float) -> Mesh:
    """A flat rectangle facing +z."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) * [width, height, 1]
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return Mesh(corners, faces, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]))


def unseen(view: View, spot: Float, side: float, front: float) -> Float:
    """`spot` (3,), moved towards the camera, as far as y = `front`, until a level lamp there is not in the picture.

    `side` is the lamp's, in metres; a little more is kept out, for the right eye stands elsewhere.
    """
    lamp = rectangle(side + 0.3, side + 0.3)
    while spot[1] > front and np.isfinite(look(view, [(lamp.vertices + spot, lamp.faces)], 64).depth).any():
        spot = spot - [0.0, min(0.2, spot[1] - front), 0.0]
    return spot


def _up(place: Float, target: Float) -> Float:
    steep = abs(place[2] - target[2]) > 0.95 * np.linalg.norm(place - target)
    return np.array([0.0, 1.0, 0.0] if steep else [0.0, 0.0, 1.0])


def _color(rgb: Float) -> Color:
    r, g, b = (float(c) for c in rgb)
    return Color((r, g, b))


def from_direction(azimuth_deg: float, elevation_deg: float) -> Float:
    """The unit vector (3,) towards a light: azimuth from +x to +y, elevation from the ground."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def ambient(stage: Stage, radiance: Float, weight: float = 0.35) -> None:
    """Even light from everywhere."""
    pixels = np.broadcast_to(np.asarray(radiance, dtype=np.float32), (4, 8, 3))
    environment(stage, np.ascontiguousarray(pixels), weight=weight)


def environment(stage: Stage, pixels: Image, turn_deg: float = 0.0, weight: float = 1.0) -> None:
    """A picture (H, W, 3) of everything around, top row straight up, as the light and the background."""
    pose = rotation(np.array([0.0, 0.0, 1.0]), turn_deg) @ _UPRIGHT
    stage.lights["environment"] = {
        "type": "envmap",
        "bitmap": Bitmap(pixels),
        "to_world": pose,
        "sampling_weight": float(weight),
    }


def sun_and_sky(stage: Stage, rng: Rng, middle: Float, radius: float, azimuth_deg: float, elevation_deg: float) -> None:
    """A clear sky, and the sun as a far disc, somewhat larger than it is so that its shadows have soft edges.

    The sun lights a level surface about four times as strongly as the sky does when it is high, less when low.
    """
    sky = clear_sky(float(rng.uniform(2.2, 5.0)), elevation_deg)
    environment(stage, sky, azimuth_deg, 0.5)
    far, half = 40.0 * radius, 40.0 * radius * math.tan(math.radians(rng.uniform(0.6, 1.6)))
    toward = from_direction(azimuth_deg, elevation_deg)
    low = math.exp(-elevation_deg / 14)
    tone = np.array([1.0, 0.95 - 0.35 * low, 0.88 - 0.6 * low])
    radiance = 4.0 * math.pi * (1 - 0.6 * low) * far**2 / (2 * half) ** 2
    panel(stage, "sun", middle + far * toward, middle, (2 * half, 2 * half), radiance * tone, 1.0)


def given_environment(stage: Stage, rng: Rng, assets: Assets) -> bool:
    """One of the user's environment maps, turned at random; False when there is none."""
    drawn = assets.hdri(rng)
    if drawn is None:
        return False
    pixels = drawn[1]
    mean = max(float(pixels.mean()), 1e-9)
    environment(stage, np.minimum(pixels / mean, 2e3).astype(np.float32), float(rng.uniform(0, 360)))
    return True


def key_and_fill(stage: Stage, rng: Rng, middle: Float, radius: float, view_azimuth_deg: float) -> None:
    """A key light from one side, hard or soft, a weak fill from the other, and dim light from all around.

    `middle` is what is lit, `radius` how large it is, `view_azimuth_deg` where the camera stands as seen from it.
    """
    side = float(rng.choice([-1.0, 1.0]))
    tone, other = ((WARM, COOL), (NEUTRAL, NEUTRAL), (COOL, WARM), (WARM, NEUTRAL))[int(rng.integers(4))]
    spread = math.exp(rng.uniform(math.log(0.18), math.log(1.2))) * radius
    far = 4.5 * radius
    key = from_direction(view_azimuth_deg + side * rng.uniform(55, 98), rng.uniform(28, 58))
    strength = 11.0 * (1.2 * radius / spread) ** 2 * rng.uniform(0.8, 1.25)
    panel(stage, "key-light", middle + far * key, middle, (2 * spread, 2 * spread), strength * tone)
    fill = from_direction(view_azimuth_deg - side * rng.uniform(25, 80), rng.uniform(20, 50))
    level = rng.uniform(0.3, 1.2)
    panel(stage, "fill-light", middle + far * fill, middle, (2.4 * radius, 2.4 * radius), level * other, 0.35)
    ambient(stage, rng.uniform(0.1, 0.25) * (0.5 * other + 0.5))


def daylight(stage: Stage, rng: Rng, middle: Float, radius: float, view_azimuth_deg: float) -> None:
    """Sun and sky, the sun at one side of the camera."""
    side = float(rng.choice([-1.0, 1.0]))
    azimuth = view_azimuth_deg + side * rng.uniform(40, 95)
    sun_and_sky(stage, rng, middle, radius, float(azimuth), float(rng.uniform(22, 55)))
