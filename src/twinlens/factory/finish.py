"""The last step of a dataset: what depends on all of its samples, the same however they came to be."""

from typing import Any

from twinlens.dataset import write_card, write_croissant
from twinlens.factory.ledger import Ledger
from twinlens.factory.preview import Preview
from twinlens.factory.recipe import Recipe


def finish(ledger: Ledger) -> None:
    """Write dataset.json, card, metadata and preview as they stay; remove what only an unfinished dataset needs."""
    broken = broken_assets(ledger.recipe)
    ledger.write(**({"skipped_assets": broken} if ledger.recipe.assets else {}))
    Preview(ledger.folder, ledger.recipe.count).write(ledger.entries.made)
    if ledger.entries.made:
        write_card(ledger.folder)
        write_croissant(ledger.folder)
    ledger.clear()


def broken_assets(recipe: Recipe) -> list[dict[str, str]]:
    """The files of the recipe's asset folders that cannot be used, by their names there, and why; read one by one."""
    from twinlens.families import Assets

    found = []
    for kind, files in recipe.sources.asset_files.items():
        for name, path in files.items():
            alone: dict[str, Any] = {kind: (path,)}
            for broken, reason in Assets(**alone).check().broken:
                found.append({"kind": kind, "file": name, "reason": reason.replace(str(broken), name)})
    return found
