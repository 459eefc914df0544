"""Reads USD files in a process of its own: usd-core crashes, never ends or fills the memory on some damaged files.

The process is this module, run as a program: it gets a `Request` on its input and writes an `Answer` to its output. It
limits its own processor time and memory (`Limits`) by the size of the layers and pictures that it reads.
"""

import math
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinlens.errors import FileError, TwinlensError, import_extra
from twinlens.processes import end_first_without_memory, format_status
from twinlens.scenes.assets import SceneContext, find_named, reading
from twinlens.scenes.usd import read_stage

_MIB = 1 << 20
# Layers that are whole take up to 0.5 s and 70 MiB for each MiB (docs/decisions/mesh-files.md).
_SECONDS = 20.0  # of processor time
_SECONDS_PER_MIB = 4.0
_MEMORY = 2 << 30
_MEMORY_PER_BYTE = 256
_MOST_MEMORY = 16 << 30
_BUSY = (
    6  # seconds per second of processor time; a process that waits forever takes none
)
_TOO_LONG = ("SIGXCPU", "SIGALRM")


@dataclass(frozen=True)
class Request:
    """A USD file below a folder, in which it may name others."""

    path: Path
    folder: Path
    with_materials: bool


@dataclass
class Answer:
    """What the process read: a `usd.UsdModel`, or the error; and the files that the file names."""

    model: Any = None
    error: TwinlensError | None = None
    files: list[Path] = field(default_factory=list)


def open_usd(path: Path, context: SceneContext, with_materials: bool = True) -> Any:
    """The `usd.UsdModel` of a file, whose other files are noted in `context.files`.

    Raises FileError, also for a file that usd-core does not survive, and MissingExtraError without usd-core.
    """
    import_extra("pxr", "usd")
    request = Request(path, context.folder, with_materials)
    # -P: modules in the current folder are not imported; `-m` would look there first.
    command = [sys.executable, "-P", "-m", "twinlens.scenes.usd_process"]
    search = os.pathsep.join(filter(None, sys.path))
    child = subprocess.run(
        command,
        input=pickle.dumps(request),
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        env=os.environ | {"PYTHONPATH": search},
        check=False,
    )
    check_status(path, child.returncode)
    return _unpacked(pickle.loads(child.stdout), context)


def check_status(path: Path, status: int) -> None:
    """Raise FileError if the process of a file ended by itself or by its limits, from its exit status."""
    if not status:
        return
    reason = f"its reader {format_status(status)}"
    if reason.endswith(_TOO_LONG):
        limit = f"{_SECONDS:.0f} s and {_SECONDS_PER_MIB:.0f} s per MiB"
        reason = f"reading takes more than {limit}"
    raise FileError(f"{path}: {reason}; is the file damaged?")


def _unpacked(answer: Answer, context: SceneContext) -> Any:
    context.files.extend(answer.files)
    if answer.error is not None:
        raise answer.error
    return answer.model


class Limits:
    """Time and memory of this process, which grow with what it reads. On Unix alone."""

    def __init__(self) -> None:
        self._size = 0

    def allow(self, size: int) -> None:
        """Allow what reading a layer or a picture of `size` bytes may take."""
        if not hasattr(signal, "alarm"):
            return
        import resource

        self._size += size
        seconds = math.ceil(_SECONDS + _SECONDS_PER_MIB * self._size / _MIB)
        memory = min(_MEMORY + _MEMORY_PER_BYTE * self._size, _MOST_MEMORY)
        _limit(resource.RLIMIT_CPU, seconds)
        _limit(resource.RLIMIT_DATA, memory)
        _limit(resource.RLIMIT_CORE, 0)
        # usd-core may not return to Python, whose handlers would wait for it.
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(_BUSY * seconds)


def _limit(kind: int, value: int) -> None:
    """Set a limit of this process, at most that which its parent has set."""
    import resource

    hard = resource.getrlimit(kind)[1]
    soft = value if hard == resource.RLIM_INFINITY else min(value, hard)
    resource.setrlimit(kind, (soft, hard))


def answer_to(request: Request, allow: Callable[[int], None]) -> Answer:
    """Read a file in this process. `allow` receives the size of each layer and picture in bytes."""
    context = SceneContext(request.folder)
    path = request.path
    try:
        with reading(path, "mesh"):
            model = read_stage(
                path,
                lambda name, owner: find_named(name, owner, context),
                allow,
                request.with_materials,
            )
        return Answer(model, files=context.files)
    except TwinlensError as error:
        return Answer(error=error, files=context.files)


def _main() -> None:
    # Run as a program this module is __main__; the caller knows its classes by the module's name.
    from twinlens.scenes import usd_process

    end_first_without_memory("self")
    request = pickle.loads(sys.stdin.buffer.read())
    answer = usd_process.answer_to(request, usd_process.Limits().allow)
    sys.stdout.flush()
    sys.stdout.buffer.write(pickle.dumps(answer))


if __name__ == "__main__":
    _main()
