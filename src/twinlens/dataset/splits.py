"""Splits of a dataset by groups, such as scenes, so that no group is in two of them."""

import hashlib
import math
from collections import Counter
from collections.abc import Mapping, Sequence

from twinlens.dataset.files import check_relative
from twinlens.errors import InputError, check_number, counted


def parse_shares(text: str) -> dict[str, float]:
    """The names and shares of splits. Raises InputError unless the shares are positive and add up to 1.

    >>> parse_shares("train=0.8,test=0.2")
    {'train': 0.8, 'test': 0.2}
    """
    shares: dict[str, float] = {}
    for part in text.split(","):
        name, sign, number = (piece.strip() for piece in part.partition("="))
        if not (name and sign and number) or name in shares:
            raise InputError(
                f"splits are NAME=SHARE,..., such as train=0.8,test=0.2, got {text!r}"
            )
        check_relative(name)
        try:
            shares[name] = float(number)
        except ValueError:
            raise InputError(
                f"the share of {name!r} must be a number, got {number!r}"
            ) from None
        check_number(f"the share of {name!r}", shares[name], "a number > 0", above=0)
    if not math.isclose(sum(shares.values()), 1.0, abs_tol=1e-6):
        raise InputError(
            f"the shares of splits must add up to 1, got {sum(shares.values()):g}"
        )
    return shares


def assign(
    groups: Sequence[str], shares: Mapping[str, float], seed: int = 0
) -> list[str]:
    """The split of each sample, from its group: one split a group, and as near to the shares as the groups allow.

    Groups are taken from the largest to the smallest, in an order that the seed sets where they are equal, and go to
    the split that lacks most samples. No split stays empty. Raises InputError for fewer groups than splits.
    """
    sizes = Counter(groups)
    if len(sizes) < len(shares):
        raise InputError(
            f"{counted(len(sizes), 'group')} of samples cannot fill {counted(len(shares), 'split')}; "
            "name fewer splits, or another value to group by"
        )
    order = sorted(sizes, key=lambda group: (-sizes[group], _shuffled(group, seed)))
    lacking = {name: share * len(groups) for name, share in shares.items()}
    split_of: dict[str, str] = {}
    filled: set[str] = set()
    for number, group in enumerate(order):
        empty = [name for name in shares if name not in filled]
        # The last groups fill the splits that would stay empty.
        names = empty if len(empty) == len(order) - number else list(shares)
        split = max(names, key=lacking.__getitem__)
        split_of[group] = split
        filled.add(split)
        lacking[split] -= sizes[group]
    return [split_of[group] for group in groups]


def _shuffled(group: str, seed: int) -> str:
    """A text by which groups are in random order."""
    return hashlib.sha256(f"{seed}:{group}".encode()).hexdigest()
