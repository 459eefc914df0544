"""What the tests of rendering share: images and truth that several tests look at are made once a session."""

import functools

import pytest

GROUPS = {  # jobs whose answers are asked for together
    "photos": ["edge", "lens", "crop", "count", "refusal", "noise"],
    "bokeh": ["bokeh"],
    "denoise": ["denoise"],
    "denoised optics": ["denoised optics"],
    "noise estimate": ["noise estimate"],
}


@pytest.fixture(scope="session")
def renderer():
    """A function from a group of jobs to its arrays by name; each group runs once a session."""
    return answers


@functools.cache
def answers(group):
    from tests.rendering.rendering_jobs import JOBS

    jobs = GROUPS[group]
    if len(jobs) == 1:
        return JOBS[jobs[0]]()
    return {
        f"{job}/{name}": array for job in jobs for name, array in JOBS[job]().items()
    }
