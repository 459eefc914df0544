"""Planned rigs, rendered: ZNCC's depth error on textured planes is what the plan predicts, over the range of depths.

The disparity error that the plans assume is measured once, through a pinhole, with another camera and texture.
"""

import functools

import numpy as np
import pytest

from twinlens.camera import Pinhole, ThinLens
from twinlens.camera.film import diffract
from twinlens.geometry import depth_from_disparity
from twinlens.optics.planning import plan_rig
from twinlens.optics.rig_task import RigTask
from twinlens.studies.stage import centred_camera, noise_planes

RIM = 10
TASKS = {
    "smallest depth error": {"fov_x_deg": 45.0, "depth_range": (1.0, 3.0), "max_disparities": 24},
    "smallest baseline, blurred ends": {
        "fov_x_deg": (20.0, 60.0), "depth_range": (0.4, 2.0), "depth_error": 0.02, "pixel_pitch_um": 40.0,
        "f_number": (1.4, 4.0),
    },
    "diffraction": {
        "focal_length_mm": (1.0, 4.0), "depth_range": (0.8, 4.0), "pixel_pitch_um": 3.0, "f_number": (5.6, 16.0),
        "airy_px": 3.0, "baseline": 0.06,
    },
}  # fmt: skip


def errors(camera, baseline, lens, depth, seed, sensor=None, exposure=None):
    """The robust standard deviations of depth (m) and of disparity (px), over positions between pixels."""
    measured_errors = []
    for k, stage in enumerate(noise_planes(camera, baseline, depth, seed)):
        radiance = stage.photograph(lens, 16, seed + k)
        if lens.aperture_diameter:
            radiance = [diffract(image, camera, lens) for image in radiance]
        disparity = stage.match(
            stage.expose(radiance, lens, seed + k, sensor, exposure), "zncc"
        ).astype(np.float64)
        true = stage.truth.disparity
        used = stage.truth.visible & (np.abs(disparity - true) < 1)
        used[:RIM] = used[-RIM:] = used[:, :RIM] = used[:, -RIM:] = False
        z = depth_from_disparity(
            disparity[used], camera.fx, baseline, stage.rig.doffs()
        )
        measured_errors.append(
            np.abs([z - stage.truth.depth[used], (disparity - true)[used]])
        )
    return 1.4826 * np.median(np.hstack(measured_errors), axis=1)


@functools.cache
def disparity_error():
    return float(errors(centred_camera(128, 96, 150.0), 0.1, Pinhole(), 1.5, seed=1)[1])


def assert_predicted(name, depths, seed):
    settings = {"width": 128, "height": 96, "pixel_pitch_um": 5.0, **TASKS[name]}
    best = plan_rig(RigTask(**settings, disparity_error_px=disparity_error())).best
    camera = centred_camera(128, 96, best.fx).replace(
        pixel_pitch_um=best.task.pixel_pitch_um
    )
    lens = ThinLens(best.aperture_diameter, best.focus_distance)
    near, far = best.task.depth_range
    for depth in 1 / np.linspace(1 / near, 1 / far, depths):
        measured = errors(camera, best.baseline, lens, float(depth), seed)[0]
        assert measured == pytest.approx(float(best.depth_error(depth)), rel=0.25), (
            depth
        )
    return best


def test_the_depth_error_of_a_plan_is_measured_at_its_ends():
    best = assert_predicted("smallest baseline, blurred ends", 2, seed=20)
    assert best.blur_px(0.4) == pytest.approx(1.0)


@pytest.mark.slow
@pytest.mark.parametrize("name", TASKS)
def test_the_depth_error_of_a_plan_is_measured_over_its_range(name):
    assert_predicted(name, 7, seed=40)
