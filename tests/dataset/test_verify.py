import shutil
from dataclasses import replace

import numpy as np
import pytest

from tests.dataset import dataset_scene
from tests.dataset.dataset_scene import list_samples, rig, sample, stored
from twinlens import geometry
from twinlens.camera import Camera, Rig
from twinlens.dataset import (
    Dataset,
    Shot,
    consistency,
    open_sample,
    read_pfm,
    read_png,
    write_pfm,
    write_png,
)
from twinlens.dataset.codecs.exr import encode_exr, read_exr
from twinlens.dataset.verify import verify_sample

SIZE = {"width": 120, "height": 90}


@pytest.fixture(scope="module")
def good(tmp_path_factory):
    folder = tmp_path_factory.mktemp("good")
    stored(folder / "s", sample(num_lenses=2, **SIZE))
    list_samples(folder, "s")
    return folder


@pytest.fixture
def listed(good, tmp_path):
    shutil.copytree(good, tmp_path / "set")
    return Dataset(tmp_path / "set")[0]


@pytest.fixture
def loose(good, tmp_path):
    """The same sample without a manifest."""
    shutil.copytree(good / "s", tmp_path / "loose")
    return open_sample(tmp_path / "loose")


def test_a_correct_sample_has_no_findings(listed, loose):
    assert verify_sample(listed) == []
    assert verify_sample(loose) == []


@pytest.mark.parametrize("baseline", [0.05, 1.0])
def test_correct_samples_have_no_findings_far_from_the_origin(tmp_path, baseline):
    made = sample(baseline=baseline, doffs=-7.3, **SIZE)
    shift = np.array([90.0, -40.0, 70.0])
    far = geometry.rigid(np.eye(3), shift)
    poses = [far @ pose for pose in made.rig.world_from_cams]
    truths = [replace(truth, position=truth.position + shift) for truth in made.truths]
    moved = replace(made, rig=Rig(made.rig.cameras, poses), truths=tuple(truths))
    assert verify_sample(stored(tmp_path / "s", moved)) == []


def test_missing_changed_and_added_files_are_reported(listed):
    (listed.folder / "im1.png").unlink()
    (listed.folder / "extra.txt").touch()
    path = listed.folder / "lens-1" / "im0.png"
    path.write_bytes(path.read_bytes()[:-1])
    assert verify_sample(listed) == [
        "im1.png: is missing",
        "extra.txt: is not listed in dataset.json",
        "lens-1/im0.png: differs from its SHA-256 in dataset.json",
    ]
    shutil.rmtree(listed.folder)
    assert len(verify_sample(listed)) == 1


def files_of(loose):
    return sorted(path for path in loose.folder.rglob("*") if path.is_file())


def test_a_truncated_file_is_reported(loose):
    for path in files_of(loose):
        whole = path.read_bytes()
        path.write_bytes(whole[:-60])
        (finding,) = verify_sample(loose)
        assert finding.startswith(f"{path.relative_to(loose.folder)}: ")
        assert str(loose.folder) not in finding
        path.write_bytes(whole)


def test_damage_never_raises(loose):
    rng = np.random.default_rng(0)
    for path in files_of(loose):
        whole = path.read_bytes()
        data = bytearray(whole)
        for _ in range(3):
            data[rng.integers(len(data))] = rng.integers(256)
        path.write_bytes(data[: rng.integers(len(data) // 2, len(data) + 1)])
        for finding in verify_sample(loose):
            assert "\n" not in finding
        path.write_bytes(whole)


def test_a_missing_file_is_reported_without_a_manifest(loose):
    (loose.folder / "lens-1/im1.png").unlink()
    (finding,) = verify_sample(loose)
    assert finding == "lens-1/im1.png: is missing (the image of view 1)"


def test_sizes_are_compared(loose):
    write_png(loose.folder / "im1.png", loose.im1[1:])
    assert verify_sample(loose) == ["im1.png: is 120 x 89, must be 120 x 90"]


def test_exchanged_images_are_reported(tmp_path):
    # Images of a texture on the planes, evaluated at the position of each pixel.
    made = sample(num_lenses=2, width=160, height=120)
    left, right = (texture(truth) for truth in made.truths)
    good, bad = (
        [Shot(made.shots[0].lens, (left, right)), Shot(made.shots[1].lens, second)]
        for second in ((left, right), (right, left))
    )
    assert verify_sample(stored(tmp_path / "good", replace(made, shots=good))) == []
    (finding,) = verify_sample(stored(tmp_path / "bad", replace(made, shots=bad)))
    assert finding.startswith(
        "lens-1/im0.png: looks exchanged with its partner's image: edges correlate by "
    )


def texture(truth):
    p = np.where(truth.hit[..., None], truth.position, 0.0)
    waves = np.sin(p @ [[37.0, 61.0], [53.0, -29.0], [17.0, 43.0]]).sum(axis=-1)
    return np.round(127 + 60 * waves).astype(np.uint8)


def nudge(array):
    array = array.copy()
    array[array.shape[0] // 2, array.shape[1] // 2] *= 1.001
    return array


def mirror(array):
    return array[:, ::-1]


DAMAGE = (
    # file, plane of an EXR file, change, finding
    ("disp0.pfm", None, nudge, "disparity differs from fx B / z - doffs at 1 of"),
    ("mask0nocc.png", None, lambda mask: 255 - mask, "mask has other"),
    ("mask0nocc.png", None, mirror, "mask differs"),
    ("truth0.exr", "depth", nudge, "position's z differs from depth at 1 of"),
    ("truth0.exr", "depth", np.negative, "position is not finite"),
    ("truth1.exr", "position.X", nudge, "position does not project to its pixel"),
    ("truth0.exr", "object_id", lambda x: x * 2, "object_id has the value 4"),
    ("truth0.exr", "object_id", np.zeros_like, "depth is not finite exactly"),
    ("truth1.exr", "material_id", lambda x: x * 2, "material_id has the value 4"),
    ("truth1.exr", "material_kind", lambda x: x * 5, "material_kind has the value 5"),
    ("truth0.exr", "blur_circle_px", nudge, "blur_circle_px is not that of"),
)


def damage(path, plane, change):
    if path.suffix == ".png":
        write_png(path, change(read_png(path)))
    elif path.suffix == ".pfm":
        write_pfm(path, change(read_pfm(path)))
    else:
        exr = read_exr(path)
        planes = {**exr.channels, plane: change(exr.channels[plane])}
        path.write_bytes(encode_exr(planes, exr.text))


def test_inconsistent_arrays_are_reported(loose):
    for name, plane, change, text in DAMAGE:
        path = loose.folder / name
        whole = path.read_bytes()
        damage(path, plane, change)
        findings = verify_sample(loose)
        assert any(line.startswith(f"{name}: {text}") for line in findings), findings
        path.write_bytes(whole)


def test_views_of_different_scenes_are_reported(tmp_path, monkeypatch):
    """Each view is consistent; together they are not, as the right one shows a farther wall."""
    left = sample(**SIZE)
    monkeypatch.setattr(dataset_scene, "WALL", dataset_scene.WALL / 1.1)
    right = sample(**SIZE)
    mixed = replace(left, truths=(left.truths[0], right.truths[1]))
    findings = verify_sample(stored(tmp_path / "s", mixed))
    assert findings[0].startswith("truth0.exr: only ")
    assert "are at a depth that the other view has there" in findings[0]


def small_pair(size, baseline):
    pose = geometry.look_at([0.5, -1.0, 1.5], [2.0, 3.0, 1.0])
    pair = Rig.stereo(Camera.from_fov(*size, 60), baseline, world_from_left=pose)
    return pair, [vars(truth) for truth in dataset_scene.truths(pair)]


@pytest.mark.parametrize("baseline", [0.05, 0.4, 0.9])
@pytest.mark.parametrize("size", [(2, 7), (12, 9), (24, 18)])
def test_correct_views_of_few_pixels_have_no_findings(size, baseline):
    """Most pixels are at the border or at a silhouette, where depths at pixel centres prove little."""
    pair, truths = small_pair(size, baseline)
    assert consistency.check_shared_points((truths[0], truths[1]), pair, (0, 1)) == []
    assert consistency.check_shared_points((truths[1], truths[0]), pair, (1, 0)) == []


@pytest.mark.parametrize("larger", [0.5, 1.1])
def test_different_scenes_are_reported_from_a_hundred_pixels(larger):
    pair, (left, right) = small_pair((12, 9), 0.4)
    other = {**right, "depth": larger * right["depth"]}
    (finding,) = consistency.check_shared_points((left, other), pair, (0, 1))
    assert "are at a depth that the other view has there" in finding


def shifted(truth, camera, pose, du, dv):
    """A view's truth shifted by whole pixels, with positions consistent with the new pixels."""
    moved = {
        key: np.roll(value, (dv, du), (0, 1)) if np.ndim(value) > 1 else value
        for key, value in truth.items()
    }
    return as_seen_by(moved, camera, pose)


def as_seen_by(truth, camera, pose):
    hit = truth["object_id"] > 0
    rays = camera.unproject(camera.pixel_grid())
    points = geometry.transform_points(
        pose, np.where(hit, truth["depth"], 1.0)[..., None] * rays
    )
    return {**truth, "position": np.where(hit[..., None], points, np.inf)}


@pytest.mark.parametrize("views", [(0, 1), (1, 0)])
@pytest.mark.parametrize(
    ("wall", "step", "axis"),
    [
        ((0.1, 0.05, 1.0), (1, 0), "u"),
        ((0.1, 0.05, 1.0), (-1, 0), "u"),
        ((0.02, 0.2, 1.0), (0, 1), "v"),
    ],
)
def test_a_view_shifted_by_a_pixel_is_reported(monkeypatch, wall, step, axis, views):
    monkeypatch.setattr(dataset_scene, "WALL", np.array(wall) / 4.0)
    pair = rig(width=120, height=90)
    truths = [vars(truth) for truth in dataset_scene.truths(pair)]
    here, there = (truths[i] for i in views)
    camera, pose = pair.cameras[views[1]], pair.world_from_cams[views[1]]
    assert consistency.check_shared_points((here, there), pair, views) == []
    moved = shifted(there, camera, pose, *step)
    (finding,) = consistency.check_shared_points((here, moved), pair, views)
    assert f" px along {axis} against the other view's surfaces" in finding


def test_a_view_with_another_pixel_convention_is_reported():
    """Pixel centres at integers in one view and at halves in the other."""
    pair, other = (rig(width=120, height=90, doffs=doffs) for doffs in (1.25, 1.75))
    left, right = (
        vars(dataset_scene.truths(pair)[0]),
        vars(dataset_scene.truths(other)[1]),
    )
    (finding,) = consistency.check_shared_points(
        (left, as_seen_by(right, pair.cameras[1], pair.world_from_cams[1])),
        pair,
        (0, 1),
    )
    assert " px along u against the other view's surfaces" in finding


@pytest.mark.parametrize("bend", [0.0, 0.005, 0.02])
def test_views_of_a_curved_wall_have_no_findings(bend):
    """Only flat surfaces are tested: curvature is not mistaken for a shift."""
    pair = Rig.stereo(Camera.from_fov(160, 120, 60), 0.1)
    truths = [
        waving(camera, x, bend)
        for camera, x in zip(pair.cameras, (0.0, 0.1), strict=True)
    ]
    assert consistency.check_shared_points((truths[0], truths[1]), pair, (0, 1)) == []
    assert consistency.check_shared_points((truths[1], truths[0]), pair, (1, 0)) == []


def waving(camera, x, bend):
    """z = 2 + 0.3 X + bend sin(60 X) in the left camera's frame, seen from (x, 0, 0), by fixed-point steps."""
    rays = camera.unproject(camera.pixel_grid())
    z = np.full(rays.shape[:2], 2.0)
    for _ in range(400):
        across = x + z * rays[..., 0]
        z += 0.05 * (2.0 + 0.3 * across + bend * np.sin(60.0 * across) - z)
    points = z[..., None] * rays + [x, 0.0, 0.0]
    px = camera.project(points - [0.1 - x, 0.0, 0.0])
    return {
        "depth": z,
        "position": points,
        "object_id": np.ones(z.shape, int),
        "visible": camera.contains(px),
    }


def test_objects_that_differ_from_the_object_ids_are_reported(loose):
    with dataset_scene.edited(loose.folder) as record:
        record["objects"][0][1]["visible_pixel_count"] -= 1
    (finding,) = verify_sample(loose)
    assert finding.startswith("sample.json: objects[0]: object 2 differs from the obj")


def test_a_record_with_another_rig_is_reported(loose):
    with dataset_scene.edited(loose.folder) as record:
        record["rig"]["cameras"][0]["cx"] += 0.5
    findings = verify_sample(loose)
    assert findings[0].startswith("calib.txt: cam0 is")
    assert any(
        line.startswith("truth0.exr: position does not project to its pixel")
        for line in findings
    )
