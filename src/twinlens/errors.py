"""The exceptions of twinlens and the checks that raise them. The command line prints their message as one line.

A message states the value, what is allowed, and what to do. Imports nothing of twinlens.
"""

import difflib
import importlib
import itertools
import math
import re
import reprlib
import warnings
from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import Any

_MIN_SIMILARITY = 0.65
_MIN_COMMON_LETTERS = 0.75
_SHORTEST_PART = 3
_MOST_FILES = 2000  # of a folder, compared with the name of a missing file


class TwinlensError(Exception):
    """The base class of twinlens's errors. `exit_code` is the exit code of the command line."""

    exit_code = 2


class InputError(TwinlensError, ValueError):
    """A value, name or file given by the caller cannot be used."""


class FileError(InputError):
    """A file is missing, unreadable or malformed; the message starts with its path."""


class OutputError(TwinlensError, OSError):
    """A file could not be written: a full disk, a read-only folder."""


class NotUsedWarning(UserWarning):
    """A part of a file is not used; the message names it and what is done instead."""


def warn_not_used(
    file: object, parts: Iterable[str], kind: type[NotUsedWarning] = NotUsedWarning
) -> None:
    """Warn in one line of the parts of a file that are not used, each with what is done instead."""
    named = ", ".join(dict.fromkeys(parts))
    if named:
        warnings.warn(f"{file}: not used: {named}", kind, stacklevel=3)


class MissingExtraError(TwinlensError, ImportError):
    """An optional package is not installed; the message names the extra that installs it."""


def import_extra(module: str, extra: str) -> Any:
    """The module of an optional package. Raises MissingExtraError, with the extra that installs it."""
    try:
        return importlib.import_module(module)
    except ImportError:
        package = module.partition(".")[0]
        raise MissingExtraError(
            f"{package} is not installed; pip install 'twinlens[{extra}]'"
        ) from None


class BackendError(TwinlensError, RuntimeError):
    """The rendering backend is not available on this machine; the message says what to install."""


def is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C raised the error, or caused it: a loop of Dr.Jit raises a RuntimeError from it."""
    while error is not None:
        if isinstance(error, KeyboardInterrupt):
            return True
        error = error.__cause__
    return False


@contextmanager
def located(where: str) -> Iterator[None]:
    """Prefix the InputErrors of a block, such as with a file and a key; their type is kept."""
    try:
        yield
    except InputError as error:
        raise type(error)(f"{where}: {error}") from error


def unknown(kind: str, name: str, choices: Iterable[str]) -> InputError:
    """The error for a name that is not in `choices`, with the nearest known name.

    >>> str(unknown("scene", "stairs", ["staircase", "fence"]))
    "unknown scene 'stairs'; did you mean 'staircase'? (known: fence, staircase)"
    """
    names = sorted(choices)
    near = nearest(name, names)
    hint = f"; did you mean {near!r}?" if near else ""
    return InputError(f"unknown {kind} {name!r}{hint} (known: {', '.join(names)})")


def check_known(kind: str, name: Any, choices: Collection[str]) -> None:
    """Raise `unknown` unless `name` is one of `choices`."""
    if not isinstance(name, str) or name not in choices:
        raise unknown(
            kind, name if isinstance(name, str) else format_value(name), choices
        )


def nearest(name: str, choices: Iterable[str]) -> str | None:
    """The known name that is meant: `name` is a part of it, or else like it, or else like its first word; or None.

    Alike are names with a Ratcliff-Obershelp similarity (`difflib`) of at least 0.65, case ignored: one wrong letter of
    three, or two of six, but not two of five. Or else names that begin with the same letter and have three of four
    letters in common, in any order. A part is a prefix or the last words of a name, three letters or more.

    >>> nearest("ZNC", ["sad", "zncc"]), nearest("diameter", ["aperture_diameter"]), nearest("nikon", ["phone"])
    ('zncc', 'aperture_diameter', None)
    >>> nearest("zcnn", ["sad", "zncc"])
    'zncc'
    """
    typed = _normalized(name)
    names = {_normalized(choice): choice for choice in choices}
    long_enough = len(typed) >= _SHORTEST_PART
    parts = [
        choice
        for choice in names
        if long_enough and (choice.startswith(typed) or choice.endswith(f"_{typed}"))
    ]
    close = parts or difflib.get_close_matches(
        typed, names, len(names) or 1, _MIN_SIMILARITY
    )
    close = close or [choice for choice in names if _is_mixed_up(typed, choice)]
    first = r"^[^\W\d_]{3,}"  # kitti of kitti2015
    close = close or [
        n
        for n in names
        if difflib.get_close_matches(typed, re.findall(first, n), 1, _MIN_SIMILARITY)
    ]
    return names.get(
        max(
            sorted(close),
            key=lambda choice: difflib.SequenceMatcher(None, typed, choice).ratio(),
            default="",
        )
    )


def file_hint(path: object) -> str:
    """What to add to the message of a missing file: the file or folder beside it whose name is nearly the same.

    Empty if there is none, and for places that are not on this machine.
    """
    if not isinstance(path, Path):
        return ""
    try:
        beside = itertools.islice(path.parent.iterdir(), _MOST_FILES)
        names = [entry.name for entry in beside]
    except (OSError, ValueError):
        return ""
    meant = nearest(path.name, [name for name in names if not name.startswith(".")])
    return f"; did you mean {meant!r}?" if meant else ""


def _is_mixed_up(typed: str, choice: str) -> bool:
    """Whether letters of a name are exchanged or doubled: the first one and three of four letters are the same."""
    # An upper bound of the similarity, of the letters without their order.
    letters = difflib.SequenceMatcher(None, typed, choice).quick_ratio()
    return typed[:1] == choice[:1] and letters >= _MIN_COMMON_LETTERS


def _normalized(name: str) -> str:
    return re.sub(r"[-_.\s]+", "_", name.casefold())


def check_number(
    name: str,
    value: Any,
    allowed: str,
    above: float = -math.inf,
    least: float = -math.inf,
    most: float = math.inf,
    below: float = math.inf,
) -> None:
    """Raise InputError unless `value` is a finite real number > above, >= least, <= most, < below.

    `allowed` describes this range in the message. Booleans, text and arrays are refused.

    >>> check_number("baseline", -0.1, "a positive number of metres", above=0)
    Traceback (most recent call last):
    twinlens.errors.InputError: baseline must be a positive number of metres, got -0.1
    """
    number = as_float(value)
    if not (
        math.isfinite(number) and above < number < below and least <= number <= most
    ):
        raise InputError(f"{name} must be {allowed}, got {format_value(value)}")


def check_int(
    name: str, value: Any, least: int | None = None, most: int | None = None
) -> None:
    """Raise InputError unless `value` is an integer (not a bool) from `least` to `most`.

    >>> check_int("count", 2.5, 1, 9)
    Traceback (most recent call last):
    twinlens.errors.InputError: count must be a whole number from 1 to 9, got 2.5
    """
    whole = isinstance(value, Integral) and not isinstance(value, bool)
    if (
        not whole
        or (least is not None and value < least)
        or (most is not None and value > most)
    ):
        allowed = (
            ""
            if least is None
            else f" >= {least}"
            if most is None
            else f" from {least} to {most}"
        )
        numbers = (
            f"{least}"
            if least is not None and least == most
            else f"a whole number{allowed}"
        )
        raise InputError(f"{name} must be {numbers}, got {format_value(value)}")


def check_triple(name: str, values: Any, allowed: str) -> tuple[float, float, float]:
    """`values` as three positive finite numbers (red, green, blue), or InputError; `allowed` describes them.

    >>> check_triple("wavelengths", [611e-9, 549e-9, 464e-9], "three positive numbers of metres")
    (6.11e-07, 5.49e-07, 4.64e-07)
    """
    try:
        numbers = [as_float(value) for value in values]
    except TypeError:
        numbers = []
    if len(numbers) != 3 or not all(
        math.isfinite(number) and number > 0 for number in numbers
    ):
        raise InputError(f"{name} must be {allowed}, got {format_value(values)}")
    return numbers[0], numbers[1], numbers[2]


def format_value(value: Any) -> str:
    """The repr of `value` on one line, shortened, for a message.

    >>> format_value([[0.5, 1.0], [2.0, 4.0]])
    '[[0.5, 1.0], [2.0, 4.0]]'
    """
    return " ".join(reprlib.repr(value).split())


def counted(number: int, noun: str, plural: str = "") -> str:
    """The number with its noun, whose plural ends in s unless another one is given.

    >>> counted(1, "seed"), counted(0, "seed"), counted(2, "pass", "passes")
    ('1 seed', '0 seeds', '2 passes')
    """
    word = noun if number == 1 else plural or f"{noun}s"
    return f"{number} {word}"


def as_float(value: Any) -> float:
    """`value` as a float; NaN for what is not a real number or is too large."""
    try:
        if isinstance(value, Real) and not isinstance(value, bool):
            return float(value)
        return math.nan
    except OverflowError:
        return math.nan
