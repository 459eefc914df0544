"""Every block of docs/loading.md runs, in order, on a dataset of ten small samples."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import Manifest, Row, write_manifest, write_sample

PAGE = (Path(__file__).parents[2] / "docs" / "loading.md").read_text()
BLOCKS = re.findall(r"```python\n(.*?)```", PAGE, re.S)
USES_TORCH = [" torch" in block for block in BLOCKS]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("loading")
    sums = write_sample(
        folder / "out/s0", dataset_scene.sample(num_lenses=2, width=280, height=200)
    )
    for i in range(1, 10):
        shutil.copytree(folder / "out/s0", folder / f"out/s{i}")
    rows = [
        Row(f"s{i}", sums, {"scene": "ab"[i % 2], "split": "train"}) for i in range(10)
    ]
    write_manifest(folder / "out", Manifest(tuple(rows)))
    return folder


@pytest.fixture(scope="module")
def names(folder):
    """The names that the blocks define which run as printed, but for the one with torch."""
    defined = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block, uses_torch in zip(BLOCKS, USES_TORCH, strict=True):
            if not uses_torch:
                exec(block, defined)
    return defined


def test_the_block_with_torch_runs_as_printed(folder, names, monkeypatch):
    pytest.importorskip("torch")
    monkeypatch.chdir(folder)
    exec(BLOCKS[USES_TORCH.index(True)], names)
    loader = names["DataLoader"]
    (batch, _) = loader(names["augmented"], batch_size=4, collate_fn=names["tensors"])
    assert batch["im0"].shape == (4, 192, 256, 3)
    assert batch["K1"].shape == (4, 3, 3)
    assert batch["disp0"].is_contiguous()


def test_the_recipes_keep_their_promises(folder, names, monkeypatch):
    """Splits are disjoint and of exact size; the normalised disparity is baseline over depth, also when augmented."""
    monkeypatch.chdir(folder)
    assert len(names["train"]) == 8
    assert len(names["validation"]) == 2
    assert set(names["train"].names) | set(names["validation"].names) == set(
        names["data"].names
    )
    assert names["held_out"].names == ("s0", "s2", "s4", "s6", "s8")
    samples = names["data"].select(
        *names["PAIR"], "depth0", "depth1", "world_from_cam0", "world_from_cam1"
    )
    flipped = 0
    for seed in range(6):
        sample = names["augment"](samples[0], np.random.default_rng(seed))
        normalised = names["normalise"](sample)
        assert normalised["im0"].shape == (3, 192, 256)
        assert normalised["im0"].dtype == normalised["inverse0"].dtype == np.float32
        assert_allclose(
            normalised["inverse0"], sample["baseline"] / sample["depth0"], rtol=1e-5
        )  # 0 at infinity
        assert_array_equal(normalised["known0"], np.isfinite(sample["depth0"]))
        flipped += not np.array_equal(
            sample["world_from_cam0"], samples[0]["world_from_cam0"]
        )
    assert 0 < flipped < 6
