"""Settings shared by all tests: hypothesis draws the same cases each time and has no deadline."""

from hypothesis import settings

settings.register_profile("twinlens", deadline=None, derandomize=True)
settings.load_profile("twinlens")

collect_ignore = ["user_program"]  # type-checked by test_public_types.py, never imported
