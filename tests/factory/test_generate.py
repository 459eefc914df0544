import importlib
import json
import os
import shutil
from pathlib import Path

import fsspec
import numpy as np
import pytest

from tests.factory_recipes import RECIPE, digests, write_recipe, write_sky
from twinlens.dataset import (
    About,
    Dataset,
    Manifest,
    Row,
    describe,
    read_image,
    read_manifest,
    write_manifest,
)
from twinlens.dataset.files import locked
from twinlens.dataset.metadata import about
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.verify import verify_sample
from twinlens.errors import FileError, InputError, OutputError
from twinlens.factory import (
    estimate,
    generate,
    make,
    produce,
    read_recipe,
    recipe_from_table,
)
from twinlens.factory.plan import SampleSpec
from twinlens.factory.produce import Exhausted


@pytest.fixture(scope="module")
def recipe(tmp_path_factory):
    return read_recipe(write_recipe(tmp_path_factory.mktemp("recipe")))


@pytest.fixture(scope="module")
def whole(recipe, tmp_path_factory):
    """The dataset of one uninterrupted run."""
    folder = tmp_path_factory.mktemp("whole") / "set"
    outcome = generate(recipe, folder)
    assert (outcome.made, outcome.before, outcome.complete, outcome.failures) == (
        4,
        0,
        True,
        (),
    )
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


def test_a_sample_is_made_again_from_what_its_record_says(recipe, whole):
    record = Dataset(whole)[2].record["record"]
    again = produce(SampleSpec(**record["spec"]), recipe.sources)
    stored = Dataset(whole)[2]
    assert np.array_equal(again.shots[0].images[1], stored.im1)
    assert again.rig.nominal.baseline() == stored.rig.baseline()


def test_samples_differ_where_the_recipe_says_so(whole):
    data = Dataset(whole)
    assert len({sample.rig.baseline() for sample in data}) == 4
    assert all(0.05 <= sample.rig.baseline() <= 0.2 for sample in data)
    assert len({tuple(sample.rig.world_from_cams[0][:3, 3]) for sample in data}) == 4


def test_the_manifest_names_recipe_tools_and_splits(recipe, whole):
    manifest = read_manifest(whole)
    assert manifest.recipe == recipe.written
    assert manifest.info["complete"] is True
    assert manifest.info["made_with"]["versions"]["mitsuba"]
    assert sum(manifest.info["splits"].values()) == 4
    assert [row.info["index"] for row in manifest.rows] == [0, 1, 2, 3]


@pytest.mark.parametrize("calls", [0, 1, 2, 3, 5, 8])
def test_an_interrupted_run_leaves_whole_samples_and_resumes(
    recipe, whole, folder, calls
):
    with pytest.raises(KeyboardInterrupt):
        generate(recipe, folder, report=interrupting(calls))
    assert not list(folder.glob(".*unfinished*"))
    there = [entry.name for entry in folder.iterdir() if entry.name.isdecimal()]
    again = generate(recipe, folder)
    assert (again.before, again.made, again.complete) == (
        len(there),
        4 - len(there),
        True,
    )
    assert digests(folder) == digests(whole)


def test_limit_counts_this_runs_samples(recipe, whole, folder):
    assert [generate(recipe, folder, limit=3).made for _ in range(3)] == [3, 1, 0]
    assert digests(folder) == digests(whole)


def test_an_unfinished_dataset_has_a_preview_of_its_samples_and_credits(tmp_path):
    generate(read_recipe(write_recipe(tmp_path, count=100)), tmp_path / "set", limit=2)
    assert read_image(tmp_path / "set" / "preview.png").shape[1] == 2 * (160 + 4) + 4
    assert "| tiny/scene.toml |" in (tmp_path / "set" / "ASSETS.md").read_text()


def test_shards_make_the_whole_in_any_order(recipe, whole, folder):
    made = [generate(recipe, folder, shard=(i, 3)) for i in (2, 3, 1)]
    assert [outcome.made for outcome in made] == [1, 1, 2]
    assert [outcome.complete for outcome in made] == [False, False, True]
    assert [(outcome.before, outcome.there) for outcome in made] == [
        (0, 1),
        (1, 2),
        (2, 4),
    ]
    assert [outcome.left for outcome in made] == [0, 0, 0]
    assert digests(folder) == digests(whole)


def test_shards_made_apart_are_merged_by_a_run_of_the_whole(
    recipe, whole, folder, tmp_path
):
    for i in (1, 2):
        generate(recipe, tmp_path / str(i) / "set", shard=(i, 2))
        for part in (tmp_path / str(i) / "set").iterdir():
            if part.is_dir() and not part.name.startswith("."):
                folder.mkdir(exist_ok=True)
                part.rename(folder / part.name)
    outcome = generate(recipe, folder)
    assert (outcome.before, outcome.made) == (4, 0)
    assert digests(folder) == digests(whole)


def test_rows_that_were_lost_or_torn_come_back_from_the_samples(recipe, whole, folder):
    generate(recipe, folder, limit=3)
    rows = sorted((folder / ".rows").iterdir())
    rows[0].unlink()
    rows[1].write_bytes(rows[1].read_bytes()[:40])
    (folder / "dataset.json").unlink()
    assert generate(recipe, folder).before == 3
    assert digests(folder) == digests(whole)


def test_a_sample_that_was_taken_away_is_made_again(recipe, whole, folder):
    generate(recipe, folder)
    for path in (folder / "0000001").iterdir():
        path.unlink()
    (folder / "0000001").rmdir()
    assert generate(recipe, folder).made == 1
    assert digests(folder) == digests(whole)


def test_what_a_killed_process_left_half_written_goes(recipe, whole, folder):
    generate(recipe, folder, limit=1)
    (folder / ".0000001.unfinished-1-ab").mkdir()
    (folder / ".0000001.unfinished-1-ab" / "im0.png").write_bytes(b"half")
    generate(recipe, folder)
    assert digests(folder) == digests(whole)


def test_a_set_may_grow_and_its_samples_stay(recipe, folder, tmp_path):
    generate(recipe, folder, limit=4)
    before = digests(folder)
    grown = read_recipe(write_recipe(tmp_path, count=6))
    assert generate(grown, folder).made == 2
    kept = {
        name: digest
        for name, digest in digests(folder).items()
        if name in before and name[0] == "0"
    }
    assert kept == {name: digest for name, digest in before.items() if name[0] == "0"}
    assert len(Dataset(folder)) == 6


def test_described_values_are_kept_and_replace_those_of_the_recipe(recipe, folder):
    generate(recipe, folder, limit=1)
    describe(folder, About(license="CC0-1.0"))
    describe(folder, About(name="My set", creator="Ada"))
    texts = {
        "name": "Recipe's",
        "description": "Cards.",
        "creator": "Bob",
        "license": "MIT",
    }
    changed = read_recipe(recipe.file, {"about": texts, "count": 2})
    for _ in range(2):
        generate(changed, folder)
        given, manifest = about(Dataset(folder))
        assert given == About(
            name="My set", description="Cards.", license="CC0-1.0", creator="Ada"
        )
        assert manifest.info["about"] == {
            "license": "CC0-1.0",
            "name": "My set",
            "creator": "Ada",
        }
        assert "# My set\n\nCards.\n" in (folder / "README.md").read_text()


def test_a_set_does_not_shrink(recipe, folder, tmp_path):
    generate(recipe, folder, limit=2)
    before = digests(folder)
    with pytest.raises(
        InputError,
        match=r"holds 1 sample\(s\) beyond the recipe's count of 1; a count may grow",
    ):
        generate(read_recipe(write_recipe(tmp_path, count=1)), folder)
    assert digests(folder) == before


def test_a_folder_in_which_nothing_was_made_takes_another_recipe(
    recipe, folder, tmp_path
):
    """As after a mistake that only the first sample shows."""
    with pytest.raises(KeyboardInterrupt):
        generate(recipe, folder, report=interrupting(0))
    other = read_recipe(
        write_recipe(tmp_path, RECIPE.replace("spp = 1", "spp = 2"), count=1)
    )
    assert generate(other, folder).complete
    assert read_manifest(folder).recipe["spp"] == 2


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


@pytest.mark.parametrize("rows_too", [False, True])
def test_samples_of_another_recipe_are_not_taken_for_its_own(
    recipe, folder, tmp_path, rows_too
):
    generate(recipe, folder, limit=1)
    (folder / "dataset.json").unlink()
    for row in (folder / ".rows").iterdir() if rows_too else ():
        row.unlink()
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


def test_samples_that_other_tools_made_are_not_merged(recipe, folder, tmp_path):
    generate(recipe, folder, limit=1)
    (folder / "dataset.json").unlink()
    path = folder / "0000000" / "sample.json"
    record = json.loads(path.read_text())
    record["record"]["versions"]["mitsuba"] = "3.9.0"
    path.write_text(json.dumps(record))
    with pytest.raises(InputError, match=r"other versions made it .*mitsuba"):
        generate(recipe, folder)


def test_a_folder_of_something_else_is_left_alone(recipe, folder):
    folder.mkdir()
    (folder / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=r"contains 'thesis.tex'"):
        generate(recipe, folder)


def test_a_dataset_of_render_is_named_as_such(recipe, folder):
    write_manifest(folder, Manifest((Row("cards", {}, {"scene": "cards"}),), seed=0))
    with pytest.raises(
        InputError,
        match="holds a dataset that `twinlens generate` did not make; name a new folder",
    ):
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
    finish, refused = module.finish, []

    def finish_while_another_tries(ledger):
        with (
            pytest.raises(OutputError, match="another run"),
            locked(folder, shared=True),
        ):
            pass
        refused.append(True)
        finish(ledger)

    generate(recipe, folder, shard=(1, 2))
    monkeypatch.setattr(module, "finish", finish_while_another_tries)
    assert generate(recipe, folder, shard=(2, 2)).complete
    assert refused


def test_what_cannot_be_written_is_told(recipe, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="/file: is a file where a folder is needed"):
        generate(recipe, tmp_path / "file" / "set")


def test_a_bucket_holds_the_same_samples(recipe, whole):
    url = f"memory://{os.getpid()}/set"
    generate(recipe, url, limit=2)
    outcome = generate(recipe, url)
    assert (outcome.before, outcome.made, outcome.complete) == (2, 2, True)
    system = fsspec.filesystem("memory")
    root = f"/{os.getpid()}/set/"
    there = {
        name.removeprefix(root): system.cat_file(name) for name in system.find(root)
    }
    assert {name: data for name, data in there.items() if name[0] == "0"} == {
        name: (whole / name).read_bytes() for name in digests(whole) if name[0] == "0"
    }
    assert set(there) == set(digests(whole))


def test_draws_that_gates_turn_away_are_drawn_anew_counted_and_told(folder, tmp_path):
    text = RECIPE.replace("count = {count}", "count = {count}\nndisp = 3")
    recipe = read_recipe(write_recipe(tmp_path, text, count=6))
    outcome = generate(recipe, folder)
    assert outcome.complete
    turned = outcome.rejections["disparity beyond ndisp"]
    assert turned > 0
    rows = read_manifest(folder).rows
    assert (
        sum(len(row.info["rejections"]) for row in rows)
        + sum(len(f.rejections) for f in outcome.failures)
        == turned
    )
    assert any(row.info["attempt"] > 0 for row in rows)
    for sample in Dataset(folder):
        assert sample.disp0[np.isfinite(sample.disp0)].max() < 3
        assert sample.calibration.ndisp == 3


def test_a_sample_that_cannot_be_is_told_with_what_to_change_and_the_rest_is_made(
    folder, tmp_path
):
    text = (
        RECIPE.replace("uniform = [0.05, 0.2]", "sweep = [0.1, 2.5]")
        + "[gates]\nattempts = 3\nvisible = 0.5\n"
    )
    recipe = read_recipe(write_recipe(tmp_path, text))
    outcome = generate(recipe, folder)
    assert [failure.index for failure in outcome.failures] == [1, 3]
    assert (outcome.count, outcome.made, outcome.before, outcome.there) == (4, 2, 0, 2)
    assert "rig.baseline" in outcome.failures[0].remedy
    assert len(outcome.failures[0].rejections) == 3
    assert outcome.complete
    assert [sample.name for sample in Dataset(folder)] == ["0000000", "0000002"]
    before = digests(folder)
    assert generate(recipe, folder).made == 0
    assert digests(folder) == before
    assert [entry["index"] for entry in read_manifest(folder).info["failed"]] == [1, 3]


def test_an_estimate_writes_nothing_and_knows_what_is_there(recipe, folder):
    estimated = estimate(recipe, folder)
    assert not folder.exists()
    assert (estimated.count, estimated.before, estimated.todo) == (4, 0, 4)
    assert estimated.bytes == 4 * estimated.bytes_each > 0
    assert estimated.seconds > 0
    generate(recipe, folder)
    assert estimate(recipe, folder).todo == 0


def test_an_estimate_knows_the_size_of_a_sample(recipe, whole, folder):
    estimated = estimate(recipe, folder)
    size = sum(path.stat().st_size for path in (whole / "0000000").iterdir())
    assert estimated.bytes_each == size


def test_a_draw_that_cannot_be_built_is_counted_and_the_next_one_taken(
    folder, tmp_path
):
    """Either coefficient alone keeps the image unfolded (1 + 3 k1 r^2 + 5 k2 r^4 > 0), both together do not."""
    bent = "[rig.distortion]\nk1.choice = [0.0, -0.4, -0.4]\nk2.choice = [0.0, -0.5, -0.5]\n\n[[lenses]]"
    recipe = read_recipe(
        write_recipe(tmp_path, RECIPE.replace("[[lenses]]", bent, 1), count=6)
    )
    outcome = generate(recipe, folder)
    assert set(outcome.rejections) == {"impossible draw"}
    bends = [
        sample.record["record"]["spec"]["drawn"]["rig"]["distortion"]
        for sample in Dataset(folder)
    ]
    assert len(bends) == 6
    assert {"k1": -0.4, "k2": -0.5} not in bends
    found = [
        turned["found"]
        for row in read_manifest(folder).rows
        for turned in row.info["rejections"]
    ]
    assert not [text for text in found if str(tmp_path) in text]


@pytest.mark.parametrize("file", ["im0.png", "sample.json"])
def test_a_damaged_sample_is_told_with_what_to_do(recipe, whole, folder, file):
    shutil.copytree(whole, folder)
    (folder / "0000001" / file).write_bytes(b"torn")
    if file == "sample.json":
        for path in filter(
            Path.is_file, folder.iterdir()
        ):  # so that its row is made of its files again
            path.unlink()
    with pytest.raises(FileError) as caught:
        generate(recipe, folder)
    assert f"{folder / '0000001' / file}" in str(caught.value)
    assert (
        f"delete the folder {folder / '0000001'} and run the same command again"
        in str(caught.value)
    )
    shutil.rmtree(folder / "0000001")
    assert generate(recipe, folder).complete
    assert digests(folder) == digests(whole)


@pytest.mark.parametrize(
    "files", [("calib.txt",), ("im0.png", "im1.png"), ("lens-1/im0.png",)]
)
def test_a_sample_that_lost_a_file_is_told_with_what_to_do(
    recipe, whole, folder, tmp_path, files
):
    """Else it would be counted among those that are there."""
    if "/" in files[0]:
        text = RECIPE.replace("[sensor]", "[[lenses]]\nkind = 'pinhole'\n\n[sensor]")
        recipe = read_recipe(write_recipe(tmp_path, text, count=2))
        generate(recipe, folder)
    else:
        shutil.copytree(whole, folder)
    before = digests(folder)
    for file in files:
        (folder / "0000001" / file).unlink()
    more = r" \(and 1 more\)" if len(files) > 1 else ""
    for way in (generate, estimate):
        with pytest.raises(
            FileError,
            match=f"{files[0]}: is missing{more}; delete the folder .*0000001 and run",
        ):
            way(recipe, folder)
    shutil.rmtree(folder / "0000001")
    assert generate(recipe, folder).made == 1
    assert digests(folder) == before


def test_a_sample_in_a_bucket_that_lost_a_file_is_told(recipe):
    url = f"memory://{os.getpid()}/lost"
    generate(recipe, url, limit=2)
    fsspec.filesystem("memory").rm(f"/{os.getpid()}/lost/0000001/calib.txt")
    with pytest.raises(
        FileError, match=r"0000001/calib.txt: is missing; delete the folder"
    ):
        generate(recipe, url)


def test_a_folder_without_its_mark_is_told_with_what_to_do(recipe, folder):
    (folder / "0000000").mkdir(parents=True)
    (folder / "0000000" / "im0.png").touch()
    with pytest.raises(
        OutputError,
        match=r"is not a whole sample; delete the folder .*0000000 and run the same command",
    ):
        generate(recipe, folder, limit=1)


def test_where_nothing_is_left_to_chance_the_first_draw_tells(folder, tmp_path):
    """Twenty draws of a scene from a file with one rig are one draw; but photographs have noise, and are taken anew."""
    fixed = "seed = 1\ncount = {count}\nscenes = ['tiny']\nwidth = 32\nheight = 24\nspp = 1\n"
    recipe = read_recipe(
        write_recipe(
            tmp_path, fixed + "ndisp = 1\nrig.baseline.sweep = [0.1, 0.001]\n", count=2
        )
    )
    outcome = generate(recipe, folder)
    assert [
        (failure.index, len(failure.rejections)) for failure in outcome.failures
    ] == [(0, 1)]
    assert outcome.failures[0].rejections[0]["reason"] == "disparity beyond ndisp"
    assert outcome.there == 1
    bent = "[rig.distortion]\nk1.sweep = [0.0, -0.4]\nk2.sweep = [0.0, -0.5]\n"  # each valid, not both together
    with pytest.raises(Exhausted, match="1 draws rejected"):
        make(read_recipe(write_recipe(tmp_path, fixed + bent)), 3)
    noisy = read_recipe(
        write_recipe(
            tmp_path, fixed + "exposure.time = 1e-9\n[gates]\nattempts = 3\n", count=1
        )
    )
    with pytest.raises(Exhausted, match="3 draws rejected"):
        make(noisy, 0)
    drawn = "ndisp = 1\nrig.baseline.uniform = [0.1, 0.2]\n[gates]\nattempts = 3\n"
    with pytest.raises(Exhausted, match="3 draws rejected"):
        make(read_recipe(write_recipe(tmp_path, fixed + drawn, count=1)), 0)


THIN = 'kind = "thin"\naperture_mm = {{ choice = [0, 2, 8] }}\nfocus = "object"'


@pytest.mark.parametrize("subject", [{"scenes": ["cards"]}, {"families": ["tabletop"]}])
@pytest.mark.parametrize(
    ("mismatch", "message"),
    [
        (
            ["typical", "typical"],
            "number of mismatches of the sensor must be 1, .* got 2",
        ),
        ([], "must be 1, .* got 0"),
        (
            {"scale_px": -90},
            "scale_px=-90: too large for an image of 64x48 pixels, its corners are 40 px from",
        ),
        ({"focus_um": -1e5}, "focus_um=-100000 moves the film to the lens"),
    ],
)
def test_a_constant_impossible_mismatch_leaves_no_folder_behind(
    tmp_path, folder, subject, mismatch, message
):
    lenses = [{"kind": "thin", "aperture_mm": 8}]
    table = {
        "seed": 1,
        "count": 2,
        "width": 64,
        "height": 48,
        "lenses": lenses,
        "sensor": {"mismatch": mismatch},
    }
    with pytest.raises(InputError, match=f"^recipe.toml: .*{message}"):
        generate(
            recipe_from_table({**table, **subject}, tmp_path / "recipe.toml"), folder
        )
    assert not folder.exists()


def test_a_scene_without_light_needs_a_sky(tmp_path, folder):
    path = write_recipe(tmp_path, count=1)
    scene = tmp_path / "tiny" / "scene.toml"
    scene.write_text(
        scene.read_text().replace('[lights.sky]\ntype = "constant"\nradiance = 1.0', "")
    )
    with pytest.raises(
        InputError, match=r"scenes: the scene 'tiny' has no light: .*or a sky"
    ):
        generate(read_recipe(path), folder)
    assert not folder.exists()
    write_sky(tmp_path / "day.exr", np.full((4, 8, 3), 0.5))
    path.write_text(path.read_text() + '[sky]\nfile = "day.exr"\n')
    assert make(read_recipe(path), 0).shots[0].images[0].any()


def test_progress_names_the_reason_of_the_last_rejected_draw(folder, tmp_path):
    recipe = read_recipe(
        write_recipe(
            tmp_path, RECIPE + "[gates]\nattempts = 2\nvisible = 1.0\n", count=1
        )
    )
    texts = []
    outcome = generate(recipe, folder, report=lambda _, text: texts.append(text))
    assert texts[0] == "0/1"
    assert (
        texts[-1]
        == f"0/1 draw 2 of 2; last rejected: {outcome.failures[0].rejections[0]['reason']}"
    )
