"""Reads USD files in a process of its own: usd-core crashes or never ends on some damaged files.

The process is this module, run as a program: it gets a `Request` on its input and writes an `Answer` to its output.
"""

import contextlib
import os
import pickle
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from twinlens.errors import FileError, TwinlensError, import_extra
from twinlens.processes import format_status
from twinlens.scenes.assets import SceneContext, find_named, reading
from twinlens.scenes.usd import read_stage

SECONDS = 120.0
_SECONDS_PER_BYTE = 1 / (1 << 20)
_MOST_MEMORY = 16 << 30  # bytes of address space


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
    limit = SECONDS + _SECONDS_PER_BYTE * path.stat().st_size
    # -P: modules in the current folder are not imported; `-m` would look there first.
    command = [sys.executable, "-P", "-m", "twinlens.scenes.usd_process"]
    search = os.pathsep.join(filter(None, sys.path))
    try:
        child = subprocess.run(
            command,
            input=pickle.dumps(request),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"PYTHONPATH": search},
            timeout=limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise FileError(
            f"{path}: reading takes more than {limit:.0f} s; is it damaged?"
        ) from None
    if child.returncode:
        status = format_status(child.returncode)
        raise FileError(f"{path}: its reader {status}; is the file damaged?")
    return _unpacked(pickle.loads(child.stdout), context)


def _unpacked(answer: Answer, context: SceneContext) -> Any:
    context.files.extend(answer.files)
    if answer.error is not None:
        raise answer.error
    return answer.model


def answer_to(request: Request) -> Answer:
    """Read a file in this process."""
    context = SceneContext(request.folder)
    path = request.path
    try:
        with reading(path, "mesh"):
            model = read_stage(
                path,
                lambda name, owner: find_named(name, owner, context),
                request.with_materials,
            )
        return Answer(model, files=context.files)
    except TwinlensError as error:
        return Answer(error=error, files=context.files)


def _main() -> None:
    # Run as a program this module is __main__; the caller knows its classes by the module's name.
    from twinlens.scenes import usd_process

    with contextlib.suppress(ImportError, OSError, ValueError):
        import resource

        resource.setrlimit(resource.RLIMIT_AS, (_MOST_MEMORY, _MOST_MEMORY))
    request = pickle.loads(sys.stdin.buffer.read())
    answer = usd_process.answer_to(request)
    sys.stdout.flush()
    sys.stdout.buffer.write(pickle.dumps(answer))


if __name__ == "__main__":
    _main()
