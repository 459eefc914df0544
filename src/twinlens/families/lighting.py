"""Lights: area lamps, the sun, and environment maps with the zenith in their top row. All setups cast shadows."""

import math

import numpy as np

from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, log_uniform, one_of
from twinlens.families.patterns import noise
from twinlens.families.surfaces import Sheet
from twinlens.geometry import Float, look_at
from twinlens.scenes.materials import Bitmap, Color, lambert
from twinlens.scenes.scene import Mesh, Sky
from twinlens.scenes.textures import Image

_BLACK = lambert(Bitmap(np.zeros((2, 2, 3), dtype=np.float32)))
WARM, NEUTRAL, COOL = (
    np.array([1.0, 0.84, 0.66]),
    np.array([1.0, 0.96, 0.91]),
    np.array([0.84, 0.93, 1.0]),
)


def panel(
    scene: Composition,
    name: str,
    place: Float,
    target: Float,
    sides: Float,
    radiance: Float,
    weight: float = 1.0,
) -> None:
    """Add a rectangular lamp, its `sides` (2,) in metres, at `place` that faces `target`; see `Composition`."""
    if not scene.own_lights:
        return
    steep = abs(place[2] - target[2]) > 0.95 * np.linalg.norm(place - target)
    pose = look_at(place, target, [0.0, 1.0, 0.0] if steep else [0.0, 0.0, 1.0])
    emitter(scene, name, rectangle(*sides), pose, radiance, weight)


def emitter(
    scene: Composition,
    name: str,
    mesh: Mesh,
    pose: Float,
    radiance: Float,
    weight: float = 1.0,
) -> None:
    """Add a mesh that emits light, of radiance (3,); `weight` is its share of samples."""
    r, g, b = (float(c) for c in radiance)
    area = {
        "type": "area",
        "radiance": Color((r, g, b)),
        "sampling_weight": float(weight),
    }
    scene.add(name, mesh, _BLACK, pose, area)


def rectangle(width: float, height: float) -> Mesh:
    """A flat rectangle facing +z."""
    return Sheet(
        *np.array([[-width / 2, -height / 2, 0], [width, 0, 0], [0, height, 0]])
    ).mesh()


def from_direction(azimuth_deg: float, elevation_deg: float) -> Float:
    """The unit vector (3,) towards a light: azimuth from +x to +y, elevation above the horizon."""
    a, e = math.radians(azimuth_deg), math.radians(elevation_deg)
    return np.array([math.cos(e) * math.cos(a), math.cos(e) * math.sin(a), math.sin(e)])


def environment(
    scene: Composition, pixels: Image, turn_deg: float = 0.0, weight: float = 1.0
) -> None:
    """Set the environment map (H, W, 3), its top row straight up: a light and the background."""
    scene.lights["environment"] = Sky(pixels, turn_deg).plugin() | {
        "sampling_weight": float(weight)
    }


def user_environment(scene: Composition, rng: Rng) -> bool:
    """Light the scene with one of the user's environment maps at a random angle; False where there is none."""
    drawn = scene.assets.draw("hdris", rng)
    if drawn is None:
        return False
    pixels = drawn[1]
    mean = max(float(pixels.mean()), 1e-9)
    environment(
        scene,
        np.minimum(pixels / mean, 2e3).astype(np.float32),
        float(rng.uniform(0, 360)),
    )
    return True


def key_and_fill(scene: Composition, rng: Rng, middle: Float, radius: float) -> None:
    """A key light from one side, a weak fill light from the other, and dim ambient light; the camera looks from -y."""
    side = one_of(rng, [-1.0, 1.0])
    tone, other = one_of(
        rng, [(WARM, COOL), (COOL, WARM), (NEUTRAL, WARM), (WARM, NEUTRAL)]
    )
    spread = log_uniform(rng, 0.18, 1.2) * radius
    far = 4.5 * radius
    key = from_direction(-90.0 + side * rng.uniform(55, 98), rng.uniform(28, 58))
    strength = 11.0 * (1.2 * radius / spread) ** 2 * rng.uniform(0.8, 1.25)
    panel(
        scene,
        "key-light",
        middle + far * key,
        middle,
        np.full(2, 2 * spread),
        strength * tone,
    )
    fill = from_direction(-90.0 - side * rng.uniform(25, 80), rng.uniform(20, 50))
    level = rng.uniform(0.3, 1.2)
    panel(
        scene,
        "fill-light",
        middle + far * fill,
        middle,
        np.full(2, 2.4 * radius),
        level * other,
        0.35,
    )
    ambient = np.asarray(rng.uniform(0.1, 0.25) * (0.5 * other + 0.5), dtype=np.float32)
    environment(scene, np.tile(ambient, (4, 8, 1)), weight=0.35)


def daylight(scene: Composition, rng: Rng, middle: Float, radius: float) -> None:
    """A clear sky, and a distant square as the sun, larger than the real one for soft shadows."""
    side = one_of(rng, [-1.0, 1.0])
    azimuth, elevation = (
        -90.0 + side * float(rng.uniform(40, 95)),
        float(rng.uniform(22, 55)),
    )
    environment(
        scene, clear_sky(float(rng.uniform(2.2, 5.0)), elevation), azimuth + 90.0, 0.5
    )  # its sun is at -y
    far = 40.0 * radius
    half = far * math.tan(math.radians(rng.uniform(0.6, 1.6)))
    low = math.exp(-elevation / 14)
    tone = np.array([1.0, 0.95 - 0.35 * low, 0.88 - 0.6 * low])
    radiance = 4.0 * math.pi * (1 - 0.6 * low) * far**2 / (2 * half) ** 2
    sun = middle + far * from_direction(azimuth, elevation)
    panel(scene, "sun", sun, middle, np.full(2, 2 * half), radiance * tone)


_PEREZ = {  # the coefficients A to E, each as (slope, offset) of a linear function of the turbidity
    "Y": (
        (0.1787, -1.4630),
        (-0.3554, 0.4275),
        (-0.0227, 5.3251),
        (0.1206, -2.5771),
        (-0.0670, 0.3703),
    ),
    "x": (
        (-0.0193, -0.2592),
        (-0.0665, 0.0008),
        (-0.0004, 0.2125),
        (-0.0641, -0.8989),
        (-0.0033, 0.0452),
    ),
    "y": (
        (-0.0167, -0.2608),
        (-0.0950, 0.0092),
        (-0.0079, 0.2102),
        (-0.0441, -1.6537),
        (-0.0109, 0.0529),
    ),
}
_ZENITH = {  # rows: turbidity to the powers 2, 1, 0; columns: the sun's zenith angle to the powers 3, 2, 1, 0
    "x": ((0.00166, -0.00375, 0.00209, 0.0), (-0.02903, 0.06377, -0.03202, 0.00394),
          (0.11693, -0.21196, 0.06052, 0.25886)),
    "y": ((0.00275, -0.00610, 0.00317, 0.0), (-0.04214, 0.08970, -0.04153, 0.00516),
          (0.15346, -0.26756, 0.06670, 0.26688)),
}  # fmt: skip
_RGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
_GROUND = np.array([0.32, 0.29, 0.25])


def clear_sky(turbidity: float, elevation_deg: float, width: int = 256) -> Image:
    """A clear sky without its sun, (width/2, width, 3), of mean luminance 1; the sun is above the centre column.

    Source: Preetham et al., A Practical Analytic Model for Daylight, SIGGRAPH 1999, appendix A.
    """
    rise = (0.5 - (np.arange(width // 2)[:, None] + 0.5) / (width // 2)) * math.pi
    turn = ((np.arange(width)[None, :] + 0.5) / width - 0.5) * 2 * math.pi
    sun = math.radians(elevation_deg)
    zenith = np.maximum(np.sin(rise), 0.02)
    away = np.arccos(
        np.clip(
            np.sin(rise) * math.sin(sun) + np.cos(rise) * math.cos(sun) * np.cos(turn),
            -1,
            1,
        )
    )
    theta = math.pi / 2 - sun
    degrees, powers = (
        np.array([turbidity**2, turbidity, 1.0]),
        np.array([theta**3, theta**2, theta, 1.0]),
    )
    x, y = (
        float(degrees @ np.array(_ZENITH[key]) @ powers)
        * _perez(key, turbidity, zenith, away, theta)
        for key in "xy"
    )
    luminance = _perez("Y", turbidity, zenith, away, theta)
    xyz = (
        np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1)
        * luminance[..., None]
    )
    sky = np.maximum(xyz @ _RGB_FROM_XYZ.T, 0.0)
    above = np.broadcast_to(rise > 0, luminance.shape)
    sky /= luminance[above].mean()
    return np.where(above[..., None], sky, _GROUND * 0.8).astype(np.float32)


def _perez(
    key: str, turbidity: float, zenith: Float, away: Float, theta: float
) -> Float:
    """The sky relative to its zenith; `zenith` is the cosine of the zenith angle, `away` the angle from the sun."""
    a, b, c, d, e = (slope * turbidity + offset for slope, offset in _PEREZ[key])

    def f(cosine: Float | float, angle: Float | float) -> Float:
        return np.asarray(
            (1 + a * np.exp(b / cosine))
            * (1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2)
        )

    return np.asarray(f(zenith, away) / f(1.0, theta))


_SKIES = (
    ((0.16, 0.36, 0.75), (0.75, 0.85, 0.95), (1.0, 0.98, 0.95)),
    ((0.25, 0.33, 0.55), (1.0, 0.62, 0.38), (1.0, 0.75, 0.6)),
    ((0.45, 0.52, 0.6), (0.8, 0.82, 0.85), (0.92, 0.93, 0.95)),
    ((0.1, 0.15, 0.4), (0.75, 0.45, 0.55), (0.8, 0.6, 0.75)),
    ((0.12, 0.45, 0.6), (0.9, 0.92, 0.82), (1.0, 1.0, 0.95)),
)
"""(zenith, horizon, cloud) colours of painted skies."""


def painted_sky(rng: Rng, width: int = 512) -> Image:
    """A cloudy sky, (width/2, width, 3), hazy at the horizon and mirrored below it; the sun is a soft glow."""
    zenith, horizon, cloud = one_of(rng, _SKIES)
    elevation = (0.5 - (np.arange(width // 2)[:, None] + 0.5) / (width // 2)) * math.pi
    height = np.abs(np.sin(elevation)) ** 0.55
    sky = np.array(horizon) + (np.array(zenith) - np.array(horizon)) * height[..., None]
    field = noise(width, rng, 5, octaves=7, gain=0.55, contrast=1.6)[: width // 2]
    cover = (
        np.clip((field - rng.uniform(0.45, 0.6)) * 4, 0, 1)[..., None]
        * np.clip(height * 3, 0, 1)[..., None]
    )
    sky = sky * (1 - cover) + np.array(cloud) * cover
    out = np.where(elevation[..., None] > 0, sky, 0.8 * sky)
    azimuth, rise = rng.integers(width), math.radians(rng.uniform(15, 60))
    longitude = (np.arange(width)[None, :] - azimuth) * 2 * math.pi / width
    toward = np.sin(elevation) * math.sin(rise) + np.cos(elevation) * math.cos(
        rise
    ) * np.cos(longitude)
    glow = 60 * np.exp((toward - 1) * 300) + 1.2 * np.exp((toward - 1) * 6)
    return np.asarray(
        out + glow[..., None] * (0.5 + 0.5 * np.array(cloud)), dtype=np.float32
    )
