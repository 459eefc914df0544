"""Subsets and merges: every file is that of the source or says what it lacks, and a stopped run goes on."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.dataset.dataset_scene import list_samples, sample
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    card,
    combine as combining,
    read_manifest,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.combine import combine
from twinlens.dataset.dataset import row_of
from twinlens.dataset.splits import assign, parse_shares
from twinlens.errors import FileError, InputError, OutputError

NAMES = ("0000000", "0000001", "0000002")


@pytest.fixture(scope="module")
def shards(tmp_path_factory):
    """Two datasets whose samples have the same names and different files."""
    home = tmp_path_factory.mktemp("shards")
    for folder, made in (("a", sample(num_lenses=2)), ("b", rich_sample())):
        for name in NAMES:
            write_sample(home / folder / name, made)
        list_samples(home / folder, *NAMES)
    return home / "a", home / "b"


def rich_sample():
    """A sample of two lenses with linear images, dual pixels, and where its images were warped."""
    made = sample(num_lenses=2)
    radiances = tuple(image.astype(np.float32) for image in made.shots[0].images)
    halves = tuple((image, 255 - image) for image in made.shots[0].images)
    shots = [replace(shot, radiances=radiances, halves=halves) for shot in made.shots]
    valid = np.full(made.truths[0].depth.shape, 255, np.uint8)
    truths = [
        replace(truth, extra={**truth.extra, "valid": valid}) for truth in made.truths
    ]
    record = {**made.record, "dual_pixel": True}
    return replace(made, shots=tuple(shots), truths=tuple(truths), record=record)


@pytest.fixture(scope="module", autouse=True)
def _cards_have_no_figures():
    """Tests of the card draw them."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card, "statistics_figure", lambda many: b"")
        yield


def findings(folder):
    return {name: lines for name, lines in verify_place(folder) if lines}


def content(folder):
    """SHA-256 of every file below a folder."""
    files = sorted(path for path in Path(folder).rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }


def test_a_merge_has_every_file_of_its_sources_below_their_names(shards, tmp_path):
    done = combine([Dataset(shard) for shard in shards], tmp_path / "all")
    assert (done.samples, done.made, done.repeated) == (6, 6, 0)
    names = [f"{shard}/{name}" for shard in "ab" for name in NAMES]
    assert list(Dataset(tmp_path / "all").names) == names
    for shard in shards:
        for name in NAMES:
            copied = tmp_path / "all" / shard.name / name
            assert content(copied) == content(shard / name)
    assert findings(tmp_path / "all") == {}


def test_names_that_differ_stay_and_order_is_that_of_the_sources(shards, tmp_path):
    a, b = map(Dataset, shards)
    combine([b[[2]], a[[1, 0]]], tmp_path / "some")
    assert list(Dataset(tmp_path / "some").names) == ["0000002", "0000001", "0000000"]
    assert (tmp_path / "some/0000002/radiance0.exr").exists()


def test_a_sample_that_two_sources_share_is_written_once(shards, tmp_path):
    a = Dataset(shards[0])
    done = combine([a[:2], a[1:]], tmp_path / "whole")
    assert (done.samples, done.repeated) == (3, 1)
    assert list(Dataset(tmp_path / "whole").names) == list(NAMES)


def test_sources_of_one_name_get_numbers(shards, tmp_path):
    parts = [Dataset(shards[0])[:1], Dataset(shards[1])[:1]]
    parts[0].path, parts[1].path = tmp_path / "x/out", tmp_path / "y/out"
    assert [origin.name for origin in combining._origins(parts, tmp_path / "new")] == [
        "out",
        "out-2",
    ]


def test_links_are_the_same_files(shards, tmp_path):
    done = combine([Dataset(shards[1])], tmp_path / "linked", link=True)
    assert done.linked == done.files
    assert done.bytes == 0
    for path in content(shards[1] / NAMES[0]):
        assert (tmp_path / "linked" / NAMES[0] / path).samefile(
            shards[1] / NAMES[0] / path
        )
    assert findings(tmp_path / "linked") == {}


def test_changed_files_are_never_links(shards, tmp_path):
    before = content(shards[0])
    combine([Dataset(shards[0])], tmp_path / "new", link=True, dropped=["normal"])
    assert content(shards[0]) == before
    assert findings(tmp_path / "new") == {}
    changed = {"truth0.exr", "truth1.exr", "sample.json"}
    for name in content(shards[0] / NAMES[0]):
        same = (tmp_path / "new" / NAMES[0] / name).samefile(
            shards[0] / NAMES[0] / name
        )
        assert same != (name in changed)


@pytest.mark.parametrize("link", [False, True])
def test_a_stopped_run_resumes_to_the_same_bytes(shards, tmp_path, monkeypatch, link):
    parts = [Dataset(shard) for shard in shards]
    combine(parts, tmp_path / "at once", link=link)
    write, calls = combining.write_folder, []

    def stopping(folder, *args, **kwargs):
        calls.append(folder)
        if len(calls) == 4:
            raise KeyboardInterrupt
        write(folder, *args, **kwargs)

    monkeypatch.setattr(combining, "write_folder", stopping)
    with pytest.raises(KeyboardInterrupt):
        combine(parts, tmp_path / "stopped", link=link)
    assert read_manifest(tmp_path / "stopped").rows == ()
    with pytest.raises(FileError, match="rerun the same `twinlens subset`"):
        Dataset(tmp_path / "stopped")
    # What a killed process or a power failure leaves.
    (tmp_path / "stopped/a/.0000002.unfinished-1-2").mkdir()
    if not link:
        (tmp_path / "stopped/a/0000001/im0.png").write_bytes(b"")
    done = combine(parts, tmp_path / "stopped", link=link)
    assert done.made == (3 if link else 4)
    assert content(tmp_path / "stopped") == content(tmp_path / "at once")
    assert combine(parts, tmp_path / "stopped", link=link).made == 0


def test_other_options_need_another_folder(shards, tmp_path):
    combine([Dataset(shards[0])], tmp_path / "new")
    before = content(tmp_path / "new")
    with pytest.raises(OutputError, match="other options, or from other sources"):
        combine([Dataset(shards[0])[:2]], tmp_path / "new")
    with pytest.raises(OutputError, match="is another dataset"):
        combine([Dataset(tmp_path / "new")], shards[0])
    assert content(tmp_path / "new") == before


def test_a_folder_with_other_files_and_one_inside_the_source_are_refused(
    shards, tmp_path
):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/notes.txt").write_text("x")
    with pytest.raises(OutputError, match=r"contains 'notes.txt'"):
        combine([Dataset(shards[0])], tmp_path / "mine")
    for inside in (shards[0], shards[0] / "part"):
        with pytest.raises(OutputError, match="choose a folder outside"):
            combine([Dataset(shards[0])], inside)
    with pytest.raises(InputError, match="no sample is left"):
        combine([Dataset(shards[0])[:0]], tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_damaged_source_is_named_and_nothing_is_listed(tmp_path):
    write_sample(tmp_path / "a/x", sample())
    list_samples(tmp_path / "a", "x")
    (tmp_path / "a/x/disp0.pfm").write_bytes(b"Pf")
    with pytest.raises(FileError, match=r"x/disp0.pfm: differs from its SHA-256"):
        combine([Dataset(tmp_path / "a")], tmp_path / "new")
    assert read_manifest(tmp_path / "new").rows == ()
    (tmp_path / "a/x/disp0.pfm").unlink()
    with pytest.raises(FileError, match=r"x/disp0.pfm: no such file"):
        combine([Dataset(tmp_path / "a")], tmp_path / "linked", link=True)


def test_a_plain_folder_becomes_a_dataset_with_checksums(tmp_path):
    write_sample(tmp_path / "plain/x", sample())
    for name in ("sample.json", "truth0.exr", "truth1.exr"):
        (tmp_path / "plain/x" / name).unlink()
    combine([Dataset(tmp_path / "plain")], tmp_path / "new")
    assert findings(tmp_path / "new") == {}
    assert "im0.png" in read_manifest(tmp_path / "new").rows[0].files


def test_folders_inside_of_samples_are_refused(tmp_path):
    for name in ("a/s", "b/s/t"):
        write_sample(tmp_path / name, sample())
    list_samples(tmp_path / "a", "s")
    list_samples(tmp_path / "b", "s/t")
    with pytest.raises(InputError, match=r"'s/t' would be inside the sample 's'"):
        combine([Dataset(tmp_path / "a"), Dataset(tmp_path / "b")], tmp_path / "new")


# -- channels


def test_what_is_dropped_is_gone_and_the_rest_is_equal(shards, tmp_path):
    dropped = ["normal", "shading_normal", "radiance", "dp_left", "dp_right", "dp_disp"]
    combine([Dataset(shards[1])], tmp_path / "new", dropped=dropped)
    assert findings(tmp_path / "new") == {}
    old, new = Dataset(shards[1])[0], Dataset(tmp_path / "new")[0]
    assert new.dropped == tuple(sorted(dropped))
    for name in ("im1", "disp0", "depth0", "position1", "object_id0", "lit0", "valid0"):
        np.testing.assert_array_equal(new[name], old[name])
    gone = set(content(old.folder)) - set(content(new.folder))
    stems = {path.split("/")[-1].split(".")[0].rstrip("01") for path in gone}
    assert stems == {"radiance", "dp-left", "dp-right", "dp-disp"}
    with pytest.raises(FileError, match=r"has no normal, which `twinlens subset`"):
        new["normal0"]
    with pytest.raises(FileError, match=r"has no normal, shading_normal, which"):
        new.truth(0)
    with pytest.raises(FileError, match=r"radiance0.exr: is not in this dataset"):
        new.radiance(0)


def test_position_and_blur_follow_from_the_depth(shards, tmp_path):
    combine(
        [Dataset(shards[0])], tmp_path / "new", dropped=["position", "blur_circle_px"]
    )
    assert findings(tmp_path / "new") == {}
    old, new = Dataset(shards[0])[0], Dataset(tmp_path / "new")[0]
    hit = np.isfinite(old.depth0)
    # float32 coordinates and depths of a few metres
    np.testing.assert_allclose(new.position0[hit], old.position0[hit], atol=5e-6)
    assert np.isinf(new.position0[~hit]).all()
    np.testing.assert_allclose(
        new.truth0.position[hit], old.truth0.position[hit], atol=5e-6
    )
    np.testing.assert_allclose(new.blur_circle_px0, old.blur_circle_px0, rtol=1e-5)


def test_images_alone_are_a_pair_without_truth(shards, tmp_path):
    truth = ["depth", "position", "normal", "shading_normal", "visible", "object_id", "material_id",
             "material_kind", "blur_circle_px", "projector_pixels", "lit", "disp", "mask_nonocc"]  # fmt: skip
    combine([Dataset(shards[0])], tmp_path / "new", dropped=truth)
    assert findings(tmp_path / "new") == {}
    pair = Dataset(tmp_path / "new")[0]
    assert not {"truth0.exr", "disp0.pfm", "mask0nocc.png"} & set(content(pair.folder))
    assert not pair.may_have_disparity(0)
    with pytest.raises(FileError, match=r"disp0.pfm: is not in this dataset"):
        _ = pair.disp0


def test_what_was_dropped_before_stays_dropped(shards, tmp_path):
    combine([Dataset(shards[0])], tmp_path / "one", dropped=["normal"])
    combine([Dataset(tmp_path / "one")], tmp_path / "two", dropped=["shading_normal"])
    assert findings(tmp_path / "two") == {}
    assert Dataset(tmp_path / "two")[0].dropped == ("normal", "shading_normal")


def test_verify_still_finds_wrong_truth(shards, tmp_path):
    """Without normals, a disparity that contradicts the depth; without the mark, a missing channel."""
    combine([Dataset(shards[0])[:1]], tmp_path / "new", dropped=["normal"])
    place = tmp_path / "new" / NAMES[0]
    disparity = place / "disp0.pfm"
    data = bytearray(disparity.read_bytes())
    data[-12000:-11500] = np.full(125, 7.0, "<f4").tobytes()
    disparity.write_bytes(data)
    write_manifest(tmp_path / "new", Manifest([row_of(tmp_path / "new", NAMES[0])]))
    assert (
        "disparity differs from fx B / z - doffs"
        in findings(tmp_path / "new")[NAMES[0]][0]
    )
    record = json.loads((place / "sample.json").read_text())
    (place / "sample.json").write_text(json.dumps({**record, "dropped": []}))
    write_manifest(tmp_path / "new", Manifest([row_of(tmp_path / "new", NAMES[0])]))
    assert "has no channel 'normal'" in findings(tmp_path / "new")[NAMES[0]][0]


@pytest.mark.parametrize(
    ("name", "message"),
    [("im", "cannot be dropped"), ("normals", "did you mean 'normal'")],
)
def test_wrong_channels_are_named(shards, tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        combine([Dataset(shards[0])], tmp_path / "new", dropped=[name])
    assert not (tmp_path / "new").exists()


# -- licences


def described(folder, about, **info):
    write_sample(folder / "x", sample())
    rows = [row_of(folder, "x")]
    write_manifest(folder, Manifest(rows, {"about": about}, info=info))
    return Dataset(folder)


def test_all_licences_authors_and_credits_are_kept(tmp_path):
    credit = {"files": "hdris/*.exr", "license": "CC0-1.0"}
    one = {"license": "CC-BY-4.0", "creator": "Ada", "name": "A", "credits": [credit]}
    two = {"license": "CC0-1.0", "creator": "Bo", "name": "B"}
    parts = [
        described(tmp_path / "a", one, sources={"hdris/sky.exr": "12"}),
        described(
            tmp_path / "b", two, sources={"hdris/sky.exr": "34"}, bundled=["fence"]
        ),
    ]
    combine([parts[0], parts[1]], tmp_path / "all", dropped=())
    info = read_manifest(tmp_path / "all").info
    assert info["about"]["license"] == "CC-BY-4.0 AND CC0-1.0"
    assert info["about"]["creator"] == "Ada, Bo"
    assert "name" not in info["about"]
    assert info["sources"] == {"a/hdris/sky.exr": "12", "b/hdris/sky.exr": "34"}
    assets = (tmp_path / "all/ASSETS.md").read_text()
    assert "| a/hdris/sky.exr | `12` | CC0-1.0 |" in assets
    assert "| b/hdris/sky.exr | `34` | not stated |" in assets
    card = (tmp_path / "all/README.md").read_text()
    assert "CC-BY-4.0 AND CC0-1.0" in card
    assert "### a" in card
    assert "Licence: CC-BY-4.0." in card


def test_a_source_without_licence_leaves_the_whole_without(tmp_path):
    parts = [
        described(tmp_path / "a", {"license": "CC0-1.0"}),
        described(tmp_path / "b", {}),
    ]
    combine(parts, tmp_path / "all")
    assert "license" not in read_manifest(tmp_path / "all").info["about"]
    alone = combine(parts[:1], tmp_path / "part")
    assert alone.samples == 1
    assert read_manifest(tmp_path / "part").info["about"] == {"license": "CC0-1.0"}


# -- splits


@pytest.mark.parametrize("seed", [0, 1, 7])
def test_groups_stay_together_and_shares_are_near(seed):
    rng = np.random.default_rng(seed)
    groups = [f"scene {number}" for number in rng.integers(0, 40, 1000)]
    shares = {"train": 0.7, "val": 0.1, "test": 0.2}
    splits = assign(groups, shares, seed)
    of_group = {}
    for group, split in zip(groups, splits, strict=True):
        assert of_group.setdefault(group, split) == split
    largest = max(groups.count(group) for group in set(groups))
    for name, share in shares.items():
        assert abs(splits.count(name) - 1000 * share) <= largest
    assert assign(groups, shares, seed) == splits


def test_seeds_differ_and_every_split_is_filled():
    groups = [f"scene {number}" for number in range(20)]
    halves = {"a": 0.5, "b": 0.5}
    assert len({tuple(assign(groups, halves, seed)) for seed in range(5)}) == 5
    tiny = assign(["x"] * 98 + ["y", "z"], {"a": 0.98, "b": 0.01, "c": 0.01})
    assert set(tiny) == {"a", "b", "c"}
    with pytest.raises(InputError, match="1 group of samples cannot fill 2 splits"):
        assign(["x"] * 5, halves)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("train", "splits are NAME=SHARE"),
        ("a=0.5,a=0.5", "splits are NAME=SHARE"),
        ("a=0.5,b=half", "must be a number"),
        ("a=0.5,b=0.6", "must add up to 1, got 1.1"),
        ("a=1,b=0", "the share of 'b'"),
        ("../a=1", "not a plain relative name"),
    ],
)
def test_wrong_shares_are_named(text, message):
    with pytest.raises(InputError, match=message):
        parse_shares(text)


def test_new_splits_are_those_of_the_dataset(tmp_path):
    for name in NAMES:
        write_sample(tmp_path / "a" / name, sample())
    rows = [
        Row(name, row_of(tmp_path / "a", name).files, {"split": "old", "k": 1})
        for name in NAMES
    ]
    write_manifest(tmp_path / "a", Manifest(rows))
    data = Dataset(tmp_path / "a")
    done = combine([data], tmp_path / "b", split_of=lambda samples: ["x", "y", "y"])
    assert done.splits == {"x": 1, "y": 2}
    assert list(Dataset(tmp_path / "b").split("y").names) == list(NAMES[1:])
    assert read_manifest(tmp_path / "b").rows[0].info == {"split": "x", "k": 1}
    combine([data], tmp_path / "c")
    assert len(Dataset(tmp_path / "c").split("old")) == 3
