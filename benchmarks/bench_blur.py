"""The blur of `Mismatch.blur_px` as measured on a point, and the difference in blur of the two images of pairs.

    python benchmarks/bench_blur.py                               # stated and acting blur
    python benchmarks/bench_blur.py LEFT RIGHT [LEFT RIGHT ...]   # blur difference of rectified pairs, pixels

Rows of a rectified pair correspond, and disparity moves columns only: the spectra along the columns need no matching.
Where one image has the additional blur s, ln(P_left / P_right) = 4 pi^2 s^2 f^2 + constant. The fit takes 0.08 to 0.3
cycles per pixel, below the noise. Additional blurs of 0.1 to 0.5 px are found 3 to 8 % too large (window leakage).
"""

import argparse
import math

import cv2
import numpy as np

import twinlens as tl

SIGMAS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0, 1.5, 2.0)
FREQUENCY = 0.25  # cycles per pixel
WINDOW = 128  # pixels
BAND = (0.08, 0.3)  # cycles per pixel
BORDER = 0.1  # of the width, which may be of one view only


def acting_blur(sigma: float) -> tuple[float, float]:
    """The standard deviation of a blurred point, and the contrast that a grating keeps at `FREQUENCY`."""
    mismatch = tl.Mismatch(blur_px=sigma)
    point = np.zeros((65, 65, 3))
    point[32, 32] = 1.0
    profile = mismatch.light(point)[..., 1].sum(axis=0)
    distance = np.arange(65) - 32
    spread = math.sqrt(profile @ distance**2 / profile.sum())
    wave = np.cos(2 * np.pi * FREQUENCY * (np.arange(64) + 0.5))
    light = np.broadcast_to((1 + 0.5 * wave)[:, None], (64, 64, 3))
    kept = mismatch.light(light)[0, :, 1] - 1
    return spread, float(kept @ wave / (0.5 * wave @ wave))


def spectrum(grey: np.ndarray) -> np.ndarray:
    """The power spectrum along the columns, the mean of all columns and of overlapping windows."""
    height, width = grey.shape
    border = int(BORDER * width)
    taper = np.hanning(WINDOW)[:, None]
    powers = []
    for top in range(0, height - WINDOW + 1, WINDOW // 2):
        part = grey[top : top + WINDOW, border : width - border].astype(np.float64)
        amplitude = np.fft.rfft((part - part.mean(axis=0)) * taper, axis=0)
        powers.append((np.abs(amplitude) ** 2).mean(axis=1))
    return np.mean(powers, axis=0)


def blur_difference(left: np.ndarray, right: np.ndarray) -> float:
    """Blur of the right image beyond that of the left one, pixels; negative where the left one has more."""
    frequency = np.arange(WINDOW // 2 + 1) / WINDOW
    used = (frequency >= BAND[0]) & (frequency <= BAND[1])
    ratio = np.log(spectrum(left) / spectrum(right))[used]
    slope = np.polyfit(4 * np.pi**2 * frequency[used] ** 2, ratio, 1)[0]
    return math.copysign(math.sqrt(abs(slope)), slope)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("images", nargs="*", help="left and right images, in turn")
    images = parser.parse_args().images
    if not images:
        print(
            "| stated | acting | contrast | of a Gaussian |\n| --- | --- | --- | --- |"
        )
        for sigma in SIGMAS:
            spread, contrast = acting_blur(sigma)
            right = math.exp(-2 * (math.pi * sigma * FREQUENCY) ** 2)
            print(f"| {sigma} | {spread:.3f} | {contrast:.3f} | {right:.3f} |")
        return
    differences = []
    for left, right in zip(images[::2], images[1::2], strict=True):
        greys = [cv2.imread(path, cv2.IMREAD_GRAYSCALE) for path in (left, right)]
        differences.append(blur_difference(*greys))
        print(f"{left}: {differences[-1]:+.2f} px")
    sizes = np.abs(differences)
    rms = np.sqrt((sizes**2).mean())
    print(f"{len(sizes)} pairs: median {np.median(sizes):.2f} px, rms {rms:.2f} px")


if __name__ == "__main__":
    main()
