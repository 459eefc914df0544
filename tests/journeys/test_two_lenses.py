"""Which of two lenses is better: from a recipe to the difference with its interval, by commands alone."""

import json

import numpy as np
import pytest

RECIPE = """
seed = 5
count = 3
families = ["tabletop"]
width = 96
height = 72
spp = 2
denoise = false
[rig]
baseline = { uniform = [0.05, 0.1] }
[[lenses]]
kind = "thin"
f_number = 1.4
[[lenses]]
kind = "thin"
f_number = 4
[gates]
attempts = 5
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("lenses")
    (folder / "recipe.toml").write_text(RECIPE)
    return folder


@pytest.mark.slow
def test_from_two_lenses_to_their_difference(twinlens, folder):
    data, board = folder / "data", folder / "board"
    assert twinlens("generate", folder / "recipe.toml", "-o", data)[0] == 0
    matchers = ("--methods", "sad,zncc", "--by", "lens")
    code, out, _ = twinlens("benchmark", data, *matchers, "-o", board)
    assert code == 0
    assert "by lens" in out
    assert "f/4 - f/1.4" in out
    assert "paired, 3 scenes" in out
    code, out, _ = twinlens("benchmark", data, *matchers, "-o", board, "--json")
    assert code == 0
    _check_differences(json.loads(out))

    code, _, err = twinlens(
        "benchmark", data, "--methods", "ssd", "--by", "lense", "-o", folder / "other"
    )
    assert code == 2
    assert "did you mean 'lens'?" in err
    assert not (folder / "other").exists()

    code, out, _ = twinlens("report", board, data, "--by", "rig.baseline")
    assert code == 0
    code, _, err = twinlens("report", board, data, "--by", "family")
    assert code == 2
    assert "one group of the samples (tabletop)" in err


def _check_differences(record):
    """The differences are those of the entries, and the intervals of three scenes span their differences."""
    scores = {
        (entry["method"], entry["sample"]): entry["regions"]["nonocc"]["metrics"]
        for entry in record["entries"]
    }
    names = [f"000000{k}" for k in range(3)]
    compared = record["compared"]["lens"]["middlebury-v3"]["nonocc"]
    for method in ("sad", "zncc"):
        wide, narrow = (
            np.array(
                [scores[method, f"{name} · {lens}"]["totbad2.0"] for name in names]
            )
            for lens in ("f/1.4", "f/4")
        )
        assert compared["means"]["f/1.4"][method] == pytest.approx(wide.mean())
        difference = compared["differences"]["f/4"][method]
        interval = difference["interval"]
        assert difference["paired"]
        assert interval["value"] == pytest.approx((narrow - wide).mean())
        assert interval["low"] == pytest.approx((narrow - wide).min())
        assert interval["high"] == pytest.approx((narrow - wide).max())


def test_lenses_of_render_are_called_as_on_the_command_line(twinlens, folder):
    data = folder / "rendered"
    small = ("--size", "64x48", "--spp", 1, "--no-denoise")
    lenses = ("--lens", "pinhole", "--lens", "f/2@3")
    code, _, _ = twinlens("render", "cards", *small, *lenses, "-o", data)
    assert code == 0
    _, out, _ = twinlens("benchmark", data, "--methods", "sad", "-o", folder / "b")
    assert (
        "the means are over 2 lenses (f/2@3, pinhole); --by lens compares them" in out
    )
    matcher = ("--methods", "sad", "--by", "lens")
    code, out, _ = twinlens("benchmark", data, *matcher, "-o", folder / "b")
    assert code == 0
    assert "f/2@3 - pinhole" in out
    assert "paired, 1 scene" in out
    assert "the means are over" not in out
