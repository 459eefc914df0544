"""Statistics of pairs, beside naive code pixel by pixel, scikit-image, and images of known statistics."""

import json
import math

import numpy as np
import pytest
from scipy import interpolate, signal, stats
from skimage.restoration import estimate_sigma
from skimage.util import view_as_blocks

from twinlens.cli import run
from twinlens.errors import InputError
from twinlens.report.plots import pair_figure
from twinlens.scoring import STATISTICS, Pair, motorcycle, pair_statistics, summarize
from twinlens.scoring.regions import textureless
from twinlens.scoring.scene_statistics import geometry_statistics, image_statistics


def crop(rows, columns):
    real = motorcycle()
    box = np.s_[rows : rows + 48, columns : columns + 150]
    arrays = real.im0, real.im1, real.disp0, real.mask0_nonocc
    # Disparities are at most 60 px, so the matches of these columns are inside the crop's right image or masked.
    return Pair("crop", *(array[box] for array in arrays), 70)


def plain_pair(image, disparity=0.0):
    """A pair of equal images, with one disparity everywhere."""
    truth = np.full(image.shape, disparity, np.float32)
    return Pair("plain", image, image, truth, None, 8)


def windows_of(array, side):
    """(rows, columns, side^2): the pixels of all windows inside the array."""
    windows = np.lib.stride_tricks.sliding_window_view(array, (side, side))
    return windows.reshape(*windows.shape[:2], -1)


def naive_warp(pair, right):
    """The right image at u - d, and the pixels to compare, pixel by pixel."""
    height, width = right.shape
    truth = np.where(np.isfinite(pair.disp0), pair.disp0, np.nan)
    warped, used = np.full(right.shape, np.nan), pair.mask0_nonocc == 255
    # SciPy's FITPACK spline through all pixels has other ends than ndimage's: the two differ near the border.
    spline = interpolate.RectBivariateSpline(
        np.arange(height), np.arange(width), right, kx=3, ky=3
    )
    for v, u in np.ndindex(height, width):
        if 0 <= u - truth[v, u] <= width - 1:
            warped[v, u] = spline(v, u - truth[v, u])[0, 0]
    used &= np.isfinite(warped)
    for v, u in np.ndindex(height, width):
        for b, a in ((v + 1, u), (v, u + 1)):
            if b == height or a == width:
                continue
            if abs(truth[v, u] - truth[b, a]) > 1:
                used[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4] = False
                used[max(b - 3, 0) : b + 4, max(a - 3, 0) : a + 4] = False
    return warped, used


def naive(pair):
    """Each statistic by its definition or with another library; without the noise from wavelets."""
    left, right = (image @ [0.299, 0.587, 0.114] for image in (pair.im0, pair.im1))
    finite = np.isfinite(pair.disp0)
    warped, used = naive_warp(pair, right)
    difference = np.where(used, left - warped, np.nan)
    around = windows_of(np.pad(difference, 10, constant_values=np.nan), 21)
    low = np.nanmean(around[used], axis=-1)
    gain, offset = huber_line(warped[used], left[used])
    rest = left[used] - gain * warped[used] - offset - (low - np.median(low))
    whole = windows_of(used, 9).all(axis=-1)
    both = zip(windows_of(left, 9)[whole], windows_of(warped, 9)[whole], strict=True)
    contrast = windows_of(left, 9).std(axis=-1)
    # Continued along its slope, the image has one-sided differences at its edges.
    padded = np.pad(left, 1, mode="reflect", reflect_type="odd")
    across = (padded[1:-1, 2:] - padded[1:-1, :-2]) / 2
    down = (padded[2:, 1:-1] - padded[:-2, 1:-1]) / 2
    steps = left[:, 1:] - left[:, :-1]
    moments = [np.mean((steps - steps.mean()) ** power) for power in (2, 4)]
    return {
        "gain": abs(gain - 1),
        "offset": offset,
        "residual": 1.482602218505602 * np.median(abs(rest - np.median(rest))),
        "flat_noise": flattest_blocks(left),
        "textureless": textureless(np.rint(left).astype(np.uint8)).mean(),
        "spectrum_low": slope_of_power(left, 0.02, 0.15),
        "spectrum_high": slope_of_power(left, 0.2, 0.45),
        "low_sd": np.std(low),
        "bias": abs(np.nanmedian(difference)),
        "contrast": np.median(contrast),
        "flat": np.mean(contrast < 3),
        "kurtosis": moments[1] / moments[0] ** 2,
        "correlation": np.median([np.corrcoef(a, b)[0, 1] for a, b in both]),
        "gradient": np.median(np.hypot(across, down)),
        "occluded": (pair.mask0_nonocc == 128).sum() / finite.sum(),
        "largest_disparity": pair.disp0[finite].max() / left.shape[1],
        "width": left.shape[1],
    }


def huber_line(x, y):
    """Gain and offset of least Huber loss, by weighted least squares; the scale is that of the residuals of y = x."""
    delta = 1.345 * 1.482602218505602 * np.median(abs(y - x - np.median(y - x)))
    columns = np.stack([x, np.ones_like(x)], axis=1)
    line = np.array([1.0, 0.0])
    for _ in range(500):
        sizes = np.maximum(abs(y - columns @ line), 1e-12)
        weights = np.sqrt(np.minimum(1, delta / sizes))
        weighted = columns * weights[:, None]
        line = np.linalg.lstsq(weighted, y * weights, rcond=None)[0]
    return line


def flattest_blocks(image):
    """Immerkaer's noise of the flattest fifth of the 8x8 blocks."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    responses = signal.convolve2d(np.pad(image, 1, mode="reflect"), mask, mode="valid")
    height, width = (size // 8 * 8 for size in image.shape)
    variances, means = (
        function(view_as_blocks(array[:height, :width], (8, 8)), axis=(2, 3)).ravel()
        for function, array in ((np.var, image), (np.mean, abs(responses)))
    )
    flattest = variances.argsort()[: len(variances) // 5]
    return math.sqrt(math.pi / 2) / 6 * means[flattest].mean()


def slope_of_power(image, low, high):
    """Slope of the logarithm of the mean power in rings as wide as the lowest frequency of the shorter side."""
    hann = [signal.windows.hann(size) for size in image.shape]
    power = abs(np.fft.fft2((image - image.mean()) * np.outer(*hann))) ** 2
    shorter = min(image.shape)
    v, u = np.indices(image.shape)
    rows, columns = image.shape
    v, u = np.minimum(v, rows - v) / rows, np.minimum(u, columns - u) / columns
    ring = np.round(np.hypot(v, u) * shorter)
    points = [
        (math.log(k / shorter), math.log(power[ring == k].mean()))
        for k in range(1, shorter)
        if low <= k / shorter <= high
    ]
    return stats.linregress(*np.transpose(points)).slope


@pytest.mark.parametrize("corner", [(0, 200), (330, 550)])
def test_statistics_equal_naive_code(corner):
    pair = crop(*corner)
    statistics, expected = pair_statistics(pair), naive(pair)
    for name, value in expected.items():
        # The splines' ends reach a few pixels into the image.
        rough = name in ("low_sd", "bias", "gain", "offset", "residual", "correlation")
        rel, most = (0.02, 0.02) if rough else (1e-6, 1e-9)
        assert statistics[name] == pytest.approx(value, rel=rel, abs=most), name
    # test_scene_statistics.py has those of the scene.
    of_scene = geometry_statistics(pair.disp0) | image_statistics(pair.im0[..., 0])
    assert {*expected, "noise", *of_scene} == {*statistics}


def test_wavelet_noise_equals_scikit_images():
    pytest.importorskip("pywt")
    rng = np.random.default_rng(0)
    for shape in ((40, 51), (33, 64)):
        levels = rng.integers(0, 256, shape).astype(np.uint8)
        expected = float(estimate_sigma(levels / 1.0))
        noise = pair_statistics(plain_pair(levels))["noise"]
        assert noise == pytest.approx(expected, rel=1e-12)


def test_the_slope_of_a_power_law():
    """Noise with amplitude f^-1.3 has power f^-2.6."""
    size = 256
    frequency = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size))
    frequency[0, 0] = 1.0
    white = np.random.default_rng(5).normal(size=(size, size))
    image = np.fft.ifft2(np.fft.fft2(white) * frequency**-1.3).real
    levels = np.rint(30000 + 20000 * image / np.abs(image).max()).astype(np.uint16)
    statistics = pair_statistics(plain_pair(levels))
    for name in ("spectrum_low", "spectrum_high"):
        assert statistics[name] == pytest.approx(-2.6, abs=0.15), name


def test_a_pair_without_truth_or_texture_has_no_differences():
    statistics = pair_statistics(plain_pair(np.full((40, 40), 100, np.uint8), np.inf))
    for name in ("low_sd", "gain", "correlation", "occluded", "kurtosis"):
        assert math.isnan(statistics[name]), name
    assert (statistics["textureless"], statistics["flat"]) == (1.0, 1.0)
    assert statistics["noise"] == pytest.approx(0.0, abs=1e-9)


def test_a_small_image_is_refused():
    with pytest.raises(InputError, match="statistics need 32 x 32"):
        pair_statistics(plain_pair(np.zeros((31, 40), np.uint8)))


def test_the_summary_skips_missing_values():
    rows = [{"noise": v, "bias": math.nan} for v in (1.0, 2.0, 3.0, math.nan)]
    assert summarize(rows)["noise"] == (2.0, pytest.approx(1.2), pytest.approx(2.8))
    assert math.isnan(summarize(rows)["bias"][0])
    assert summarize([]) == {}


def test_the_command_prints_a_table_json_and_a_figure(tmp_path, capsys, monkeypatch):
    part = crop(0, 200)
    monkeypatch.setattr("twinlens.cli.statistics.open_pairs", lambda _names: [part])
    statistics = pair_statistics(part)
    figure = tmp_path / "s.svg"
    assert run(["statistics", "motorcycle", "-o", str(figure)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == list(STATISTICS)
    assert figure.read_bytes() == pair_figure([statistics], "svg")
    assert run(["statistics", "motorcycle", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["pairs"]["crop"] == statistics
    assert document["real"]["noise"] == [0.95, 0.5, 2.0]
