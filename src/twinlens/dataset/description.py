"""A dataset described where it lies: its card for people, its Croissant metadata for tools."""

import dataclasses

from twinlens.dataset.about import KEY, About, about
from twinlens.dataset.card import write_card
from twinlens.dataset.croissant import write_croissant
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.manifest import write_manifest
from twinlens.dataset.storage import Where


def describe(dataset: Where | Dataset, said: About | None = None) -> list[str]:
    """Write the card and croissant.json into a dataset's folder; the names of the files.

    `said` is kept in dataset.json, over what it said before, so that it need not be said again; the texts of `said`
    that are empty stay as they were. Of each sample only sample.json is read, and of 64 the left image. Raises
    FileError when `said` is given and there is no dataset.json, and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    if said is not None and said.plain():
        manifest = dataset.manifest
        before, _ = about(dataset)
        kept = before.plain() | said.plain()
        info = {**manifest.info, KEY: kept}
        write_manifest(dataset.path, dataclasses.replace(manifest, info=info))
    return [*write_card(dataset), write_croissant(dataset)]
