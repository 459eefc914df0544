"""Lights: area lamps, the sun, and environment maps with the zenith in their top row. All setups cast shadows."""

import math
from collections.abc import Callable

import numpy as np

from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, log_uniform, one_of, weighted
from twinlens.families.patterns import noise
from twinlens.families.surfaces import Sheet
from twinlens.geometry import Float, look_at
from twinlens.scenes.materials import Bitmap, Color, lambert
from twinlens.scenes.scene import Mesh, Sky
from twinlens.scenes.textures import Image

Light = Callable[[Composition, Rng, Float, float, float], None]
"""Adds the lights of one kind: of a scene, by a stream, around a middle, of a radius, from a side; see `one_kind`."""
_WEAK = 0.35  # share of samples of lights that add little
_BRIGHTEST = 2e3  # of a pixel of an environment map, in units of the map's mean
_BLACK = lambert(Bitmap(np.zeros((2, 2, 3), dtype=np.float32)))
WARM = np.array([1.0, 0.84, 0.66])
NEUTRAL = np.array([1.0, 0.96, 0.91])
COOL = np.array([0.84, 0.93, 1.0])
_TONES = ((WARM, COOL), (COOL, WARM), (NEUTRAL, WARM), (WARM, NEUTRAL))
"""Colours of a key light and of its fill light."""


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
    red, green, blue = map(float, radiance)
    area = {
        "type": "area",
        "radiance": Color((red, green, blue)),
        "sampling_weight": float(weight),
    }
    scene.add(name, mesh, _BLACK, pose, area)


def rectangle(width: float, height: float) -> Mesh:
    """A flat rectangle facing +z."""
    corner = np.array([-width / 2, -height / 2, 0])
    return Sheet(corner, np.array([width, 0, 0]), np.array([0, height, 0])).mesh()


def from_direction(azimuth_deg: float, elevation_deg: float) -> Float:
    """The unit vector (3,) towards a light: azimuth from +x to +y, elevation above the horizon."""
    azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
    x = math.cos(elevation) * math.cos(azimuth)
    y = math.cos(elevation) * math.sin(azimuth)
    return np.array([x, y, math.sin(elevation)])


def environment(
    scene: Composition, pixels: Image, turn_deg: float = 0.0, weight: float = 1.0
) -> None:
    """Set the environment map (H, W, 3), its top row straight up: a light and the background."""
    sky = Sky(pixels, turn_deg).plugin()
    scene.lights["environment"] = sky | {"sampling_weight": float(weight)}


def user_environment(scene: Composition, rng: Rng) -> bool:
    """Light the scene with one of the user's environment maps at a random angle; False where there is none."""
    drawn = scene.assets.draw("hdris", rng)
    if drawn is None:
        return False
    _, pixels = drawn
    # Of mean 1, as the other environments. A clipped sun keeps its direction and makes fewer bright specks.
    mean = max(float(pixels.mean()), 1e-9)
    scaled = np.minimum(pixels / mean, _BRIGHTEST).astype(np.float32)
    environment(scene, scaled, float(rng.uniform(0, 360)))
    return True


def one_kind(
    scene: Composition,
    rng: Rng,
    middle: Float,
    radius: float,
    side: float = 0.0,
    outdoors: bool = False,
) -> None:
    """Light around `middle`, metres, of a kind drawn once for a scene: hard or soft, even or with dark parts.

    The camera looks from -y. side : of the main light, -1 for -x, 1 for +x; 0 draws it. outdoors : only kinds with a
    sky that may be seen.
    """
    listed = [row for row in KINDS if not outdoors or row[0] in _OUTDOORS]
    if scene.is_night:
        listed = list(_AT_NIGHT)
    kinds = [kind for kind, _ in listed]
    shares = [share for _, share in listed]
    light = weighted(rng, kinds, shares)
    drawn = one_of(rng, [-1.0, 1.0])
    light(scene, rng, middle, radius, side or drawn)


def key_and_fill(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """A key light from one side, a weak fill light from the other, and dim ambient light; the camera looks from -y."""
    key_tone, fill_tone = one_of(rng, _TONES)
    half_key = log_uniform(rng, 0.18, 1.2) * radius  # small lamps cast sharp shadows
    distance = 4.5 * radius

    key = from_direction(-90.0 + side * rng.uniform(55, 98), rng.uniform(28, 58))
    # The irradiance at the middle is that of a lamp of half side 1.2 radius, whatever the lamp's size.
    strength = 11.0 * (1.2 * radius / half_key) ** 2 * rng.uniform(0.8, 1.25)
    sides = np.full(2, 2 * half_key)
    place = middle + distance * key
    panel(scene, "key-light", place, middle, sides, strength * key_tone)

    fill = from_direction(-90.0 - side * rng.uniform(25, 80), rng.uniform(20, 50))
    level = rng.uniform(0.3, 1.2)
    sides = np.full(2, 2.4 * radius)
    place = middle + distance * fill
    panel(scene, "fill-light", place, middle, sides, level * fill_tone, _WEAK)

    # Half of the fill light's colour, half white.
    _ambient(scene, rng.uniform(0.1, 0.25) * (0.5 * fill_tone + 0.5))


def _ambient(scene: Composition, radiance: Float) -> None:
    """Dim light (3,) from everywhere."""
    pixels = np.tile(np.asarray(radiance, dtype=np.float32), (4, 8, 1))
    environment(scene, pixels, weight=_WEAK)


def one_lamp(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """Night with one small lamp near the scene: what is beside it may clip, and its shadows are nearly black."""
    tone = one_of(rng, [WARM, WARM, NEUTRAL])
    towards = from_direction(-90.0 + side * rng.uniform(50, 92), rng.uniform(8, 55))
    # Beside the picture. The nearer, the faster its light falls off over the scene.
    distance = log_uniform(rng, 1.2, 2.4) * radius / abs(towards[0])
    half = rng.uniform(0.06, 0.2) * distance
    strength = 2.5 * (distance / half) ** 2 * rng.uniform(0.8, 1.25)
    place = middle + distance * towards
    panel(scene, "key-light", place, middle, np.full(2, 2 * half), strength * tone)
    _ambient(scene, log_uniform(rng, 0.0001, 0.006) * COOL)


def headlight(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """Night with a lamp just above the camera, as of a robot or a car: what is far away is nearly black."""
    tone = one_of(rng, [COOL, NEUTRAL, WARM])
    view = scene.view
    distance = float(np.linalg.norm(middle - view.eye))
    right, down, forward = view.world_from_cam[:3, :3].T
    # Behind the plane of the cameras, so that none sees it.
    off = np.array([side * rng.uniform(0.02, 0.12), -rng.uniform(0.03, 0.12), -0.01])
    place = view.eye + distance * (off @ np.stack([right, down, forward]))
    width = rng.uniform(0.02, 0.06) * distance
    # The same irradiance at the middle as from the lamp beside the scene.
    strength = 10.0 * (distance / width) ** 2 * rng.uniform(0.8, 1.25)
    panel(scene, "key-light", place, middle, np.full(2, width), strength * tone)
    _ambient(scene, log_uniform(rng, 0.0001, 0.006) * COOL)


def window(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """A large window at one side, low, in a dim room: soft light that grazes what it meets."""
    tone = one_of(rng, [COOL, COOL, NEUTRAL])
    towards = from_direction(-90.0 + side * rng.uniform(70, 95), rng.uniform(6, 24))
    place = middle + 2.6 * radius * towards
    sides = radius * rng.uniform(1.2, 2.2, 2)
    panel(scene, "key-light", place, middle, sides, rng.uniform(7, 12) * tone)
    _ambient(scene, log_uniform(rng, 0.004, 0.12) * tone)


def overcast(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """A covered sky, three times as bright at the zenith as at the horizon, without shadows (CIE, Moon and Spencer)."""
    # As high as clear skies: kernels depend on the height, and scenes share them.
    elevation, _ = _directions(256)
    dome = (1 + 2 * np.maximum(np.sin(elevation), 0)) / 3
    tone = one_of(rng, [COOL, NEUTRAL])
    pixels = np.broadcast_to(dome[..., None] * tone, (128, 256, 3))
    environment(scene, np.asarray(pixels, dtype=np.float32), weight=1.0)


def daylight(
    scene: Composition, rng: Rng, middle: Float, radius: float, side: float
) -> None:
    """A clear sky, and a distant square as the sun, larger than the real one for soft shadows."""
    azimuth_deg = -90.0 + side * float(rng.uniform(40, 95))
    elevation_deg = float(rng.uniform(9, 55))
    sky = clear_sky(float(rng.uniform(2.2, 5.0)), elevation_deg)
    environment(scene, sky, azimuth_deg + 90.0, 0.5)  # its sun is at -y

    distance = 40.0 * radius
    half = distance * math.tan(math.radians(rng.uniform(0.6, 1.6)))
    # The lower the sun, the longer the way of its light through air: the redder and the weaker it is.
    low = math.exp(-elevation_deg / 14)
    tone = np.array([1.0, 0.95 - 0.35 * low, 0.88 - 0.6 * low])
    # An irradiance of 4 pi (1 - 0.6 low) from a square of this solid angle.
    radiance = 4.0 * math.pi * (1 - 0.6 * low) * distance**2 / (2 * half) ** 2
    place = middle + distance * from_direction(azimuth_deg, elevation_deg)
    panel(scene, "sun", place, middle, np.full(2, 2 * half), radiance * tone)


KINDS: tuple[tuple[Light, float], ...] = (
    (key_and_fill, 0.4),
    (daylight, 0.26),
    (overcast, 0.14),
    (window, 0.2),
)
"""Kinds of light and their shares of the scenes by day; at night there is one lamp, `_AT_NIGHT`."""
HEADLIGHTS = 0.4
"""Share of the nights whose lamp is at the camera."""
_AT_NIGHT: tuple[tuple[Light, float], ...] = (
    (one_lamp, 1 - HEADLIGHTS),
    (headlight, HEADLIGHTS),
)
_OUTDOORS = (daylight, overcast)
NAMES = frozenset(("sun", "key-light", "fill-light"))
"""Names of the lamps that they add."""

# fmt: off
_PEREZ = {
    "Y": ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    "x": ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    "y": ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
}
"""The coefficients A to E of luminance and chromaticity: slope and offset of linear functions of the turbidity."""
_ZENITH = {
    "x": ((0.00166, -0.00375, 0.00209, 0.0), (-0.02903, 0.06377, -0.03202, 0.00394),
          (0.11693, -0.21196, 0.06052, 0.25886)),
    "y": ((0.00275, -0.00610, 0.00317, 0.0), (-0.04214, 0.08970, -0.04153, 0.00516),
          (0.15346, -0.26756, 0.06670, 0.26688)),
}
"""Chromaticity at the zenith. Rows: turbidity to the powers 2, 1, 0; columns: the sun's zenith angle to 3, 2, 1, 0."""
# fmt: on
_RGB_FROM_XYZ = np.array(
    [[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]]
)
_GROUND = np.array([0.32, 0.29, 0.25])


def _directions(width: int) -> tuple[Float, Float]:
    """Elevation (H, 1) and azimuth (1, W) of the pixels of a map of the whole sphere; 0 in its centre."""
    height = width // 2
    rows = (np.arange(height)[:, None] + 0.5) / height
    columns = (np.arange(width)[None, :] + 0.5) / width
    return (0.5 - rows) * math.pi, (columns - 0.5) * 2 * math.pi


def clear_sky(turbidity: float, elevation_deg: float, width: int = 256) -> Image:
    """A clear sky without its sun, (width/2, width, 3), of mean luminance 1; the sun is above the centre column.

    Source: Preetham et al., A Practical Analytic Model for Daylight, SIGGRAPH 1999, appendix A.
    """
    elevation, azimuth = _directions(width)
    sun = math.radians(elevation_deg)
    # The cosines of the angles from the zenith, and from the sun.
    zenith = np.maximum(np.sin(elevation), 0.02)
    from_sun = np.sin(elevation) * math.sin(sun)
    from_sun = from_sun + np.cos(elevation) * math.cos(sun) * np.cos(azimuth)
    angle = np.arccos(np.clip(from_sun, -1, 1))

    theta = math.pi / 2 - sun
    degrees = np.array([turbidity**2, turbidity, 1.0])
    powers = np.array([theta**3, theta**2, theta, 1.0])
    x, y = (
        float(degrees @ np.array(_ZENITH[key]) @ powers)
        * _perez(key, turbidity, zenith, angle, theta)
        for key in "xy"
    )
    luminance = _perez("Y", turbidity, zenith, angle, theta)

    # CIE xyY to XYZ, then to linear sRGB; colours outside its gamut are clipped.
    xyz = np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1)
    xyz = xyz * luminance[..., None]
    sky = np.maximum(xyz @ _RGB_FROM_XYZ.T, 0.0)
    above = np.broadcast_to(elevation > 0, luminance.shape)
    sky /= luminance[above].mean()
    return np.where(above[..., None], sky, _GROUND * 0.8).astype(np.float32)


def _perez(
    key: str, turbidity: float, zenith: Float, from_sun: Float, theta: float
) -> Float:
    """The sky relative to its zenith: F(zenith angle, angle from the sun) / F(0, `theta`).

    `zenith` is the cosine of the zenith angle, `from_sun` the angle from the sun, `theta` the sun's zenith angle.
    """
    a, b, c, d, e = (slope * turbidity + offset for slope, offset in _PEREZ[key])

    def relative(cosine: Float | float, angle: Float | float) -> Float:
        horizon = 1 + a * np.exp(b / cosine)
        around_sun = 1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2
        return np.asarray(horizon * around_sun)

    return np.asarray(relative(zenith, from_sun) / relative(1.0, theta))


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
    zenith, horizon, cloud = map(np.array, one_of(rng, _SKIES))
    elevation, _ = _directions(width)
    height = np.abs(np.sin(elevation)) ** 0.55  # 0 at the horizon, 1 at the zenith
    sky = horizon + (zenith - horizon) * height[..., None]

    # Clouds where the noise is above a level, with soft edges; none at the horizon.
    field = noise(width, rng, 5, octaves=7, gain=0.55, contrast=1.6)[: width // 2]
    cloudiness = np.clip((field - rng.uniform(0.45, 0.6)) * 4, 0, 1)[..., None]
    cover = cloudiness * np.clip(height * 3, 0, 1)[..., None]
    sky = sky * (1 - cover) + cloud * cover
    painted = np.where(elevation[..., None] > 0, sky, 0.8 * sky)

    # The sun: a narrow lobe of 3 degrees and a wide one, in the colour of the clouds' light.
    azimuth = rng.integers(width)
    rise = math.radians(rng.uniform(15, 60))
    longitude = (np.arange(width)[None, :] - azimuth) * 2 * math.pi / width
    cosine = np.sin(elevation) * math.sin(rise)
    cosine = cosine + np.cos(elevation) * math.cos(rise) * np.cos(longitude)
    glow = 60 * np.exp((cosine - 1) * 300) + 1.2 * np.exp((cosine - 1) * 6)
    light = glow[..., None] * (0.5 + 0.5 * cloud)
    return np.asarray(painted + light, dtype=np.float32)
