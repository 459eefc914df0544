"""Radiometric differences: gain, gamma and vignetting of the right image, noise of both; local costs."""

from dataclasses import replace

import numpy as np
import pytest

from twinlens.studies.radiometric import (
    CHANGES,
    SENSOR,
    changed_pair,
    image_pair,
    is_local,
)
from twinlens.studies.stage import Stage

GREY = np.full((61, 81, 3), 100, np.uint8)


def changed(name, amount, seed=0):
    return changed_pair((GREY, GREY), CHANGES[name], amount, seed)


@pytest.mark.parametrize("name", CHANGES)
def test_the_neutral_amount_changes_nothing(name):
    left, right = changed(name, CHANGES[name].neutral)
    assert np.array_equal(left, GREY)
    assert np.array_equal(right, GREY)


@pytest.mark.parametrize("name", ["gain", "gamma", "vignetting"])
def test_the_left_image_is_unchanged(name):
    left, right = changed(name, CHANGES[name].amounts[0])
    assert np.array_equal(left, GREY)
    assert not np.array_equal(right, GREY)


def test_local_costs_are_recognised():
    others = ("sgm", "sgm4", "sad:optimisation=sgm8", "adaptive")
    program = "program:command='prog {left} {right} {out}'"
    assert all(map(is_local, ("sad", "zncc:block_size=21")))
    assert not any(map(is_local, (*others, program)))


def test_gain_multiplies_and_saturates():
    assert (changed("gain", 1.4)[1] == 140).all()
    assert (changed("gain", 4.0)[1] == 255).all()


def test_gamma_keeps_black_and_white_and_has_an_inverse():
    ramp = np.repeat(np.arange(256, dtype=np.uint8)[None, :, None], 3, axis=2)
    dark = changed_pair((ramp, ramp), CHANGES["gamma"], 2.0, 0)[1]
    assert dark[0, 0, 0] == 0
    assert dark[0, 255, 0] == 255
    assert dark[0, 128, 0] == 64
    back = changed_pair((dark, dark), CHANGES["gamma"], 0.5, 0)[1]
    assert np.abs(back[0, 40:].astype(int) - ramp[0, 40:]).max() <= 2


def test_vignetting_keeps_the_centre_and_scales_the_corners():
    right = changed("vignetting", 0.3)[1]
    assert right[30, 40, 0] == 100
    assert {int(right[y, x, 0]) for y in (0, -1) for x in (0, -1)} == {30}
    assert right[30, 0, 0] == 65  # half of the squared distance to a corner


def test_noise_is_independent_in_both_images():
    left, right = (picture.astype(float) - 100 for picture in changed("noise", 8.0))
    for noise in (left, right):
        # Relative standard error 1/sqrt(2 n); rounding adds a variance of 1/12.
        assert noise.std() == pytest.approx(
            np.hypot(8.0, 12**-0.5), rel=4 / np.sqrt(2 * noise.size)
        )
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 4 / np.sqrt(left.size)
    assert np.array_equal(changed("noise", 8.0)[1], changed("noise", 8.0)[1])
    assert not np.array_equal(
        changed("noise", 8.0)[1], changed("noise", 8.0, seed=1)[1]
    )


@pytest.mark.slow
def test_rendering_noise_falls_with_the_samples():
    """16 times the samples: at most a quarter of the noise of raw images, as paths are independent or better.

    Denoised images have no such law. Theirs is less than that of raw images, and falls. The sensor adds none.
    """
    assert not SENSOR.shot_noise
    denoised = Stage.of("cards", 64, 48)
    raw = replace(denoised, denoise=False)
    noise = {
        (stage.denoise, spp): image_pair(stage, spp, 0)[1]
        for stage in (raw, denoised)
        for spp in (8, 128)
    }
    assert 0 < noise[False, 128] < 0.25 * noise[False, 8]
    assert 0 < noise[True, 128] < noise[True, 8]
    assert noise[True, 8] < 0.5 * noise[False, 8]
    assert noise[True, 128] < noise[False, 128]
