"""Textures, noise and block matching without the theory that they are compared with."""

import math

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.ndimage import gaussian_filter

from twinlens.sensor import Exposure
from twinlens.studies.aperture.theory import SENSOR, ScaleModel
from twinlens.studies.stage import Stage


def sheet(random, shape, grain):
    """A Gaussian texture of variance 1: white noise smoothed by a Gaussian of standard deviation `grain`."""
    smooth = gaussian_filter(random.normal(size=shape), grain, mode="wrap")
    return smooth * 2 * grain * math.sqrt(math.pi)


def window_costs(left, right, ndisp, side, step=1):
    """Sums of squared differences (ndisp, rows, columns) of windows, from column `ndisp` on: all partners exist."""
    width = left.shape[1]
    costs = []
    for shift in range(ndisp):
        squares = (left[:, ndisp:] - right[:, ndisp - shift : width - shift]) ** 2
        windows = sliding_window_view(squares, (side, side))[::step, ::step]
        costs.append(windows.sum(axis=(2, 3)))
    return np.stack(costs)


def refined_shifts(costs):
    """The shifts of least cost, refined by a parabola except at the ends of the range."""
    best = costs.argmin(axis=0)
    inner = np.clip(best, 1, len(costs) - 2)
    below, least, above = (
        np.take_along_axis(costs, (inner + step)[None], axis=0)[0]
        for step in (-1, 0, 1)
    )
    bend = below - 2 * least + above
    offset = 0.5 * (below - above) / np.where(bend > 0, bend, 1)
    return np.where(best == inner, best + offset, best)


def wall_of(colour):
    """A stage with the camera of the study, its lens at f/4, and the radiance of a wall."""
    stage = Stage.of("cards", 160, 120, pixel_pitch_um=3.45)
    wall = np.tile(np.array(colour, np.float32), (120, 160, 1))
    return stage.camera, ScaleModel(stage, 1.0).lens(4.0), wall


def measured_noise(values_of, camera, lens, wall, exposure):
    """The standard deviation of `values_of` photographs of a wall, in units of the exposure.

    Values are divided by their slope, between 0.9 and 1.1 times the exposure.
    """

    def values(factor):
        timed = Exposure(factor * exposure.time, exposure.gain)
        shots = [
            SENSOR.expose(wall, camera=camera, lens=lens, seed=seed, exposure=timed)
            for seed in range(4)
        ]
        return np.stack([values_of(shot.image) for shot in shots]).astype(np.float64)

    slope = (values(1.1).mean() - values(0.9).mean()) / 0.2
    return values(1.0).std() / slope
