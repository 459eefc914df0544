"""Sharpness and light on the film behind a bare round hole: MTF of a slanted edge (ISO 12233), diffraction, radiometry.

The diffraction pattern, from the hole's shadow to its Airy pattern, is I = |U|^2 with

    U(r) = integral over rho from 0 to a of  J0(2 pi r rho / (lambda v)) exp(i pi rho^2 (1/v + 1/z) / lambda) rho d rho

for the radius a of the hole, the film at v, the point at z (Born and Wolf, Principles of Optics, section 8.8; Young,
Pinhole optics, Applied Optics 10(12), 1971). All lengths in metres.

The path-traced box uses no camera formula: a black box whose front plate has a hole, under a uniform sky. A diffuse
film of reflectance 1 inside the box has the radiance E / pi, where E is its irradiance (Lambert's law).
"""

import math
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy import optimize, signal, special

from twinlens.camera import BareAperture, Camera, Pinhole, Rig
from twinlens.errors import InputError
from twinlens.geometry import Float, look_at
from twinlens.rendering import render
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.sensor import Exposure, Sensor
from twinlens.studies.stage import GLOW, centred_camera, glowing

FILM = 0.05  # film distance, metres
PITCH = 25e-6
WAVELENGTH = 550e-9
DEPTH = 10.0  # distance of the edge
SLANT = math.radians(5.0)  # of the edge from the vertical
OVERSAMPLING = 4
_REFITS = 4  # of the line along the edge
_RINGS = 40
SENSOR = Sensor.preset(
    "machine_vision",
    filters="mono",
    output="linear",
    bits=16,
    wavelengths=(WAVELENGTH,) * 3,
    prnu=0.0,
    dsnu=0.0,
)
_SIZE = 10.0  # film distance of the box, metres: large, so that the renderer's ray offsets of 1e-4 (1 + position) m
# are negligible; in a box of 50 mm they would move the film by 0.2 %
_CORNERS = 512  # of the round hole; the polygon misses 3e-5 of its area
_HALF_WIDTH = 3.0  # of the box, in film distances
_PIXELS = 48  # image side
_PATCH = 0.02  # imaged part of the film, in film distances: E varies by 2e-4 within it


def edge_camera(finer: int = 1) -> Camera:
    """The camera with film distance FILM and pixel pitch PITCH, or a pitch smaller by an integer factor."""
    return centred_camera(finer * 420, finer * 90, finer * FILM / PITCH)


def edge_scene() -> Scene:
    """A luminous half plane at DEPTH, its edge near the axis."""
    size, sine, cosine = 4.0, math.sin(SLANT), math.cos(SLANT)
    pose = np.diag([size, -size, -1.0, 1.0])
    pose[:2, :2] = size * np.array([[cosine, sine], [sine, -cosine]])
    pose[:3, 3] = -size * cosine, -size * sine, DEPTH
    return glowing("edge", [("half", {"type": "rectangle"}, pose, GLOW)], DEPTH)


def edge_spread(picture: ArrayLike) -> tuple[Float, Float]:
    """The edge-spread function: (distance perpendicular to the edge in pixels, mean grey level), every quarter pixel.

    picture: (H, W) linear grey levels with one nearly vertical edge through every row. Raises InputError if a row has
    no edge, or if the edge spans less than a pixel from top to bottom.
    """
    image = np.asarray(picture, np.float64)
    slopes = np.abs(np.diff(image, axis=1))
    if image.ndim != 2 or not (slopes.sum(axis=1) > 0).all():
        raise InputError(
            "the slanted edge needs a grey image with an edge through every row"
        )
    height, width = image.shape
    slope, intercept = _edge_line(slopes)
    if abs(slope) * height < 1:
        raise InputError(
            "the edge is not slanted: it must span more than a pixel from top to bottom"
        )

    # The distance of each pixel from the edge is its distance along the row times the cosine of the edge's angle.
    edge_u = np.polyval([slope, intercept], np.arange(height))
    distance = (np.arange(width) - edge_u[:, None]) * math.cos(math.atan(slope))

    # Means over bins of a quarter pixel. Bins with few pixels, at the ends and between rows, are interpolated.
    bins = np.rint(distance * OVERSAMPLING).astype(np.intp)
    first = int(bins.min())
    count = np.bincount((bins - first).ravel())
    total = np.bincount((bins - first).ravel(), weights=image.ravel())
    places = (np.arange(len(count)) + first) / OVERSAMPLING
    full = count >= 0.5 * np.median(count)
    span = np.flatnonzero(full)
    inner = slice(span[0], span[-1] + 1)
    means = np.interp(places[inner], places[full], total[full] / count[full])
    return places[inner], means


def _edge_line(slopes: Float) -> Float:
    """(slope, intercept) of the line u = slope v + intercept through the edge; `slopes` are those along the rows."""
    middles, rows = np.arange(slopes.shape[1]) + 0.5, np.arange(slopes.shape[0])
    near = slopes
    for _ in range(_REFITS):
        # The centroid of each row's slopes, then only of the slopes within a quarter of the width of the last line.
        total = near.sum(axis=1)
        has_slope = total > 0
        centroids = (near * middles).sum(axis=1)[has_slope] / total[has_slope]
        line = np.polyfit(rows[has_slope], centroids, 1)
        away = np.abs(middles - np.polyval(line, rows)[:, None])
        near = slopes * (away < 0.25 * len(middles))
    return np.asarray(line, np.float64)


def modulation_transfer(picture: ArrayLike) -> tuple[Float, Float]:
    """(frequency in cycles/pixel up to 1, MTF) of the whole system, pixels included.

    MTF(nu) = |FT of the line-spread function| / its value at 0; the line spread is the derivative of the edge spread.
    Source: ISO 12233, the slanted edge.
    """
    _, spread = edge_spread(picture)
    line_spread = np.gradient(spread) * OVERSAMPLING
    # The steepest place, averaged over a pixel, is the middle of a window that lets both ends go to 0.
    steepness = np.convolve(np.abs(line_spread), np.ones(OVERSAMPLING), mode="same")
    centre = int(np.argmax(steepness))
    half = min(centre, len(line_spread) - 1 - centre)
    lines = line_spread[centre - half : centre + half + 1] * np.hamming(2 * half + 1)
    # Four times as many samples, filled with zeros, interpolate the spectrum.
    length = 1 << max(len(lines) * 4 - 1, 1).bit_length()
    spectrum = np.abs(np.fft.rfft(lines, length))
    frequency = np.fft.rfftfreq(length, 1.0 / OVERSAMPLING)
    is_kept = frequency <= 1.0
    frequency = frequency[is_kept]
    # A central difference over two steps h has the response sin(2 pi nu h) / (2 pi nu h) of the derivative's, which is
    # divided out.
    damping = np.sinc(2.0 * frequency / OVERSAMPLING)
    transfer = np.asarray(spectrum[is_kept] / spectrum[0] / damping, np.float64)
    return np.asarray(frequency, np.float64), transfer


def frequency_at(picture: ArrayLike, contrast: float) -> float:
    """The frequency in cycles/pixel at which the MTF first falls below `contrast`: 0.5 for MTF50, 0.1 for MTF10."""
    return crossing(*modulation_transfer(picture), contrast)


def crossing(frequency: Float, transfer: Float, contrast: float) -> float:
    """The interpolated frequency at which the transfer first falls below `contrast`; the highest if it does not."""
    k = int(np.argmax(transfer < contrast))
    if k == 0:
        return float(frequency[-1])
    share = (transfer[k - 1] - contrast) / (transfer[k - 1] - transfer[k])
    return float(frequency[k - 1] + share * (frequency[k] - frequency[k - 1]))


def intensity(
    radius: Float, diameter: float, film: float, depth: float, wavelength: float
) -> Float:
    """|U(r)|^2 at each radius on the film, for a point at `depth` on the axis, up to a factor.

    Fresnel's integral over a hole of radius a, film distance v, depth z (Born and Wolf, section 8.8):

        U(r) = integral from 0 to a of J0(2 pi r rho / (lambda v)) exp(i pi (1/v + 1/z) rho^2 / lambda) rho drho
    """
    edge = 0.5 * diameter
    bend = math.pi * (1.0 / film + 1.0 / depth) / wavelength
    # The phase, in radians, over which the integrand turns; Gauss-Legendre needs a node for each.
    turns = bend * edge**2
    turns += 2.0 * math.pi * float(radius.max()) * edge / (wavelength * film)
    nodes, weights = special.roots_legendre(64 + math.ceil(turns))
    rho = 0.5 * edge * (nodes + 1.0)
    waves = special.j0(2.0 * math.pi / (wavelength * film) * radius[:, None] * rho)
    amplitude = waves @ (0.5 * edge * weights * rho * np.exp(1j * bend * rho**2))
    return np.asarray(np.abs(amplitude) ** 2)


def fresnel_kernel(
    diameter: float, film: float, depth: float, wavelength: float, pitch: float, *, sub: int = 3,
    most_px: int | None = None,
) -> Float:  # fmt: skip
    """The image of a point on pixels of this pitch, (2R + 1, 2R + 1), sum 1.

    R covers the hole's shadow and forty Airy rings (99.5 % of a narrow hole's light), at most `most_px`. A value is the
    mean of `sub` x `sub` points: 3 approximates the integral over the pixel; 1 samples the pattern.
    """
    shadow = 0.5 * diameter * (1.0 + film / depth)
    reach = shadow + _RINGS * wavelength * film / diameter
    size = int(min(math.ceil(reach / pitch), most_px or math.inf))
    radii = np.linspace(0.0, math.sqrt(2.0) * (size + 1) * pitch, 8 * size + 64)
    profile = intensity(radii, diameter, film, depth, wavelength)
    side = 2 * size + 1
    steps = (np.arange(side * sub) - (side * sub - 1) / 2) * pitch / sub
    fine = np.interp(np.hypot(steps[:, None], steps[None, :]), radii, profile)
    kernel = fine.reshape(side, sub, side, sub).sum(axis=(1, 3))
    return np.asarray(kernel / kernel.sum())


def transfer(
    frequency: Float, diameter: float, film: float, depth: float, wavelength: float
) -> Float:
    """The optical transfer function of the hole at frequencies in cycles/m on the film.

    OTF(nu) = 1/(pi a^2) integral over |x| < a - s/2 of 2 sqrt(a^2 - (|x| + s/2)^2) cos(2 pi kappa s x / lambda) dx with
    the shift s = lambda v nu of the pupil and kappa = 1/v + 1/z (Hopkins, The frequency response of a defocused optical
    system, Proc. Roy. Soc. A 231, 1955).

    >>> transfer(np.array([0.0, 1e6]), 0.2e-3, 0.05, np.inf, 550e-9).round(6).tolist()
    [1.0, 0.0]
    """
    edge = 0.5 * diameter
    shift = wavelength * film * np.asarray(frequency, np.float64)[:, None]
    nodes, weights = special.roots_legendre(240)
    half = np.maximum(edge - 0.5 * shift, 0.0)
    x = 0.5 * half * (nodes + 1.0)
    chord = 2.0 * np.sqrt(np.maximum(edge**2 - (x + 0.5 * shift) ** 2, 0.0))
    waves = np.cos(2.0 * math.pi * (1.0 / film + 1.0 / depth) * shift * x / wavelength)
    integral = (half * weights * chord * waves).sum(axis=1)
    return np.asarray(integral / (math.pi * edge**2))


def convolved(sharp: Float, kernel: Float) -> Float:
    """A sharp grey image (H, W), extended by its edge pixels, convolved with the kernel."""
    reach = kernel.shape[0] // 2
    return np.asarray(
        signal.fftconvolve(np.pad(sharp, reach, mode="edge"), kernel, mode="valid")
    )


@lru_cache
def predicted_frequency(millimetres: float, contrast: float) -> float:
    """The frequency (cycles/mm on the film) at which Hopkins's transfer function times the pixel's is `contrast`."""
    frequency = np.linspace(0.0, 0.5 / PITCH, 2001)
    of_hole = transfer(frequency, 1e-3 * millimetres, FILM, DEPTH, WAVELENGTH)
    of_pixel = np.sinc(frequency * PITCH)
    return crossing(frequency, of_hole * of_pixel, contrast) / 1e3


@lru_cache
def predicted_best(contrast: float) -> float:
    """The hole diameter (mm) with the highest `predicted_frequency`."""
    optimum = optimize.minimize_scalar(
        lambda d: -predicted_frequency(d, contrast),
        bounds=(0.12, 0.45),
        method="bounded",
    )
    return float(optimum.x)


def half_of_white(camera: Camera, hole: BareAperture) -> float:
    """The exposure time, seconds, that gives half of white for a radiance of 1."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    return 0.5 / float(SENSOR.level_rate(white, camera=camera, lens=hole).mean())


def exposed(camera: Camera, hole: BareAperture, time: float, seed: int) -> Float:
    """The levels (H, W) of a film lit with a radiance of 1, exposed for `time` seconds."""
    white = np.ones((camera.height, camera.width, 3), np.float32)
    photo = SENSOR.expose(
        white, camera=camera, lens=hole, seed=seed, exposure=Exposure(time)
    )
    return photo.image.astype(np.float64)


def exposed_rate(camera: Camera, hole: BareAperture, seed: int) -> float:
    """Mean level per second of a uniformly lit film, exposed to half of white."""
    time = half_of_white(camera, hole)
    return float(exposed(camera, hole, time, seed).mean()) / time


def film_light(diameter: float, film: float, spp: int, seed: int) -> float:
    """E / (pi L) at the centre of a film behind a hole in a plate under a sky of radiance L, path-traced.

    Each of 2304 spp light paths passes the hole or not, so the result has a binomial distribution.
    """
    eye, middle = np.array([0.4, 0.0, 0.3]) * _SIZE, np.array([0.0, 0.0, _SIZE])
    fx = _PIXELS * float(np.linalg.norm(middle - eye)) / (_PATCH * _SIZE)
    rig = Rig(
        (centred_camera(_PIXELS, _PIXELS, fx),),
        (look_at(eye, middle, up=(0.0, -1.0, 0.0)),),
    )
    picture = render(_box(diameter / film * _SIZE), rig, Pinhole(), spp, seed)[0]
    return float(picture[..., 1].mean(dtype=np.float64))


def _walls(hole_radius: float, half: float) -> Mesh:
    """A plate from the rim of the hole outwards to `half`, and a tube from there to behind the film."""
    around = np.linspace(0.0, 2.0 * math.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(_CORNERS)], axis=1)
    behind = [0.0, 0.0, 1.01 * _SIZE]
    rings = [hole_radius * circle, half * circle, half * circle + behind]

    # Two triangles between neighbours of one ring and of the next.
    step = np.arange(_CORNERS)
    following = (step + 1) % _CORNERS
    first = np.stack([step, following, step + _CORNERS], axis=1)
    second = np.stack([following, following + _CORNERS, step + _CORNERS], axis=1)
    strip = np.concatenate([first, second])
    faces = np.concatenate([strip, strip + _CORNERS])
    return Mesh(np.concatenate(rings), faces.astype(np.uint32))


def _box(diameter: float) -> Scene:
    """A black plate with a hole at z = 0, black walls and a white film at z = _SIZE behind it; a sky of radiance 1."""
    half = _HALF_WIDTH * _SIZE
    walls = _walls(0.5 * diameter, half)
    towards_hole = np.diag([2.0 * half, -2.0 * half, -1.0, 1.0])
    towards_hole[2, 3] = _SIZE
    objects = (
        SceneObject("walls", walls, "black"),
        SceneObject("film", {"type": "rectangle"}, "white", towards_hole),
    )
    grey = {name: {"type": "diffuse", "reflectance": {"type": "rgb", "value": value}}
            for name, value in (("black", 0.0), ("white", 1.0))}  # fmt: skip
    sky = {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}
    paths = {"type": "path", "max_depth": 2}
    return Scene(
        "box",
        objects,
        grey,
        np.eye(4),
        (0.5 * _SIZE, 2.0 * _SIZE),
        lights={"sky": sky},
        integrator=paths,
    )
