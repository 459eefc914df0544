"""Residual misalignment and lens shading, measured on rendered chessboards and flat fields."""

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import FACING, HERE, sky
from twinlens.scenes import Scene, SceneObject

CAMERA = tl.Camera(240, 180, 260.0, 260.0, 119.5, 89.5)
RIG = tl.Rig.stereo(CAMERA, 0.1)
SQUARES = (12, 9)


def chessboard() -> Scene:
    """A board of 12 x 9 squares of 19.5 pixels, 2 m in front of the second camera, under a uniform sky."""
    paints = {f"color{i}": {"type": "rgb", "value": value} for i, value in enumerate((0.02, 0.98))}
    check = {"type": "checkerboard", "to_uv": np.diag([SQUARES[0] / 2, SQUARES[1] / 2, 1.0, 1.0]), **paints}
    board = FACING @ np.diag([0.9, 0.675, 1.0, 1.0])
    board[:3, 3] = 0.1, 0.0, 2.0
    light = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    objects = (SceneObject("board", {"type": "rectangle"}, "check", board),)
    material = {"check": {"type": "diffuse", "reflectance": check}}
    return Scene("board", objects, material, HERE, (1.0, 3.0), light, {"type": "path", "max_depth": 2})


def corners(rig: tl.Rig) -> np.ndarray:
    """The inner corners (88, 2) in the second image, to sub-pixels by OpenCV."""
    image = tl.render(chessboard(), rig, tl.Pinhole(), spp=256, seed=0)[1].mean(axis=-1)
    grey = cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)  # sharp edges bias cornerSubPix by 0.1 px
    v, u = np.mgrid[-3.5:4, -4.5:5]
    near = np.stack([119.5 + 19.5 * (u - 0.5), 89.5 + 19.5 * v], axis=-1).reshape(-1, 1, 2).astype(np.float32)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-5)
    return cv2.cornerSubPix(grey, near, (6, 6), (-1, -1), criteria)[:, 0].astype(np.float64)


@pytest.fixture(scope="module")
def aligned() -> np.ndarray:
    return corners(RIG)


@pytest.mark.parametrize(
    ("name", "px"),
    [
        ("pitch_px", 0.4),
        pytest.param("yaw_px", -0.3, marks=pytest.mark.slow),
        pytest.param("roll_px", 0.5, marks=pytest.mark.slow),
        pytest.param("scale_px", 0.6, marks=pytest.mark.slow),
        ("distortion_px", 0.8),
    ],
)
def test_misalignment_of_a_rendered_chessboard(aligned, name, px):
    """The displacement of the corners, as a shift, a turn or a scale, by least squares."""
    moved = corners(tl.Mismatch(**{name: px}).misalign(RIG)) - aligned
    x, y = (aligned - [119.5, 89.5]).T
    r = np.hypot(x, y)
    shape = {
        "pitch_px": (0 * x, 0 * y + 1),
        "yaw_px": (0 * x + 1, 0 * y),
        "roll_px": (-y / 120, x / 120),
        "scale_px": (x / 150, y / 150),
        "distortion_px": (x / r * (r / 150) ** 3, y / r * (r / 150) ** 3),
    }
    basis = np.stack([np.concatenate(part) for part in shape.values()], axis=1)
    found = dict(zip(shape, np.linalg.lstsq(basis, np.concatenate(moved.T), rcond=None)[0], strict=True))
    assert found["pitch_px"] == pytest.approx(px if name == "pitch_px" else 0, abs=0.02)
    assert found["yaw_px"] == pytest.approx(px if name == "yaw_px" else 0, abs=0.02)
    one = np.stack(shape[name], axis=-1)
    assert (moved * one).sum() / (one**2).sum() == pytest.approx(px, abs=0.02)


def test_vignetting_of_a_rendered_flat_field():
    """The default sensor's image of a uniform sky at f/1.4, beside rays through the stop and the barrel's rim."""
    camera, far = CAMERA, 260.0 * 1e-4
    camera = camera.replace(pixel_pitch_um=100.0)  # film distance 26 mm
    lens = tl.ThinLens(far / 1.4, 1.0)
    light = tl.render(sky(), tl.Rig([camera], [HERE]), lens, spp=4, seed=0)[0]
    image = tl.Sensor(output="linear", bits=16).expose(light, camera=camera, lens=lens).image.mean(axis=-1)
    rng = np.random.default_rng(1)
    radius, angle = lens.aperture_diameter / 2 * np.sqrt(rng.random(200_000)), rng.uniform(0, 2 * np.pi, 200_000)

    def passed(x: float, y: float) -> float:
        """Share of the light of the axis at (x, y) pixels from it; the rim is half a film distance before the stop."""
        tx, ty = x / 260, y / 260
        ray = np.hypot(radius * np.cos(angle) + 0.5 * far * tx, radius * np.sin(angle) + 0.5 * far * ty)
        return float(np.mean(ray <= far / 2.8) * np.cos(np.arctan(np.hypot(tx, ty))) ** 4)

    middle = image[84:96, 114:126].mean()
    for x, y in ((60, 0), (-114, 0), (0, 84), (114, -84)):
        u, v = round(119.5 + x), round(89.5 + y)
        patch = image[max(v - 5, 0) : v + 6, max(u - 5, 0) : u + 6]
        assert patch.mean() / middle == pytest.approx(passed(x, y), rel=0.02), (x, y)


def test_shading_of_a_rendered_flat_field():
    """Edges and a corner against the centre, through a lens and the noise of a sensor."""
    lens = tl.ThinLens(0.002, 1.0)
    images = tl.render(sky(), RIG, lens, spp=4, seed=0)
    mismatch = tl.Mismatch(gain=1.05, shading_right=0.08, shading_down=-0.06, shading_corner=0.1)
    sensor = tl.Sensor(output="linear", bits=16, mismatch=mismatch)
    photos = sensor.expose_pair(*images, rig=RIG, lens=lens)
    left, right = (photo.image.mean(axis=-1) for photo in photos)

    def patch(row: int, column: int) -> float:
        return right[row : row + 12, column : column + 12].mean() / left[row : row + 12, column : column + 12].mean()

    middle = patch(84, 114)
    assert middle == pytest.approx(1.05, rel=0.01)
    reach = 1 - 12 / 240  # of the middle of an outermost patch, in halves of the image
    assert patch(84, 228) / middle == pytest.approx(1 + 0.08 * reach - 0.1 * 0.64 * reach**2, rel=0.02)
    assert patch(84, 0) / middle == pytest.approx(1 - 0.08 * reach - 0.1 * 0.64 * reach**2, rel=0.02)
    assert patch(168, 228) / middle == pytest.approx(1 + 0.08 - 0.06 - 0.1, rel=0.02)
