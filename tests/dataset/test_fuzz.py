"""Damaged files of each format are read or raise a twinlens error, in bounded memory and time.

A hundred files each time; ten thousand in the slow set, which also has the decoders of test_codecs.py. Bytes are
damaged as disks and downloads do it. The values of JSON files are also exchanged for others, to get past the parser.
Each test reads in a process of its own, so that its peak memory does not depend on the tests before it.
"""

import json
import multiprocessing
import resource
import warnings
from concurrent.futures import ProcessPoolExecutor

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from tests.dataset import dataset_scene
from tests.dataset.dataset_damage import damaged
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    describe,
    verify_place,
    write_manifest,
    write_sample,
)
from twinlens.dataset.card import Contents, card_text
from twinlens.dataset.channels import TRUTH
from twinlens.dataset.codecs.calib import Calibration, decode_calib, encode_calib
from twinlens.dataset.codecs.exr import decode_exr, encode_exr
from twinlens.dataset.codecs.pfm import decode_pfm, encode_pfm
from twinlens.dataset.codecs.png import decode_png, encode_png
from twinlens.dataset.metadata import about, write_croissant
from twinlens.dataset.statistics import statistics, stored_statistics
from twinlens.errors import TwinlensError

QUICK, CASES = 100, 10_000
LONGEST_MS = (
    10_000  # no reader takes a hundredth of it on its own; the machine may be busy
)
PLANE = np.arange(24 * 31, dtype=np.float32).reshape(24, 31)
COLOR = np.stack([PLANE, PLANE[::-1], PLANE * 3], axis=-1)
SAMPLE = dataset_scene.sample(num_lenses=2, width=16, height=12)

DECODERS = {
    "pfm": (decode_pfm, encode_pfm(PLANE)),
    "color pfm": (decode_pfm, encode_pfm(COLOR)),
    "png": (decode_png, encode_png(COLOR.astype(np.uint8))),
    "16-bit png": (decode_png, encode_png(COLOR.astype(np.uint16))),
    "exr": (
        decode_exr,
        encode_exr({"depth": PLANE, "id": PLANE.astype(int)}, {"names": '["a"]'}),
    ),
    "calib.txt": (
        lambda data: decode_calib(data.decode("utf-8", "replace")),
        encode_calib(Calibration.from_rig(SAMPLE.rig, ndisp=64)).encode(),
    ),
}


def read_sample(root):
    sample = Dataset(root)["a"]
    _ = (
        sample.rig,
        [sample.lens(k).lens for k in range(sample.num_lenses)],
        stored_statistics(sample),
    )


def read_dataset(root):
    data = Dataset(root)
    texts, manifest = about(data)
    contents = Contents({"a": statistics(SAMPLE)}, [0.3])
    assert texts.title in card_text(texts, manifest, contents)
    write_croissant(data, texts, manifest)


def look_over(root):
    """Verification raises for no content of a file; a finding counts as a rejection."""
    _, findings = next(verify_place(root))
    if findings:
        raise TwinlensError(findings[0])


FILES = {
    "a/sample.json": read_sample,
    "dataset.json": read_dataset,
    "croissant.json": look_over,
    "a/truth0.exr": lambda root: TRUTH.read(root / "a" / "truth0.exr"),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    root = tmp_path_factory.mktemp("fuzzed")
    row = Row("a", write_sample(root / "a", SAMPLE), {"split": "train"})
    texts = {
        "about": {"license": "MIT"},
        "versions": {"numpy": "2"},
        "rejected": {"dark": 1},
    }
    write_manifest(root, Manifest((row,), {"count": 1}, 3, texts))
    describe(root)
    return root


SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=9)
NAMES = st.sampled_from(["type", "name", "files", "cameras", "fx", "about"]) | st.text(
    max_size=5
)
VALUES = st.recursive(
    SCALARS,
    lambda below: (
        st.lists(below, max_size=4) | st.dictionaries(NAMES, below, max_size=4)
    ),
    max_leaves=8,
)


@st.composite
def other_values(draw, good):
    """A JSON file with one to three of its values, at any depth, replaced or removed."""
    record = json.loads(good)
    for _ in range(draw(st.integers(1, 3))):
        holder, key = record, draw(st.sampled_from(sorted(record))) if record else None
        while (
            key is not None
            and isinstance(holder[key], (dict, list))
            and holder[key]
            and draw(st.integers(0, 3))
        ):
            holder = holder[key]
            key = draw(
                st.sampled_from(
                    sorted(holder) if isinstance(holder, dict) else range(len(holder))
                )
            )
        if key is not None and draw(st.integers(0, 4)):
            holder[key] = draw(VALUES)
        elif key is not None:
            del holder[key]
    return json.dumps(record).encode()


def rejected(read, data):
    """Whether the data is rejected, with a message of one line."""
    try:
        read(data)
    except TwinlensError as error:
        message = str(error)
    else:
        return False
    assert "\n" not in message
    return True


def fuzz(read, strategy, cases):
    """Read `cases` damaged files; some must be rejected, and memory must not grow."""

    def peak_after(check):
        """The process's peak memory, in kB, after all cases. Hypothesis takes much of it."""

        limits = settings(
            max_examples=cases,
            deadline=LONGEST_MS,
            database=None,
            derandomize=True,
            suppress_health_check=list(HealthCheck),
        )

        def look(data):
            check(data)

        limits(given(strategy)(look))()
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss

    outcomes = []
    warnings.simplefilter("error")
    unread = peak_after(len)
    assert (
        peak_after(lambda data: outcomes.append(rejected(read, data))) - unread
        < 200_000
    )
    assert any(outcomes)


def fuzz_bytes(kind, cases):
    decode, good = DECODERS[kind]
    fuzz(decode, damaged(good) | st.binary(max_size=80), cases)


def fuzz_file(made, name, cases):
    good = (made / name).read_bytes()
    strategy = (
        damaged(good) | other_values(good) if name.endswith(".json") else damaged(good)
    )

    def read(data):
        (made / name).write_bytes(data)
        FILES[name](made)

    try:
        fuzz(read, strategy, cases)
    finally:
        (made / name).write_bytes(good)


@pytest.fixture(scope="module")
def in_process():
    """Call a function of this module in a new process, forked from one that has only imported the module."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])

    def call(function, *arguments):
        with ProcessPoolExecutor(1, context) as pool:
            pool.submit(function, *arguments).result()

    return call


many = pytest.mark.parametrize(
    "cases", [QUICK, pytest.param(CASES, marks=pytest.mark.slow)]
)


@pytest.mark.slow
@pytest.mark.parametrize("kind", DECODERS)
def test_damaged_bytes(in_process, kind):
    in_process(fuzz_bytes, kind, CASES)


@many
@pytest.mark.parametrize("name", FILES)
def test_damaged_files(in_process, made, name, cases):
    in_process(fuzz_file, made, name, cases)
