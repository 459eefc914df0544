"""A long run in a fresh process now and then: what a compiler of kernels never gives back goes with the old one.

LLVM, as Dr.Jit uses it, keeps some 15 KiB for every kernel that it ever compiled, whatever is freed. A command whose
work lies whole on the disk can simply begin anew, as if it had been typed again.
"""

import os
import sys
from collections.abc import Sequence


class Renewal(BaseException):
    """Raised by a command that wants to go on in a fresh process, with these options after its own."""

    def __init__(self, *options: str) -> None:
        super().__init__(*options)
        self.options = options


def renewed(options: Sequence[str]) -> None:
    """Run the command that this process was started with anew, in its place, with `options` after its own.

    An option that is there twice counts as it is said last. Returns only where a process cannot be replaced.
    """
    if os.name != "posix":
        return
    sys.stdout.flush()
    sys.stderr.flush()
    os.execv(sys.executable, [sys.executable, *sys.orig_argv[1:], *options])
