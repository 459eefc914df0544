"""`twinlens score`: options without effect are refused, and --json prints valid JSON."""

import json
import shutil

import numpy as np
import pytest

import twinlens as tl
from tests.dataset import dataset_scene
from twinlens.dataset import write_pfm, write_sample
from twinlens.dataset.files import locked
from twinlens.scoring import read_board
from twinlens.scoring.board_file import board_from_json


@pytest.fixture
def maps(tmp_path):
    """One map, its truth, and a folder of maps."""
    write_pfm(tmp_path / "d.pfm", np.full((4, 5), np.inf, np.float32))
    write_pfm(tmp_path / "gt.pfm", np.full((4, 5), 3, np.float32))
    write_pfm(tmp_path / "mine.pfm" / "s.pfm", np.full((4, 5), 3, np.float32))
    return tmp_path


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


def test_unmatched_maps_are_counted_and_named(twinlens, dataset, tmp_path):
    """The first three are printed; the JSON, which is still a board, lists all."""
    truth, mine = tl.Dataset(dataset)[0].disp0, tmp_path / "mine"
    unscored = ["card.pfm", "cards/lens-2.pfm", "crads/lens-0.pfm", "fence.pfm"]
    for name in ("cards/lens-0.pfm", "cards/lens-1.pfm", *unscored):
        write_pfm(mine / name, truth)
    line = ("score", mine, "--truth", dataset, "-o", tmp_path / "b")
    code, out, err = twinlens(*line, "--json")
    assert code == 0
    names = "card.pfm, cards/lens-2.pfm, crads/lens-0.pfm and 1 more"
    assert err == f"mine: maps that match no sample: 4 ({names})\n"
    assert json.loads(out)["unscored"] == {"mine": unscored}
    assert board_from_json(out) == read_board(tmp_path / "b" / "board.json")


def test_one_map_that_matches_two_datasets_is_refused(twinlens, dataset, tmp_path):
    """cards.pfm matches the first lens of one dataset's `cards`, and the other dataset's `cards`."""
    other, mine, board = (tmp_path / name for name in ("other", "mine", "board"))
    write_sample(other / "cards", dataset_scene.sample(width=64, height=48))
    truth = tl.Dataset(dataset)[0].disp0
    write_pfm(mine / "cards.pfm", truth)
    for first, second in ((other, dataset), (dataset, other)):
        line = ("score", mine, "--truth", first, "--truth", second, "-o", board)
        code, out, err = twinlens(*line)
        assert (code, out) == (2, "")
        assert "cards.pfm matches both" in err
        assert not board.exists()
    write_pfm(mine / "cards" / "lens-0.pfm", truth)
    code, _, err = twinlens(*line)
    missing = "mine: missing maps: 1 of 3 (cards/lens-1.pfm)\n"
    assert (code, err) == (0, missing), "each has a file of its own now"


def test_a_board_locked_by_another_run_is_not_changed(twinlens, dataset, tmp_path):
    """Also before the first pair, when there is no board.json yet."""
    board = tmp_path / "board"
    maps = board / "maps" / "cards"
    maps.mkdir(parents=True)
    error = f"twinlens: {board}: another run is writing there; wait for it\n"
    with locked(board):
        before = sorted(board.rglob("*"))
        for line in (
            ("benchmark", dataset, "--methods", "sad", "-o", board),
            ("score", maps, "--truth", dataset, "-o", board),
        ):
            assert twinlens(*line) == (2, "", error)
        assert sorted(board.rglob("*")) == before


def test_matches_before_a_damaged_sample_are_kept(twinlens, dataset, tmp_path):
    copy, board = tmp_path / "set", tmp_path / "board"
    shutil.copytree(dataset, copy)
    image = copy / "cards" / "lens-1" / "im1.png"
    whole = image.read_bytes()
    image.write_bytes(whole[:50])
    line = ("benchmark", copy, "--methods", "sad", "-o", board)
    code, out, err = twinlens(*line)
    assert (code, out) == (2, "")
    assert str(image) in err
    note = f"; 1 finished matches are in {board / 'board.json'}: fix this and rerun to resume\n"
    assert err.endswith(note)
    (first,) = read_board(board / "board.json").entries
    image.write_bytes(whole)
    assert twinlens(*line)[0] == 0
    again, _ = read_board(board / "board.json").entries
    assert again.seconds == first.seconds
