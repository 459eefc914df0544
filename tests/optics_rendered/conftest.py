"""The optics are measured on photographs of this process's backend, which must trace rays in compiled bundles."""

import os

import pytest


@pytest.fixture(autouse=True, scope="session")
def _compiled_backend():
    """Skip where no such backend works; where TWINLENS_REQUIRE_LLVM=1 says there must be one, fail."""
    from twinlens.rendering import backend

    if not backend().is_jit and os.environ.get("TWINLENS_REQUIRE_LLVM") != "1":
        pytest.skip("the full camera law needs the LLVM or CUDA backend")
