"""Samples of a sequence of patterns: their frames, files and noise; decoded, against the closed form of a plane."""

import shutil
from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from twinlens import geometry
from twinlens.camera import GrayCode, PhaseShift, Pinhole, ThinLens
from twinlens.dataset import open_sample, write_sample
from twinlens.dataset.codecs.png import write_png
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.verify import verify_sample
from twinlens.errors import InputError
from twinlens.factory import remake
from twinlens.factory.rectified import rectified_sample
from twinlens.factory.sample import Shoot, make_sample
from twinlens.factory.sequences import frame_sums
from twinlens.reconstruction.decoding import decode_sample
from twinlens.rendering import requests
from twinlens.scenes import Scene, SceneObject
from twinlens.sensor import Exposure, Mismatch, Sensor

Z, BASELINE, APART = 2.0, 0.1, 0.25
CAMERA = tl.Camera.from_fov(48, 36, 30)
LENS = tl.Camera.from_fov(64, 48, 50)
CODES = ["white", GrayCode(64, 48), GrayCode(64, 48, "v"), PhaseShift(64, 48, 16, 4)]
ROTATE_TO_FLOOR = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
TOO_LONG_S = 0.1
FRAMES = 1 + 12 + 12 + 4
LINEAR = Sensor(
    output="linear", bits=16, shot_noise=False, read_noise=0.0, prnu=0.0, dsnu=0.0
)


def plane(**lights):
    """A grey plane at depth Z before cameras at the origin that look along z."""
    turn = np.diag([-1.0, 1, -1])
    pose = geometry.rigid(turn, [0, 0, Z]) @ np.diag([9.0, 9, 1, 1])
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    wall = SceneObject("wall", {"type": "rectangle"}, "grey", pose)
    path = {"type": "path", "max_depth": 2}
    return Scene("plane", (wall,), {"grey": grey}, np.eye(4), (1.0, 9.0), lights, path)


def rig_of(*sequence):
    pose = geometry.rigid(np.eye(3), [APART, 0, 0])
    lamp = tl.Projector(pose, LENS, power=20.0, band="rgb", sequence=sequence)
    return tl.Rig.stereo(CAMERA, BASELINE).with_projectors([lamp])


def seen_positions(view):
    """The closed form of the projector pixels (H, W, 2) on the plane that a view sees, of parallel pinholes."""
    v, u = np.mgrid[:36, :48]
    x = Z * (u - CAMERA.cx) / CAMERA.fx + view * BASELINE - APART
    y = Z * (v - CAMERA.cy) / CAMERA.fy
    return np.stack([LENS.fx * x / Z + LENS.cx, LENS.fy * y / Z + LENS.cy], axis=-1)


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("sequence") / "plane"
    shoot = Shoot(spp=16, sensor=LINEAR, keep_radiance=True, seed=5)
    sample = make_sample(plane(), rig_of(*CODES), [Pinhole()], shoot)
    write_sample(folder, sample)
    return open_sample(folder)


def test_decoded_positions_and_points_are_the_closed_form_of_the_plane(stored):
    assert stored.num_frames == FRAMES
    for view, decoded in enumerate(decode_sample(stored)):
        exact = seen_positions(view)
        inside = (exact >= 1).all(axis=-1) & (exact <= (62, 46)).all(axis=-1)
        assert inside.mean() > 0.5
        assert decoded.valid[inside].all()
        u, v = decoded.axes["u"].position, decoded.axes["v"].position
        assert np.abs(u - exact[..., 0])[inside].max() < 0.05  # a phase shift
        assert np.abs(v - exact[..., 1])[inside].max() < 0.5  # a Gray code
        # An error e of the column moves the point by z^2 e / (f b) to first order.
        apart = abs(APART - view * BASELINE)
        depth = decoded.points[..., 2][inside]
        assert np.abs(depth - Z).max() < 1.1 * 0.05 * Z**2 / (LENS.fx * apart)
        truth = decoded.against_truth
        assert truth["u_px"]["median"] < 0.05
        assert truth["u_px"]["within_half"] == 1
        assert truth["decoded_of_lit"] > 0.9
        error = np.linalg.norm(decoded.points - stored.truth(view).position, axis=-1)
        compared = decoded.valid & stored.truth(view).projections[0].lit
        median = 1e3 * np.median(error[compared])
        assert truth["point_mm"]["median"] == pytest.approx(median)


@pytest.mark.parametrize(
    ("image", "size"),
    [
        (np.zeros((18, 24, 3), np.uint16), "24x18 pixels of 3 channels"),
        (np.zeros((36, 48), np.uint16), "48x36 pixels of 1 channel"),
    ],
)
def test_frames_of_different_sizes_are_refused_by_file(stored, tmp_path, image, size):
    """The error names the file once, and the sizes of both frames."""
    other = tmp_path / "plane"
    shutil.copytree(stored.folder, other)
    write_png(other / "frame-3" / "im1.png", image)
    with pytest.raises(InputError) as caught:
        decode_sample(open_sample(other))
    assert str(caught.value) == (
        f"{other}: frame-3/im1.png is {size}, im1.png of frame 0 is 48x36 pixels of 3 channels; "
        "all frames must be alike"
    )


def test_a_lens_beyond_the_last_names_the_sample_once(stored):
    with pytest.raises(InputError) as caught:
        decode_sample(stored, lens=1)
    assert str(caught.value) == "plane: has lenses 0 to 0, no lens 1"


def half_dark_plane():
    """The plane, and before its left half one of a tenth of the reflectance."""
    scene = plane()
    (wall,) = scene.objects
    left = geometry.rigid(np.eye(3), [-9, 0, -1e-5]) @ wall.world_from_object
    dark = SceneObject("dark", {"type": "rectangle"}, "dark", left)
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.05}}
    materials = {**scene.materials, "dark": black}
    return replace(scene, objects=(wall, dark), materials=materials)


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"output": "srgb", "bits": 8},
        {"output": "raw", "adc_bits": 12},
        {"filters": "RGGB"},
        {"mismatch": Mismatch(white_balance_red=0.9, white_balance_blue=0.9)},
    ],
)
def test_a_saturated_pixel_has_no_position(tmp_path, changes):
    """A clipped sinusoid has another phase: an error of up to a pixel at a period of 16."""
    sensor = LINEAR.replace(**changes)
    rig = rig_of("white", GrayCode(64, 48), PhaseShift(64, 48, 16, 4))
    shoot = Shoot(spp=4, sensor=sensor, exposure=Exposure(TOO_LONG_S))
    write_sample(
        tmp_path / "bright", make_sample(half_dark_plane(), rig, [Pinhole()], shoot)
    )
    for view, decoded in enumerate(decode_sample(open_sample(tmp_path / "bright"))):
        exact = seen_positions(view)
        inside = (exact >= 1).all(axis=-1) & (exact <= (62, 46)).all(axis=-1)
        x = (np.arange(48) - CAMERA.cx) / CAMERA.fx * Z + view * BASELINE
        is_dark = np.broadcast_to(x < -0.1, inside.shape)
        is_bright = np.broadcast_to(x > 0.1, inside.shape)
        assert decoded.valid[inside & is_dark].all()
        assert not decoded.valid[is_bright].any()
        error = np.abs(decoded.axes["u"].position - exact[..., 0])
        assert error[inside & is_dark].max() < 0.5


def test_a_pattern_and_its_inverse_add_up_to_white(stored):
    """The frames have one exposure and the same light paths; between them only the pattern differs."""
    white = stored.frame(0).radiance(0)
    pair = stored.frame(1).radiance(0) + stored.frame(2).radiance(0)
    assert np.abs(pair - white).max() < 1e-5 * white.max()
    times = {
        frame.record["exposures"][view]["time_s"]
        for frame in map(stored.frame, range(FRAMES))
        for view in (0, 1)
    }
    assert len(times) == 1
    images = [stored.frame(number).im1 for number in (0, 3, 4)]
    assert images[0].max() <= 0.95 * 65535
    # The converter rounds each image to half a digital number.
    number = 65535 / (LINEAR.largest_dn - LINEAR.black_level) * LINEAR.balance().max()
    rounding = images[1].astype(float) + images[2] - images[0]
    assert np.abs(rounding).max() <= 1.5 * number + 2


def test_the_light_of_inverse_patterns_is_not_rendered_twice(stored):
    """Of each code after the first pair, half of the frames follow; they are what a render of their own gives."""
    rigs = [rig_of(*CODES).at_frame(number) for number in range(FRAMES)]
    rendered = [number for number, parts in enumerate(frame_sums(rigs)) if not parts]
    assert rendered == [0, 1, 2, *range(3, 13, 2), *range(13, 25, 2), 25, 26]
    lone = rig_of("white", "dots", PhaseShift(64, 48, 16, 3))
    assert frame_sums([lone.at_frame(number) for number in range(5)]) == [None] * 5
    shot = stored.lens(0)
    for number in (4, 16, 27):
        (left, right) = tl.render(plane(), rigs[number], spp=16, seed=shot.record["seed"])  # fmt: skip
        for view, alone in enumerate((left, right)):
            frame = stored.frame(number).radiance(view)
            assert np.abs(frame - alone).max() < 1e-5 * alone.max()


def test_light_that_is_not_rendered_has_the_bounces_and_the_blur_of_a_render():
    shelf = geometry.rigid(ROTATE_TO_FLOOR, [0, 0.3, Z]) @ np.diag([9.0, 9, 1, 1])
    scene = plane()
    floor = SceneObject("floor", {"type": "rectangle"}, "grey", shelf)
    objects = (*scene.objects, floor)
    paths = {"type": "path", "max_depth": 6}
    scene = replace(scene, objects=objects, integrator=paths)
    rig, lens = rig_of("white", GrayCode(64, 48)), ThinLens(0.05, focus_distance=1.0)
    rigs = [rig.at_frame(number) for number in range(rig.num_frames)]
    lenses = LINEAR.lenses(rig, lens)
    shoot = Shoot(spp=4, sensor=LINEAR, keep_radiance=True)
    (shot,) = make_sample(scene, rig, [lens], shoot, truths=()).shots
    summed = [number for number, parts in enumerate(frame_sums(rigs)) if parts]
    assert len(summed) == 5
    for number in summed[::2]:
        again = tl.render(scene, rigs[number], lenses, 4, shot.record["seed"])
        for view, alone in enumerate(again):
            frame = shot.frames[number - 1].radiances[view]
            assert np.abs(frame - alone).max() < 1e-5 * alone.max()
    direct = replace(scene, integrator={**paths, "max_depth": 2})
    (_, right) = tl.render(direct, rigs[number], lenses, 4, shot.record["seed"])
    assert alone.mean() > 1.05 * right.mean()


def test_frames_have_noise_of_their_own_and_the_fixed_pattern_of_the_sensor():
    noisy = LINEAR.replace(shot_noise=True, read_noise=2.0)
    fixed = LINEAR.replace(prnu=0.05, dsnu=20.0)
    taken = {}
    for name, sensor in {"clean": LINEAR, "noisy": noisy, "fixed": fixed}.items():
        shoot = Shoot(spp=2, sensor=sensor, keep_radiance=True)
        (taken[name],) = make_sample(
            plane(), rig_of("white", "white"), [Pinhole()], shoot, truths=()
        ).shots
    for shot in taken.values():
        (second,) = shot.frames
        assert np.array_equal(shot.radiances[0], second.radiances[0])
    clean, noisy = (
        np.array([frame.images[0] for frame in (shot, *shot.frames)], dtype=float)
        for shot in (taken["clean"], taken["noisy"])
    )
    lit = clean[0] > 1000
    first, second = (noisy - clean)[:, lit]
    assert abs(np.corrcoef(first, second)[0, 1]) < 0.1
    assert (first != second).mean() > 0.9
    assert np.array_equal(taken["fixed"].images[0], taken["fixed"].frames[0].images[0])


def test_the_files_of_frames_are_read_verified_and_made_again(stored, tmp_path):
    assert verify_sample(stored) == []
    assert stored["frame3.im1"].shape == (36, 48, 3)
    assert np.array_equal(stored["frame3.im1"], stored.frame(3).im1)
    assert np.array_equal(stored["lens0.frame3.radiance0"], stored.frame(3).radiance(0))
    assert not np.array_equal(stored["frame3.im0"], stored.im0)
    for number in (-1, FRAMES):
        with pytest.raises(InputError, match=f"frames 0 to {FRAMES - 1}, no frame"):
            stored.frame(number)
    with pytest.raises(InputError, match="quantity"):
        stored["frame3.disp0"]
    made = sample_files(remake(stored.record, plane()))
    for name, content in made.items():
        assert stored.path(name).read_bytes() == content
    damaged = tmp_path / "damaged"
    for name, content in made.items():
        if name != "frame-7/im1.png":
            (damaged / name).parent.mkdir(exist_ok=True, parents=True)
            (damaged / name).write_bytes(content)
    (finding,) = verify_sample(open_sample(damaged))
    assert finding.startswith("frame-7/im1.png: is missing")
    (damaged / "frame-7/im1.png").write_bytes(made["frame-7/im1.png"][:99])
    (finding,) = verify_sample(open_sample(damaged))
    assert finding.startswith("frame-7/im1.png: ")


def test_rectified_samples_have_all_frames_and_each_lens_has_its_own(stored):
    rectified = rectified_sample(stored, plane())
    assert rectified.num_frames == FRAMES
    result = rectified.shots[0].frames[4].images[1]
    assert np.abs(result.astype(float) - stored.frame(5).im1).mean() < 200  # of 65535
    lenses = [Pinhole(), ThinLens(0.05, focus_distance=1.0)]
    shoot = Shoot(spp=2, sensor=LINEAR)
    sample = make_sample(plane(), rig_of("white", "checker"), lenses, shoot, truths=())
    files = sample_files(sample)
    assert {"frame-1/im0.png", "lens-1/im0.png", "lens-1/frame-1/im1.png"} < files.keys()  # fmt: skip
    assert files["frame-1/im0.png"] != files["lens-1/frame-1/im0.png"]


def test_what_a_sequence_excludes_is_refused(tmp_path, monkeypatch):
    shoot = Shoot(spp=1, sensor=LINEAR, dual_pixel=True)
    with pytest.raises(InputError, match="dual_pixel and a projector's sequence"):
        make_sample(plane(), rig_of("white", "dots"), [Pinhole()], shoot)
    bounded = Shoot(spp=1, sensor=LINEAR, noise=0.3)
    for sequence in (["dots", "white"], [GrayCode(64, 48)]):
        with pytest.raises(InputError, match=r"noise.* starts with white"):
            make_sample(plane(), rig_of(*sequence), [Pinhole()], bounded)
    make_sample(plane(), rig_of("white", "dots"), [Pinhole()], bounded, truths=())
    monkeypatch.setattr(requests, "memory_bytes", lambda: 4_000_000)
    small = Shoot(spp=1, sensor=LINEAR)
    make_sample(plane(), rig_of("white", "dots"), [Pinhole()], small, truths=())
    with pytest.raises(InputError, match=r"100 frames of 2 images .* fewer patterns"):
        make_sample(plane(), rig_of(*["white"] * 100), [Pinhole()], small)
    sample = make_sample(plane(), rig_of("white", "dots"), [Pinhole()], Shoot(spp=1))
    write_sample(tmp_path / "plain", sample)
    with pytest.raises(InputError, match="has no sequence of coded patterns"):
        decode_sample(open_sample(tmp_path / "plain"))
