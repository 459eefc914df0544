"""The tests of this folder need a JIT backend."""

import os

import pytest


@pytest.fixture(autouse=True, scope="session")
def _compiled_backend():
    """Skip without a working backend; fail if TWINLENS_REQUIRE_LLVM=1."""
    from twinlens.rendering import backend

    if not backend().is_jit and os.environ.get("TWINLENS_REQUIRE_LLVM") != "1":
        pytest.skip("the full camera law needs the LLVM or CUDA backend")
