"""Requests that cannot be rendered are refused before anything is built."""

import numpy as np
import pytest

from twinlens.camera import Camera, Pinhole, Rig
from twinlens.errors import InputError
from twinlens.rendering import requests


def rig_of(*sizes):
    cameras = [Camera.from_fov(*size, fov_x_deg=60) for size in sizes]
    return Rig(cameras, [np.eye(4)] * len(cameras))


@pytest.mark.parametrize(
    ("sizes", "says"),
    [
        (
            [(30000, 30000)],
            "1 image of up to 30000x30000 pixels need at least 55.8 GB",
        ),
        ([(4000, 200), (65536, 3000)], "2 images of up to 65536x3000 pixels need at"),
        ([(4000, 3000)] * 60, "60 images of up to 4000x3000 pixels need at least"),
    ],
)
def test_images_larger_than_the_memory_are_refused(monkeypatch, sizes, says):
    monkeypatch.setattr(requests, "memory_bytes", lambda: 8_000_000_000)
    with pytest.raises(InputError, match=says) as refusal:
        requests.check_request({}, rig_of(*sizes), [Pinhole()], 1, 0, "sobol")
    assert "this machine has 8 GB: use smaller images" in str(refusal.value)


def test_images_that_fit_are_not_refused(monkeypatch):
    monkeypatch.setattr(requests, "memory_bytes", lambda: 8_000_000_000)
    requests.check_request(
        {}, rig_of((8000, 6000), (640, 480)), [Pinhole()], 1, 0, "sobol"
    )
