"""`twinlens score`: options without effect are refused, and --json prints valid JSON."""

import json
import math
import shutil

import numpy as np
import pytest

import twinlens as tl
from twinlens.cli.boards import run_board
from twinlens.dataset import write_pfm
from twinlens.dataset.files import locked
from twinlens.scoring import Pair, caption, open_submission, read_board
from twinlens.scoring.board_file import board_from_json


@pytest.fixture
def maps(tmp_path):
    """One map, its truth, and a folder of maps."""
    write_pfm(tmp_path / "d.pfm", np.full((4, 5), np.inf, np.float32))
    write_pfm(tmp_path / "gt.pfm", np.full((4, 5), 3, np.float32))
    write_pfm(tmp_path / "mine.pfm" / "s.pfm", np.full((4, 5), 3, np.float32))
    return tmp_path


@pytest.mark.parametrize(
    "extra", [("--region", "all"), ("-o", "board"), ("--time-limit", "3")]
)
def test_one_map_refuses_options_of_boards(twinlens, maps, extra):
    code, out, err = twinlens(
        "score", maps / "d.pfm", "--truth", maps / "gt.pfm", *extra
    )
    assert (code, out) == (2, "")
    assert extra[0] in err
    assert err.count("\n") == 1


def test_one_map_has_no_calibration(twinlens, maps):
    code, _, err = twinlens(
        "score", maps / "d.pfm", "--truth", maps / "gt.pfm", "--protocol", "points"
    )
    assert (code, err.count("\n")) == (2, 1)
    assert (
        "--protocol points: needs the pair's calibration; score a folder of maps, with --truth DATASET"
        in err
    )


@pytest.mark.parametrize("extra", [(), ("-o", "board")])
def test_one_map_needs_a_truth_map(twinlens, maps, extra):
    code, _, err = twinlens("score", maps / "d.pfm", "--truth", maps, *extra)
    assert code == 2
    assert (
        f"{maps} is a dataset, and {maps / 'd.pfm'} is one map: give one truth map"
        in err
    )


@pytest.mark.parametrize(
    "extra",
    [
        ("--mask", "m.png"),
        ("--ndisp", "8"),
        ("--min-disparity", "-8"),
        ("--time-limit", "3"),
    ],
)
def test_boards_refuse_options_of_one_map(twinlens, maps, extra):
    """Also if a folder is named like a map."""
    code, out, err = twinlens(
        "score",
        maps / "mine.pfm",
        "--truth",
        "motorcycle",
        "-o",
        maps / "board",
        *extra,
    )
    assert (code, out) == (2, "")
    assert extra[0] in err
    assert err.count("\n") == 1
    assert not (maps / "board").exists()


@pytest.mark.parametrize(
    ("extra", "totbad"), [((), 0), (("--ndisp", 3), 0), (("--min-disparity", 0), 100)]
)
def test_a_perfect_map_of_negative_disparities_is_perfect(
    twinlens, maps, extra, totbad
):
    write_pfm(maps / "n.pfm", np.full((4, 5), -4.5, np.float32))
    _, out, _ = twinlens(
        "score", maps / "n.pfm", "--truth", maps / "n.pfm", "--json", *extra
    )
    assert json.loads(out)["regions"]["all"]["totbad2.0"] == totbad


def test_an_earlier_map_is_dropped_after_a_failure(maps):
    image, gt = np.zeros((4, 5), np.uint8), np.full((4, 5), 3, np.float32)
    pairs, folder = [Pair("s", image, image, gt, None, 8)], maps / "mine"
    kept = maps / "board" / "maps" / "s" / "mine.pfm"
    for shape in ((4, 5), (4, 6)):
        write_pfm(folder / "s.pfm", np.full(shape, 3, np.float32))
        board = run_board(
            pairs, [open_submission(folder)], maps / "board", ["middlebury-v3"], ["all"]
        )
        assert board.entries[0].ok == kept.exists() == (shape == gt.shape)


@pytest.mark.parametrize(
    ("protocol", "avgerr"), [("middlebury-v3", None), ("eth3d", "inf")]
)
def test_a_metric_without_a_number_is_still_json(twinlens, maps, protocol, avgerr):
    arguments = (
        "score",
        maps / "d.pfm",
        "--truth",
        maps / "gt.pfm",
        "--protocol",
        protocol,
        "--json",
    )
    code, out, _ = twinlens(*arguments)
    found = json.loads(out, parse_constant=pytest.fail)["regions"]["all"]
    assert code == 0
    assert (found["avgerr"], found["coverage"], found["evaluated"]) == (avgerr, 0, 20)
    assert all(
        value is None or value == "inf" or math.isfinite(value)
        for value in found.values()
    )


def test_missing_maps_are_counted_and_named(twinlens, dataset, tmp_path):
    """One of three maps exists, under the sample's plain name."""
    truth = tl.Dataset(dataset)[0].disp0
    write_pfm(tmp_path / "mine" / "cards.pfm", truth)
    arguments = (
        "score",
        tmp_path / "mine",
        "--truth",
        dataset,
        "--truth",
        "motorcycle",
        "-o",
        tmp_path / "b",
        "--json",
    )
    code, out, err = twinlens(*arguments)
    found = {e["sample"]: e["failure"] for e in json.loads(out)["entries"]}
    assert code == 0
    assert [failure and failure["kind"] for failure in found.values()] == [
        None,
        "missing",
        "missing",
    ]
    assert err == "mine: missing maps: 2 of 3 (cards/lens-1.pfm, motorcycle.pfm)\n"


def test_unmatched_maps_are_counted_and_named(twinlens, dataset, tmp_path):
    """The first three are printed; the JSON, which is still a board, lists all."""
    truth = tl.Dataset(dataset)[0].disp0
    for name in (
        "cards/lens-0",
        "cards/lens-1",
        "card",
        "cards/lens-2",
        "crads/lens-0",
        "fence",
    ):
        write_pfm(tmp_path / "mine" / f"{name}.pfm", truth)
    arguments = ("score", tmp_path / "mine", "--truth", dataset, "-o", tmp_path / "b")
    code, out, err = twinlens(*arguments, "--json")
    assert code == 0
    names = "card.pfm, cards/lens-2.pfm, crads/lens-0.pfm and 1 more"
    assert err == f"mine: maps that match no sample: 4 ({names})\n"
    unscored = ["card.pfm", "cards/lens-2.pfm", "crads/lens-0.pfm", "fence.pfm"]
    assert json.loads(out)["unscored"] == {"mine": unscored}
    assert board_from_json(out) == read_board(tmp_path / "b" / "board.json")
    for name in unscored[1:]:
        (tmp_path / "mine" / name).unlink()
    assert twinlens(*arguments)[2] == "mine: maps that match no sample: 1 (card.pfm)\n"
    (tmp_path / "mine" / unscored[0]).unlink()
    code, out, err = twinlens(*arguments, "--json")
    assert (code, err, json.loads(out)["unscored"]) == (0, "", {"mine": []})


@pytest.mark.parametrize("word", ["folder", "motorcycle"])
def test_one_map_against_a_dataset_is_refused(twinlens, maps, dataset, word):
    truth = dataset if word == "folder" else word
    code, out, err = twinlens("score", maps / "d.pfm", "--truth", truth)
    assert (code, out) == (2, "")
    assert f"{truth} is a dataset" in err
    assert "one truth map" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("turned", [False, True])
def test_one_map_that_matches_two_datasets_is_refused(
    twinlens, maps, dataset, tmp_path, turned
):
    """cards.pfm matches the first lens of one dataset's `cards`, and the other dataset's `cards`."""
    other = tmp_path / "other"
    assert (
        twinlens(
            "render",
            "cards",
            "--size",
            "64x48",
            "--spp",
            "2",
            "--no-denoise",
            "-o",
            other,
        )[0]
        == 0
    )
    write_pfm(tmp_path / "mine" / "cards.pfm", tl.Dataset(dataset)[0].disp0)
    truths = (other, dataset) if turned else (dataset, other)
    options = [word for truth in truths for word in ("--truth", truth)]
    code, out, err = twinlens(
        "score", tmp_path / "mine", *options, "-o", tmp_path / "board"
    )
    assert (code, out) == (2, "")
    assert "cards.pfm matches both" in err
    assert "'cards'" in err
    assert not (tmp_path / "board").exists()
    write_pfm(tmp_path / "mine" / "cards" / "lens-0.pfm", tl.Dataset(dataset)[0].disp0)
    code, _, err = twinlens(
        "score", tmp_path / "mine", *options, "-o", tmp_path / "board"
    )
    assert (code, err) == (0, "mine: missing maps: 1 of 3 (cards/lens-1.pfm)\n"), (
        "each has a file of its own now"
    )


def test_a_board_locked_by_another_run_is_not_changed(twinlens, dataset, tmp_path):
    """Also before the first pair, when there is no board.json yet."""
    board = tmp_path / "board"
    maps = board / "maps" / "cards"
    maps.mkdir(parents=True)
    commands = (
        ("benchmark", dataset, "--methods", "sad"),
        ("score", maps, "--truth", dataset),
    )
    with locked(board):
        before = sorted(board.rglob("*"))
        for command in commands:
            code, out, err = twinlens(*command, "-o", board)
            assert (code, out) == (2, "")
            assert (
                err == f"twinlens: {board}: another run is writing there; wait for it\n"
            )
        assert sorted(board.rglob("*")) == before


def test_boards_one_after_the_other_are_one_board(twinlens, dataset, tmp_path):
    for method in ("sad", "ssd"):
        assert (
            twinlens(
                "benchmark", dataset, "--methods", method, "-o", tmp_path / "board"
            )[0]
            == 0
        )
        assert sorted(path.name for path in (tmp_path / "board").iterdir()) == [
            "board.json",
            "index.html",
            "maps",
        ]
    entries = json.loads((tmp_path / "board" / "board.json").read_text())["entries"]
    assert {entry["method"] for entry in entries} == {"sad", "ssd"}


def test_a_table_without_terminal_is_not_truncated(twinlens, dataset, tmp_path):
    maps = tmp_path / ("m" * 200)
    for name in ("lens-0.pfm", "lens-1.pfm"):
        (maps / "cards").mkdir(parents=True, exist_ok=True)
        (maps / "cards" / name).write_bytes(
            (dataset / "cards" / "disp0.pfm").read_bytes()
        )
    code, out, err = twinlens(
        "score",
        maps,
        "--truth",
        dataset,
        "-o",
        tmp_path / "board",
        "--protocol",
        "eth3d",
    )
    assert code == 0, err
    lines = out.splitlines()
    assert sum(maps.name in line for line in lines) == 1
    assert lines == [line.rstrip() for line in lines]
    board = read_board(tmp_path / "board" / "board.json")
    assert set(caption(board, "eth3d", "nonocc").splitlines()) <= set(lines)


def test_matches_before_a_damaged_sample_are_kept(twinlens, dataset, tmp_path):
    copy = tmp_path / "set"
    shutil.copytree(dataset, copy)
    image = next(copy.glob("cards/lens-*/im1.png"))
    whole = image.read_bytes()
    image.write_bytes(whole[:50])
    command = ("benchmark", copy, "--methods", "sad", "-o", tmp_path / "board")
    code, out, err = twinlens(*command)
    assert (code, out) == (2, "")
    assert str(image) in err
    board = tmp_path / "board" / "board.json"
    assert err.endswith(
        f"; 1 finished matches are in {board}: fix this and rerun to resume\n"
    )
    first = json.loads(board.read_text())["entries"]
    assert len(first) == 1
    image.write_bytes(whole)
    assert twinlens(*command)[0] == 0
    assert json.loads(board.read_text())["entries"][0] == first[0]
