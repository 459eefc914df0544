import json
import math
import re
import shutil
import tomllib

import pytest

from tests.factory_recipes import RECIPE, digests, write_recipe
from twinlens.cli.options import print_json
from twinlens.factory import produce


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    return write_recipe(tmp_path_factory.mktemp("recipe"), count=2)


NARROW = """
seed = 1
count = 1
families = ["cards"]
width = 32
height = 24
spp = 1
denoise = false
[rig]
fov_x_deg = 0.9
[gates]
attempts = 2
"""


def test_of_rejected_draws_alone_nothing_stays_and_the_field_is_named(
    twinlens, tmp_path
):
    recipe, root = tmp_path / "narrow.toml", tmp_path / "new" / "set"
    recipe.write_text(NARROW)
    code, out, err = twinlens("generate", recipe, "-o", root)
    assert code == 1
    assert "too little visible in both views" in err
    assert "rig.fov_x_deg" in err
    assert "nothing is kept" in err
    assert "0 of 1 sample, 0 made" in out
    assert [path.name for path in tmp_path.iterdir()] == ["narrow.toml"]
    recipe.write_text(NARROW.replace("0.9", "40"))
    code, out, _ = twinlens("generate", recipe, "-o", root)
    assert (code, "1 of 1 sample, 1 made" in out) == (0, True)


def test_lengths_in_millimetres_end_a_run_at_once(twinlens, tmp_path, monkeypatch):
    """Taken for metres, before a scene is composed, and also where nothing is to be written."""
    recipe = tmp_path / "wide.toml"
    recipe.write_text(NARROW.replace("fov_x_deg = 0.9", "baseline = 120"))
    monkeypatch.setattr("twinlens.factory.produce.random_scene", pytest.fail)
    for more in ((), ("--dry-run",), ("--limit", "1")):
        code, out, err = twinlens("generate", recipe, "-o", tmp_path / "set", *more)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "wide.toml: rig: cameras 0 and 1 are 120 m apart" in err
        assert "in metres" in err
    assert [path.name for path in tmp_path.iterdir()] == ["wide.toml"]


def test_after_hopeless_draws_the_recipe_is_named_and_not_the_same_command(
    twinlens, tmp_path
):
    recipe = tmp_path / "narrow.toml"
    recipe.write_text(NARROW.replace("count = 1", "count = 3"))
    command = ("generate", recipe, "-o", tmp_path / "set", "--limit", "1")
    code, _, err = twinlens(*command)
    assert code == 1
    assert "run the same command to make the rest" not in err
    assert "the 2 samples left may fail alike: change the recipe" in err
    recipe.write_text(NARROW.replace("0.9", "40").replace("count = 1", "count = 3"))
    code, out, err = twinlens(*command)
    assert (code, "1 of 3 samples, 1 made" in out) == (0, True)
    assert "run the same command to make the rest" in err


def test_a_failed_dry_run_makes_its_draws_once(twinlens, tmp_path, monkeypatch):
    drawn = []
    made = produce.random_scene
    monkeypatch.setattr(
        produce, "random_scene", lambda *a, **k: drawn.append(a) or made(*a, **k)
    )
    (tmp_path / "narrow.toml").write_text(NARROW)
    code, _, err = twinlens(
        "generate", tmp_path / "narrow.toml", "-o", tmp_path / "set", "--dry-run"
    )
    assert (code, "rig.fov_x_deg" in err, len(drawn)) == (2, True, 2)


def test_a_view_too_wide_for_a_family_is_said_once(twinlens, tmp_path):
    wide = NARROW.replace("0.9", "95").replace("count = 1", "count = 2")
    (tmp_path / "wide.toml").write_text(wide)
    code, _, err = twinlens("generate", tmp_path / "wide.toml", "-o", tmp_path / "set")
    assert code == 0
    assert err.count("cards: the view is 95 degrees wide") == 1
    assert "rig.fov_x_deg" in err


def test_the_repair_hint_of_verify_repairs_damage(twinlens, recipe, tmp_path):
    root = tmp_path / "set"
    twinlens("generate", recipe, "-o", root)
    before, file = digests(root), root / "0000001" / "disp0.pfm"
    whole = file.read_bytes()
    file.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    code, _, err = twinlens("verify", root)
    assert code == 1
    assert "1 sample is damaged: delete its folder and rerun `twinlens generate`" in err
    shutil.rmtree(file.parent)
    twinlens("generate", recipe, "-o", root)
    assert digests(root) == before


def test_json_has_no_infinity_or_nan(capsys):
    print_json({"focus": [math.inf, (-math.inf, math.nan)], "spp": 4})
    assert json.loads(capsys.readouterr().out, parse_constant=pytest.fail) == {
        "focus": ["inf", ["-inf", None]],
        "spp": 4,
    }


def test_a_dry_run_tells_time_and_disk_and_writes_nothing(twinlens, recipe, tmp_path):
    line = ("generate", recipe, "-o", tmp_path / "set", "--dry-run")
    code, out, _ = twinlens(*line)
    assert code == 0
    assert re.search(r"took [0-9.]+ s and [0-9.]+ kB; the rest needs about ", out)
    assert not (tmp_path / "set").exists()
    report = json.loads(twinlens(*line, "--json")[1])
    assert report["bytes"] == 2 * report["bytes_each"]
    table = out.partition("split test\n")[2].partition("one sample")[0]
    assert tomllib.loads(table) == report["next"]["drawn"]


def test_samples_that_cannot_be_are_told_with_the_remedy(twinlens, tmp_path):
    text = (
        RECIPE.replace("uniform = [0.05, 0.2]", "sweep = [0.1, 2.5]")
        + "[gates]\nattempts = 2\nvisible = 0.5\n"
    )
    path = write_recipe(tmp_path, text, count=2)
    code, out, err = twinlens("generate", path, "-o", tmp_path / "set")
    assert code == 1
    assert "1 of 2 samples" in out
    assert "draws rejected: 2 too little visible in both views" in out
    assert "sample 1 failed: 2 draws rejected; last reason: too little visible" in err
    assert "change rig.baseline" in err


def test_shards_are_told_what_is_needed_still(twinlens, recipe, tmp_path):
    root = tmp_path / "set"
    line = ("generate", recipe, "-o", root, "--shard")
    assert "when the other shards are done" in twinlens(*line, "1/2")[2]
    code, out, err = twinlens("verify", root)
    assert (code, out) == (0, "1 sample, 0 with findings\n")
    assert "dataset.json lists 0 of 2 samples; 1 made but not listed yet" in err
    assert twinlens(*line, "2/2")[2] == ""
    assert twinlens("verify", root) == (0, "2 samples, 0 with findings\n", "")


def test_render_puts_no_sample_into_what_generate_makes(twinlens, recipe, tmp_path):
    assert twinlens("generate", recipe, "-o", tmp_path / "set", "--limit", 1)[0] == 0
    before = digests(tmp_path / "set")
    code, out, err = twinlens(
        "render", "cards", "--size", "32x24", "--spp", "1", "-o", tmp_path / "set"
    )
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert "is a dataset of `twinlens generate`; choose another folder" in err
    assert digests(tmp_path / "set") == before
    assert twinlens("generate", recipe, "-o", tmp_path / "set")[0] == 0
