"""Lamps: the diameter of a disk from second moments, and the law of blur and disparity on rendered images."""

import numpy as np
import pytest

from twinlens.camera import Camera, Rig, ThinLens
from twinlens.studies.focus import blur_and_disparity, disk_diameter


def painted(diameter, centre, size=60, sub=16):
    """A uniform disk on pixels, each the mean of sub x sub points."""
    steps = (np.arange(size * sub) + 0.5) / sub - 0.5
    inside = (
        np.hypot(steps[:, None] - centre[1], steps[None, :] - centre[0])
        < 0.5 * diameter
    )
    return inside.reshape(size, sub, size, sub).mean(axis=(1, 3))


@pytest.mark.parametrize("diameter", [7.5, 12.0, 20.0])
@pytest.mark.parametrize("centre", [(30.0, 30.0), (28.3, 31.7)])
def test_the_diameter_of_a_painted_disk(diameter, centre):
    assert disk_diameter(painted(diameter, centre), sharp_px=0.0) == pytest.approx(
        diameter, rel=0.004
    )


def test_the_lamps_own_image_is_subtracted():
    """Convolved disks add their variances."""
    wide, small = painted(15.0, (30, 30)), painted(3.0, (30, 30))
    both = np.fft.ifft2(
        np.fft.fft2(wide) * np.fft.fft2(np.roll(small, (-30, -30), (0, 1)))
    ).real
    # Both images contain the pixel variance; the formula subtracts it once.
    assert disk_diameter(np.clip(both, 0, None), sharp_px=3.0) == pytest.approx(
        15.0, rel=0.01
    )


def test_blur_is_proportional_to_the_disparity_from_the_focus():
    """c = (A/B) |d - d_focus|, here with A/B = 0.8."""
    camera = Camera(72, 56, 220.0, 220.0, 35.5, 27.5)
    rig = Rig.stereo(camera, 0.1, np.eye(4))
    lens = ThinLens(0.08, 2.0)
    for depth in (1.0, 4.0):
        blur, disparity = blur_and_disparity(rig, lens, depth, 512, 1)
        # About 4000 rays hit the lamp: the centroid of a disk 9 px wide has a standard error of 2.2 px / sqrt(4000).
        assert disparity == pytest.approx(220.0 * 0.1 / depth, abs=0.15)
        assert blur == pytest.approx(
            0.8 * abs(220.0 * 0.1 / depth - 220.0 * 0.1 / 2.0), rel=0.04
        )
