"""Reasons on a board's page for rendered scenes: in Chromium, against labels from the truth.

The labels are computed from ground truth and an image without sensor noise; nothing of the tested rule is used.
"""

import numpy as np
import pytest
from numpy.lib.stride_tricks import sliding_window_view

import twinlens as tl
from tests.report.test_costs_page import asked_page, matched
from tests.report.test_page import needs_chromium
from twinlens.scoring import Pair

pytestmark = pytest.mark.slow

METHODS = ["mine=zncc:block_size=9", "sad9=sad:block_size=9"]
RADIUS = 4
WRONG_PX, JUMP_PX, FLAT_LEVELS = 2.0, 2.0, 2.0
PER_LABEL = 12
KINDS = {"range", "occluded", "texture", "discontinuity"}


def windows(image):
    padded = np.pad(np.asarray(image, float), RADIUS, mode="edge")
    return sliding_window_view(padded, (2 * RADIUS + 1, 2 * RADIUS + 1))


def labels(disparity, visible, clean, ndisp):
    """The cause of each pixel's error, "" if the truth names none or several.

    Range and occlusion precede. Discontinuity: neighbours in the window differ by 2 px or more. No texture: rows of the
    clean window have an RMS deviation from their mean below 2 grey levels.
    """
    d = windows(np.where(np.isfinite(disparity), disparity, -1e3))
    across, down = (np.abs(np.diff(d, axis=axis)) >= JUMP_PX for axis in (-1, -2))
    jump = across.any(axis=(-2, -1)) | down.any(axis=(-2, -1))
    rows = windows(clean)
    flat = rows.std(axis=-1)  # of each row of the window
    flat = np.sqrt(np.mean(flat**2, axis=-1)) < FLAT_LEVELS
    found = np.full(disparity.shape, "", object)
    found[flat & ~jump], found[jump & ~flat] = "texture", "discontinuity"
    found[~visible] = "occluded"
    found[(disparity < -1) | (disparity > ndisp)] = "range"
    found[~np.isfinite(disparity)] = ""
    return found


def rendered(name):
    """(pair, clean grey image of the left view) of a bundled scene, photographed with sensor noise."""
    scene = tl.load_scene(name)
    camera = tl.Camera.from_fov(200, 150, fov_x_deg=50)
    rig = tl.Rig.stereo(camera, baseline=0.12, world_from_left=scene.world_from_left)
    radiance = tl.render(scene, rig, tl.Pinhole(), spp=16, seed=0, denoise=True)
    photos = [
        tl.Sensor().expose_pair(*radiance, rig=rig, lens=tl.Pinhole(), seed=seed)
        for seed in range(9)
    ]  # the mean of eight more exposures has hardly any noise
    truth = tl.ground_truth(scene, rig)[0]
    clean = np.mean(
        [tl.matching.grey(left.image.astype(np.float32)) for left, _ in photos[1:]],
        axis=0,
    )
    mask = np.where(truth.visible, 255, 128).astype(np.uint8)
    disparity = truth.disparity.astype(np.float32)
    ndisp = int(np.ceil(disparity[np.isfinite(disparity)].max())) + 4
    return (
        Pair("scene", *(photo.image for photo in photos[0]), disparity, mask, ndisp),
        clean,
        truth.visible,
    )


def answers(pair, clean, visible, folder):
    """[(label, kind on the page, sentence)] of wrong pixels."""
    page = matched([pair], METHODS)
    cause, rng, chosen = (
        labels(pair.disp0, visible, clean, pair.ndisp),
        np.random.default_rng(3),
        [],
    )
    for (name, _), disparity in page[2].items():
        wrong = ~(np.abs(disparity - np.where(cause == "", 0, pair.disp0)) <= WRONG_PX)
        for kind in sorted(KINDS):
            pixels = np.argwhere(wrong & (cause == kind))
            chosen += [
                (name, int(x), int(y), kind)
                for y, x in pixels[rng.permutation(len(pixels))[:PER_LABEL]]
            ]
    found = asked_page(*page, folder, reasons=[pixel[:3] for pixel in chosen])[
        "reasons"
    ]
    return [(pixel, *reason) for pixel, reason in zip(chosen, found, strict=True)]


@needs_chromium
def test_reasons_of_rendered_scenes_are_those_of_the_truth(tmp_path):
    found = []
    for name in ("cards", "staircase", "tabletop"):
        pair, clean, visible = rendered(name)
        found += [(name, *each) for each in answers(pair, clean, visible, tmp_path)]
        if name == "cards":
            known = pair.disp0[np.isfinite(pair.disp0)]
            short = Pair(
                "scene",
                pair.im0,
                pair.im1,
                pair.disp0,
                pair.mask0_nonocc,
                int(np.median(known)),
            )
            found += [
                ("narrow", *each) for each in answers(short, clean, visible, tmp_path)
            ]
    assert {pixel[3] for _, pixel, *_ in found} == KINDS
    misses = [each for each in found if each[1][3] != each[2]]
    assert len(misses) <= 0.1 * len(found), misses
