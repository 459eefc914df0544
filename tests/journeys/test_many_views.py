"""From a recipe with an orbit to what COLMAP, nerfstudio and ROS read, by the blocks of docs/multiview.md alone."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest

import twinlens as tl
from tests.docs.pages import blocks, run_block
from twinlens.dataset.verify import verify_sample

PAGE = Path(__file__).parents[2] / "docs" / "multiview.md"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not next to tests/")
COUNT = 8
SMALL = {
    "width = 640\nheight = 480": "width = 64\nheight = 48",
    "spp = 16": "spp = 4\ndenoise = false",
    "count = 24": f"count = {COUNT}",
}
FEWEST = 500  # points


def tables():
    """The scene, the recipe and the other rigs of the page."""
    return [text for _, text in blocks(PAGE, "toml")]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder in which the commands of the page have run, with small images."""
    folder = tmp_path_factory.mktemp("views")
    scene, recipe, *_ = tables()
    (folder / "turntable.toml").write_text(scene)
    for large, small in SMALL.items():
        assert large in recipe
        recipe = recipe.replace(large, small)
    (folder / "orbit.toml").write_text(recipe)
    for block in blocks(PAGE, "sh"):
        run_block(*block, folder)
    return folder


def test_the_other_rigs_of_the_page_are_read(tmp_path):
    scene, _, *rigs = tables()
    (tmp_path / "turntable.toml").write_text(scene)
    loaded = tl.load_scene(tmp_path / "turntable.toml")
    counts = []
    for text in rigs:
        (tmp_path / "rig.toml").write_text(text.replace("[rig]\n", ""))
        table = tl.scenes.read_toml(tmp_path / "rig.toml")
        counts.append(len(tl.scenes.rig_from_table(table, loaded, 64, 48)))
    assert counts == [100, 60]


@pytest.mark.slow
def test_the_orbit_is_around_the_point_that_the_scene_looks_at(folder):
    (sample,) = tl.Dataset(folder / "orbit")
    assert verify_sample(sample) == []
    assert len(sample.rig) == COUNT
    assert {sample.rig.cameras[0]} == set(sample.rig.cameras)
    loaded = tl.load_scene(folder / "turntable.toml")
    centre = loaded.world_from_left @ [0, 0, 2.4, 1]
    eyes = np.array([pose[:3, 3] for pose in sample.rig.world_from_cams])
    away = eyes - centre[:3]
    assert np.linalg.norm(away, axis=1) == pytest.approx([2.4] * COUNT)
    assert away[:, 2] == pytest.approx([2.4 * np.sin(np.radians(30))] * COUNT)
    # One camera: no mismatch between the views, and no error of its calibration.
    assert sample.photographed_by.calibrated is None


@pytest.mark.slow
def test_pycolmap_reads_points_that_the_scene_has(folder):
    """Every track against rays of the scene itself: points on its surfaces, views that see them, pixels below 1e-3."""
    (sample,) = tl.Dataset(folder / "orbit")
    loaded = tl.load_scene(folder / "turntable.toml")
    model = pycolmap.Reconstruction(
        folder / "orbit-colmap" / sample.name / "sparse" / "0"
    )
    assert model.num_images() == COUNT
    assert model.num_points3D() > FEWEST
    worst = 0.0
    num_views = {number: set() for number in model.points3D}
    for view in range(COUNT):
        image = model.images[view + 1]
        seen = [point for point in image.points2D if point.has_point3D()]
        for point in seen:
            at = image.project_point(model.points3D[point.point3D_id].xyz)
            worst = max(worst, np.abs(at - point.xy).max())
            num_views[point.point3D_id].add(view)
    assert worst < 1e-3
    hidden = total = 0
    for source in range(COUNT):
        pixels = {}
        for point in model.images[source + 1].points2D:
            u, v = point.xy - 0.5
            if max(abs(u - round(u)), abs(v - round(v))) < 1e-3:
                pixels[round(u), round(v)] = point.point3D_id
        at = np.array(list(pixels))
        for target in set(range(COUNT)) - {source}:
            exact = tl.correspondence(loaded, sample.rig, source, target)
            for (u, v), number in zip(at, pixels.values(), strict=True):
                if target in num_views[number]:
                    total += 1
                    hidden += not exact.visible[v, u]
    assert total > FEWEST
    assert hidden == 0


@pytest.mark.slow
def test_the_workspace_and_the_other_exports_are_whole(folder, tmp_path):
    (sample,) = tl.Dataset(folder / "orbit")
    options = pycolmap.StereoFusionOptions(min_num_pixels=2, num_threads=1)
    workspace = folder / "orbit-colmap" / sample.name
    fused = pycolmap.stereo_fusion(tmp_path, workspace, options=options)
    assert fused.num_points3D() > FEWEST
    text = (folder / "orbit-nerfstudio" / sample.name / "transforms.json").read_text()
    table = json.loads(text)
    assert len(table["frames"]) == COUNT
    assert len(table["test_filenames"]) == 1
    assert (folder / "orbit-ros" / "bag-00000" / "bag-00000.mcap").is_file()
    for kind, block in blocks(PAGE, "python"):
        printed = run_block(kind, block, folder)
        assert (
            "of view 0 is visible in view 2" in printed or "num_images = 8" in printed
        )
