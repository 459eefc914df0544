"""Finding scenes, and what every bundled one promises."""

import subprocess
import sys

import numpy as np
import pytest
from PIL import Image

from tests.scenes.test_materials import check_translation
from twinlens.camera import Camera, Rig
from twinlens.errors import FileError, InputError
from twinlens.rendering import ground_truth
from twinlens.scenes import (
    Bitmap,
    Mesh,
    bundled_folder,
    bundled_headings,
    bundled_scenes,
    load_scene,
)

PROMISED = {
    "cards",
    "corner",
    "fence",
    "room",
    "spheres",
    "staircase",
    "tabletop",
    "yard",
}


def test_the_documented_scenes_are_bundled():
    assert set(bundled_scenes()) >= PROMISED
    files = [path for path in bundled_folder().rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 4_000_000


def test_paths_are_taken_as_files_and_folders(read_scene, tmp_path):
    written = read_scene()
    for path in (tmp_path, tmp_path / "scene.toml", str(tmp_path / "scene.toml")):
        assert load_scene(path).name == written.name


MISSING = {
    "stairs": "unknown scene 'stairs'; did you mean 'staircase'",
    "Fence": "unknown scene 'Fence'; did you mean 'fence'",
    "nothing.toml": "no such scene file",
    "scene.blend": r"a scene is a \.toml or a Mitsuba \.xml",
}


@pytest.mark.parametrize("name", MISSING)
def test_what_is_no_scene_is_an_error(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "scene.blend").touch()
    with pytest.raises(InputError, match=MISSING[name]) as caught:
        load_scene(name)
    assert isinstance(caught.value, FileError) == (name == "nothing.toml")


def test_loading_a_scene_imports_no_renderer(read_scene, tmp_path):
    read_scene("materials.grey.reflectance = { type = 'checker', cells = 2 }")
    code = "import sys, twinlens as t; t.load_scene('.'); sys.exit(bool({'mitsuba', 'numba'} & {*sys.modules}))"
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path)


@pytest.fixture(scope="module", params=sorted(PROMISED))
def bundled(request):
    return load_scene(request.param)


def test_headings_draw_no_texture(monkeypatch):
    monkeypatch.setattr("twinlens.scenes.scene_file.SceneFile", None)
    assert [heading["name"] for heading in bundled_headings()] == bundled_scenes()


def test_a_bundled_scene_is_described_and_pictured(bundled):
    headings = {heading["name"]: heading for heading in bundled_headings()}
    for field, value in headings[bundled.name].items():
        assert value == getattr(bundled, field)
    assert len(bundled.description) > 40
    path = bundled_folder() / bundled.name / "picture.png"
    assert path.stat().st_size < 250_000
    with Image.open(path) as picture:
        assert picture.size == (480, 360)


def test_a_bundled_scene_is_physically_plausible(bundled):
    for item in bundled.objects:
        if isinstance(item.shape, Mesh):
            assert np.isfinite(item.shape.vertices).all()
    for material in bundled.materials.values():
        for value in vars(material).values():
            if isinstance(value, Bitmap):
                assert 0 <= value.pixels.min() <= value.pixels.max() <= 1


def test_a_bundled_scene_can_be_rendered_by_others_than_mitsuba(bundled):
    check_translation(bundled)


def test_the_depth_range_brackets_the_truth_and_disparities_are_useful(bundled):
    camera = Camera.from_fov(160, 120, fov_x_deg=bundled.fov_x_deg)
    rig = Rig.stereo(camera, bundled.baseline, bundled.world_from_left)
    near, far = bundled.depth_range
    for truth in ground_truth(bundled, rig):
        # Indoors or out, something is hit everywhere.
        assert np.isfinite(truth.depth).all()
        assert near <= truth.depth.min() <= 1.5 * near
        assert far / 1.5 <= truth.depth.max() <= far
        at_640 = 4 * truth.disparity
        assert at_640.min() >= 5
        assert at_640.max() <= 60
        assert truth.visible.mean() > 0.7
        assert len(np.unique(truth.object_id)) >= 10
