"""A long run in a fresh process now and then: what a compiler of kernels never gives back goes with the old one.

LLVM, as Dr.Jit uses it, keeps some 15 KiB of each random scene that it compiled kernels for, whatever is freed. A
command whose work lies whole on the disk can begin anew, as if it were typed again: in the same process's place, with
the same arguments, and with what the run did so far in an environment variable.
"""

import json
import os
import sys
from dataclasses import asdict, dataclass

_VARIABLE = "TWINLENS_RENEWED"


@dataclass(frozen=True)
class Progress:
    """What the processes of a run before this one did: samples tried and made, and those there before the run."""

    tried: int = 0
    made: int = 0
    before: int | None = None
    there: int = 0


class Renewal(BaseException):
    """Raised by a command that wants to go on in a fresh process."""

    def __init__(self, progress: Progress) -> None:
        super().__init__(progress)
        self.progress = progress


def earlier() -> Progress:
    """What was done before this process was renewed; nothing where it was not."""
    said = os.environ.pop(_VARIABLE, "")
    return Progress(**json.loads(said)) if said else Progress()


def is_possible() -> bool:
    """Whether this process can begin anew: its arguments are those that it was started with."""
    arguments = sys.argv[1:]
    return os.name == "posix" and bool(sys.executable) and sys.orig_argv[-len(arguments) :] == arguments


def begin_anew(progress: Progress) -> None:
    """Run the command of this process anew, in its place. Returns where that fails, for the caller to go on."""
    os.environ[_VARIABLE] = json.dumps(asdict(progress))
    try:
        sys.stdout.flush()
        sys.stderr.flush()
        os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:]])
    except OSError:
        return
