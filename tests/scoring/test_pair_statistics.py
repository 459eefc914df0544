"""Statistics of pairs, beside naive code pixel by pixel, scikit-image, and images of known statistics."""

import json
import math

import numpy as np
import pytest
from scipy import interpolate, ndimage, stats
from skimage.restoration import estimate_sigma

from twinlens.cli import run
from twinlens.errors import InputError
from twinlens.report.plots import pair_figure
from twinlens.scoring import STATISTICS, Pair, motorcycle, pair_statistics, summarize

NAMES = tuple(STATISTICS)


def crop(rows, columns):
    real = motorcycle()
    box = np.s_[rows : rows + 48, columns : columns + 150]
    # Disparities are at most 60 px, so the matches of these columns are inside the crop's right image or masked.
    return Pair(
        "crop",
        real.im0[box],
        real.im1[box],
        real.disp0[box],
        real.mask0_nonocc[box],
        70,
    )


def plane_pair(gain=1.0, offset=0.0, noise=0.0, shade=0.0, seed=0, size=(80, 120)):
    """A smooth texture seen by two cameras at a disparity of 4 px; the left one has the gain, offset and shading."""
    rng = np.random.default_rng(seed)
    height, width = size
    texture = ndimage.gaussian_filter(rng.normal(size=(height, width + 4)), 2.0)
    texture = 120 + 40 * texture / np.abs(texture).max()
    wave = shade * np.sin(2 * np.pi * np.arange(width) / width)
    left = gain * texture[:, :width] + offset + wave + noise * rng.normal(size=size)
    right = texture[:, 4:] + noise * rng.normal(size=size)
    levels = [
        np.clip(np.rint(257 * image), 0, 65535).astype(np.uint16)
        for image in (left, right)
    ]
    truth = np.full(size, 4.0, np.float32)
    mask = np.where(np.arange(width) >= 4, 255, 128) * np.ones(size)
    return Pair("plane", *levels, truth, mask.astype(np.uint8), 16)


def naive(pair):
    """Each statistic in loops over pixels or with another library; without the noise from wavelets."""
    left, right = (
        0.299 * i[..., 0] + 0.587 * i[..., 1] + 0.114 * i[..., 2]
        for i in (pair.im0 / 1.0, pair.im1 / 1.0)
    )
    height, width = left.shape
    truth, mask = pair.disp0, pair.mask0_nonocc
    warped, used = np.full(left.shape, np.nan), np.zeros(left.shape, bool)
    # SciPy's FITPACK spline through all pixels has other ends than ndimage's: the two differ near the border.
    spline = interpolate.RectBivariateSpline(
        np.arange(height), np.arange(width), right, kx=3, ky=3
    )
    for v in range(height):
        for u in range(width):
            if np.isfinite(truth[v, u]) and 0 <= u - truth[v, u] <= width - 1:
                warped[v, u] = spline(v, u - truth[v, u])[0, 0]
                used[v, u] = mask[v, u] == 255
    jump = np.zeros(left.shape, bool)
    for v in range(height):
        for u in range(width):
            for b, a in ((v + 1, u), (v, u + 1)):
                known = (
                    b < height
                    and a < width
                    and np.isfinite([truth[v, u], truth[b, a]]).all()
                )
                if known and abs(truth[v, u] - truth[b, a]) > 1:
                    jump[v, u] = jump[b, a] = True
    for v, u in np.argwhere(jump):
        used[max(v - 3, 0) : v + 4, max(u - 3, 0) : u + 4] = False
    difference = left - warped
    low = []
    for v, u in np.argwhere(used):
        box = np.s_[max(v - 10, 0) : v + 11, max(u - 10, 0) : u + 11]
        low.append(difference[box][used[box]].mean())
    windows = [
        left[v : v + 9, u : u + 9] for v in range(height - 8) for u in range(width - 8)
    ]
    correlations = []
    for v in range(height - 8):
        for u in range(width - 8):
            box = np.s_[v : v + 9, u : u + 9]
            if used[box].all():
                correlations.append(
                    np.corrcoef(left[box].ravel(), warped[box].ravel())[0, 1]
                )
    gradients = []
    for v in range(height):
        for u in range(width):
            above, below, before, after = (
                max(v - 1, 0),
                min(v + 1, height - 1),
                max(u - 1, 0),
                min(u + 1, width - 1),
            )
            across = (left[v, after] - left[v, before]) / (after - before)
            gradients.append(
                math.hypot(across, (left[below, u] - left[above, u]) / (below - above))
            )
    known = np.isfinite(truth)
    steps = left[:, 1:] - left[:, :-1]
    gain, offset = huber_line(warped[used], left[used])
    rest = left[used] - gain * warped[used] - offset - (np.array(low) - np.median(low))
    loops = [
        textureless_pixel(np.rint(left), v, u)
        for v in range(height)
        for u in range(width)
    ]
    return {
        "gain": abs(gain - 1),
        "offset": offset,
        "residual": 1.482602218505602 * np.median(abs(rest - np.median(rest))),
        "flat_noise": flattest_blocks(left),
        "textureless": np.mean(loops),
        "spectrum_low": slope_of_power(left, 0.02, 0.15),
        "spectrum_high": slope_of_power(left, 0.2, 0.45),
        "low_sd": np.std(low),
        "bias": abs(np.median(difference[used])),
        "contrast": np.median([w.std() for w in windows]),
        "flat": np.mean([w.std() < 3 for w in windows]),
        "kurtosis": np.mean((steps - steps.mean()) ** 4)
        / np.mean((steps - steps.mean()) ** 2) ** 2,
        "correlation": np.median(correlations),
        "gradient": np.median(gradients),
        "occluded": (mask == 128).sum() / known.sum(),
        "largest_disparity": truth[known].max() / width,
        "width": width,
    }


def huber_line(x, y):
    """Gain and offset of least Huber loss, by weighted least squares; the scale is that of the residuals of y = x."""
    delta = 1.345 * 1.482602218505602 * np.median(abs(y - x - np.median(y - x)))
    line = np.array([1.0, 0.0])
    for _ in range(500):
        weights = np.sqrt(
            np.minimum(1, delta / np.maximum(abs(y - line[0] * x - line[1]), 1e-12))
        )
        line = np.linalg.lstsq(
            np.stack([x, np.ones_like(x)], 1) * weights[:, None],
            y * weights,
            rcond=None,
        )[0]
    return line


def textureless_pixel(image, v, u):
    """Whether the 3x3 mean of the squared difference from the left or right neighbour, the larger, is below 16."""
    height, width = image.shape
    total = 0
    for y in (v - 1, v, v + 1):
        for x in (u - 1, u, u + 1):
            row, column = min(max(y, 0), height - 1), min(max(x, 0), width - 1)
            beside = [image[row, c] for c in (column - 1, column + 1) if 0 <= c < width]
            total += max((image[row, column] - other) ** 2 for other in beside)
    return total < 16 * 9


def flattest_blocks(image):
    """Immerkaer's noise of the flattest fifth of the 8x8 blocks."""
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]])
    padded = np.pad(image, 1, mode="reflect")
    height, width = image.shape
    blocks = []
    for v in range(0, height - 7, 8):
        for u in range(0, width - 7, 8):
            responses = [
                abs((padded[y : y + 3, x : x + 3] * mask).sum())
                for y in range(v, v + 8)
                for x in range(u, u + 8)
            ]
            blocks.append((image[v : v + 8, u : u + 8].var(), np.mean(responses)))
    blocks.sort()
    return (
        math.sqrt(math.pi / 2)
        / 6
        * np.mean([response for _, response in blocks[: len(blocks) // 5]])
    )


def slope_of_power(image, low, high):
    """Slope of the logarithm of the mean power in rings as wide as the lowest frequency of the shorter side."""
    height, width = image.shape
    hann = [
        0.5 - 0.5 * np.cos(2 * math.pi * np.arange(n) / (n - 1))
        for n in (height, width)
    ]
    power = abs(np.fft.fft2((image - image.mean()) * hann[0][:, None] * hann[1])) ** 2
    rings = {}
    for i in range(height):
        for j in range(width):
            f = math.hypot(
                (i if i < height / 2 else i - height) / height,
                (j if j < width / 2 else j - width) / width,
            )
            rings.setdefault(round(f * min(height, width)), []).append(power[i, j])
    points = [
        (math.log(k / min(height, width)), math.log(np.mean(values)))
        for k, values in rings.items()
        if low <= k / min(height, width) <= high
    ]
    return stats.linregress(*zip(*points, strict=True)).slope


@pytest.mark.parametrize("corner", [(0, 200), (200, 350), (330, 550)])
def test_statistics_equal_naive_code(corner):
    pair = crop(*corner)
    found, expected = pair_statistics(pair), naive(pair)
    for name, value in expected.items():
        # The splines' ends reach a few pixels into the image.
        rough = name in ("low_sd", "bias", "gain", "offset", "residual", "correlation")
        assert found[name] == pytest.approx(
            value, rel=0.02 if rough else 1e-6, abs=0.02 if rough else 1e-9
        ), name
    assert {*expected, "noise"} == {*found}


def test_wavelet_noise_equals_scikit_images():
    pytest.importorskip("pywt")
    rng = np.random.default_rng(0)
    for shape in ((40, 51), (33, 64)):
        levels = rng.integers(0, 256, shape).astype(np.uint8)
        pair = Pair("noise", levels, levels, np.zeros(shape, np.float32), None, 8)
        assert pair_statistics(pair)["noise"] == pytest.approx(
            float(estimate_sigma(levels / 1.0)), rel=1e-12
        )


def test_gain_and_offset_are_found():
    found = pair_statistics(plane_pair(gain=1.05, offset=3.0))
    assert found["gain"] == pytest.approx(0.05, abs=2e-4)
    assert found["offset"] == pytest.approx(3.0, abs=0.03)
    assert found["correlation"] > 0.9999


def test_shading_is_low_sd():
    """A sine of amplitude a has s.d. a / sqrt(2); the 21 px mean over 120 px keeps sinc(21/120) = 0.951 of it."""
    found = pair_statistics(plane_pair(shade=4.0))
    assert found["low_sd"] == pytest.approx(
        4 / math.sqrt(2) * np.sinc(21 / 120), rel=0.05
    )


def test_white_noise_is_measured_three_ways():
    found = pair_statistics(plane_pair(noise=1.5, size=(256, 256)))
    assert found["noise"] == pytest.approx(1.5, rel=0.05)
    assert found["residual"] == pytest.approx(1.5 * math.sqrt(2), rel=0.05)
    # Choosing the flattest blocks favours weak noise: Immerkaer's figure is a little low.
    assert 1.2 < found["flat_noise"] < 1.55


def test_the_slope_of_a_power_law():
    """Noise with amplitude f^-1.3 has power f^-2.6."""
    rng = np.random.default_rng(5)
    size = 256
    f = np.hypot(np.fft.fftfreq(size)[:, None], np.fft.fftfreq(size)[None])
    f[0, 0] = 1.0
    image = np.fft.ifft2(np.fft.fft2(rng.normal(size=(size, size))) * f**-1.3).real
    levels = np.rint(30000 + 20000 * image / np.abs(image).max()).astype(np.uint16)
    found = pair_statistics(
        Pair("power", levels, levels, np.zeros((size, size), np.float32), None, 8)
    )
    assert found["spectrum_low"] == pytest.approx(-2.6, abs=0.15)
    assert found["spectrum_high"] == pytest.approx(-2.6, abs=0.15)


def test_a_pair_without_truth_or_texture_has_no_differences():
    grey = np.full((40, 40), 100, np.uint8)
    found = pair_statistics(
        Pair("empty", grey, grey, np.full((40, 40), np.inf, np.float32), None, 8)
    )
    assert all(
        math.isnan(found[name])
        for name in ("low_sd", "gain", "correlation", "occluded", "kurtosis")
    )
    assert (found["textureless"], found["flat"]) == (1.0, 1.0)
    assert found["noise"] == pytest.approx(0.0, abs=1e-9)


def test_a_small_image_is_refused():
    small = np.zeros((20, 40), np.uint8)
    with pytest.raises(InputError, match="statistics need 32 x 32"):
        pair_statistics(
            Pair("small", small, small, np.zeros((20, 40), np.float32), None, 8)
        )


def test_the_summary_skips_missing_values():
    rows = [{"noise": v, "bias": math.nan} for v in (1.0, 2.0, 3.0, math.nan)]
    assert summarize(rows)["noise"] == (2.0, pytest.approx(1.2), pytest.approx(2.8))
    assert math.isnan(summarize(rows)["bias"][0])
    assert summarize([]) == {}


def test_the_command_prints_a_table_json_and_a_figure(tmp_path, capsys):
    assert run(["statistics", "motorcycle", "-o", str(tmp_path / "s.png")]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:-1]] == list(NAMES)
    assert (tmp_path / "s.png").read_bytes().startswith(b"\x89PNG")
    assert run(["statistics", "motorcycle", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["pairs"]["motorcycle"]["width"] == 741
    assert document["real"]["noise"] == [0.95, 0.5, 2.0]
    assert run(["statistics", "motorcycle", "-o", "s.jpg"]) == 2


def test_the_same_pairs_give_the_same_figure():
    rows = [pair_statistics(plane_pair(seed=k)) for k in range(2)]
    assert pair_figure(rows, "svg") == pair_figure(rows, "svg")
