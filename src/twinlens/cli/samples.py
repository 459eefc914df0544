"""Which sample a path means: a sample's own folder, or DATASET/SAMPLE."""

from twinlens.dataset import Dataset, Place, StoredSample
from twinlens.errors import InputError


def open_sample(path: Place) -> StoredSample:
    """The sample whose folder `path` is. Raises InputError for a dataset of several, FileError for anything else."""
    dataset = Dataset(path)
    if len(dataset) > 1:
        raise InputError(f"{path}: is a dataset of {len(dataset)} samples; name one, as {path / dataset[0].name}")
    return dataset[0]


def parse_pair(text: str, count: int) -> tuple[int, int]:
    """The two cameras, counted from 0, that `text` names.

    >>> parse_pair("0,2", 3)
    (0, 2)
    """
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise InputError(f"--cameras must read A,B, as 0,1, got {text!r}")
    a, b = (int(part) for part in parts)
    if a == b or max(a, b) >= count:
        raise InputError(f"--cameras {text}: name two different ones out of 0 to {count - 1}")
    return a, b
