"""Every way twinlens says no. The command line catches `TwinlensError` in one place and prints its message as one line.

A message names the value, what is allowed, and the remedy. Imports nothing of twinlens.
"""

import difflib
import math
import re
import reprlib
from collections.abc import Iterable
from numbers import Real
from typing import Any

_ALIKE = 0.65
_SHORTEST_PART = 3


class TwinlensError(Exception):
    """The root of twinlens's own errors. `exit_code` is what the command line leaves with."""

    exit_code = 2


class InputError(TwinlensError, ValueError):
    """A value, a name or a file that the caller gave cannot be used."""


class FileError(InputError):
    """A file is missing, unreadable, or not what its name promises; the message begins with its path."""


class OutputError(TwinlensError, OSError):
    """Something could not be written: a full disk, a read-only folder."""


class MissingExtraError(TwinlensError, ImportError):
    """An optional package is needed; the message names the extra that installs it."""


class BackendError(TwinlensError, RuntimeError):
    """This machine's rendering backend cannot do what was asked; the message says what to install."""


def unknown(kind: str, name: str, known: Iterable[str]) -> InputError:
    """The error for a name that is not among the known ones, with the nearest of them.

    >>> str(unknown("scene", "stairs", ["staircase", "fence"]))
    "unknown scene 'stairs'; did you mean 'staircase'? (known: fence, staircase)"
    """
    names = sorted(known)
    near = nearest(name, names)
    hint = f"; did you mean {near!r}?" if near else ""
    return InputError(f"unknown {kind} {name!r}{hint} (known: {', '.join(names)})")


def nearest(name: str, known: Iterable[str]) -> str | None:
    """The known name that `name` may be a misspelling or a part of; None where it is a stranger.

    A misspelling shares at least `_ALIKE` of its letters with the name, in order (Ratcliff and Obershelp's measure, as
    difflib has it), whatever their case: one letter of three may be wrong, or two of six, but not two of five. A part
    is what a name begins with, or its last words: three letters or more.

    >>> nearest("ZNC", ["sad", "zncc"]), nearest("diameter", ["aperture_diameter"]), nearest("nikon", ["phone"])
    ('zncc', 'aperture_diameter', None)
    """
    plain = _plain(name)
    close = {each: share for each in known if (share := _share(plain, _plain(each))) is not None}
    return max(close, key=lambda each: close[each], default=None)


def _share(plain: str, known: str) -> float | None:
    """Of their letters, how many they share; None where too few. Bounds of it come first: a name may be very long."""
    pair = difflib.SequenceMatcher(None, plain, known)
    if _is_part(plain, known):
        return pair.ratio()
    if pair.real_quick_ratio() < _ALIKE or pair.quick_ratio() < _ALIKE:
        return None
    share = pair.ratio()
    return share if share >= _ALIKE else None


def _plain(name: str) -> str:
    """As names are compared: no case, and one sign between words."""
    return re.sub(r"[-_.\s]+", "_", name.casefold())


def _is_part(part: str, name: str) -> bool:
    return len(part) >= _SHORTEST_PART and (name.startswith(part) or name.endswith(f"_{part}"))


def check_number(
    name: str,
    value: Any,
    allowed: str,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> None:
    """Raise InputError unless `value` is a finite real number > above, >= least, <= most, < below; `allowed` says so.

    Truth values, texts and arrays are no numbers.

    >>> check_number("baseline", -0.1, "a positive number of metres", above=0)
    Traceback (most recent call last):
    twinlens.errors.InputError: baseline must be a positive number of metres, got -0.1
    """
    number = _as_float(value)
    if not (math.isfinite(number) and above < number < below and least <= number <= most):
        raise InputError(f"{name} must be {allowed}, got {format_value(value)}")


def check_triple(name: str, values: Any, allowed: str) -> tuple[float, float, float]:
    """`values` as three positive finite numbers (red, green, blue), or InputError; `allowed` says so in words.

    >>> check_triple("wavelengths", [611e-9, 549e-9, 464e-9], "three positive numbers of metres")
    (6.11e-07, 5.49e-07, 4.64e-07)
    """
    try:
        numbers = [_as_float(value) for value in values]
    except TypeError:
        numbers = []
    if len(numbers) != 3 or not all(math.isfinite(number) and number > 0 for number in numbers):
        raise InputError(f"{name} must be {allowed}, got {format_value(values)}")
    return numbers[0], numbers[1], numbers[2]


def format_value(value: Any) -> str:
    """What a message shows of a value: its repr, cut where it is long.

    >>> format_value([[0.5, 1.0], [2.0, 4.0]])
    '[[0.5, 1.0], [2.0, 4.0]]'
    """
    return " ".join(reprlib.repr(value).split())


def _as_float(value: Any) -> float:
    """NaN for what is no real number, and for an integer too large to be one here."""
    try:
        return float(value) if isinstance(value, Real) and not isinstance(value, bool) else math.nan
    except OverflowError:
        return math.nan
