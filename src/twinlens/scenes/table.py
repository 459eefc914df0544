"""Reading a table of a scene file: typed values, and errors that say which file, which key, and what would be right.

A `Table` hands out each key once, through a parser that checks it; what is left at `done` is unknown and refused. This
module knows nothing of what the keys mean.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from twinlens.errors import InputError, unknown
from twinlens.geometry import Float

T = TypeVar("T")
REQUIRED: Any = object()
Hint = Callable[[str, Any, type], str]
"""Of a value at a place where another kind was wanted: what more to say of it, or nothing."""


def _no_hint(place: str, value: Any, kind: type) -> str:
    return ""


@dataclass(frozen=True, eq=False)
class Source:
    """The file being read, the folder its assets must lie below, the assets it named so far, and what it may say more
    of a value of the wrong kind."""

    file: Path
    textures: Mapping[str, Any] = field(default_factory=dict)
    assets: list[Path] = field(default_factory=list)
    hint: Hint = _no_hint

    @property
    def folder(self) -> Path:
        return self.file.parent


@dataclass(frozen=True)
class At:
    """A place in a file: which table, which key."""

    source: Source
    path: str = ""

    def __truediv__(self, key: str | int) -> "At":
        if isinstance(key, str) and not key.isprintable():
            key = repr(key)  # a message is one line
        step = f"[{key}]" if isinstance(key, int) else f".{key}" if self.path else key
        return At(self.source, self.path + step)

    def wrong(self, text: str) -> InputError:
        """The error of this place; raise it."""
        where = f"{self.path}: " if self.path else ""
        return InputError(f"{self.source.file}: {where}{text}")

    def unlike(self, kind: type, wanted: str, value: Any) -> InputError:
        """The error for a value that is not as wanted, with the source's hint where it is of another kind."""
        more = "" if isinstance(value, kind) else self.source.hint(self.path, value, kind)
        return self.wrong(f"must be {wanted}, got {show(value)}{more}")

    def unknown(self, kind: str, name: str, known: Iterable[str]) -> InputError:
        """The error for a name of this place that is not among the known ones, with the nearest of them."""
        return self.wrong(str(unknown(kind, name, known)))


Parser = Callable[[At, Any], T]


class Table(Generic[T]):
    """The keys of one TOML table, each to be taken once."""

    def __init__(self, at: At, value: Any) -> None:
        if not isinstance(value, Mapping):
            raise at.wrong(f"must be a table of keys and values, got {show(value)}")
        self.at = at
        self._left = dict(value)
        self._asked: set[str] = set()

    def take(self, key: str, parser: Parser[Any], default: Any = REQUIRED) -> Any:
        """The parsed value of `key`, or `default` where the table lacks it; InputError when it has no default."""
        self._asked.add(key)
        if key in self._left:
            return parser(self.at / key, self._left.pop(key))
        if default is REQUIRED:
            raise self.at.wrong(f"needs the key {key!r}")
        return default

    def need(self, *keys: str) -> None:
        """Refuse a table that lacks some of `keys`, naming all that it lacks."""
        missing = ", ".join(repr(key) for key in keys if key not in self._left)
        if missing:
            raise self.at.wrong(f"needs the {'keys' if ',' in missing else 'key'} {missing}")

    def has(self, key: str) -> bool:
        """Whether `key` is there and not yet taken."""
        self._asked.add(key)
        return key in self._left

    def rest(self) -> dict[str, Any]:
        """Everything not yet taken, for a reader that knows more keys than this one."""
        left, self._left = self._left, {}
        return left

    def done(self) -> None:
        """Refuse what nobody asked for."""
        for key in self._left:
            raise self.at.unknown("key", key, self._asked)


def show(value: Any) -> str:
    """A value in an error message, kept short."""
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def number(low: float = -math.inf, high: float = math.inf, *, above: float | None = None) -> Parser[float]:
    """A finite number in [low, high]; with `above`, strictly greater than it."""
    floor = low if above is None else above

    def parse(at: At, value: Any) -> float:
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
        if not good or not floor <= value <= high or (above is not None and value == above):
            raise at.unlike(float, _range_text(floor, high, above is not None), value)
        return float(value)

    return parse


def _range_text(low: float, high: float, strict: bool) -> str:
    lower = f" {'>' if strict else '>='} {low:g}" if math.isfinite(low) else ""
    upper = f"{' and' if lower else ''} <= {high:g}" if math.isfinite(high) else ""
    return f"a finite number{lower}{upper}"


def whole(low: int, high: int) -> Parser[int]:
    """A whole number in [low, high]."""

    def parse(at: At, value: Any) -> int:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise at.unlike(int, f"a whole number from {low} to {high}", value)
        return value

    return parse


def boolean(at: At, value: Any) -> bool:
    """true or false."""
    if not isinstance(value, bool):
        raise at.unlike(bool, "true or false", value)
    return value


def text(at: At, value: Any) -> str:
    """A string."""
    if not isinstance(value, str):
        raise at.unlike(str, "a string", value)
    return value


def choice(*known: str) -> Parser[str]:
    """One of a few words."""

    def parse(at: At, value: Any) -> str:
        if text(at, value) not in known:
            raise at.unknown("value", value, known)
        return str(value)

    return parse


def listed(item: Parser[T], least: int = 0, most: int = 100_000) -> Parser[list[T]]:
    """A list, each element through `item`."""

    def parse(at: At, value: Any) -> list[T]:
        if not isinstance(value, list) or not least <= len(value) <= most:
            size = f"{least}" if least == most else f"{least} to {most}"
            raise at.unlike(list, f"a list of {size} values", value)
        return [item(at / i, element) for i, element in enumerate(value)]

    return parse


def vector(length: int, element: Parser[float] | None = None) -> Parser[Float]:
    """`length` finite numbers, as a float64 array."""
    read = listed(element or number(), length, length)
    return lambda at, value: np.array(read(at, value))


def scalar_or_vector(length: int, element: Parser[float] | None = None) -> Parser[Float]:
    """`length` numbers, or one that stands for all of them."""
    one, many = element or number(), vector(length, element)
    return lambda at, value: many(at, value) if isinstance(value, list) else np.full(length, one(at, value))
