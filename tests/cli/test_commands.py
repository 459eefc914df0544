"""Normal use of each command; see test_refusals for invalid input."""

import json

import numpy as np
import pytest

import twinlens as tl
from tests.cli.conftest import QUICK
from twinlens.camera.presets import CAMERAS
from twinlens.cli import COMMANDS, run
from twinlens.dataset import read_pfm
from twinlens.matching import METHODS
from twinlens.scoring import read_board
from twinlens.studies.run import STUDIES


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(twinlens, name):
    code, out, _ = twinlens(name, "--help")
    assert code == 0
    assert f"Example:  twinlens {name}" in out
    assert "[default: (" not in out
    assert twinlens(name, "-h") == (code, out, "")


def test_match_then_score(twinlens, dataset, tmp_path):
    sample = dataset / "cards"
    code, _, _ = twinlens(
        "match", sample / "im0.png", sample / "im1.png", "--num-disparities", "16", "--method", "sad:block_size=5",
        "-o", tmp_path / "d.pfm", "--picture", tmp_path / "d.png",
    )  # fmt: skip
    assert code == 0
    assert read_pfm(tmp_path / "d.pfm").shape == (48, 64)
    assert (tmp_path / "d.png").exists()
    code, out, _ = twinlens(
        "score", tmp_path / "d.pfm", "--truth", sample / "disp0.pfm", "--json"
    )
    direct = tl.evaluate(read_pfm(tmp_path / "d.pfm"), read_pfm(sample / "disp0.pfm"))
    assert code == 0
    assert json.loads(out)["regions"]["all"]["bad2.0"] == direct.all["bad2.0"]


@pytest.fixture(scope="module")
def other(tmp_path_factory):
    """A dataset whose sample has the name of the fixture `dataset`'s, and other images."""
    folder = tmp_path_factory.mktemp("rendered") / "other"
    lenses = ("--lens", "pinhole", "--lens", "thin:30")
    assert (
        run(["render", "cards", *lenses, *QUICK, "--seed", "1", "-o", str(folder)]) == 0
    )
    return folder


def test_samples_that_are_not_the_board_s_are_refused(
    twinlens, dataset, other, tmp_path
):
    board, page = tmp_path / "board", tmp_path / "page.html"
    assert twinlens("benchmark", dataset, "--methods", "sad", "-o", board)[0] == 0
    before = (board / "board.json").read_bytes()
    changed = "is not the one that the board scores"
    foreign = "motorcycle: none of its samples is on the board"
    for line, words in (
        (("benchmark", other, "--methods", "sad", "-o", board), changed),
        (("report", board, other, "-o", page), changed),
        (("report", board, dataset, "motorcycle", "-o", page), foreign),
        (("report", board, dataset, "-o", tmp_path / "a.txt"), "must end in .html"),
    ):
        code, out, err = twinlens(*line)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    assert (board / "board.json").read_bytes() == before
    assert not page.exists()
    (board / "index.html").unlink()
    assert twinlens("report", board, dataset, "-o", page)[0] == 0
    assert twinlens("report", board)[0] == 0
    assert page.exists()
    assert (board / "index.html").exists()


def test_samples_of_one_name_in_two_datasets_are_named_after_their_datasets(
    twinlens, dataset, other, tmp_path
):
    sets = (dataset, other, "motorcycle")
    code, _, err = twinlens(
        "benchmark", *sets, "--methods", "sad", "-o", tmp_path / "board"
    )
    assert code == 0, err
    entries = read_board(tmp_path / "board" / "board.json").entries
    names = {"out/cards · pinhole", "other/cards · pinhole", "motorcycle"}
    assert names <= {entry.sample for entry in entries}
    code, out, _ = twinlens("statistics", dataset, other)
    assert code == 0
    assert "4 pairs" in out


def test_a_folder_of_maps_is_scored_like_a_method(twinlens, dataset, tmp_path):
    board, other = tmp_path / "board", tmp_path / "other"
    twinlens("benchmark", dataset, "--methods", "sad", "-o", board)
    line = ("score", board / "maps", "--truth", dataset, "-o", other)
    assert twinlens(*line)[0] == 0
    regions = []
    for folder in (board, other):
        entries = json.loads((folder / "board.json").read_text())["entries"]
        regions.append({entry["sample"]: entry["regions"] for entry in entries})
    assert regions[0] == regions[1]


def test_lists_name_everything_there_is(twinlens):
    for line, key, names in (
        (("scenes",), "name", tl.bundled_scenes()),
        (("methods",), "method", METHODS),
        (("study", "list"), "name", STUDIES),
    ):
        rows = json.loads(twinlens(*line, "--json")[1])
        listed = list(rows) if isinstance(rows, dict) else [row[key] for row in rows]
        assert sorted(listed) == sorted(names)
        assert all(name in twinlens(*line)[1] for name in names)
    shown = twinlens("cameras")[1]
    for preset in CAMERAS.values():
        assert preset.description in shown
        assert preset.source in shown
    for camera in json.loads(twinlens("cameras", "--json")[1])["cameras"]:
        assert camera["baseline"] == CAMERAS[camera["name"]].baseline


@pytest.mark.parametrize(
    ("coefficients", "half_deg"),
    [
        # cv2.fisheye: the angle is the distance from the centre over f where all k are 0.
        ("fisheye = true", (np.degrees(64 / 60), np.degrees(48 / 60))),
        ("fisheye = false", (np.degrees(np.arctan2(64, 60)), np.degrees(np.arctan2(48, 60)))),
    ],
)  # fmt: skip
def test_cameras_prints_the_fields_of_view_of_a_fisheye(
    twinlens, tmp_path, coefficients, half_deg
):
    """And reads the .toml file that it advises to write."""
    matrix = "[[60, 0, 63.5], [0, 60, 47.5], [0, 0, 1]]"
    (tmp_path / "stereo.yml").write_text(
        f"image_width: 128\nimage_height: 96\nM1: {matrix}\nM2: {matrix}\nD1: [0, 0, 0, 0]\nD2: [0, 0, 0, 0]\n"
        "R: [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\nT: [-0.1, 0, 0]\n"
    )
    path = tmp_path / "rig.toml"
    path.write_text(f'file = "stereo.yml"\n{coefficients}\n')
    code, out, err = twinlens("cameras", "--read", str(path), "--json")
    assert code == 0, err
    for camera in json.loads(out)["cameras"]:
        assert camera["field_deg"] == pytest.approx([2 * half for half in half_deg])


def test_doctor_reports_a_missing_package(twinlens, monkeypatch):
    from twinlens.cli import doctor

    monkeypatch.setattr(doctor, "_PACKAGES", ("numpy", "no-such-package"))
    code, out, _ = twinlens("doctor")
    assert code == 0
    assert "no-such-package missing" in out


def test_the_exit_code_is_1_only_if_every_method_failed(twinlens, dataset, tmp_path):
    """A function that does not accept images fails; a matcher in the same run succeeds."""
    bad = "function:function=math:cos"
    line = ("benchmark", dataset, "-o", tmp_path / "board", "--methods")
    code, out, _ = twinlens(*line, bad)
    assert code == 1
    assert "every method failed" in out
    assert (tmp_path / "board" / "index.html").exists()
    assert twinlens(*line, bad, "--json")[0] == 1
    assert twinlens(*line, f"{bad},sad")[0] == 0
