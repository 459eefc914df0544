"""The probability that noise moves a block match far from the truth: the threshold effect of shift estimation.

A window of n = side^2 pixels has a texture t of variance V and autocorrelation rho(x) = exp(-x^2 / (4 g^2)) along each
axis, and white Gaussian noise a, b of variance sigma^2 in the two images. It is matched by its sum of squared
differences. At the shift h from the truth, which is in the middle of the range,

    S_h = sum over the window of (t(x) - t(x + h) + a(x) - b(x + h))^2 = E_h + T_h + N_h

    texture     E_h = sum (t(x) - t(x + h))^2,                       mean 2 n V (1 - rho(h))
    both        T_h = 2 sum (t(x) - t(x + h)) (a(x) - b(x + h)),     variance 8 sigma^2 E_h
    noise       N_h = sum (a(x) - b(x + h))^2,                       far differences of variance 12 n sigma^4

A match is wrong if the least sum, refined by a parabola, is more than 2 px from the truth. Without texture the
probability is about 1 - 4/ndisp. There is no closed form: E_h of a window with few grains is far from Gaussian, and so
are the tails of N_h. Textures and noise are therefore sampled: 4000 Gaussian windows with fixed seeds.

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
"""Largest error in pixels of a correct match."""
_SNR = np.geomspace(1e-3, 1e4, 29)
_SPREADS = np.geomspace(0.5, 12.0, 12)
_DRAWS = 4000


class Sums(NamedTuple):
    """E, T and N of sampled windows at each shift, (4000, ndisp), for V = sigma = 1."""

    texture: Float
    both: Float
    noise: Float


def mismatch_share(snr: ArrayLike, spread: ArrayLike, side: int, ndisp: int) -> Float:
    """The probability of a mismatch, interpolated in tables of `mismatch` over log(V/sigma^2) and log(g).

    snr: V/sigma^2 of a pixel, >= 0; spread: g in pixels; broadcast against each other.
    """
    snr, spread = np.broadcast_arrays(np.asarray(snr, np.float64), np.asarray(spread, np.float64))
    at = (np.log(np.clip(snr, _SNR[0], _SNR[-1])), np.log(np.clip(spread, _SPREADS[0], _SPREADS[-1])))
    return np.asarray(_table(side, ndisp)(np.stack(at, axis=-1)), np.float64)


@lru_cache(maxsize=16)
def _table(side: int, ndisp: int) -> RegularGridInterpolator:
    shares = np.stack([mismatch(_SNR, float(spread), side, ndisp) for spread in _SPREADS], axis=1)
    return RegularGridInterpolator((np.log(_SNR), np.log(_SPREADS)), shares)


def mismatch(snr: Float, spread: float, side: int, ndisp: int) -> Float:
    """The probability of a mismatch (K,). snr: V/sigma^2, (K,); spread: g in pixels.

    >>> mismatch(np.array([0.0, 100.0]), 1.2, 9, 32).round(1)
    array([0.9, 0. ])
    """
    shifts = np.arange(ndisp) - ndisp // 2
    sums = drawn_sums(spread, side, ndisp)
    totals = (ratio * sums.texture + np.sqrt(ratio) * sums.both + sums.noise for ratio in snr)
    return np.array([float((np.abs(_least(total, shifts)) > RIGHT_PX).mean()) for total in totals])


def drawn_sums(spread: float, side: int, ndisp: int) -> Sums:
    """Sampled sums of squared differences at the shifts -(ndisp // 2) to ndisp - ndisp // 2 - 1."""
    width = side + ndisp - 1
    textures = _root(side, spread) @ _standard(0, side, width) @ _root(width, spread)
    left = textures[:, :, ndisp // 2 :][:, :, :side]
    noise, other_noise = _standard(1, side, side), _standard(2, side, width)
    parts = np.empty((3, _DRAWS, ndisp))
    for k in range(ndisp):
        texture, both = left - textures[:, :, k : k + side], noise - other_noise[:, :, k : k + side]
        parts[:, :, k] = _inner(texture, texture), 2.0 * _inner(texture, both), _inner(both, both)
    return Sums(*parts)


def _inner(one: Float, other: Float) -> Float:
    """Inner products of windows, (4000,)."""
    return np.asarray(np.einsum("nyx,nyx->n", one, other))


def _root(length: int, spread: float) -> Float:
    """The symmetric square root of the covariance of a row of texture, (length, length)."""
    distance = np.arange(length)[:, None] - np.arange(length)
    values, vectors = np.linalg.eigh(np.exp(-np.square(distance) / (4.0 * spread**2)))
    return np.asarray((vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T)


@lru_cache(maxsize=3)
def _standard(seed: int, rows: int, columns: int) -> Float:
    """Independent standard normal numbers, (4000, rows, columns)."""
    return np.random.default_rng(seed).standard_normal((_DRAWS, rows, columns))


def _least(sums: Float, shifts: NDArray[np.int64]) -> Float:
    """The shift of each row's least sum, refined by a parabola except at the ends."""
    best = sums.argmin(axis=1)
    if len(shifts) < 3:
        return np.asarray(shifts[best], np.float64)
    inner = np.clip(best, 1, len(shifts) - 2)
    below, least, above = (np.take_along_axis(sums, (inner + k)[:, None], axis=1)[:, 0] for k in (-1, 0, 1))
    bend = below - 2.0 * least + above
    offset = np.where(best == inner, 0.5 * (below - above) / np.where(bend > 0, bend, 1.0), 0.0)
    return np.asarray(shifts[best] + offset)
