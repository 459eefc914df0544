"""Environment maps of skies: a clear sky from a model, and painted clouds. The top row is the zenith."""

import math

import numpy as np

from twinlens.families.draws import Rng, one_of
from twinlens.families.patterns import Image, noise
from twinlens.geometry import Float

_PEREZ = {  # A, B, C, D, E as (a, b) of a T + b, with turbidity T
    "Y": ((0.1787, -1.4630), (-0.3554, 0.4275), (-0.0227, 5.3251), (0.1206, -2.5771), (-0.0670, 0.3703)),
    "x": ((-0.0193, -0.2592), (-0.0665, 0.0008), (-0.0004, 0.2125), (-0.0641, -0.8989), (-0.0033, 0.0452)),
    "y": ((-0.0167, -0.2608), (-0.0950, 0.0092), (-0.0079, 0.2102), (-0.0441, -1.6537), (-0.0109, 0.0529)),
}
_ZENITH = {  # rows: T^2, T, 1; columns: the sun's zenith angle to the powers 3, 2, 1, 0
    "x": (
        (0.00166, -0.00375, 0.00209, 0.0),
        (-0.02903, 0.06377, -0.03202, 0.00394),
        (0.11693, -0.21196, 0.06052, 0.25886),
    ),
    "y": (
        (0.00275, -0.00610, 0.00317, 0.0),
        (-0.04214, 0.08970, -0.04153, 0.00516),
        (0.15346, -0.26756, 0.06670, 0.26688),
    ),
}
_RGB_FROM_XYZ = np.array([[3.2406, -1.5372, -0.4986], [-0.9689, 1.8758, 0.0415], [0.0557, -0.2040, 1.0570]])
_GROUND = np.array([0.32, 0.29, 0.25])


def clear_sky(turbidity: float, elevation_deg: float, width: int = 256) -> Image:
    """A clear sky without its sun, (width/2, width, 3), of mean luminance 1; the sun is above the centre column.

    Source: Preetham, Shirley and Smits, A Practical Analytic Model for Daylight, SIGGRAPH 1999, tables of appendix A.
    """
    rise = (0.5 - (np.arange(width // 2)[:, None] + 0.5) / (width // 2)) * math.pi
    turn = ((np.arange(width)[None, :] + 0.5) / width - 0.5) * 2 * math.pi
    sun = math.radians(elevation_deg)
    zenith = np.maximum(np.sin(rise), 0.02)
    away = np.arccos(np.clip(np.sin(rise) * math.sin(sun) + np.cos(rise) * math.cos(sun) * np.cos(turn), -1, 1))
    theta = math.pi / 2 - sun
    powers = np.array([theta**3, theta**2, theta, 1.0])
    amount = {
        key: float(np.array([turbidity**2, turbidity, 1.0]) @ np.array(rows) @ powers) for key, rows in _ZENITH.items()
    }
    x, y = (amount[key] * _perez(key, turbidity, zenith, away, theta) for key in ("x", "y"))
    luminance = _perez("Y", turbidity, zenith, away, theta)
    xyz = np.stack([x / y, np.ones_like(x), (1 - x - y) / y], axis=-1) * luminance[..., None]
    sky = np.maximum(xyz @ _RGB_FROM_XYZ.T, 0.0)
    above = np.broadcast_to(rise > 0, luminance.shape)
    sky /= luminance[above].mean()
    return np.where(above[..., None], sky, _GROUND * 0.8).astype(np.float32)


def _perez(key: str, turbidity: float, zenith: Float, away: Float, theta: float) -> Float:
    """The sky relative to its zenith; `zenith` is the cosine of the zenith angle, `away` the angle from the sun."""
    a, b, c, d, e = (slope * turbidity + offset for slope, offset in _PEREZ[key])

    def f(cosine: Float | float, angle: Float | float) -> Float:
        return np.asarray((1 + a * np.exp(b / cosine)) * (1 + c * np.exp(d * angle) + e * np.cos(angle) ** 2))

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
    n = width
    zenith, horizon, cloud = one_of(rng, _SKIES)
    elevation = (0.5 - (np.arange(n // 2)[:, None] + 0.5) / (n // 2)) * math.pi
    height = np.abs(np.sin(elevation)) ** 0.55
    sky = np.array(horizon) + (np.array(zenith) - np.array(horizon)) * height[..., None]
    field = noise(n, rng, 5, octaves=7, gain=0.55, contrast=1.6)[: n // 2]
    cover = np.clip((field - rng.uniform(0.45, 0.6)) * 4, 0, 1)[..., None] * np.clip(height * 3, 0, 1)[..., None]
    sky = sky * (1 - cover) + np.array(cloud) * cover
    out = np.where(elevation[..., None] > 0, sky, 0.8 * sky)
    azimuth, rise = rng.integers(n), math.radians(rng.uniform(15, 60))
    longitude = (np.arange(n)[None, :] - azimuth) * 2 * math.pi / n
    toward = np.sin(elevation) * math.sin(rise) + np.cos(elevation) * math.cos(rise) * np.cos(longitude)
    glow = 60 * np.exp((toward - 1) * 300) + 1.2 * np.exp((toward - 1) * 6)
    return np.asarray(out + glow[..., None] * (0.5 + 0.5 * np.array(cloud)), dtype=np.float32)
