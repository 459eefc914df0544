"""`twinlens show`: the pictures of epipolar geometry and of costs, their numbers, and refusals."""

import json

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


def test_a_folder_without_truth_is_drawn_from_its_disparity_map(
    twinlens, dataset, tmp_path
):
    folder = tmp_path / "plain"
    folder.mkdir()
    for name in ("im0.png", "im1.png", "disp0.pfm", "calib.txt"):
        (folder / name).write_bytes((dataset / "cards" / name).read_bytes())
    assert twinlens("show", "epipolar", folder, "-o", tmp_path / "e.png")[0] == 0
    assert (
        twinlens(
            "show", "epipolar", folder, "-o", tmp_path / "e.png", "--cameras", "1,0"
        )[0]
        == 2
    )


@pytest.mark.parametrize("cameras", ["0", "0,0", "0,2", "a,b", "0,1,2"])
def test_bad_camera_pairs_are_refused(twinlens, dataset, tmp_path, cameras):
    code, _, err = twinlens(
        "show",
        "epipolar",
        dataset / "cards",
        "-o",
        tmp_path / "e.png",
        "--cameras",
        cameras,
    )
    assert code == 2
    assert "--cameras" in err


def test_missing_samples_and_unknown_subcommands_are_refused(
    twinlens, dataset, tmp_path
):
    assert (
        twinlens("show", "epipolar", tmp_path / "none", "-o", tmp_path / "e.png")[0]
        == 2
    )
    assert (
        twinlens("show", "epipolr", dataset / "cards", "-o", tmp_path / "e.png")[0] == 2
    )


def test_the_picture_must_end_in_png(twinlens, dataset, tmp_path):
    for name in ("e.jpg", "e"):
        code, _, err = twinlens(
            "show", "epipolar", dataset / "cards", "-o", tmp_path / name
        )
        assert (code, err.count("\n")) == (2, 1)
        assert "must end in .png" in err
        assert not (tmp_path / name).exists()
    assert (
        twinlens("show", "epipolar", dataset / "cards", "-o", tmp_path / "E.PNG")[0]
        == 0
    )


def test_costs_are_those_of_the_library(twinlens, dataset, tmp_path):
    place = dataset / "cards"
    code, out, _ = twinlens(
        "show",
        "costs",
        place,
        "--at",
        "40,20",
        "--methods",
        "sad,sgm",
        "-o",
        tmp_path / "c.png",
    )
    assert (code, out.count("\n")) == (0, 3)
    assert read_png(tmp_path / "c.png").shape[1] == 1575
    arguments = (
        "--at",
        "40,20",
        "--methods",
        "sad",
        "--methods",
        "sgm",
        "--lens",
        1,
        "--json",
    )
    record = json.loads(twinlens("show", "costs", place, *arguments)[1])
    stored = Dataset(dataset)[0]
    assert record["truth"] == pytest.approx(float(stored.disp0[20, 40]))
    images = stored.lens(1).image(0), stored.lens(1).image(1)
    curves = tl.cost_curve(
        *images, 40, 20, ["sad", "sgm"], num_disparities=stored.ndisp
    )
    for name, curve in curves.items():
        found = record["curves"][name]
        assert (found["winner"], found["rival"]) == (curve.winner, curve.rival)
        reason = tl.scoring.reason_of(load_pair(stored, 1), curve)
        assert found["reason"] == {"kind": reason.kind, "text": reason.text}
        assert [float(cost) for cost in found["costs"]] == pytest.approx(
            list(curve.costs)
        )
    first = tl.cost_curve(
        stored.im0, stored.im1, 40, 20, ["sad"], num_disparities=stored.ndisp
    )["sad"]
    assert (
        f"sad: winner {first.disparity:.2f} px (cost {first.costs.min():.4g}), rival {first.rival} px"
        in out
    )
    assert tl.scoring.reason_of(load_pair(stored), first).text in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--at", "64,0"),
            "--at must be U,V, a column from 0 to 63 and a row from 0 to 47, got '64,0'",
        ),
        (("--at", "1"), "--at must be U,V"),
        (("--at", "1,-2"), "--at must be U,V"),
        (("--at", "1,2", "--methods", "opencv_bm"), "opencv_bm has no cost curve"),
        (("--at", "1,2", "--lens", "2"), "--lens must be a whole number from 0 to 1"),
    ],
)
def test_wrong_pixels_and_methods_are_refused(
    twinlens, dataset, tmp_path, arguments, message
):
    code, _, err = twinlens(
        "show", "costs", dataset / "cards", *arguments, "-o", tmp_path / "c.svg"
    )
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert not (tmp_path / "c.svg").exists()


def test_costs_need_a_figure_or_json(twinlens, dataset):
    code, _, err = twinlens("show", "costs", dataset / "cards", "--at", "1,1")
    assert (code, err.count("\n")) == (2, 1)
    assert "--output" in err


def test_confidences_are_scored_as_by_evaluate(twinlens, dataset, tmp_path):
    arguments = "show", "confidence", dataset / "cards", "--method", "sad:block_size=5"
    code, out, _ = twinlens(*arguments, "-o", tmp_path / "c.png")
    assert (code, out.count("\n")) == (0, 7)
    assert read_png(tmp_path / "c.png").ndim == 3
    record = json.loads(twinlens(*arguments, "--json")[1])
    stored = Dataset(dataset)[0]
    options = {
        "block_size": 5,
        "num_disparities": stored.ndisp,
        "confidence": "curvature",
    }
    disparity, trust = tl.matching.match_with_confidence(
        stored.im0, stored.im1, "sad", **options
    )
    scores = tl.evaluate(
        disparity, stored.disp0, stored.mask0_nonocc, stored.ndisp, confidence=trust
    ).nonocc
    assert record["measures"]["curvature"]["auc2.0"] == pytest.approx(scores["auc2.0"])
    assert record["measures"]["curvature"]["sparsification"] == pytest.approx(
        scores.sparsification
    )
    assert (record["pixels"], record["auc2.0_opt"]) == (
        scores.estimated,
        pytest.approx(scores["auc2.0_opt"]),
    )


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (
            ("--method", "opencv_bm", "-o", "c.png"),
            "--method opencv_bm: this method has no cost volume",
        ),
        (
            ("--method", "sad:block_size=999", "-o", "c.png"),
            "--method sad:block_size=999: block_size is 999",
        ),
        (("--lens", "2", "-o", "c.png"), "--lens must be a whole number from 0 to 1"),
        ((), "--output"),
    ],
)
def test_confidences_that_cannot_be_drawn_are_refused(
    twinlens, dataset, monkeypatch, tmp_path, options, message
):
    monkeypatch.chdir(tmp_path)
    code, _, err = twinlens("show", "confidence", dataset / "cards", *options)
    assert (code, err.count("\n")) == (2, 1)
    assert message in err
    assert not (tmp_path / "c.png").exists()
