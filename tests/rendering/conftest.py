"""What the tests of rendering share. A process holds one Mitsuba variant: each backend works in a child of its own."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

WORKER = "tests.rendering.rendering_worker"
ROOT = Path(__file__).parents[2]
BACKENDS = ("scalar", "llvm")
GROUPS = {  # jobs that share a process; the last one meddles with threads
    "truth": ["truth"],
    "corners": ["corners"],
    "photos": ["edge", "lens", "crop", "count", "refusal", "noise"],
    "bokeh": ["bokeh"],
    "denoise": ["denoise"],
    "denoised optics": ["denoised optics"],
    "noise estimate": ["noise estimate"],
}


@pytest.fixture(scope="session", params=BACKENDS)
def renderer(request, tmp_path_factory):
    """A function from a group of jobs to its arrays in one backend; each group runs once a session."""
    return Renderer(request.param, tmp_path_factory)


@pytest.fixture(scope="session")
def both(tmp_path_factory):
    """The renderers of both backends, by name."""
    return {name: Renderer(name, tmp_path_factory) for name in BACKENDS}


class Renderer:
    """One backend; its answers are shared by the session."""

    answers: dict[tuple[str, str], dict[str, np.ndarray]] = {}  # noqa: RUF012

    def __init__(self, backend, tmp_path_factory):
        self.backend = backend
        self._folder = tmp_path_factory.mktemp(f"rendering-{backend}")

    def __call__(self, group):
        if self.backend == "llvm":
            skip_without_llvm()
        key = self.backend, group
        if key not in self.answers:
            file = self._folder / f"{group}.npz"
            command = [sys.executable, "-m", WORKER, str(file), *GROUPS[group]]
            environment = {**os.environ, "TWINLENS_BACKEND": self.backend}
            child = subprocess.run(
                command,
                cwd=ROOT,
                env=environment,
                capture_output=True,
                text=True,
                timeout=300,
            )
            assert child.returncode == 0, child.stderr
            with np.load(file) as arrays:
                prefix = f"{group}/" if len(GROUPS[group]) == 1 else ""
                self.answers[key] = {
                    name.removeprefix(prefix): array for name, array in arrays.items()
                }
        return self.answers[key]


def skip_without_llvm():
    """Skip where no LLVM works; where TWINLENS_REQUIRE_LLVM=1 says there must be one, go on and fail."""
    from twinlens.rendering import llvm

    if os.environ.get("TWINLENS_REQUIRE_LLVM") == "1":
        return
    if not any(
        llvm.probe("llvm_ad_rgb", library).works for library in llvm.candidates()
    ):
        pytest.skip("no LLVM that works on this machine")
