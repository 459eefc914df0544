"""Settings of all tests: repeatable hypothesis cases without deadlines, and a kernel cache of their own."""

import os
import tempfile

from hypothesis import settings

settings.register_profile("twinlens", deadline=None, derandomize=True)
settings.load_profile("twinlens")

collect_ignore = ["user_program"]  # type-checked by test_public_types.py, never imported


def pytest_configure(config):
    """Cache compiled kernels in pytest's cache folder of this checkout, which the workers of a run share.

    Their file names contain a digest of the kernel sources. Without pytest's cache the folder is temporary.
    """
    if "NUMBA_CACHE_DIR" in os.environ:
        return
    cache = getattr(config, "cache", None)
    if cache is not None:
        folder = str(cache.mkdir("numba"))
    else:
        temporary = tempfile.TemporaryDirectory(prefix="twinlens-numba-")
        config.add_cleanup(temporary.cleanup)
        folder = temporary.name
    os.environ["NUMBA_CACHE_DIR"] = folder
