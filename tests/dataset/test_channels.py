"""The table of channels: every row is documented and round trips, and a new channel is one new row.

Who adds a channel of truth changes three files: rendering/ground_truth.py, a function and its name in `EXTRA_CHANNELS`
(tests/factory/test_sample.py renders one); dataset/channels.py, a row of `CHANNELS`; and docs/format.md, a row there.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import twinlens
from tests.dataset import dataset_scene
from tests.dataset.dataset_scene import edited, next_version, stored
from twinlens.dataset import Dataset, describe, write_sample
from twinlens.dataset.channels import CHANNELS, TEXTS, TRUTH, Channel, parse_file
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.export import export
from twinlens.dataset.verify import verify_sample
from twinlens.errors import FileError, InputError

SAMPLE = dataset_scene.sample(num_lenses=2)


def _behind(view):
    """Findings on the second surface, which must not be before the first."""
    wrong = view.channels["second_distance"] < view.channels["depth"]
    text = f"second_distance is before depth at {wrong.sum()} pixels"
    return [text] if wrong.any() else []


ROW = Channel(
    "second_distance",
    TRUTH,
    "float32",
    "distance to the second surface along the chief ray; +inf unknown",
    "m",
    since=next_version(),
    check=_behind,
)


def with_second(*distances):
    truths = tuple(
        replace(truth, extra={**truth.extra, "second_distance": distance})
        for truth, distance in zip(SAMPLE.truths, distances, strict=True)
    )
    return replace(SAMPLE, truths=truths)


SECOND = [np.float32(truth.depth + 0.25) for truth in SAMPLE.truths]


@pytest.fixture
def new_row(monkeypatch):
    monkeypatch.setitem(CHANNELS, ROW.name, ROW)


def test_every_channel_is_read_as_it_was_written(tmp_path):
    sample = dataset_scene.full_sample()
    write_sample(tmp_path / "s", sample)
    rows = [channel for channel in CHANNELS.values() if channel.dtype != TEXTS]
    for view in (0, 1):
        names = [channel.quantity(view) for channel in rows]
        values = Dataset(tmp_path).select(*names)[0]
        for channel, array in zip(rows, values.values(), strict=True):
            written = np.asarray(channel.of(sample, view))
            assert array.dtype.name in channel.dtype.split(" or ")
            assert_array_equal(array, written.astype(array.dtype))


def test_names_of_files_are_parsed_as_they_are_made(tmp_path):
    hashes = write_sample(tmp_path / "s", dataset_scene.full_sample())
    names = set()
    for name in hashes:
        if (parsed := parse_file(name)) is not None:
            file, view, lens, frame = parsed
            assert file.name(view, lens, frame) == parsed.name == name
            names.add(name)
    assert set(hashes) - names == {"calib.txt", "sample.json"}
    for name in ("im0.exr", "xim0.png", "lens-a/im0.png", "im.png", "notes0.txt"):
        assert parse_file(name) is None


def test_the_page_of_formats_lists_every_channel_of_the_truth():
    """test_items.py compares docs/loading.md with what is read."""
    page = (Path(__file__).parents[2] / "docs" / "format.md").read_text()
    for channel in TRUTH.channels:
        first = (channel.planes or (channel.name,))[0].format("<i>")
        if channel.dtype == TEXTS:
            first = f"twinlens.{channel.name}"
        assert f"`{first}`" in page


@pytest.mark.usefixtures("new_row")
def test_a_new_channel_is_one_new_row(tmp_path):
    """Written, read, verified, described and exported, without any other change."""
    write_sample(tmp_path / "set" / "s", with_second(*SECOND))
    dataset_scene.list_samples(tmp_path / "set", "s")
    data = Dataset(tmp_path / "set")

    assert_array_equal(data[0].second_distance0, SECOND[0])
    assert_array_equal(data[0]["second_distance1"], SECOND[1])
    assert_array_equal(data[0].truth1.extra["second_distance"], SECOND[1])

    assert verify_sample(data[0]) == []
    nearer = with_second(*(0.5 * truth.depth for truth in SAMPLE.truths))
    findings = verify_sample(stored(tmp_path / "wrong", nearer))
    assert findings[0].startswith("truth0.exr: second_distance is before depth at ")

    describe(data)
    metadata = (tmp_path / "set" / "croissant.json").read_text()
    assert f"- second_distance [m]: {ROW.meaning}" in metadata
    assert "projector" not in metadata, "the rig has none"

    export(data, tmp_path / "out", to="exr")
    planes = read_exr(tmp_path / "out" / "s" / "view1.exr").channels
    assert_array_equal(planes["second_distance"], SECOND[1])


def test_a_sample_needs_the_channels_of_the_version_that_wrote_it(
    tmp_path, monkeypatch
):
    old = stored(tmp_path / "s", SAMPLE)
    monkeypatch.setitem(CHANNELS, ROW.name, ROW)
    assert ROW.name not in old.truth0.extra
    assert verify_sample(old) == []
    missing = "has no channel 'second_distance'"
    with pytest.raises(FileError, match=missing):
        _ = old.second_distance0

    monkeypatch.setattr(twinlens, "__version__", ROW.since)
    with pytest.raises(InputError, match="lacks 'second_distance'"):
        write_sample(tmp_path / "new", SAMPLE)
    with edited(old.folder) as record:
        record["twinlens"] = ROW.since
    reason = rf"written by twinlens {ROW.since} must have, .* since='{ROW.since}'"
    with pytest.raises(FileError, match=rf"truth0\.exr: {missing}, .* {reason}"):
        _ = old.truth0
    findings = verify_sample(old)
    for view, finding in enumerate(findings):
        assert finding.startswith(f"truth{view}.exr: {missing}")
    assert len(findings) == 2


@pytest.mark.parametrize("since", ["", "next", "0.3"])
def test_a_row_of_truth_states_a_version(since):
    with pytest.raises(InputError, match=f"channel 'speed' must be .* got '{since}'"):
        Channel("speed", TRUTH, "float32", "of the point", since=since)


@pytest.mark.usefixtures("new_row")
def test_the_samples_of_tests_have_a_new_channel(tmp_path, monkeypatch):
    monkeypatch.setattr(twinlens, "__version__", ROW.since)
    assert ROW.name in stored(tmp_path / "s").truth0.extra


@pytest.mark.parametrize("names", [("new", "old"), ("old", "new")])
def test_croissant_lists_the_channels_of_samples_of_all_versions(
    tmp_path, monkeypatch, names
):
    write_sample(tmp_path / "old", SAMPLE)
    monkeypatch.setitem(CHANNELS, ROW.name, ROW)
    monkeypatch.setattr(twinlens, "__version__", ROW.since)
    write_sample(tmp_path / "new", with_second(*SECOND))
    dataset_scene.list_samples(tmp_path, *names)
    describe(Dataset(tmp_path))
    assert f"- {ROW.description}" in (tmp_path / "croissant.json").read_text()


@pytest.mark.usefixtures("new_row")
@pytest.mark.parametrize(
    ("array", "message"),
    [
        (SECOND[0][1:], r"'second_distance' must have the shape \(48, 64\), got \(47, 64\)"),
        (SECOND[0] + 0j, "'second_distance' must be float32, got complex64"),
        (np.full((48, 64), 2**24 + 1), "must be float32, got int64"),
    ],
)  # fmt: skip
def test_an_array_that_its_file_cannot_hold_is_refused(tmp_path, array, message):
    with pytest.raises(InputError, match=message):
        write_sample(tmp_path / "s", with_second(array, SECOND[1]))
    assert not any(tmp_path.iterdir())


@pytest.mark.usefixtures("new_row")
def test_an_array_of_another_dtype_is_written_if_its_values_stay(tmp_path):
    whole = np.arange(48 * 64).reshape(48, 64) + 10
    back = stored(tmp_path / "s", with_second(whole, whole.astype(float)))
    for view in (0, 1):
        array = back[f"second_distance{view}"]
        assert array.dtype == np.float32
        assert_array_equal(array, whole)
