"""Normal use of each command; see test_refusals for invalid input."""

import json
import shutil

import numpy as np
import pytest

import twinlens as tl
from twinlens.cli import COMMANDS
from twinlens.dataset import read_pfm


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help_with_an_example(twinlens, name):
    code, out, _ = twinlens(name, "--help")
    assert code == 0
    assert f"Example:  twinlens {name}" in out
    assert "[default: (" not in out
    assert twinlens(name, "-h") == (code, out, "")


def test_render_writes_a_dataset_that_verifies(twinlens, dataset):
    samples = tl.Dataset(dataset)
    assert [sample.name for sample in samples] == ["cards"]
    assert samples[0].im0.shape == (48, 64, 3)
    assert samples[0].num_lenses == 2
    assert not np.array_equal(samples[0].lens(1).im0, samples[0].im0)
    assert twinlens("verify", dataset)[0] == 0


def test_render_says_what_it_wrote_and_with_what(twinlens, tmp_path):
    code, out, _ = twinlens(
        "render",
        "cards",
        "--size",
        "32x24",
        "--spp",
        "1",
        "--no-denoise",
        "-o",
        tmp_path / "o",
        "--json",
    )
    answer = json.loads(out)
    assert code == 0
    assert answer["backend"] in ("llvm_ad_rgb", "cuda_ad_rgb")
    assert {"im0.png", "disp0.pfm", "truth1.exr"} <= set(answer["samples"][0]["files"])


def test_the_same_command_gives_the_same_bytes(twinlens, tmp_path):
    for name in ("a", "b"):
        twinlens(
            "render",
            "cards",
            "--size",
            "32x24",
            "--spp",
            "2",
            "--seed",
            "7",
            "-o",
            tmp_path / name,
        )
    files = sorted(
        path.relative_to(tmp_path / "a")
        for path in (tmp_path / "a").rglob("*")
        if path.is_file()
    )
    assert len(files) > 8
    assert all(
        (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
        for file in files
    )


def test_a_second_scene_joins_the_dataset(twinlens, ball, tmp_path):
    for scene in ("cards", ball):
        assert (
            twinlens(
                "render",
                scene,
                "--size",
                "32x24",
                "--spp",
                "1",
                "--no-denoise",
                "-o",
                tmp_path / "o",
            )[0]
            == 0
        )
    assert [sample.name for sample in tl.Dataset(tmp_path / "o")] == ["cards", "ball"]


def test_verify_finds_a_changed_file(twinlens, dataset, tmp_path):
    shutil.copytree(dataset, tmp_path / "o")
    (tmp_path / "o" / "cards" / "im0.png").write_bytes(b"not the picture")
    code, out, _ = twinlens("verify", tmp_path / "o")
    assert code == 1
    assert "cards: " in out
    assert "im0.png" in out


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


def test_the_truth_scores_perfectly(twinlens, dataset):
    truth = dataset / "cards" / "disp0.pfm"
    _, out, _ = twinlens("score", truth, "--truth", truth, "--json")
    assert json.loads(out)["regions"]["all"]["totbad0.5"] == 0.0


def test_benchmark_makes_a_board_and_a_page(twinlens, dataset, tmp_path):
    code, out, _ = twinlens(
        "benchmark",
        dataset,
        "--methods",
        "sad,zncc:block_size=5",
        "-o",
        tmp_path / "board",
    )
    assert code == 0
    assert "zncc:block_size=5" in out
    assert "page: file://" in out
    board = json.loads((tmp_path / "board" / "board.json").read_text())
    assert len(board["entries"]) == 2 * 2
    assert (tmp_path / "board" / "index.html").stat().st_size > 10_000


def test_report_makes_the_page_again(twinlens, dataset, tmp_path):
    twinlens("benchmark", dataset, "--methods", "sad", "-o", tmp_path / "board")
    code, out, _ = twinlens(
        "report",
        tmp_path / "board" / "board.json",
        dataset,
        "-o",
        tmp_path / "page.html",
    )
    assert code == 0
    assert (tmp_path / "page.html").exists()
    assert "page.html" in out


def test_report_takes_the_board_s_folder_too(twinlens, dataset, tmp_path):
    twinlens("benchmark", dataset, "--methods", "sad", "-o", tmp_path / "board")
    (tmp_path / "board" / "index.html").unlink()
    code, _, err = twinlens("report", tmp_path / "board")
    assert code == 0, err
    assert (tmp_path / "board" / "index.html").exists()
    code, _, err = twinlens("report", tmp_path)
    assert code == 2
    assert str(tmp_path / "board.json") in err


@pytest.fixture
def other(twinlens, tmp_path):
    """A dataset whose sample has the name of the fixture `dataset`'s, and other images."""
    quick = ("--size", "64x48", "--spp", "2", "--seed", "1")
    assert (
        twinlens(
            "render",
            "cards",
            "--lens",
            "pinhole",
            "--lens",
            "thin:30",
            *quick,
            "-o",
            tmp_path / "other",
        )[0]
        == 0
    )
    return tmp_path / "other"


def test_samples_that_are_not_the_board_s_are_refused(
    twinlens, dataset, other, tmp_path
):
    board, page = tmp_path / "board", tmp_path / "page.html"
    assert twinlens("benchmark", dataset, "--methods", "sad", "-o", board)[0] == 0
    before = (board / "board.json").read_bytes()
    for line, words in (
        (
            ("benchmark", other, "--methods", "sad", "-o", board),
            "is not the one that the board scores",
        ),
        (("report", board, other, "-o", page), "is not the one that the board scores"),
        (
            ("report", board, "motorcycle", "-o", page),
            "motorcycle: none of its samples is on the board",
        ),
        (
            ("report", board, dataset, "motorcycle", "-o", page),
            "motorcycle: none of its samples is on the board",
        ),
        (("report", board, dataset, "-o", tmp_path / "notes.txt"), "must end in .html"),
    ):
        code, out, err = twinlens(*line)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert words in err
    assert (board / "board.json").read_bytes() == before
    assert not page.exists()


def test_samples_of_one_name_in_two_datasets_are_named_after_their_datasets(
    twinlens, dataset, other, tmp_path
):
    code, _, err = twinlens(
        "benchmark",
        dataset,
        other,
        "motorcycle",
        "--methods",
        "sad",
        "-o",
        tmp_path / "board",
    )
    assert code == 0, err
    entries = json.loads((tmp_path / "board" / "board.json").read_text())["entries"]
    names = ["out/cards · pinhole", "other/cards · pinhole", "motorcycle"]
    assert [
        name for name in names if name in {entry["sample"] for entry in entries}
    ] == names
    code, out, _ = twinlens("statistics", dataset, other)
    assert code == 0
    assert "4 pairs" in out


def test_a_folder_of_maps_is_scored_like_a_method(twinlens, dataset, tmp_path):
    twinlens("benchmark", dataset, "--methods", "sad", "-o", tmp_path / "board")
    code, _, _ = twinlens(
        "score",
        tmp_path / "board" / "maps",
        "--truth",
        dataset,
        "-o",
        tmp_path / "other",
    )
    boards = [
        json.loads((tmp_path / name / "board.json").read_text())
        for name in ("board", "other")
    ]
    computed, submitted = (
        {e["sample"]: e["regions"] for e in board["entries"]} for board in boards
    )
    assert code == 0
    assert computed == submitted


def test_export(twinlens, dataset, tmp_path):
    assert (
        twinlens("export", dataset, "--to", "kitti2015", "-o", tmp_path / "kitti")[0]
        == 0
    )
    assert (tmp_path / "kitti" / "Kitti2015" / "training" / "disp_occ_0").is_dir()


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


def test_a_board_on_which_everything_failed_says_why(twinlens, dataset, tmp_path):
    empty = tmp_path / "empty"
    empty.mkdir()
    (empty / "other.pfm").write_bytes((dataset / "cards" / "disp0.pfm").read_bytes())
    code, out, _ = twinlens(
        "score", empty, "--truth", dataset, "-o", tmp_path / "board"
    )
    assert code == 1
    assert "no map of" in out
    assert "every method failed" in out


@pytest.mark.parametrize("form", [(), ("--json",)])
def test_the_exit_code_is_1_only_if_every_method_failed(
    twinlens, dataset, tmp_path, form
):
    """A function that does not accept images fails; a matcher in the same run succeeds."""
    bad = "function:function=math:cos"
    assert (
        twinlens(
            "benchmark", dataset, "--methods", bad, "-o", tmp_path / "none", *form
        )[0]
        == 1
    )
    assert (tmp_path / "none" / "index.html").exists()
    assert (
        twinlens(
            "benchmark",
            dataset,
            "--methods",
            f"{bad},sad",
            "-o",
            tmp_path / "some",
            *form,
        )[0]
        == 0
    )


def test_a_demo_without_a_terminal_prints_its_stages(capsys, monkeypatch, tmp_path):
    from twinlens.cli import demo

    monkeypatch.setattr(demo, "SCENES", ("cards",))
    monkeypatch.setattr(demo, "WIDTH", 48)
    monkeypatch.setattr(demo, "HEIGHT", 36)
    demo._render(tmp_path / "set", denoise=True)
    assert capsys.readouterr().err == "rendering cards, scene 1 of 1\n"
