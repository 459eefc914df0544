"""The files of a stored sample without some of its channels. Other files keep their bytes.

A channel is left out of files of several, and a file of which nothing is left does not appear. sample.json then says
which channels were dropped, so that readers and `verify` do not miss them.
"""

from collections.abc import Collection, Iterable

import numpy as np

from twinlens.dataset.channels import CHANNELS, TEXTS, FileOf, parse_file
from twinlens.dataset.record import encode_json
from twinlens.dataset.storage import MARK
from twinlens.dataset.stored import StoredSample
from twinlens.errors import InputError, check_known

MODELS = "models"
"""The triangles of the objects, models/*.ply, which are no channel of a view."""
_KEPT = "im"


def droppable() -> list[str]:
    """The names that `check_dropped` allows: of channels, but for the images, and `MODELS`."""
    arrays = [name for name, channel in CHANNELS.items() if channel.dtype != TEXTS]
    return [name for name in arrays if name != _KEPT] + [MODELS]


def check_dropped(names: Iterable[str]) -> None:
    """Raise InputError, with the nearest name, for what is no channel, and for the images."""
    for name in names:
        if name == _KEPT:
            raise InputError("the images (im) cannot be dropped: a sample needs them")
        check_known("channel to drop", name, droppable())


def without(
    sample: StoredSample, names: Iterable[str], dropped: Collection[str]
) -> tuple[list[str], dict[str, bytes]]:
    """Of the files `names` of a sample, those that stay as they are, and the changed ones: name -> content.

    Raises FileError for a file that cannot be read.
    """
    kept, changed = [], {}
    for name in names:
        parsed = parse_file(name)
        if parsed is None:
            if not (MODELS in dropped and name.startswith(f"{MODELS}/")):
                kept.append(name)
            continue
        arrays = parsed.file.array_names
        left = [array for array in arrays if array not in dropped]
        if len(left) == len(arrays):
            kept.append(name)
        elif left:
            data = _encoded(sample, name, parsed, dropped)
            if data is not None:
                changed[name] = data
    if MARK in kept:
        kept.remove(MARK)
        changed[MARK] = _marked(sample, dropped)
    return kept, changed


def _encoded(
    sample: StoredSample, name: str, parsed: FileOf, dropped: Collection[str]
) -> bytes | None:
    """A file of several channels without those that are dropped; None if it has no others."""
    arrays = sample.read_file(parsed.file, sample.path(name))
    left = {key: array for key, array in arrays.items() if key not in dropped}
    is_empty = (
        CHANNELS[key].dtype == TEXTS or np.size(array) == 0
        for key, array in left.items()
    )
    if all(is_empty):
        return None
    return parsed.file.format.encode({CHANNELS[key]: left[key] for key in left})


def _marked(sample: StoredSample, dropped: Collection[str]) -> bytes:
    """sample.json that names the channels which were dropped, now and before."""
    channels = {name for name in dropped if name in CHANNELS} | {*sample.dropped}
    record = {**sample.record, "dropped": sorted(channels)}
    # The list of what happened stays last, as in new samples.
    record["record"] = record.pop("record", {})
    return encode_json(record)
