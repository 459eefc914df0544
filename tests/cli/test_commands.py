"""Normal use of each command; see test_refusals for invalid input."""

import json

import pytest

import twinlens as tl
from tests.cli.conftest import QUICK
from tests.factory_recipes import digests
from twinlens.cli import COMMANDS
from twinlens.dataset import read_pfm
from twinlens.scoring import read_board


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(twinlens, name):
    code, out, _ = twinlens(name, "--help")
    assert code == 0
    assert f"Example:  twinlens {name}" in out
    assert "[default: (" not in out
    assert twinlens(name, "-h") == (code, out, "")


def test_render_says_what_it_wrote_and_with_what(twinlens, tmp_path):
    line = ("render", "cards", *QUICK, "-o", tmp_path / "o", "--json")
    code, out, _ = twinlens(*line)
    answer = json.loads(out)
    assert code == 0
    assert answer["backend"] in ("llvm_ad_rgb", "cuda_ad_rgb")
    assert {"im0.png", "disp0.pfm", "truth1.exr"} <= set(answer["samples"][0]["files"])


def test_the_same_command_gives_the_same_bytes(twinlens, tmp_path):
    line = ("render", "cards", "--size", "32x24", "--spp", "2", "--seed", "7", "-o")
    for name in ("a", "b"):
        twinlens(*line, tmp_path / name / "set")
    assert len(digests(tmp_path / "a")) > 8
    assert digests(tmp_path / "a") == digests(tmp_path / "b")


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


def test_benchmark_makes_a_board_and_a_page(twinlens, dataset, tmp_path):
    board, methods = tmp_path / "board", "sad,zncc:block_size=5"
    line = ("benchmark", dataset, "--methods", methods, "-o", board)
    code, out, _ = twinlens(*line)
    assert code == 0
    assert "zncc:block_size=5" in out
    assert "page: file://" in out
    assert len(read_board(board / "board.json").entries) == 2 * 2
    assert (board / "index.html").stat().st_size > 10_000


def test_report_makes_the_page_of_a_board_or_of_its_folder(twinlens, dataset, tmp_path):
    board, page = tmp_path / "board", tmp_path / "page.html"
    twinlens("benchmark", dataset, "--methods", "sad", "-o", board)
    code, out, _ = twinlens("report", board / "board.json", dataset, "-o", page)
    assert code == 0
    assert page.exists()
    assert "page.html" in out
    (board / "index.html").unlink()
    assert twinlens("report", board)[0] == 0
    assert (board / "index.html").exists()
    code, _, err = twinlens("report", tmp_path)
    assert code == 2
    assert str(tmp_path / "board.json") in err


@pytest.fixture
def other(twinlens, tmp_path):
    """A dataset whose sample has the name of the fixture `dataset`'s, and other images."""
    lenses = ("--lens", "pinhole", "--lens", "thin:30")
    line = ("render", "cards", *lenses, *QUICK, "--seed", "1", "-o", tmp_path / "other")
    assert twinlens(*line)[0] == 0
    return tmp_path / "other"


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


def test_scenes_lists_every_bundled_scene(twinlens):
    code, out, _ = twinlens("scenes", "--json")
    assert code == 0
    assert [row["name"] for row in json.loads(out)] == tl.bundled_scenes()


def test_doctor_says_what_renders_here(twinlens):
    code, out, _ = twinlens("doctor", "--json")
    assert code == 0
    assert json.loads(out)["backend"]["variant"].endswith("_rgb")


def test_doctor_reports_a_missing_package(twinlens, monkeypatch):
    from twinlens.cli import doctor

    monkeypatch.setattr(doctor, "_PACKAGES", ("numpy", "no-such-package"))
    code, out, _ = twinlens("doctor")
    assert code == 0
    assert "no-such-package missing" in out


def test_a_board_without_a_map_of_its_samples_says_so(twinlens, dataset, tmp_path):
    maps = tmp_path / "maps"
    maps.mkdir()
    (maps / "other.pfm").write_bytes((dataset / "cards" / "disp0.pfm").read_bytes())
    line = ("score", maps, "--truth", dataset, "-o", tmp_path / "board")
    code, out, _ = twinlens(*line)
    assert code == 1
    assert "no map of" in out


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


def test_a_demo_without_a_terminal_prints_its_stages(capsys, monkeypatch, tmp_path):
    from twinlens.cli import demo

    monkeypatch.setattr(demo, "SCENES", ("cards",))
    monkeypatch.setattr(demo, "WIDTH", 48)
    monkeypatch.setattr(demo, "HEIGHT", 36)
    demo._render(tmp_path / "set", denoise=True)
    assert capsys.readouterr().err == "rendering cards, scene 1 of 1\n"
