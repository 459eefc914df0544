"""Patterns for projectors: float32 (H, W) arrays in [0, 1], where 1 is a fully lit pixel."""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import check_size
from twinlens.errors import InputError, check_int, check_known, check_number
from twinlens.geometry import float_array

Pattern = NDArray[np.float32]
AXES = ("u", "v")
"""Across the columns, or down the rows."""
PHASE_PERIOD = 16.0
"""The default period of a phase shift, pixels."""
SPECKLE_MEAN = 0.125
"""The mean of a speckle pattern: 1 is 8 times as bright."""


def white(width: int, height: int) -> Pattern:
    """All pixels lit."""
    check_size(width, height)
    return np.ones((height, width), dtype=np.float32)


def dots(
    width: int,
    height: int,
    density: float = 0.1,
    size: int = 1,
    seed: int = 0,
    tiles: int = 1,
) -> Pattern:
    """Pseudo-random square dots of `size` pixels on a grid of that step; `density` is the share of lit cells.

    Exactly round(density * cells) cells are lit, so the pattern's mean does not depend on the seed.

    tiles : copies of one tile side by side and above each other, as the orders of a diffractive element.
    """
    check_number(
        "the density of dots", density, "a number from 0 to 1", least=0, most=1
    )
    check_int("the seed of dots", seed, 0)
    rows, columns = _cells(width, height, size)
    check_int("the tiles of dots", tiles, 1, min(rows, columns))
    tile = -(-rows // tiles), -(-columns // tiles)
    cells = np.zeros(tile[0] * tile[1], dtype=np.float32)
    lit = np.random.default_rng(seed).permutation(len(cells))[
        : round(density * len(cells))
    ]
    cells[lit] = 1.0
    return _enlarged(np.tile(cells.reshape(tile), (tiles, tiles)), size, width, height)


def dot_grid(width: int, height: int, period: int = 8, size: int = 1) -> Pattern:
    """Square dots of `size` pixels, one in the corner of every `period` x `period` pixels."""
    check_size(width, height)
    check_int("the period of a dot grid in pixels", period, 2)
    check_int("the size of a dot in pixels", size, 1, period - 1)
    lit = [np.arange(count) % period < size for count in (height, width)]
    return np.outer(*lit).astype(np.float32)


def stripes(width: int, height: int, period: int = 16, axis: str = "u") -> Pattern:
    """Stripes of half a `period`, in pixels: the first is lit. They alternate along `axis`."""
    check_int("the period of stripes in pixels", period, 2)
    return along(width, height, axis, lambda position: 2 * (position % period) < period)


def checker(width: int, height: int, size: int = 16) -> Pattern:
    """A checkerboard with squares of `size` pixels: the first is lit."""
    rows, columns = _cells(width, height, size)
    cells = (np.add.outer(np.arange(rows), np.arange(columns)) % 2 == 0).astype(
        np.float32
    )
    return _enlarged(cells, size, width, height)


def speckle(width: int, height: int, grain: float = 4.0, seed: int = 0) -> Pattern:
    """Fully developed speckle behind a round aperture: the intensity I has the probability density exp(-I/m) / m.

    Its mean m is `SPECKLE_MEAN`; I is clipped at 1, which is above 99.9 % of the pixels. At a distance of r pixels its
    correlation is (2 J1(x) / x)^2, x = pi r / grain.

    grain : wavelength * fx / aperture diameter, pixels, from 2 to half of the smaller side. The first zero is at 1.22
        grains.

    Source: Goodman, Speckle Phenomena in Optics, 2007, chapters 3 and 5.
    """
    check_size(width, height)
    most = max(
        2.0, 0.5 * min(width, height)
    )  # larger: fewer than 5 waves make the pattern
    check_number(
        "the grain of speckle",
        grain,
        f"a number of pixels from 2 to {most:g}",
        least=2,
        most=most,
    )
    check_int("the seed of speckle", seed, 0)
    # A rough surface sends waves of random phase through the aperture, a disk of spatial frequencies; their sum, the
    # Fourier transform, is the field on the film, and its squared magnitude the intensity, here of mean 1.
    frequency = np.hypot(np.fft.fftfreq(height)[:, None], np.fft.fftfreq(width))
    aperture = frequency <= 0.5 / grain
    real, imaginary = np.random.default_rng(seed).standard_normal((2, height, width))
    field = np.fft.fft2(np.where(aperture, real + 1j * imaginary, 0.0))
    intensity = np.abs(field) ** 2 / (2 * aperture.sum())
    pattern: Pattern = np.minimum(SPECKLE_MEAN * intensity, 1.0).astype(np.float32)
    return pattern


def gray_code(width: int, height: int, frame: int = 0, axis: str = "u") -> Pattern:
    """Image `frame` of the Gray code of the columns ("u") or rows ("v"), see `structured_light.GrayCode`."""
    check_size(width, height)
    check_known("axis", axis, AXES)
    bits = gray_code_bits(width if axis == "u" else height)
    check_int("the frame of a Gray code", frame, 0, 2 * bits - 1)
    bit = bits - 1 - frame // 2
    return along(width, height, axis, lambda u: (u ^ (u >> 1)) >> bit & 1 ^ frame % 2)


def gray_code_bits(count: int) -> int:
    """The number of bits of a Gray code of `count` positions, >= 1."""
    return max(1, (count - 1).bit_length())


def phase_shift(
    width: int,
    height: int,
    frame: int = 0,
    period: float = PHASE_PERIOD,
    steps: int = 4,
    axis: str = "u",
) -> Pattern:
    """Image `frame` of a sinusoid shifted `steps` times, see `structured_light.PhaseShift`."""
    check_number(
        "the period of a phase shift", period, "a number of pixels > 2", above=2
    )
    check_int("the steps of a phase shift", steps, 3)
    check_int("the frame of a phase shift", frame, 0, steps - 1)
    return along(
        width,
        height,
        axis,
        lambda u: 0.5 + 0.5 * np.cos(2 * np.pi * (u / period - frame / steps)),
    )


PATTERNS: dict[str, Callable[..., Pattern]] = {
    "white": white,
    "dots": dots,
    "dot_grid": dot_grid,
    "stripes": stripes,
    "checker": checker,
    "speckle": speckle,
    "gray_code": gray_code,
    "phase_shift": phase_shift,
}
"""The patterns that have a name: functions of width, height and options."""


def named(name: str, width: int, height: int, /, **options: Any) -> Pattern:
    """A pattern of `PATTERNS`. Raises InputError for an unknown name or option.

    >>> float(named("dots", 20, 10, density=0.25).mean())
    0.25
    """
    check_known("pattern", name, PATTERNS)
    try:
        return PATTERNS[name](width, height, **options)
    except TypeError as error:
        raise InputError(f"pattern {name!r}: {error}") from error


def checked_pattern(values: ArrayLike) -> Pattern:
    """The pattern float32 (H, W), which cannot be written to. Raises InputError unless its values are in [0, 1]."""
    pattern = float_array("a projector's pattern", values).astype(np.float32)
    if pattern.ndim != 2:
        raise InputError(
            f"a projector's pattern must have the shape (H, W), got {pattern.shape}"
        )
    if not ((pattern >= 0) & (pattern <= 1)).all():
        raise InputError(
            "a projector's pattern must have values from 0 to 1, and no NaN"
        )
    pattern.setflags(write=False)
    return pattern


def along(
    width: int, height: int, axis: str, value: Callable[[NDArray[np.int64]], Any]
) -> Pattern:
    """The pattern that has `value(position)` at each column ("u") or row ("v")."""
    check_size(width, height)
    check_known("axis", axis, AXES)
    values = np.asarray(
        value(np.arange(width if axis == "u" else height)), dtype=np.float32
    )
    return np.array(
        np.broadcast_to(values if axis == "u" else values[:, None], (height, width))
    )


def _cells(width: int, height: int, size: int) -> tuple[int, int]:
    """Rows and columns of the cells of `size` pixels that cover the pattern."""
    check_size(width, height)
    check_int("the size of a cell in pixels", size, 1, max(width, height))
    return -(-height // size), -(-width // size)


def _enlarged(cells: Pattern, size: int, width: int, height: int) -> Pattern:
    return cells.repeat(size, axis=0).repeat(size, axis=1)[:height, :width].copy()
