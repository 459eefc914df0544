"""What became of the samples of a dataset, packed: so that memory hardly grows while a large one is made."""

import json
import zlib
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, overload

from twinlens.dataset import Row


@dataclass(frozen=True)
class Failure:
    """A sample that no draw of passed the gates: its rejections, and what in the recipe to change."""

    index: int
    rejections: list[dict[str, Any]]
    remedy: str

    def plain(self) -> dict[str, Any]:
        """As dataset.json lists it."""
        return {"index": self.index, "remedy": self.remedy, "rejections": self.rejections}


Entry = Row | Failure
"""What became of a sample."""


class Entries:
    """Entries by the index of their samples; iterates over the indices in order."""

    def __init__(self) -> None:
        self._made: dict[int, bytes] = {}
        self._failed: dict[int, bytes] = {}

    def __len__(self) -> int:
        return len(self._made) + len(self._failed)

    def __contains__(self, index: int) -> bool:
        return index in self._made or index in self._failed

    def __iter__(self) -> Iterator[int]:
        return iter(sorted((*self._made, *self._failed)))

    def __getitem__(self, index: int) -> Entry:
        return _row(self._made[index]) if index in self._made else _failure(self._failed[index])

    def __setitem__(self, index: int, entry: Entry) -> None:
        self.pop(index)
        if isinstance(entry, Failure):
            self._failed[index] = _packed([entry.index, entry.rejections, entry.remedy])
        else:
            self._made[index] = _packed([entry.name, dict(entry.files), dict(entry.info)])

    def pop(self, index: int) -> None:
        """Forget a sample, known or not."""
        self._made.pop(index, None)
        self._failed.pop(index, None)

    @property
    def made(self) -> list[int]:
        """The indices of the samples that are made, in order."""
        return sorted(self._made)

    @property
    def rows(self) -> Sequence[Row]:
        """The samples that are made, in order, as they are now; each is unpacked when it is asked for."""
        return _Rows([self._made[index] for index in self.made])

    @property
    def failures(self) -> list[Failure]:
        """The samples that could not be made, in order."""
        return [_failure(packed) for _, packed in sorted(self._failed.items())]

    def rejections(self) -> dict[str, int]:
        """How often each gate turned a draw away."""
        counts = Counter(turned["reason"] for row in self.rows for turned in row.info.get("rejections", ()))
        counts.update(turned["reason"] for failure in self.failures for turned in failure.rejections)
        return dict(sorted(counts.items()))


class _Rows(Sequence[Row]):
    """Packed rows as a sequence of rows."""

    def __init__(self, packed: list[bytes]) -> None:
        self._packed = packed

    def __len__(self) -> int:
        return len(self._packed)

    @overload
    def __getitem__(self, place: int) -> Row: ...
    @overload
    def __getitem__(self, place: slice) -> Sequence[Row]: ...
    def __getitem__(self, place: int | slice) -> Row | Sequence[Row]:
        return _Rows(self._packed[place]) if isinstance(place, slice) else _row(self._packed[place])


def _packed(plain: list[Any]) -> bytes:
    return zlib.compress(json.dumps(plain).encode(), 1)


def _row(packed: bytes) -> Row:
    return Row(*json.loads(zlib.decompress(packed)))


def _failure(packed: bytes) -> Failure:
    return Failure(*json.loads(zlib.decompress(packed)))
