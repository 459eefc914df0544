"""Kernels compiled for older processors give the same disparities."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

import twinlens.matching as tm

COMMON = "+sse2,+sse3,+ssse3,+sse4.1,+sse4.2,+popcnt,+cx16"
OLDER = {
    "generic": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "haswell": {
        "NUMBA_CPU_NAME": "haswell",
        "NUMBA_CPU_FEATURES": f"{COMMON},+avx,+avx2,+fma,+bmi,+bmi2,+lzcnt,+f16c",
    },
}
ELSEWHERE = """
import sys, numpy as np, twinlens.matching as tm
pair = np.load(sys.argv[1])
maps = [tm.match(*pair, method, block_size=5, num_disparities=40, threads=1) for method in sys.argv[3:]]
np.save(sys.argv[2], maps)
"""


@pytest.fixture(scope="module")
def pair():
    """Shifted texture, partly black or white, next to a wall of one value, where candidates tie."""
    scene = np.clip(
        np.random.default_rng(0).normal(128, 120, (2, 9, 90)), 0, 255
    ).astype(np.uint8)
    left, right = scene[0, :, 9:79].copy(), scene[0, :, 16:86].copy()
    left[:, 40:], right[:, 35:] = 77, 77
    return np.stack([left, right])


@pytest.mark.skipif(
    platform.machine() not in ("x86_64", "AMD64"), reason="names processors of x86-64"
)
@pytest.mark.parametrize(
    ("processor", "methods"),
    [
        ("generic", ["zncc"]),
        pytest.param("haswell", ["sad", "zncc"], marks=pytest.mark.slow),
    ],
)
def test_older_processors_choose_the_same(processor, methods, pair, tmp_path):
    pair_file, maps_file = tmp_path / "pair.npy", tmp_path / "maps.npy"
    np.save(pair_file, pair)
    command = [
        sys.executable,
        "-c",
        ELSEWHERE,
        str(pair_file),
        str(maps_file),
        *methods,
    ]
    subprocess.run(command, env=os.environ | OLDER[processor], check=True, timeout=600)
    for method, elsewhere in zip(methods, np.load(maps_file), strict=True):
        here = tm.match(*pair, method, block_size=5, num_disparities=40, threads=1)
        np.testing.assert_allclose(elsewhere, here, atol=1e-5)
