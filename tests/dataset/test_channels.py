"""The table of channels: every row is documented and round trips, and a new channel is one new row."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import Dataset, describe, write_sample
from twinlens.dataset.channels import CHANNELS, TEXTS, TRUTH, Channel, parse_file
from twinlens.dataset.codecs.exr import read_exr
from twinlens.dataset.export import export
from twinlens.dataset.verify import verify_sample
from twinlens.errors import InputError

SAMPLE = dataset_scene.sample(num_lenses=2)


def _behind(view):
    """Findings on the second surface, which must not be before the first."""
    wrong = view.channels["second_distance"] < view.channels["depth"]
    text = f"second_distance is before depth at {wrong.sum()} pixels"
    return [text] if wrong.any() else []


SECOND_DISTANCE = Channel(
    "second_distance",
    TRUTH,
    "float32",
    "distance to the second surface along the chief ray; +inf unknown",
    "m",
    optional=True,
    check=_behind,
)


def test_every_channel_is_read_as_it_was_written(tmp_path):
    sample = dataset_scene.full_sample()
    write_sample(tmp_path / "s", sample)
    stored = Dataset(tmp_path)[0]
    for channel in CHANNELS.values():
        if channel.dtype == TEXTS:
            continue
        for view in (0, 1):
            array = stored[channel.quantity(view)]
            written = np.asarray(channel.of(sample, view))
            assert array.dtype.name in channel.dtype.split(" or ")
            assert_array_equal(array, written.astype(array.dtype))
            assert_array_equal(array, getattr(stored, channel.quantity(view)))


def test_names_of_files_are_parsed_as_they_are_made(tmp_path):
    hashes = write_sample(tmp_path / "s", dataset_scene.full_sample())
    names = set()
    for name in hashes:
        if (parsed := parse_file(name)) is not None:
            file, view, lens = parsed
            assert file.name(view, lens) == name
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


def test_a_new_channel_is_one_new_row(tmp_path, monkeypatch):
    """Written, read, verified, described and exported, without any other change."""
    second = [np.float32(truth.depth + 0.25) for truth in SAMPLE.truths]
    truths = [
        replace(truth, extra={"second_distance": distance})
        for truth, distance in zip(SAMPLE.truths, second, strict=True)
    ]
    sample = replace(SAMPLE, truths=tuple(truths))
    with pytest.raises(InputError, match="unknown channel 'second_distance'"):
        write_sample(tmp_path / "set" / "s", sample)

    monkeypatch.setitem(CHANNELS, "second_distance", SECOND_DISTANCE)
    write_sample(tmp_path / "set" / "s", sample)
    dataset_scene.list_samples(tmp_path / "set", "s")
    data = Dataset(tmp_path / "set")
    stored = data[0]

    assert_array_equal(stored.second_distance0, second[0])
    assert_array_equal(stored["second_distance1"], second[1])
    assert_array_equal(
        data.select("second_distance0")[0]["second_distance0"], second[0]
    )
    assert_array_equal(stored.truth1.extra["second_distance"], second[1])

    assert verify_sample(stored) == []
    nearer = [
        replace(truth, extra={"second_distance": 0.5 * truth.depth})
        for truth in SAMPLE.truths
    ]
    write_sample(tmp_path / "wrong", replace(SAMPLE, truths=tuple(nearer)))
    findings = verify_sample(Dataset(tmp_path / "wrong")[0])
    assert findings[0].startswith("truth0.exr: second_distance is before depth at ")

    describe(data)
    assert "second_distance" in (tmp_path / "set" / "croissant.json").read_text()

    export(data, tmp_path / "out", to="exr")
    planes = read_exr(tmp_path / "out" / "s" / "view1.exr").channels
    assert_array_equal(planes["second_distance"], second[1])


def test_samples_without_an_optional_channel_are_read(tmp_path, monkeypatch):
    monkeypatch.setitem(CHANNELS, "second_distance", SECOND_DISTANCE)
    write_sample(tmp_path / "s", SAMPLE)
    stored = Dataset(tmp_path)[0]
    assert stored.truth0.extra == {}
    assert verify_sample(stored) == []
    with pytest.raises(ValueError, match=r"truth0.exr: has no channel"):
        _ = stored.second_distance0
