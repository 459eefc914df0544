"""`twinlens show`: the pictures of epipolar geometry and of costs, their numbers, and refusals."""

import json
from pathlib import Path

import numpy as np
import pytest

import twinlens as tl
from twinlens.dataset import Dataset, read_png
from twinlens.scoring import load_pair


def test_points_are_true_matches_on_their_epipolar_lines(twinlens, dataset, tmp_path):
    code, out, _ = twinlens(
        "show", "epipolar", dataset / "cards", "-o", tmp_path / "e.png", "--points", 4
    )
    assert (code, "4 true matches" in out) == (0, True)
    assert read_png(tmp_path / "e.png").shape == (48, 2 * 64 + 12, 3)
    code, out, _ = twinlens(
        "show", "epipolar", dataset, "-o", tmp_path / "e.png", "--json"
    )
    record = json.loads(out)
    assert max(record["off_px"]) < 1e-4
    stored = Dataset(dataset)[0]
    for (u, v), (u2, v2) in zip(
        record["points"]["a"], record["points"]["b"], strict=True
    ):
        assert u - u2 == pytest.approx(stored.disp0[round(v), round(u)], abs=1e-3)
        assert v == pytest.approx(v2, abs=1e-3)


MOVING = Path(__file__).parents[2] / "docs" / "motion.toml"


def test_flow_is_drawn_without_images(twinlens, tmp_path):
    """The ball of docs/motion.toml moves 0.3 m to the right in 0.2 s, and turns as it rolls."""
    line = ("show", "flow", MOVING, "--target", "0@0.2", "--size", "48x36")
    code, out, _ = twinlens(*line, "-o", tmp_path / "f.png")
    assert (code, out.count("\n")) == (0, 1)
    picture = read_png(tmp_path / "f.png")
    assert picture.shape == (36, 48, 3)
    is_red = (picture[..., 0] == 255) & (picture[..., 1:] < 128).all(axis=-1)
    assert is_red.sum() > 20
    assert (picture[0] == 255).all()  # the wall stands still
    record = json.loads(twinlens(*line, "-o", tmp_path / "f.png", "--json")[1])
    scene = tl.load_scene(MOVING)
    camera = tl.Camera.from_fov(48, 36, fov_x_deg=50)
    rig = tl.Rig.stereo(camera, 0.1, scene.world_from_left)
    answer = tl.correspondence(scene, rig, (0, 0.0), (0, 0.2))
    longest = np.linalg.norm(answer.flow[answer.visible], axis=-1).max()
    assert record["largest_px"] >= longest > 3
    assert record["visible"] == answer.visible.mean()
    assert record["target"] == [0, 0.2]


def test_a_scene_that_moves_is_not_rendered(twinlens, tmp_path):
    code, out, error = twinlens("render", MOVING, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert "moves, and images and truth are of one time" in error
    assert not (tmp_path / "out").exists()


def test_costs_are_those_of_the_library(twinlens, dataset, tmp_path):
    line = ("show", "costs", dataset / "cards", "--at", "40,20", "--methods", "sad")
    code, out, _ = twinlens(*line, "-o", tmp_path / "c.png")
    assert (code, out.count("\n")) == (0, 2)
    assert read_png(tmp_path / "c.png").shape[1] == 1575
    stored = Dataset(dataset)[0]
    search = {"methods": ["sad", "sgm"], "num_disparities": stored.ndisp}
    first = tl.cost_curve(stored.im0, stored.im1, 40, 20, **search)["sad"]
    assert tl.scoring.reason_of(load_pair(stored), first).text in out

    record = json.loads(twinlens(*line, "--methods", "sgm", "--lens", 1, "--json")[1])
    assert record["truth"] == pytest.approx(float(stored.disp0[20, 40]))
    lens = stored.lens(1)
    curves = tl.cost_curve(lens.image(0), lens.image(1), 40, 20, **search)
    for name, curve in curves.items():
        shown = record["curves"][name]
        assert (shown["winner"], shown["rival"]) == (curve.winner, curve.rival)
        assert [float(cost) for cost in shown["costs"]] == pytest.approx(curve.costs)


def test_confidences_are_scored_as_by_evaluate(twinlens, dataset, tmp_path):
    line = ("show", "confidence", dataset / "cards", "--method", "sad:block_size=5")
    code, out, _ = twinlens(*line, "-o", tmp_path / "c.png")
    assert (code, out.count("\n")) == (0, 7)
    assert read_png(tmp_path / "c.png").ndim == 3
    record = json.loads(twinlens(*line, "--json")[1])
    stored = Dataset(dataset)[0]
    ndisp = stored.ndisp
    options = {"block_size": 5, "num_disparities": ndisp, "confidence": "curvature"}
    disparity, trust = tl.matching.match_with_confidence(
        stored.im0, stored.im1, "sad", **options
    )
    truth = (stored.disp0, stored.mask0_nonocc, ndisp)
    scores = tl.evaluate(disparity, *truth, confidence=trust).nonocc
    measured = record["measures"]["curvature"]
    assert measured["auc2.0"] == pytest.approx(scores["auc2.0"])
    assert record["pixels"] == scores.estimated
