"""What every test shares: hypothesis draws the same cases each time, and kernels may compile at their first call."""

from hypothesis import settings

settings.register_profile("twinlens", deadline=None, derandomize=True)
settings.load_profile("twinlens")
