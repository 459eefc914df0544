"""Light: soft boxes, sun and sky, and painted or given environment maps, each strong enough that shadows mean something."""

import math

import numpy as np

from twinlens.geometry import Float, look_at
from twinlens.scenes import shapes
from twinlens.scenes.families.assets import Assets
from twinlens.scenes.families.patterns import Image, noise
from twinlens.scenes.families.stage import Stage
from twinlens.scenes.placement import rotation
from twinlens.scenes.scene import Bitmap, Color, Mesh, Plugin

Rng = np.random.Generator
_BLACK: Plugin = {"type": "diffuse", "reflectance": Bitmap(np.zeros((2, 2, 3), dtype=np.float32))}
_UPRIGHT = rotation(np.array([1.0, 0.0, 0.0]), 90.0)  # environment maps have y up, our worlds z
WARM, NEUTRAL, COOL = np.array([1.0, 0.84, 0.66]), np.array([1.0, 0.96, 0.91]), np.array([0.84, 0.93, 1.0])


def panel(stage: Stage, name: str, place: Float, target: Float, size: tuple[float, float], radiance: Float) -> None:
    """A rectangular lamp of `size` metres at `place` that shines towards `target`."""
    pose = look_at(place, target, _up(place, target))
    stage.add(name, rectangle(*size), _BLACK, pose, {"type": "area", "radiance": _color(radiance)})


def rectangle(width: float, height: float) -> Mesh:
    """A flat rectangle facing +z."""
    corners = np.array([[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]) * [width, height, 1]
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.uint32)
    return Mesh(corners, faces, np.tile([0.0, 0.0, 1.0], (4, 1)), np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]))


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


def ambient(stage: Stage, radiance: Float) -> None:
    """Even light from everywhere."""
    pixels = np.broadcast_to(np.asarray(radiance, dtype=np.float32), (4, 8, 3))
    environment(stage, np.ascontiguousarray(pixels))


def environment(stage: Stage, pixels: Image, turn_deg: float = 0.0) -> None:
    """A picture (H, W, 3) of everything around, top row straight up, as the light and the background."""
    pose = rotation(np.array([0.0, 0.0, 1.0]), turn_deg) @ _UPRIGHT
    stage.lights["environment"] = {"type": "envmap", "bitmap": Bitmap(pixels), "to_world": pose}


def sun_and_sky(stage: Stage, rng: Rng, azimuth_deg: float, elevation_deg: float) -> None:
    """Daylight of some haze. Source: Hosek and Wilkie, An Analytic Model for Full Spectral Sky-Dome Radiance, 2012."""
    stage.lights["sky"] = {
        "type": "sunsky",
        "turbidity": float(rng.uniform(2.0, 5.0)),
        "sun_direction": from_direction(azimuth_deg, elevation_deg).tolist(),
        "sun_aperture": float(rng.uniform(1.0, 3.0)),
        "sun_scale": float(rng.uniform(0.5, 1.0)),
        "sky_scale": 1.0,
    }


def given_environment(stage: Stage, rng: Rng, assets: Assets) -> bool:
    """One of the user's environment maps, turned at random; False when there is none."""
    drawn = assets.hdri(rng)
    if drawn is None:
        return False
    pixels = drawn[1]
    mean = max(float(pixels.mean()), 1e-9)
    environment(stage, np.minimum(pixels / mean, 2e3).astype(np.float32), float(rng.uniform(0, 360)))
    return True


def painted_sky(rng: Rng, width: int = 512) -> Image:
    """A sky of clouds over a hazy horizon and dark ground, (width/2, width, 3), its sun a soft glow."""
    n = width
    zenith, horizon, cloud = _SKIES[int(rng.integers(len(_SKIES)))]
    elevation = (0.5 - (np.arange(n // 2)[:, None] + 0.5) / (n // 2)) * math.pi
    height = np.clip(np.sin(elevation), 0, 1) ** 0.55
    sky = np.array(horizon) + (np.array(zenith) - np.array(horizon)) * height[..., None]
    field = noise(n, rng, 5, octaves=7, gain=0.55, contrast=1.6)[: n // 2]
    cover = np.clip((field - rng.uniform(0.45, 0.6)) * 4, 0, 1)[..., None] * np.clip(height * 3, 0, 1)[..., None]
    sky = sky * (1 - cover) + np.array(cloud) * cover
    ground = np.array(horizon) * 0.35
    out = np.where(elevation[..., None] > 0, sky, ground)
    azimuth, rise = rng.integers(n), math.radians(rng.uniform(15, 60))
    longitude = (np.arange(n)[None, :] - azimuth) * 2 * math.pi / n
    toward = np.sin(elevation) * math.sin(rise) + np.cos(elevation) * math.cos(rise) * np.cos(longitude)
    glow = 60 * np.exp((toward - 1) * 300) + 1.2 * np.exp((toward - 1) * 6)
    return (out + glow[..., None] * (0.5 + 0.5 * np.array(cloud))).astype(np.float32)


_SKIES = (
    ((0.16, 0.36, 0.75), (0.75, 0.85, 0.95), (1.0, 0.98, 0.95)),
    ((0.25, 0.33, 0.55), (1.0, 0.62, 0.38), (1.0, 0.75, 0.6)),
    ((0.45, 0.52, 0.6), (0.8, 0.82, 0.85), (0.92, 0.93, 0.95)),
    ((0.1, 0.15, 0.4), (0.75, 0.45, 0.55), (0.8, 0.6, 0.75)),
    ((0.12, 0.45, 0.6), (0.9, 0.92, 0.82), (1.0, 1.0, 0.95)),
)


def key_and_fill(stage: Stage, rng: Rng, middle: Float, radius: float, view_azimuth_deg: float) -> None:
    """A key light from one side, larger or smaller, a weak fill from the other, and dim light from all around.

    `middle` is what is lit, `radius` how large it is, `view_azimuth_deg` where the camera stands as seen from it.
    """
    side = float(rng.choice([-1.0, 1.0]))
    tone, other = ((WARM, COOL), (NEUTRAL, NEUTRAL), (COOL, WARM))[int(rng.integers(3))]
    spread = rng.uniform(0.6, 1.8) * radius
    far = 4.0 * radius
    key = from_direction(view_azimuth_deg + side * rng.uniform(50, 115), rng.uniform(32, 62))
    strength = 9.0 * (radius * 1.2 / spread) ** 2 * rng.uniform(0.8, 1.25)
    panel(stage, "key-light", middle + far * key, middle, (2 * spread, 2 * spread), strength * tone)
    fill = from_direction(view_azimuth_deg - side * rng.uniform(25, 80), rng.uniform(20, 50))
    panel(stage, "fill-light", middle + far * fill, middle, (2.4 * radius, 2.4 * radius), rng.uniform(0.6, 1.6) * other)
    ambient(stage, rng.uniform(0.12, 0.3) * (0.5 * other + 0.5))


def tilted(mesh: Mesh, pose: Float) -> Mesh:
    """A mesh moved once and for all."""
    return shapes.transformed(mesh, pose)


def glow(stage: Stage, name: str, mesh: Mesh, pose: Float, radiance: Float) -> None:
    """A mesh that shines: window panes, lamp shades."""
    stage.add(name, mesh, _BLACK, pose, {"type": "area", "radiance": _color(radiance)})
