"""The chance that noise takes a block match far from the truth: the threshold effect of a shift's estimation.

A window of n = side^2 pixels, whose texture has variance V and autocorrelation rho(x) = exp(-x^2 / (4 g^2)), is matched
by its sum of squared differences; either eye adds white Gaussian noise of variance sigma^2. Over the shifts h from the
truth these sums, less the squares of the left eye's noise that all share, are Gaussian by the central limit, with

    mean          D_h^2 = 2 n V (1 - rho(h))
    covariance    4 n V sigma^2 (1 - rho(h) - rho(k) + rho(h - k)) (1 + w(h - k))        noise on texture
                + 4 n sigma^4 [h = k] + 2 n sigma^4 w(h - k),   w(x) = (1 - |x| / side)+      noise on noise

so that a single far rival wins with the chance Q(D^2 / sqrt(8 sigma^2 D^2 + 12 n sigma^4)): without noise on noise,
Q(sqrt(n V) / (2 sigma)). A match is wrong where the least of the sums, refined by a parabola, lies over 2 px from
the truth, which is in the middle of the range. Blur wide enough that texture is no more than a slope makes that what
the Cramer-Rao bound says of P(|error| > 2 px); without any texture it is mere chance, about 1 - 4/ndisp.

A window holds few grains, one alone where blur is wider than it is, and may find them faint: D_h^2, and the noise on
it, are those of its own texture, a sum of lambda_i z_i^2 over its mean, z normal and lambda the eigenvalues of the
covariance of the differences t(x) - t(x + h) in the window: of those along x times those along y. This is fading, whose
tail falls as a power of the light. A quarter of its variance is of the left window's texture and so all shifts', the
rest is alike as rho(h - k)^2.

The chance has no closed form: the Gaussians are drawn, 2000 times, always the same.

Sources: Ziv and Zakai, Some lower bounds on signal parameter estimation, IEEE Trans. Information Theory 15(3), 1969;
Ianniello, Time delay estimation via cross-correlation in the presence of large estimation errors, IEEE Trans. ASSP
30(6), 1982; Weinstein and Weiss, Fundamental limitations in passive time delay estimation II, IEEE Trans. ASSP 32(5),
1984.
"""

from collections.abc import Iterator
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import RegularGridInterpolator
from scipy.special import ndtr

Float = NDArray[np.float64]

RIGHT_PX = 2
"""An error up to this many pixels is none."""
_SNR = np.geomspace(1e-3, 1e4, 29)
_SPREADS = np.geomspace(0.5, 12.0, 12)
_DRAWS = 2000
_JITTER = 1e-9


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
    errors = (np.abs(_least(sums, shifts)) for sums in _drawn(snr, spread, side, shifts))
    return np.array([float((error > RIGHT_PX).mean()) for error in errors])


def _drawn(snr: Float, spread: float, side: int, shifts: NDArray[np.int64]) -> Iterator[Float]:
    """Sums of squared differences in units of sigma^2, (2000, ndisp), for each snr."""
    pixels = side**2
    apart = shifts[:, None] - shifts
    common = np.maximum(1.0 - np.abs(apart) / side, 0.0)
    alike, near = _rho(apart, spread), _rho(shifts, spread)
    texture = 4.0 * pixels * (1.0 - near[:, None] - near + alike) * (1.0 + common)
    own = _normal(0, 4.0 * pixels * np.eye(len(shifts)) + 2.0 * pixels * common)
    on_texture = _normal(1, texture)
    light = _fading(_normal(2, 0.25 + 0.75 * alike**2), spread, side, shifts)
    mean = 2.0 * pixels * light * (1.0 - near)
    on_texture *= np.sqrt(light)
    for ratio in snr:
        yield ratio * mean + np.sqrt(ratio) * on_texture + own


def _normal(seed: int, covariance: Float) -> Float:
    """Draws of this covariance, (2000, ndisp)."""
    steady = covariance + _JITTER * covariance.max() * np.eye(len(covariance))
    return np.asarray(_standard(seed, len(covariance)) @ np.linalg.cholesky(steady).T)


@lru_cache(maxsize=4)
def _standard(seed: int, columns: int) -> Float:
    """Independent normal numbers, (2000, columns)."""
    return np.random.default_rng(seed).standard_normal((_DRAWS, columns))


def _fading(normal: Float, spread: float, side: int, shifts: NDArray[np.int64]) -> Float:
    """D_h^2 over its mean, of the same rank as these normal variables, (2000, ndisp)."""
    squares = _standard(3, side * side) ** 2
    lags = np.arange(side)[:, None] - np.arange(side)
    down = np.linalg.eigvalsh(_rho(lags, spread))
    rank = np.linspace(0.0, 1.0, _DRAWS)
    light = np.ones(normal.shape)
    for distance in np.unique(np.abs(shifts[shifts != 0])):
        differences = 2.0 * _rho(lags, spread) - _rho(lags + distance, spread) - _rho(lags - distance, spread)
        scales = np.outer(np.linalg.eigvalsh(differences), down).ravel()
        drawn = np.sort(squares @ np.maximum(scales, 0.0))
        for k in np.flatnonzero(np.abs(shifts) == distance):
            light[:, k] = np.interp(ndtr(normal[:, k]), rank, drawn / drawn.mean())
    return light


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
