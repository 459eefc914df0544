"""Method names, options, imports and kernel caching."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import InputError
from twinlens.matching.methods import Options, method_tables


def test_text_gives_a_method_its_options_and_its_name():
    spec = tm.parse_method(" mine=zncc:block_size=21, lr_check=1.5,subpixel=none")
    matcher = spec.matcher(num_disparities=100, nothing_known=1)
    assert spec.name == "mine"
    assert spec.method is tm.METHODS["zncc"]
    assert (matcher.block_size, matcher.lr_check, matcher.subpixel) == (21, 1.5, "none")
    assert matcher.num_disparities == 100
    spec = tm.parse_method("sad:num_disparities=32")
    assert spec.name == "sad:num_disparities=32"
    assert spec.matcher(num_disparities=100).num_disparities == 32


def test_options_in_a_list_belong_to_the_method_before_them():
    lists = ["a=sad,b=zncc:block_size=5,lr_check=1,c=sad", "sgm:cost=sad,ssd"]
    expected = ["a=sad", "b=zncc:block_size=5,lr_check=1", "c=sad", "sgm:cost=sad"]
    assert tm.split_methods(lists) == [*expected, "ssd"]


FLAT = """
import numpy as np
from helper import VALUE

def flat(left, right, *, num_disparities, min_disparity):
    return np.full(left.shape[:2], VALUE + num_disparities + min_disparity)
"""


def test_a_function_in_a_file_is_a_method_from_any_folder(tmp_path, monkeypatch):
    (tmp_path / "their_method.py").write_text(FLAT)
    (tmp_path / "helper.py").write_text("VALUE = 100")
    image = np.zeros((6, 9), np.uint8)
    monkeypatch.setattr(sys, "path", list(sys.path))
    spec = tm.parse_method(f"mine=function:{tmp_path / 'their_method.py'}:flat")
    assert spec.name == "mine"
    assert spec.content.startswith("their_method.py=")
    disparity = spec.match(image, image, num_disparities=7, min_disparity=2)
    np.testing.assert_array_equal(disparity, np.full((6, 9), 109, np.float32))


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("absent.py:f", "cannot be imported: no file absent.py"),
        ("wrong.py:f", "syntax error"),
        ("right.py:g", "right.py has no function 'g'"),
    ],
)
def test_a_function_that_cannot_be_imported_is_refused(
    place, message, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    Path("wrong.py").write_text("def f(:")
    Path("right.py").write_text("f = print")
    with pytest.raises(InputError, match=message):
        tm.parse_method(f"function:{place}").check_parts()


@pytest.mark.parametrize("name", ["sad", "sgm", "opencv_bm", "opencv_sgbm"])
def test_the_range_of_a_call_replaces_that_of_the_matcher(name):
    left, right = np.random.default_rng(0).integers(0, 256, (2, 30, 90), dtype=np.uint8)
    matcher = tm.METHODS[name].make(num_disparities=16)
    search = {"num_disparities": 32, "min_disparity": -3}
    expected = tm.METHODS[name].make(**search).match(left, right)
    np.testing.assert_array_equal(matcher.match(left, right, **search), expected)


def test_the_typed_options_of_match_are_those_of_all_methods():
    assert set(Options.__annotations__) == {
        name for method in tm.METHODS.values() for name in method.options
    }


def test_the_page_of_methods_is_current():
    page = Path(__file__).parents[2] / "docs" / "methods.md"
    assert page.read_text().endswith(method_tables()), (
        "replace them with the output of: twinlens methods --markdown"
    )


def run_python(code: str, *arguments: str, **environment: str) -> str:
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.check_output(command, text=True, env=os.environ | environment)


def test_importing_the_room_compiles_and_imports_nothing_heavy():
    code = "import sys, twinlens.matching; print([n for n in ('numba', 'cv2', 'mitsuba') if n in sys.modules])"
    assert run_python(code).strip() == "[]"


SUMS = """
import numpy as np
from twinlens.matching.kernels import windows
sums = np.empty((3, 4))
windows.window_statistics(np.ones((5, 6), np.uint8), 3, windows.TOTALS, sums, sums.copy())
print(sums.max())
"""
UNWRITABLE = """
import numba.core.caching as caching
def refuse(*_args):
    raise OSError("read-only")
for locator in caching.CacheImpl._locator_classes:
    locator.ensure_cache_path = refuse
"""
EDITED = """
import sys
from twinlens.matching.kernels import compiling
compiling.source_digest = lambda: sys.argv[1]
"""
SEMI_GLOBAL = """
import numpy as np, twinlens.matching as m
image = np.arange(60, dtype=np.uint8).reshape(5, 12) * 7
m.match(image, image, "sgm:block_size=1", num_disparities=2)
"""


def test_kernels_compile_where_no_cache_can_be_written(tmp_path: Path):
    blocker = tmp_path / "a file where a folder would be"
    blocker.write_text("")
    printed = run_python(UNWRITABLE + SUMS, NUMBA_CACHE_DIR=str(blocker))
    assert printed.strip() == "9.0"


@pytest.mark.parametrize(
    "code", [SUMS, pytest.param(SEMI_GLOBAL, marks=pytest.mark.slow)]
)
def test_kernels_are_loaded_by_a_second_process_and_compiled_after_an_edit(
    code, tmp_path
):
    def cached(digest):
        run_python(EDITED + code, digest, NUMBA_CACHE_DIR=str(tmp_path))
        files = tmp_path.rglob("*.nb[ci]")
        return {(path.name, path.stat().st_mtime_ns) for path in files}

    first = cached("before")
    assert first
    assert cached("before") == first
    assert len(cached("after")) == 2 * len(first)


ENTRY_POINTS = """[twinlens.methods]
flat = theirs:flat
broken = theirs:none
"""


def test_entry_points_of_packages_are_methods(tmp_path, monkeypatch):
    """Of an installed package that offers a matcher, and one that is broken."""
    (tmp_path / "theirs.py").write_text(FLAT)
    (tmp_path / "helper.py").write_text("VALUE = 0")
    meta = tmp_path / "theirs-1.0.dist-info"
    meta.mkdir()
    (meta / "METADATA").write_text(
        "Metadata-Version: 2.1\nName: theirs\nVersion: 1.0\n"
    )
    (meta / "entry_points.txt").write_text(ENTRY_POINTS)
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "helper", raising=False)
    image = np.zeros((6, 9), np.uint8)
    disparity = tm.match(image, image, "flat", num_disparities=7, min_disparity=2)
    np.testing.assert_array_equal(disparity, np.full((6, 9), 9))
    spec = tm.parse_method("flat")
    assert spec.runs_user_code
    assert spec.content.startswith("theirs.py=")
    with pytest.raises(InputError, match="'theirs:none' cannot be imported"):
        tm.match(image, image, "broken")


class Ranged:
    """Returns its search range as disparities."""

    def match(self, left, right, *, num_disparities, min_disparity):
        return np.full(left.shape, 100 * min_disparity + num_disparities)


def test_an_object_is_a_method():
    image = np.random.default_rng(0).integers(0, 256, (12, 30), dtype=np.uint8)
    search = {"num_disparities": 7, "min_disparity": 2}
    assert set(tm.match(image, image, Ranged()).flat) == {64.0}
    assert set(tm.match(image, image, Ranged(), **search).flat) == {207.0}
    matcher = tm.StereoMatcher(cost="sad", **search)
    expected = matcher.match(image, image)
    np.testing.assert_array_equal(tm.match(image, image, matcher), expected)
    with pytest.raises(InputError, match="option of a matcher object"):
        tm.match(image, image, Ranged(), block_size=5)
    with pytest.raises(InputError, match="method must be a name such as 'zncc'"):
        tm.match(image, image, Ranged)
