"""Samples of scenes that stand far from the origin: what is stored is as exact as near it."""

import numpy as np
import pytest

import twinlens as tl
from twinlens.dataset import Dataset, write_sample
from twinlens.dataset.verify import verify_sample
from twinlens.factory import Shoot, default_rig, make_sample

SCENE = """
[camera]
position = [{x}, {near}, {eye}]
look_at = [{x}, {y}, {z}]
depth_range = [1.0, 9.0]
[materials.grey]
type = "diffuse"
reflectance = {{ type = "checker", cells = 40 }}
[lights.sky]
type = "constant"
radiance = 1.0
[objects.ball]
shape = "icosphere"
radius = 0.5
subdivisions = 4
translate = [{x}, {y}, {z}]
material = "grey"
[objects.floor]
shape = "box"
extents = [4, 4, 0.1]
translate = [{x}, {y}, {floor}]
material = "grey"
"""


@pytest.mark.parametrize("place", [(408201.5848, 4080928.0166, 52.25), (0, -1e7, 0)])
def test_a_stored_sample_is_as_exact_far_from_the_origin(tmp_path, place):
    x, y, z = place
    text = SCENE.format(x=x, y=y, z=z, near=y - 3, eye=z + 0.6, floor=z - 0.55)
    path = tmp_path / "scene.toml"
    path.write_text(text)
    scene = tl.load_scene(path)
    rig = default_rig(scene, 64, 48)
    sample = make_sample(scene, rig, (tl.Pinhole(),), Shoot(spp=1, seed=0))
    write_sample(tmp_path / "sample", sample)
    (stored,) = Dataset(tmp_path)
    assert verify_sample(stored) == []
    for view, truth in enumerate(sample.truths):
        read = stored.truth(view)
        hit = truth.hit
        # float32 depths of 3 to 5 m are right to 2.4e-7 m, and float64 coordinates of 1e7 m to 1e-9 m.
        np.testing.assert_allclose(
            read.position[hit], truth.position[hit], rtol=0, atol=1e-6
        )
    seen = stored.correspondence(0, 1)
    both = truth.hit & np.isfinite(seen.pixels[..., 0]) & sample.truths[0].hit
    disparity = rig.cameras[0].pixel_grid()[..., 0] - seen.pixels[..., 0]
    expected = sample.truths[0].disparity
    np.testing.assert_allclose(disparity[both], expected[both], rtol=0, atol=1e-3)
