"""Residual misalignment, lens shading and focus, measured on rendered chessboards, flat fields and lights."""

import cv2
import numpy as np
import pytest

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    FACING,
    HERE,
    disk_diameter,
    grey,
    lamps,
    sky,
    square_camera,
)
from twinlens.factory import Shoot, make_sample
from twinlens.rendering import render_measured
from twinlens.scenes import Scene, SceneObject

CAMERA = tl.Camera(240, 180, 260.0, 260.0, 119.5, 89.5)
RIG = tl.Rig.stereo(CAMERA, 0.1)
SQUARES = (12, 9)


def chessboard(depth: float) -> Scene:
    """A board of 12 x 9 squares of 19.5 pixels in front of the second camera, under a uniform sky."""
    paints = {
        f"color{i}": {"type": "rgb", "value": value}
        for i, value in enumerate((0.02, 0.98))
    }
    check = {
        "type": "checkerboard",
        "to_uv": np.diag([SQUARES[0] / 2, SQUARES[1] / 2, 1.0, 1.0]),
        **paints,
    }
    board = FACING @ np.diag([0.45 * depth, 0.3375 * depth, 1.0, 1.0])
    board[:3, 3] = 0.1, 0.0, depth
    light = {"sky": {"type": "constant", "radiance": {"type": "rgb", "value": 1.0}}}
    objects = (SceneObject("board", {"type": "rectangle"}, "check", board),)
    material = {"check": {"type": "diffuse", "reflectance": check}}
    return Scene(
        "board",
        objects,
        material,
        HERE,
        (1.0, 3.0),
        light,
        {"type": "path", "max_depth": 2},
    )


def corners(rig: tl.Rig, depth: float = 2.0) -> np.ndarray:
    """The inner corners (88, 2) in the second image, to sub-pixels by OpenCV."""
    second = tl.Rig(rig.cameras[1:], rig.world_from_cams[1:])
    image = tl.render(chessboard(depth), second, tl.Pinhole(), spp=256, seed=0)[0].mean(
        axis=-1
    )
    grey = cv2.GaussianBlur(
        image.astype(np.float32), (0, 0), 1.5
    )  # sharp edges bias cornerSubPix by 0.1 px
    v, u = np.mgrid[-3.5:4, -4.5:5]
    near = (
        np.stack([119.5 + 19.5 * (u - 0.5), 89.5 + 19.5 * v], axis=-1)
        .reshape(-1, 1, 2)
        .astype(np.float32)
    )
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 1e-5)
    return cv2.cornerSubPix(grey, near, (6, 6), (-1, -1), criteria)[:, 0].astype(
        np.float64
    )


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
    found = dict(
        zip(
            shape,
            np.linalg.lstsq(basis, np.concatenate(moved.T), rcond=None)[0],
            strict=True,
        )
    )
    assert found["pitch_px"] == pytest.approx(px if name == "pitch_px" else 0, abs=0.02)
    assert found["yaw_px"] == pytest.approx(px if name == "yaw_px" else 0, abs=0.02)
    one = np.stack(shape[name], axis=-1)
    assert (moved * one).sum() / (one**2).sum() == pytest.approx(px, abs=0.02)


@pytest.mark.parametrize("depth", [0.8, 2.0])
def test_translation_of_a_rendered_chessboard(depth):
    """A pinhole that moved: -f tx/Z and -f ty/Z pixels, and a scale of Z/(Z - tz), by least squares."""
    aligned = corners(RIG, depth)
    moved = (
        corners(
            tl.Mismatch(right_mm=1.0, down_mm=-1.5, forward_mm=3.0).misalign(RIG), depth
        )
        - aligned
    )
    x, y = (aligned - [119.5, 89.5]).T / 150
    basis = np.stack(
        [
            np.concatenate(part)
            for part in ((0 * x + 1, 0 * y), (0 * x, 0 * y + 1), (x, y))
        ],
        axis=1,
    )
    right, down, corner = np.linalg.lstsq(basis, np.concatenate(moved.T), rcond=None)[0]
    assert right == pytest.approx(-260 * 0.001 / (depth - 0.003), abs=0.02)
    assert down == pytest.approx(260 * 0.0015 / (depth - 0.003), abs=0.02)
    assert corner == pytest.approx(150 * 0.003 / (depth - 0.003), abs=0.02)


@pytest.mark.parametrize("f_number", [1.0, 1.25])
@pytest.mark.parametrize(
    ("focus", "focus_um"), [(1.0, 40.0), (1.0, -40.0), (np.inf, -40.0), (np.inf, 60.0)]
)
def test_the_blur_disk_of_a_displaced_film(focus, focus_um, f_number):
    """A |v' - v_point| / v_point on the film, by Gauss's lens equation, in the second image of a sample."""
    film, aperture, depth, pitch, own = 0.016, 0.005, 2.0, 4e-6, 6.0
    camera = square_camera(41, 4000.0, pixel_pitch_um=1e6 * pitch)
    rig, lens = tl.Rig([camera, camera], [HERE, HERE]), tl.ThinLens(aperture, focus)
    sensor = tl.Sensor(mismatch=tl.Mismatch(focus_um=focus_um, f_number=f_number))
    lamp = lamps([(0.0, 0.0, depth)], 0.5 * own * depth / 4000)
    sample = make_sample(
        lamp, rig, [lens], Shoot(spp=4096, sensor=sensor, keep_radiance=True)
    )
    power = 1 / focus + 1 / film
    point = 1 / (power - 1 / depth)
    for image, gap, width in zip(
        sample.shots[0].radiances,
        (0.0, 1e-6 * focus_um),
        (aperture, aperture / f_number),
        strict=True,
    ):
        blur = width * abs(film + gap - point) / point / pitch
        assert disk_diameter(grey(image), own) == pytest.approx(blur, rel=0.015)
    assert sample.shots[0].lens == lens  # that of the truth
    assert sample.rig is rig


def test_lenses_of_cameras_that_do_not_fit_the_rig():
    lens = tl.ThinLens(0.01, 1.0)
    with pytest.raises(
        tl.TwinlensError,
        match="a rig of 2 cameras needs one lens, or one for each camera, got 3",
    ):
        tl.render(sky(), RIG, [lens] * 3)
    with pytest.raises(
        tl.TwinlensError,
        match="a lens must be a Pinhole, ThinLens or BareAperture, got 3",
    ):
        tl.render(sky(), RIG, [lens, 3])


def test_equal_lenses_give_the_image_of_one():
    lens = tl.ThinLens(0.03, 1.0)
    rig = tl.Rig([CAMERA, CAMERA.replace(band="rgb+nir")], RIG.world_from_cams)
    scene = chessboard(2.0)
    one, each = (
        tl.render(scene, rig, given, spp=2, seed=3) for given in (lens, [lens, lens])
    )
    assert [image.tobytes() for image in one] == [image.tobytes() for image in each]
    mixed = tl.render(scene, rig, [tl.Pinhole(), lens], spp=2, seed=3)
    assert (
        mixed[0].tobytes()
        == tl.render(scene, rig, tl.Pinhole(), spp=2, seed=3)[0].tobytes()
    )
    assert mixed[1].tobytes() == one[1].tobytes()


def test_measured_images_through_a_lens_for_each_camera():
    """They are those of `render` but for noise; a blur circle of 4 px changes blocks of 6x6 pixels by more."""
    lenses = [tl.Pinhole(), tl.ThinLens(0.03, 1.0)]

    def blocks(image: np.ndarray) -> np.ndarray:
        return image.reshape(30, 6, 40, 6, 3).mean(axis=(1, 3))

    found, _ = render_measured(chessboard(2.0), RIG, lenses, 64, 3)
    same, swapped = (
        tl.render(chessboard(2.0), RIG, each, 64, 3) for each in (lenses, lenses[::-1])
    )
    for view, one, other in zip(found, same, swapped, strict=True):
        assert (
            2 * np.abs(blocks(view.image) - blocks(one)).mean()
            < np.abs(blocks(view.image) - blocks(other)).mean()
        )


def test_vignetting_of_a_rendered_flat_field():
    """The default sensor's image of a uniform sky at f/1.4, beside rays through the stop and the barrel's rim."""
    camera, far = CAMERA, 260.0 * 1e-4
    camera = camera.replace(pixel_pitch_um=100.0)  # film distance 26 mm
    lens = tl.ThinLens(far / 1.4, 1.0)
    light = tl.render(sky(), tl.Rig([camera], [HERE]), lens, spp=4, seed=0)[0]
    image = (
        tl.Sensor(output="linear", bits=16)
        .expose(light, camera=camera, lens=lens)
        .image.mean(axis=-1)
    )
    rng = np.random.default_rng(1)
    radius, angle = (
        lens.aperture_diameter / 2 * np.sqrt(rng.random(200_000)),
        rng.uniform(0, 2 * np.pi, 200_000),
    )

    def passed(x: float, y: float) -> float:
        """Share of the light of the axis at (x, y) pixels from it; the rim is half a film distance before the stop."""
        tx, ty = x / 260, y / 260
        ray = np.hypot(
            radius * np.cos(angle) + 0.5 * far * tx,
            radius * np.sin(angle) + 0.5 * far * ty,
        )
        return float(
            np.mean(ray <= far / 2.8) * np.cos(np.arctan(np.hypot(tx, ty))) ** 4
        )

    middle = image[84:96, 114:126].mean()
    for x, y in ((60, 0), (-114, 0), (0, 84), (114, -84)):
        u, v = round(119.5 + x), round(89.5 + y)
        patch = image[max(v - 5, 0) : v + 6, max(u - 5, 0) : u + 6]
        assert patch.mean() / middle == pytest.approx(passed(x, y), rel=0.02), (x, y)


def test_shading_of_a_rendered_flat_field():
    """Edges and a corner against the centre, through a lens and the noise of a sensor."""
    lens = tl.ThinLens(0.002, 1.0)
    images = tl.render(sky(), RIG, lens, spp=4, seed=0)
    mismatch = tl.Mismatch(
        gain=1.05, shading_right=0.08, shading_down=-0.06, shading_corner=0.1
    )
    sensor = tl.Sensor(output="linear", bits=16, mismatch=mismatch)
    photos = sensor.expose_pair(*images, rig=RIG, lens=lens)
    left, right = (photo.image.mean(axis=-1) for photo in photos)

    def patch(row: int, column: int) -> float:
        return (
            right[row : row + 12, column : column + 12].mean()
            / left[row : row + 12, column : column + 12].mean()
        )

    middle = patch(84, 114)
    assert middle == pytest.approx(1.05, rel=0.01)
    reach = 1 - 12 / 240  # of the middle of an outermost patch, in halves of the image
    assert patch(84, 228) / middle == pytest.approx(
        1 + 0.08 * reach - 0.1 * 0.64 * reach**2, rel=0.02
    )
    assert patch(84, 0) / middle == pytest.approx(
        1 - 0.08 * reach - 0.1 * 0.64 * reach**2, rel=0.02
    )
    assert patch(168, 228) / middle == pytest.approx(1 + 0.08 - 0.06 - 0.1, rel=0.02)
