"""Finding scenes, and what every bundled one promises."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes.scene_text import Read
from twinlens.camera import Camera, Rig
from twinlens.errors import FileError, InputError
from twinlens.scenes import (
    Bitmap,
    Material,
    Mesh,
    Scene,
    bundled_folder,
    bundled_headings,
    bundled_scenes,
    load_scene,
)

PROMISED = {"cards", "fence", "room", "spheres", "staircase", "tabletop"}


def test_the_documented_scenes_are_bundled() -> None:
    assert set(bundled_scenes()) >= PROMISED
    size = sum(
        path.stat().st_size for path in bundled_folder().rglob("*") if path.is_file()
    )
    assert size < 4_000_000


@pytest.mark.parametrize(
    ("wrong", "right"),
    [("stairs", "staircase"), ("Fence", "fence"), ("table", "tabletop")],
)
def test_an_unknown_name_suggests_the_nearest(wrong: str, right: str) -> None:
    with pytest.raises(
        InputError, match=f"unknown scene '{wrong}'; did you mean '{right}'"
    ):
        load_scene(wrong)


def test_paths_are_taken_as_files_and_folders(read_scene: Read, tmp_path: Path) -> None:
    written = read_scene()
    for path in (tmp_path, tmp_path / "scene.toml", str(tmp_path / "scene.toml")):
        assert load_scene(path).name == written.name
    with pytest.raises(FileError, match="no such scene file"):
        load_scene(tmp_path / "nothing.toml")
    (tmp_path / "scene.blend").write_text("")
    with pytest.raises(InputError, match=r"a scene is a \.toml or a Mitsuba \.xml"):
        load_scene(tmp_path / "scene.blend")


def test_loading_a_scene_imports_no_renderer() -> None:
    code = "import sys, twinlens as t; t.load_scene('staircase'); sys.exit(bool({'mitsuba', 'numba'} & {*sys.modules}))"
    subprocess.run([sys.executable, "-c", code], check=True, env={**os.environ})


@pytest.fixture(scope="module", params=sorted(PROMISED))
def bundled(request: pytest.FixtureRequest) -> Scene:
    return load_scene(request.param)


def test_a_heading_equals_the_scenes_data(bundled: Scene) -> None:
    (heading,) = (
        heading for heading in bundled_headings() if heading["name"] == bundled.name
    )
    for field in ("depth_range", "baseline", "description"):
        assert heading[field] == getattr(bundled, field)


def test_headings_draw_no_texture(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("twinlens.scenes.scene_file.SceneFile", None)
    assert [heading["name"] for heading in bundled_headings()] == bundled_scenes()


def test_a_bundled_scene_is_described_and_pictured(bundled: Scene) -> None:
    assert bundled.name in PROMISED
    assert len(bundled.description) > 40
    path = bundled_folder() / bundled.name / "picture.png"
    assert path.stat().st_size < 250_000
    with Image.open(path) as picture:
        assert picture.size == (480, 360)


def test_a_bundled_scene_is_physically_plausible(bundled: Scene) -> None:
    for thing in bundled.objects:
        if isinstance(thing.shape, Mesh):
            assert np.isfinite(thing.shape.vertices).all()
    for material in bundled.materials.values():
        for value in vars(material).values():
            if isinstance(value, Bitmap):
                assert 0 <= value.pixels.min() <= value.pixels.max() <= 1


def test_a_bundled_scene_names_no_plugin(bundled: Scene) -> None:
    """Every material can be rendered by others than Mitsuba."""
    kinds = {type(material) for material in bundled.materials.values()}
    assert kinds == {Material}


def test_the_depth_range_brackets_the_truth_and_disparities_are_useful(
    bundled: Scene,
) -> None:
    rendering = pytest.importorskip("twinlens.rendering")
    camera = Camera.from_fov(320, 240, fov_x_deg=bundled.fov_x_deg)
    rig = Rig.stereo(camera, bundled.baseline, bundled.world_from_left)
    near, far = bundled.depth_range
    for truth in rendering.ground_truth(bundled, rig):
        assert np.isfinite(
            truth.depth
        ).all()  # indoors or out, something is hit everywhere
        assert near <= truth.depth.min() <= 1.5 * near
        assert far / 1.5 <= truth.depth.max() <= far
        at_640 = 2 * truth.disparity
        assert at_640.min() >= 5
        assert at_640.max() <= 60
        assert truth.visible.mean() > 0.7
        assert len(np.unique(truth.object_id)) >= 10
