"""Every way twinlens says no. The command line catches `TwinlensError` in one place and prints its message as one line.

A message names the value, what is allowed, and the remedy. Imports nothing of twinlens.
"""

import difflib
from collections.abc import Iterable


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
    near = difflib.get_close_matches(name, names, n=1, cutoff=0.4)
    hint = f"; did you mean {near[0]!r}?" if near else ""
    return InputError(f"unknown {kind} {name!r}{hint} (known: {', '.join(names)})")
