import importlib
import json
import os
import shutil
import tomllib

import fsspec
import numpy as np
import pytest

from tests.factory_recipes import RECIPE, digests, write_recipe
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    read_manifest,
    write_manifest,
)
from twinlens.dataset.files import locked
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.verify import verify_sample
from twinlens.errors import FileError, InputError, OutputError
from twinlens.factory import (
    estimate,
    generate,
    make,
    read_recipe,
    recipe_from_table,
)
from twinlens.factory.produce import Exhausted


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    return read_recipe(write_recipe(tmp_path_factory.mktemp("recipe")))


@pytest.fixture(scope="module")
def whole(recipe, tmp_path_factory):
    """The dataset of one uninterrupted run."""
    folder = tmp_path_factory.mktemp("whole") / "set"
    outcome = generate(recipe, folder)
    assert (outcome.made, outcome.before, outcome.complete) == (4, 0, True)
    assert not outcome.failures
    return folder


@pytest.fixture
def folder(tmp_path):
    """Named as `whole` is: a dataset's card says its folder's name."""
    return tmp_path / "set"


def interrupting(number):
    """A `report` that raises KeyboardInterrupt at its `number`-th call, as Ctrl-C does."""
    calls = iter(range(10**9))

    def report(fraction, text):
        if next(calls) >= number:
            raise KeyboardInterrupt

    return report


def test_the_dataset_is_true_and_has_no_leftovers(whole):
    assert [verify_sample(sample) for sample in Dataset(whole)] == [[]] * 4
    assert {"dataset.json", "preview.png", "README.md", "croissant.json"} <= {
        entry.name for entry in whole.iterdir()
    }
    assert not [entry.name for entry in whole.iterdir() if entry.name.startswith(".")]


def test_a_sample_alone_is_that_sample_of_the_set(recipe, whole):
    files = sample_files(make(recipe, 3))
    assert files == {name: (whole / "0000003" / name).read_bytes() for name in files}


def test_the_manifest_names_recipe_tools_and_splits(recipe, whole):
    manifest = read_manifest(whole)
    assert manifest.recipe == recipe.written
    assert manifest.info["complete"] is True
    assert manifest.info["made_with"]["versions"]["mitsuba"]
    assert sum(manifest.info["splits"].values()) == 4
    assert [row.info["index"] for row in manifest.rows] == [0, 1, 2, 3]


@pytest.mark.parametrize(
    "calls",
    [5, *(pytest.param(calls, marks=pytest.mark.slow) for calls in (0, 2, 8))],
)
def test_an_interrupted_run_leaves_whole_samples_and_resumes(
    recipe, whole, folder, calls
):
    with pytest.raises(KeyboardInterrupt):
        generate(recipe, folder, report=interrupting(calls))
    assert not list(folder.glob(".*unfinished*"))
    there = len(list(folder.glob("[0-9]*")))
    again = generate(recipe, folder)
    assert (again.before, again.made, again.complete) == (there, 4 - there, True)
    assert digests(folder) == digests(whole)


def test_limit_counts_this_runs_samples(recipe, whole, folder):
    assert [generate(recipe, folder, limit=3).made for _ in range(3)] == [3, 1, 0]
    assert digests(folder) == digests(whole)


def test_shards_make_the_whole_in_any_order(recipe, whole, folder):
    runs = [generate(recipe, folder, shard=(i, 3)) for i in (2, 3, 1)]
    seen = [(run.before, run.made, run.there, run.left, run.complete) for run in runs]
    assert seen == [(0, 1, 1, 0, False), (1, 1, 2, 0, False), (2, 2, 4, 0, True)]
    assert digests(folder) == digests(whole)


def test_rows_that_were_lost_or_torn_come_back_from_the_samples(recipe, whole, folder):
    generate(recipe, folder, limit=3)
    rows = sorted((folder / ".rows").iterdir())
    rows[0].unlink()
    rows[1].write_bytes(rows[1].read_bytes()[:40])
    (folder / "dataset.json").unlink()
    assert generate(recipe, folder).before == 3
    assert digests(folder) == digests(whole)


def test_what_a_killed_process_left_half_written_goes(recipe, whole, folder):
    generate(recipe, folder, limit=1)
    (folder / ".0000001.unfinished-1-ab").mkdir()
    (folder / ".0000001.unfinished-1-ab" / "im0.png").write_bytes(b"half")
    generate(recipe, folder)
    assert digests(folder) == digests(whole)


def test_a_set_may_grow_and_is_then_the_larger_set(whole, folder, tmp_path):
    smaller = read_recipe(write_recipe(tmp_path, count=2))
    assert generate(smaller, folder).complete
    larger = read_recipe(write_recipe(tmp_path, count=4))
    assert generate(larger, folder, limit=1).made == 1
    assert not read_manifest(folder).info["complete"]
    assert generate(larger, folder).made == 1
    assert digests(folder) == digests(whole)


def test_a_set_does_not_shrink(recipe, folder, tmp_path):
    generate(recipe, folder, limit=2)
    before = digests(folder)
    with pytest.raises(
        InputError,
        match=r"holds 1 sample\(s\) beyond the recipe's count of 1; a count may grow",
    ):
        generate(read_recipe(write_recipe(tmp_path, count=1)), folder)
    assert digests(folder) == before


def test_another_recipe_is_refused_and_the_difference_named(recipe, folder, tmp_path):
    generate(recipe, folder, limit=1)
    before = digests(folder)
    other = read_recipe(
        write_recipe(tmp_path, RECIPE.replace("[0.05, 0.2]", "[0.05, 0.3]"))
    )
    with pytest.raises(
        InputError,
        match=r"another dataset \(rig.baseline.uniform: .*0\.2\] -> .*0\.3\]\)",
    ):
        generate(other, folder)
    assert digests(folder) == before


def test_samples_of_another_recipe_are_not_taken_for_its_own(recipe, folder, tmp_path):
    generate(recipe, folder, limit=1)
    (folder / "dataset.json").unlink()
    shutil.rmtree(folder / ".rows")
    other = read_recipe(
        write_recipe(tmp_path, RECIPE.replace("seed = 11", "seed = 12"))
    )
    with pytest.raises(InputError, match="another recipe made it"):
        generate(other, folder)


def test_other_tools_are_refused(recipe, folder):
    generate(recipe, folder, limit=1)
    path = folder / "dataset.json"
    record = json.loads(path.read_text())
    record["info"]["made_with"]["versions"]["mitsuba"] = "3.9.0"
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"versions.mitsuba: '3\.9\.0' -> "):
        generate(recipe, folder)
    path.unlink()
    sample = folder / "0000000" / "sample.json"
    record = json.loads(sample.read_text())
    record["record"]["versions"]["mitsuba"] = "3.9.0"
    sample.write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"other versions made it .*mitsuba"):
        generate(recipe, folder)


def test_a_list_that_was_lost_comes_back_from_the_samples(recipe, whole, folder):
    shutil.copytree(whole, folder)
    (folder / "dataset.json").unlink()
    with pytest.raises(InputError, match=r"if dataset\.json was lost, move that file"):
        generate(recipe, folder)
    for path in folder.iterdir():
        if path.is_file():
            path.unlink()
    outcome = generate(recipe, folder)
    assert (outcome.made, outcome.before, outcome.complete) == (0, 4, True)
    assert digests(folder) == digests(whole)


def test_a_sample_that_was_taken_away_is_made_again(recipe, whole, folder):
    shutil.copytree(whole, folder)
    shutil.rmtree(folder / "0000001")
    assert generate(recipe, folder).made == 1
    assert digests(folder) == digests(whole)


def test_a_folder_in_which_nothing_was_made_takes_another_recipe(
    recipe, folder, tmp_path
):
    """As after a mistake that only the first sample shows."""
    with pytest.raises(KeyboardInterrupt):
        generate(recipe, folder, report=interrupting(0))
    text = RECIPE.replace("spp = 1", "spp = 2")
    assert generate(read_recipe(write_recipe(tmp_path, text, count=1)), folder).complete
    assert read_manifest(folder).recipe["spp"] == 2


def test_a_dataset_of_render_is_left_alone(recipe, folder):
    write_manifest(folder, Manifest((Row("cards", {}, {"scene": "cards"}),), seed=0))
    with pytest.raises(
        InputError, match="`twinlens generate` did not make; name a new"
    ):
        generate(recipe, folder)


@pytest.mark.parametrize("part", [{"shard": (0, 2)}, {"shard": (3, 2)}, {"limit": 0}])
def test_parts_of_a_set_that_do_not_exist_are_refused(recipe, folder, part):
    with pytest.raises(InputError, match=r"a shard is i/n with|limit must be 1"):
        generate(recipe, folder, **part)
    assert not folder.exists()


def test_a_folder_of_something_else_is_left_alone(recipe, folder):
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"contains 'thesis.tex'"):
        generate(recipe, folder)


def test_only_one_run_writes_at_a_time(recipe, folder):
    with (
        locked(folder),
        pytest.raises(
            OutputError, match=r"writing there; wait for it, or split .* --shard"
        ),
    ):
        generate(recipe, folder)
    with locked(folder, shared=True):
        generate(recipe, folder, shard=(1, 2))


def test_shards_that_end_together_finish_one_after_the_other(
    recipe, folder, monkeypatch
):
    module = importlib.import_module("twinlens.factory.generate")
    finish, finished = module.finish, []

    def finish_while_another_tries(ledger):
        with pytest.raises(OutputError, match="another run"):
            locked(folder, shared=True).__enter__()
        finished.append(True)
        finish(ledger)

    generate(recipe, folder, shard=(1, 2))
    monkeypatch.setattr(module, "finish", finish_while_another_tries)
    assert generate(recipe, folder, shard=(2, 2)).complete
    assert finished


def test_a_bucket_holds_the_same_samples(recipe, whole):
    root = f"/{os.getpid()}/set"
    generate(recipe, f"memory:/{root}", limit=2)
    outcome = generate(recipe, f"memory:/{root}")
    assert (outcome.before, outcome.made, outcome.complete) == (2, 2, True)
    system = fsspec.filesystem("memory")
    stored = {name.removeprefix(f"{root}/") for name in system.find(root)}
    assert stored == set(digests(whole))
    name = "0000003/im1.png"
    assert system.cat_file(f"{root}/{name}") == (whole / name).read_bytes()
    system.rm(f"{root}/0000001/calib.txt")
    lost = r"0000001/calib.txt: is missing; delete the folder"
    with pytest.raises(FileError, match=lost):
        generate(recipe, f"memory:/{root}")


def test_draws_that_gates_turn_away_are_drawn_anew_counted_and_told(folder, tmp_path):
    text = RECIPE.replace("count = {count}", "count = {count}\nndisp = 3")
    outcome = generate(read_recipe(write_recipe(tmp_path, text, count=6)), folder)
    assert outcome.complete
    rows = read_manifest(folder).rows
    rejections = [len(row.info["rejections"]) for row in rows]
    rejections += [len(failure.rejections) for failure in outcome.failures]
    assert outcome.rejections == {"disparity beyond ndisp": sum(rejections)}
    assert any(row.info["attempt"] > 0 for row in rows)
    for sample in Dataset(folder):
        assert sample.disp0[np.isfinite(sample.disp0)].max() < 3
        assert sample.calibration.ndisp == 3


def test_a_sample_that_cannot_be_is_told_with_what_to_change_and_the_rest_is_made(
    folder, tmp_path
):
    text = RECIPE.replace("uniform = [0.05, 0.2]", "sweep = [0.1, 2.5]")
    gates = "[gates]\nattempts = 3\nvisible = 0.5\n"
    recipe = read_recipe(write_recipe(tmp_path, text + gates))
    outcome = generate(recipe, folder)
    assert [failure.index for failure in outcome.failures] == [1, 3]
    assert (outcome.made, outcome.before, outcome.there) == (2, 0, 2)
    first = outcome.failures[0]
    assert "rig.baseline" in first.remedy
    assert len(first.rejections) == 3
    assert outcome.complete
    before = digests(folder)
    assert generate(recipe, folder).made == 0
    assert digests(folder) == before
    assert [entry["index"] for entry in read_manifest(folder).info["failed"]] == [1, 3]


IMPOSSIBLE = RECIPE.replace("uniform = [0.05, 0.2]", "uniform = [2.5, 3.0]") + (
    "[gates]\nattempts = 2\nvisible = 0.5\n"
)
"""The views of its rigs share too little, at every draw."""


@pytest.mark.parametrize("shards", [1, 2])
def test_of_rejected_samples_alone_an_own_folder_keeps_only_its_files(
    folder, tmp_path, shards
):
    folder.mkdir()
    (folder / ".gitignore").write_text("*\n")
    impossible = read_recipe(write_recipe(tmp_path, IMPOSSIBLE, count=2))
    for i in range(shards):
        outcome = generate(impossible, folder, shard=(i + 1, shards))
        assert outcome.complete == (i + 1 == shards)
    assert len(outcome.failures) == 2
    kept = {path.name for path in folder.iterdir()} - {".lock"}
    assert kept == {".gitignore"}


def test_of_rejected_samples_alone_nothing_stays_after_a_stop(folder, tmp_path):
    impossible = read_recipe(write_recipe(tmp_path, IMPOSSIBLE, count=3))
    generate(impossible, folder, limit=1)
    assert (folder / "dataset.json").exists()
    outcome = generate(impossible, folder)
    assert [failure.index for failure in outcome.failures] == [0, 1, 2]
    assert not folder.exists()


def test_failures_of_another_recipe_are_not_taken_for_own_ones(
    folder, tmp_path, recipe, whole
):
    impossible = read_recipe(write_recipe(tmp_path, IMPOSSIBLE, count=4))
    generate(impossible, folder, limit=2)
    outcome = generate(recipe, folder)
    assert (outcome.made, len(outcome.failures)) == (4, 0)
    assert digests(folder) == digests(whole)


def test_of_rejected_samples_alone_nothing_stays_in_a_bucket(tmp_path):
    impossible = read_recipe(write_recipe(tmp_path, IMPOSSIBLE, count=1))
    generate(impossible, "memory://rejected/set")
    assert not fsspec.filesystem("memory").find("/rejected")


def test_an_estimate_writes_nothing_and_knows_what_is_there(recipe, whole, folder):
    estimated = estimate(recipe, folder)
    assert not folder.exists()
    assert (estimated.count, estimated.before, estimated.todo) == (4, 0, 4)
    size = sum(path.stat().st_size for path in (whole / "0000000").iterdir())
    assert estimated.bytes == 4 * size
    assert estimated.seconds > 0
    assert estimate(recipe, whole).todo == 0


@pytest.mark.parametrize(
    ("damage", "named"),
    [
        ({"im0.png": b"torn"}, "im0.png"),
        ({"im0.png": None, "im1.png": None}, r"im0.png: is missing \(and 1 more\)"),
    ],
)
def test_a_damaged_sample_is_told_with_what_to_do(recipe, whole, folder, damage, named):
    """Else it would be counted among those that are there."""
    shutil.copytree(whole, folder)
    sample = folder / "0000001"
    for name, content in damage.items():
        (sample / name).unlink()
        if content is not None:
            (sample / name).write_bytes(content)
    remedy = f"; delete the folder {sample} and run the same command again"
    with pytest.raises(FileError, match=f"{sample}/{named}.*{remedy}"):
        generate(recipe, folder)
    shutil.rmtree(sample)
    assert generate(recipe, folder).made == 1
    assert digests(folder) == digests(whole)


def test_a_folder_without_its_mark_is_told_with_what_to_do(recipe, folder):
    (folder / "0000000").mkdir(parents=True)
    (folder / "0000000" / "im0.png").touch()
    with pytest.raises(
        OutputError,
        match=r"is not a whole sample; delete the folder .*0000000 and run the same command",
    ):
        generate(recipe, folder, limit=1)


@pytest.mark.parametrize(
    ("text", "index", "draws"),
    [
        ("ndisp = 1\n", 0, 1),
        # Each coefficient is valid, not both together.
        (
            "rig.distortion = {{ k1.sweep = [0.0, -0.4], k2.sweep = [0.0, -0.5] }}\n",
            3,
            1,
        ),
        # A dark photograph is taken again with other noise.
        ("exposure.time = 1e-9\n[gates]\nattempts = 3\n", 0, 3),
        ("ndisp = 1\nrig.baseline.uniform = [0.1, 0.2]\n[gates]\nattempts = 3\n", 0, 3),
    ],
)
def test_where_nothing_is_left_to_chance_the_first_draw_tells(
    tmp_path, text, index, draws
):
    """Twenty draws of a scene from a file with one rig are one draw; photographs have noise."""
    fixed = "seed = 1\ncount = {count}\nscenes = ['tiny']\nwidth = 32\nheight = 24\nspp = 1\n"
    recipe = read_recipe(write_recipe(tmp_path, fixed + text))
    with pytest.raises(Exhausted, match=f"{draws} draws? rejected"):
        make(recipe, index)


@pytest.mark.parametrize(
    ("subject", "mismatch", "message"),
    [
        ({"scenes": ["cards"]}, {"scale_px": -90}, "scale_px=-90: too large for"),
        ({"families": ["tabletop"]}, {"focus_um": -1e5}, "moves the film to the lens"),
    ],
)
def test_a_constant_impossible_mismatch_leaves_no_folder_behind(
    tmp_path, folder, subject, mismatch, message
):
    table = {"seed": 1, "count": 2, "width": 64, "height": 48, **subject}
    lenses = [{"kind": "thin", "aperture_mm": 8}]
    table |= {"lenses": lenses, "sensor": {"mismatch": mismatch}}
    with pytest.raises(InputError, match=f"^recipe.toml: .*{message}"):
        generate(recipe_from_table(table, tmp_path / "recipe.toml"), folder)
    assert not folder.exists()


def test_a_scene_that_moves_is_refused_before_it_is_rendered(tmp_path, folder):
    path, scene = write_recipe(tmp_path, count=1), tmp_path / "tiny" / "scene.toml"
    tables = tomllib.loads(scene.read_text())
    name = next(iter(tables["objects"]))
    motion = f"\n[[motion]]\nobject = '{name}'\nvelocity = [1, 0, 0]\n"
    scene.write_text(scene.read_text() + motion)
    with pytest.raises(InputError, match="scenes: the scene 'tiny' moves, and images"):
        generate(read_recipe(path), folder)
    assert not folder.exists()


def test_a_scene_without_light_needs_a_sky(tmp_path, folder):
    path, scene = write_recipe(tmp_path, count=1), tmp_path / "tiny" / "scene.toml"
    light = '[lights.sky]\ntype = "constant"\nradiance = 1.0'
    scene.write_text(scene.read_text().replace(light, ""))
    dark = r"scenes: the scene 'tiny' has no light: .*or a sky"
    with pytest.raises(InputError, match=dark):
        generate(read_recipe(path), folder)
    assert not folder.exists()
