"""What a recipe would cost: one sample made and measured, nothing written."""

import math
import time
from dataclasses import dataclass
from typing import Any

from twinlens.dataset import sample_files
from twinlens.dataset.storage import Where, place
from twinlens.errors import InputError
from twinlens.factory.entries import Failure
from twinlens.factory.ledger import Ledger
from twinlens.factory.plan import plan
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import made_with
from twinlens.factory.work import Work, rendered


@dataclass(frozen=True)
class Estimate:
    """Samples asked for, there, and to make; one sample's seconds and bytes, and those of all that are to be made."""

    count: int
    before: int
    todo: int
    next: dict[str, Any] | None
    seconds_each: float = math.nan
    bytes_each: int = 0
    seconds: float = 0.0
    bytes: int = 0


def estimate(recipe: Recipe, folder: Where) -> Estimate:
    """Make the next sample of `recipe`, keep nothing, and reckon from it.

    It is made twice, and the second time counts: the first compiles what all others share.
    """
    root = place(folder)
    ledger = Ledger(root, recipe, made_with())
    ledger.recover()
    ledger.refuse_damaged()
    missing = ledger.missing()
    before = recipe.count - len(missing)
    if not missing:
        return Estimate(recipe.count, before, 0, None)
    work = Work(recipe, str(root), ledger.made_with)
    rendered(work, missing[0])
    begun = time.perf_counter()
    made = rendered(work, missing[0])
    if isinstance(made, Failure):
        last = made.rejections[-1]
        raise InputError(f"{recipe.at.source.file}: sample {made.index} fails: {last['found']}; change {made.remedy}")
    size = sum(map(len, sample_files(made).values()))
    seconds = time.perf_counter() - begun
    spec = plan(recipe, missing[0], made.record["spec"]["attempt"]).plain()
    todo = len(missing)
    return Estimate(recipe.count, before, todo, spec, seconds, size, seconds * todo, size * todo)
