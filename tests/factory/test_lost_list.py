"""dataset.json lost, and made again from the samples as docs/format.md says."""

import pytest

from tests.factory_recipes import digests, write_recipe
from twinlens.errors import InputError
from twinlens.factory import generate, read_recipe


def test_samples_give_their_list_back(tmp_path):
    recipe, folder = read_recipe(write_recipe(tmp_path, count=2)), tmp_path / "set"
    generate(recipe, folder)
    before = digests(folder)
    (folder / "dataset.json").unlink()
    with pytest.raises(
        InputError, match=r"if dataset\.json was lost, move that file away"
    ):
        generate(recipe, folder)
    for name in (
        "README.md",
        "samples.jpg",
        "statistics.png",
        "ASSETS.md",
        "croissant.json",
    ):
        (folder / name).rename(tmp_path / name)
    outcome = generate(recipe, folder)
    assert (outcome.made, outcome.before, outcome.complete) == (0, 2, True)
    assert digests(folder) == before
