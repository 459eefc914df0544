"""Settings of all tests: repeatable hypothesis cases without deadlines, a kernel cache, equal things made once.

Mitsuba's scenes end with their test, or with its module if they belong to the module: Dr.Jit compiles the materials and
lights of all scenes that exist into every kernel, so kernels take longer to compile the more scenes there are, and are
found in its cache only if the same scenes existed. Placeholders of `share_kernels`, which a recipe of families leaves
behind, have the same effect and end with the module too.
"""

import functools
import gc
import json
import os
import tempfile

import pytest
from hypothesis import settings

settings.register_profile("twinlens", deadline=None, derandomize=True)
settings.load_profile("twinlens")

collect_ignore = [
    "user_program"
]  # type-checked by test_public_types.py, never imported


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


def pytest_collection(session):
    gc.disable()


def pytest_collection_modifyitems(items):
    """Type checkers take 10 s: at the end, where the alphabet puts them, they would leave the other worker idle."""
    items.sort(key=lambda item: item.path.name != "test_public_types.py")


def pytest_collection_finish(session):
    """No collection visits the modules of all tests, neither while they are imported nor after every test."""
    gc.collect()
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _equal_figures_of_cards_are_drawn_once():
    """Many tests make the same tiny datasets, of which each has a card with a figure."""
    from twinlens.dataset import card

    drawn, draw = {}, card.statistics_figure

    def remembered(many):
        key = json.dumps(many)
        if key not in drawn:
            drawn[key] = draw(many)
        return drawn[key]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(card, "statistics_figure", remembered)
        yield


@pytest.fixture(scope="session", autouse=True)
def _bundled_scenes_are_read_once():
    """Two of the six stay in memory by themselves, and the textures of one take a second."""
    from twinlens.scenes import scene_file

    read_once = functools.cache(scene_file.read_scene_toml)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(scene_file, "_read_bundled", read_once)
        yield


@pytest.fixture(scope="session", autouse=True)
def _built_scenes():
    """The names of Mitsuba scenes that were built since the list was emptied."""
    from twinlens.rendering import build

    names, built = [], build._built

    def noted(scene, *options):
        names.append(scene.name)
        return built(scene, *options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "_built", noted)
        yield names


@pytest.fixture(scope="module", autouse=True)
def _scenes_of_a_module_end_with_it(_built_scenes):
    from twinlens.rendering import build, shared_kernels

    yield
    build._cache.clear()
    shared_kernels._placeholders.clear()
    gc.collect()
    gc.freeze()  # what is left, such as imported modules, is not searched after every test


@pytest.fixture(autouse=True)
def _scenes_of_a_test_end_with_it(_scenes_of_a_module_end_with_it, _built_scenes):
    yield
    if _built_scenes:
        _built_scenes.clear()
        gc.collect()
