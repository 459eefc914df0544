import tracemalloc
from contextlib import contextmanager

import pytest


@pytest.fixture
def peak_below():
    """A context that fails if Python and numpy allocate more than `limit` bytes in it."""

    @contextmanager
    def peak(limit):
        tracemalloc.start()
        try:
            yield
            assert tracemalloc.get_traced_memory()[1] < limit
        finally:
            tracemalloc.stop()

    return peak
