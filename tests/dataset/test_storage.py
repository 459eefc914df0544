"""Datasets in buckets, on fsspec's memory and local file systems."""

import pickle
from pathlib import Path

import fsspec
import pytest
from fsspec.implementations.memory import MemoryFileSystem
from numpy.testing import assert_array_equal

from tests.dataset import dataset_scene
from twinlens.dataset import (
    Dataset,
    Manifest,
    place,
    read_manifest,
    write_manifest,
    write_sample,
)
from twinlens.dataset.dataset import row_of
from twinlens.dataset.files import (
    read_bytes,
    remove_unfinished,
    write_file,
    write_folder,
)
from twinlens.dataset.sample_files import sample_files
from twinlens.dataset.storage import MARK, RemotePath, is_whole, remove_objects
from twinlens.dataset.verify import verify_sample
from twinlens.errors import InputError, OutputError

SAMPLE = dataset_scene.sample(num_lenses=2)


class Watched(MemoryFileSystem):
    """A store that records its requests, and fails at the file name `broken`."""

    protocol = "watched"
    store = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012
    requests = []  # noqa: RUF012
    broken = None

    def pipe_file(self, path, value, mode="overwrite", **kwargs):
        if self.broken and path.endswith(self.broken):
            raise RuntimeError("503\nslow down")
        self.requests.append(("put", path))
        super().pipe_file(path, value, mode, **kwargs)

    def rm_file(self, path):
        self.requests.append(("remove", path))
        super()._rm(path)


fsspec.register_implementation("watched", Watched, clobber=True)


@pytest.fixture(params=["memory", "local", "disk"])
def root(request, tmp_path):
    if request.param == "disk":
        return tmp_path / "folder"
    # A local folder through fsspec is a store with real folders; place() would return a Path.
    url = f"memory:/{tmp_path}" if request.param == "memory" else f"file://{tmp_path}"
    return RemotePath(url) / "bucket"


def names_below(folder):
    if isinstance(folder, RemotePath):
        return folder.files()
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return sorted(path.relative_to(folder).as_posix() for path in paths)


@pytest.fixture
def watched(tmp_path):
    Watched.requests, Watched.broken = [], None
    return place(f"watched:/{tmp_path}/s")


def test_addresses_and_paths():
    assert place("out/a") == Path("out/a")
    assert place(Path("out")) == Path("out")
    assert place("file:///tmp/with%20space") == Path("/tmp/with space")
    bucket = place("s3://bucket/set/")
    assert place(bucket) is bucket
    assert (
        str(bucket / "train/0001" / "im0.png") == "s3://bucket/set/train/0001/im0.png"
    )
    assert (bucket / "a.png").name == "a.png"
    assert (bucket / "a" / "b").parent == bucket / "a"


def test_a_dataset_reads_back(root):
    sums = {name: write_sample(root / name, SAMPLE) for name in ("train/0", "b")}
    assert is_whole(root / "b")
    assert not is_whole(root / "c")
    write_manifest(root, Manifest(tuple(row_of(root, name) for name in sums), seed=3))
    assert {row.name: row.files for row in read_manifest(root).rows} == sums
    data = pickle.loads(pickle.dumps(Dataset(root)))
    assert [sample.name for sample in data] == ["train/0", "b"]
    assert_array_equal(data[0].disp0, SAMPLE.truths[0].disparity)
    assert_array_equal(data["b"].lens(1).im1, SAMPLE.shots[1].images[1])
    assert [verify_sample(sample) for sample in data] == [[], []]


def test_the_mark_is_written_last_and_removed_first(watched):
    write_sample(watched, SAMPLE)
    puts = [Path(path).name for _, path in Watched.requests]
    assert puts.index(MARK) == len(puts) - 1 == len(sample_files(SAMPLE)) - 1
    Watched.requests.clear()
    write_sample(watched, dataset_scene.sample(), overwrite=True)
    kinds = [(kind, Path(path).name) for kind, path in Watched.requests]
    assert kinds[0] == ("remove", MARK)
    assert kinds[-1] == ("put", MARK)
    assert set(watched.files()) == set(sample_files(dataset_scene.sample()))


@pytest.mark.parametrize("broken", ["im1.png", MARK])
def test_a_failure_leaves_nothing(watched, broken):
    Watched.broken = broken
    with pytest.raises(OutputError, match=r"cannot be written \(503 slow down\)"):
        write_sample(watched, SAMPLE)
    assert watched.files() == []


def test_an_incomplete_sample_in_a_bucket_is_overwritten(tmp_path):
    root = RemotePath(f"memory:/{tmp_path}") / "bucket"
    write_sample(root / "a", SAMPLE)
    write_sample(root / "b", SAMPLE)
    write_file(root / ".cache" / "im0.png", b"")
    remove_objects(root / "b", [MARK])  # as a killed process leaves it
    assert not is_whole(root / "b")
    assert [sample.name for sample in Dataset(root)] == ["a"]
    assert remove_unfinished(root) == []
    write_sample(root / "b", SAMPLE)
    assert [sample.name for sample in Dataset(root)] == ["a", "b"]


def test_only_a_sample_is_overwritten_and_only_on_request(root):
    sums = write_sample(root / "s", SAMPLE)
    files = sample_files(SAMPLE)
    assert list(sums) == names_below(root / "s") == sorted(files)
    for name, data in files.items():
        assert read_bytes(root / "s" / name) == data
    with pytest.raises(OutputError, match="already exists"):
        write_sample(root / "s", SAMPLE)
    smaller = dataset_scene.sample()
    write_sample(root / "s", smaller, overwrite=True)
    assert names_below(root / "s") == sorted(sample_files(smaller))
    write_file(root / "thesis" / "thesis.tex", b"\\end")
    with pytest.raises(OutputError, match="is not a sample"):
        write_sample(root / "thesis", SAMPLE, overwrite=True)
    assert names_below(root / "thesis") == ["thesis.tex"]


def test_folders_of_other_files(root):
    write_folder(root / "out", iter([("a/x", b"1"), ("y", b"2")]))
    assert names_below(root / "out") == ["a/x", "y"]
    with pytest.raises(OutputError, match="already exists"):
        write_folder(root / "out", [("z", b"3")])
    write_folder(root / "out", [("y", b"3")], overwrite=True)
    assert names_below(root / "out") == ["y"]
    with pytest.raises(InputError, match="two files would be named z"):
        write_folder(root / "new", [("z", b"1"), ("z", b"2")])
    with pytest.raises(InputError, match="plain relative name"):
        write_folder(root / "new", [("../z", b"1")])


def test_unknown_protocols_are_reported():
    with pytest.raises(InputError, match="not an address that fsspec knows"):
        Dataset("nowhere://bucket")
