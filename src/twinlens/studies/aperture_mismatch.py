"""The chance that noise takes a block match far from the truth: the threshold effect of a shift's estimation.

A window of n = side^2 pixels, whose texture t has variance V and autocorrelation rho(x) = exp(-x^2 / (4 g^2)) along
either axis, is matched by its sum of squared differences; either eye adds white Gaussian noise, a and b, of variance
sigma^2. At the shift h from the truth, which is in the middle of the range, the sum is

    S_h = sum over the window of (t(x) - t(x + h) + a(x) - b(x + h))^2 = E_h + T_h + N_h

    texture     E_h = sum (t(x) - t(x + h))^2,                             2 n V (1 - rho(h)) in the mean
    both        T_h = 2 sum (t(x) - t(x + h)) (a(x) - b(x + h)),           of variance 8 sigma^2 E_h
    noise       N_h = sum (a(x) - b(x + h))^2, whose far differences are   of variance 12 n sigma^4

so that a single far rival would win with the chance Q(E / sqrt(8 sigma^2 E + 12 n sigma^4)), were all this Gaussian. A
match is wrong where the least of the sums, refined by a parabola, lies over 2 px from the truth. Blur wide enough that
texture is no more than a slope makes that what the Cramer-Rao bound says of P(|error| > 2 px); without any texture it
is mere chance, about 1 - 4/ndisp.

V is the texture's, not the window's own. A window holds few grains, one alone where blur is wider than it is, and may
find them faint: fading, whose tail falls as a power of the light. Nor is N_h Gaussian enough in the tail that the least
of many rivals lies in. So the chance has no closed form. Textures and noise are drawn, Gaussian in their values, 4000
windows, always the same; nothing is assumed of the sums.

Sources: Ziv and Zakai, Some lower bounds on signal parameter estimation, IEEE Trans. Information Theory 15(3), 1969;
Ianniello, Time delay estimation via cross-correlation in the presence of large estimation errors, IEEE Trans. ASSP
30(6), 1982; Weinstein and Weiss, Fundamental limitations in passive time delay estimation II, IEEE Trans. ASSP 32(5),
1984.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator

Float = NDArray[np.float64]

RIGHT_PX = 2
"""An error up to this many pixels is none."""
_SNR = np.geomspace(1e-3, 1e4, 29)
_SPREADS = np.geomspace(0.5, 12.0, 12)
_DRAWS = 4000


class Sums(NamedTuple):
    """E, T and N of the module's first lines, of drawn windows at each shift, (4000, ndisp), for V = sigma = 1."""

    texture: Float
    both: Float
    noise: Float


def mismatch_share(snr: ArrayLike, spread: ArrayLike, side: int, ndisp: int) -> Float:
    """The chance of a mismatch, from tables of `mismatch`, bilinear in log(V/sigma^2) and log(g).

    snr: V/sigma^2 of a pixel, >= 0; spread: g in pixels; of one shape, which the answer has.
    """
    snr, spread = np.broadcast_arrays(np.asarray(snr, np.float64), np.asarray(spread, np.float64))
    at = (np.log(np.clip(snr, _SNR[0], _SNR[-1])), np.log(np.clip(spread, _SPREADS[0], _SPREADS[-1])))
    return np.asarray(_table(side, ndisp)(np.stack(at, axis=-1)), np.float64)


@lru_cache(maxsize=16)
def _table(side: int, ndisp: int) -> RegularGridInterpolator:
    shares = np.stack([mismatch(_SNR, float(spread), side, ndisp) for spread in _SPREADS], axis=1)
    return RegularGridInterpolator((np.log(_SNR), np.log(_SPREADS)), shares)


def mismatch(snr: Float, spread: float, side: int, ndisp: int) -> Float:
    """The theory of the module's first lines. snr: V/sigma^2, (K,); spread: g in pixels. Returns (K,) of 0 to 1.

    >>> mismatch(np.array([0.0, 100.0]), 1.2, 9, 32).round(1)
    array([0.9, 0. ])
    """
    shifts = np.arange(ndisp) - ndisp // 2
    sums = drawn_sums(spread, side, ndisp)
    totals = (ratio * sums.texture + np.sqrt(ratio) * sums.both + sums.noise for ratio in snr)
    return np.array([float((np.abs(_least(total, shifts)) > RIGHT_PX).mean()) for total in totals])


def drawn_sums(spread: float, side: int, ndisp: int) -> Sums:
    """The parts of the sums of squared differences at the shifts -(ndisp // 2) to ndisp - ndisp // 2 - 1."""
    width = side + ndisp - 1
    textures = _root(side, spread) @ _standard(0, side, width) @ _root(width, spread)
    left, noise, other_noise = (
        textures[:, :, ndisp // 2 :][:, :, :side],
        _standard(1, side, side),
        _standard(2, side, width),
    )
    parts = np.empty((3, _DRAWS, ndisp))
    for k in range(ndisp):
        texture, both = left - textures[:, :, k : k + side], noise - other_noise[:, :, k : k + side]
        parts[:, :, k] = _inner(texture, texture), 2.0 * _inner(texture, both), _inner(both, both)
    return Sums(*parts)


def _inner(one: Float, other: Float) -> Float:
    """Of each draw's window, (4000,)."""
    return np.asarray(np.einsum("nyx,nyx->n", one, other))


def _root(length: int, spread: float) -> Float:
    """What makes a texture's row of independent numbers: the symmetric root of its covariance, (length, length)."""
    values, vectors = np.linalg.eigh(_rho(np.arange(length)[:, None] - np.arange(length), spread))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


@lru_cache(maxsize=3)
def _standard(seed: int, rows: int, columns: int) -> Float:
    """Independent normal numbers, (4000, rows, columns)."""
    return np.random.default_rng(seed).standard_normal((_DRAWS, rows, columns))


def _rho(x: ArrayLike, spread: float) -> Float:
    """The texture's autocorrelation along one axis, at a distance of x pixels."""
    return np.asarray(np.exp(-np.square(x) / (4.0 * spread**2)))


def _least(sums: Float, shifts: NDArray[np.int64]) -> Float:
    """The shift of each row's least sum, by a parabola through it and its neighbours; at the ends as it is."""
    if len(shifts) < 3:
        return np.asarray(shifts[sums.argmin(axis=1)], np.float64)
    best = sums.argmin(axis=1)
    inner = np.clip(best, 1, len(shifts) - 2)
    below, least, above = (np.take_along_axis(sums, (inner + k)[:, None], axis=1)[:, 0] for k in (-1, 0, 1))
    bend = below - 2.0 * least + above
    beside = np.where(best == inner, 0.5 * (below - above) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.asarray(shifts[best] + beside)
