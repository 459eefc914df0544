"""Any program behind the same two words, `match(left, right)`.

The one module of this room that touches files, because files are all that a stranger's program understands: two PNGs
go into a temporary folder, one PFM comes out of it, and the folder goes. Nothing of this can be seen from outside.
"""

import contextlib
import os
import selectors
import shlex
import shutil
import signal
import struct
import subprocess
import tempfile
import time
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.checks import amount, whole
from twinlens.matching.external import WrongAnswerError, checked_result
from twinlens.matching.identity import content_of
from twinlens.matching.images import Disparity, Image, pair

PLACES = ("{left}", "{right}", "{out}")
TAIL_BYTES = 4096
"""How much of what a program prints is kept, for the message if it fails; the rest is read and forgotten."""
READ_BYTES = 1 << 16
POLL_S = 0.1


class ProgramTimeoutError(InputError, TimeoutError):
    """A program took longer than it may, and was ended."""


@dataclass(frozen=True)
class Program:
    """Any program that reads two images and writes a disparity map.

    command: its command line, with {left}, {right} (PNG files it is given), {out} (the file it must write: a grey PFM)
    and, where it wants them, {num_disparities} and {min_disparity}. No shell reads it. In the PFM +inf is unknown.
    timeout_s: how long it may take. What it prints is nobody's business, unless it fails: then its last line is said.
    """

    command: str = ""
    num_disparities: int = 64
    min_disparity: int = 0
    timeout_s: float = 600.0

    def __post_init__(self) -> None:
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        amount("timeout_s", self.timeout_s, above=True)
        for place in PLACES:
            if place not in self.command:
                raise InputError(
                    f"command is {self.command!r}; it must name {place}, as 'prog {{left}} {{right}} {{out}}'"
                )
        self._words({})

    @property
    def content(self) -> str:
        """The hashes of the program's own file and of every file that its command names, as `--weights=net.bin` does.

        What lies in a folder that it names, and what those files load in their turn, is not seen.
        """
        words = self._words({})
        named = [part for word in words[1:] for part in {word, word.rpartition("=")[2]}]
        return content_of(Path(name) for name in (shutil.which(words[0]), *named) if name and _is_file(name))

    def check_parts(self) -> None:
        """InputError if there is no such program, or it may not be run; of the files it names nothing is known."""
        name = self._words({})[0]
        if shutil.which(name) is None:
            there = Path(name).is_file()
            raise InputError(
                f"{self._name} cannot be started: {'it is not executable' if there else 'no such program'}"
            )

    def _words(self, values: dict[str, str]) -> list[str]:
        try:
            words = shlex.split(self.command)
        except ValueError as problem:
            raise InputError(f"command {self.command!r} cannot be read: {problem}") from None
        for name, value in values.items():
            words = [word.replace(f"{{{name}}}", value) for word in words]
        return words

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        pair(left, right)
        with tempfile.TemporaryDirectory(prefix="twinlens-") as place:
            folder = Path(place)
            for name, image in (("left.png", left), ("right.png", right)):
                (folder / name).write_bytes(_png(np.asarray(image)))
            self._run(folder)
            shape = np.shape(left)[:2]
            return checked_result(_read_pfm(folder / "out.pfm", shape, self._name), shape, self._name)

    @property
    def _name(self) -> str:
        return f"program {self._words({})[0]!r}"

    def _run(self, folder: Path) -> None:
        values = {"left": str(folder / "left.png"), "right": str(folder / "right.png"), "out": str(folder / "out.pfm")}
        values |= {"num_disparities": str(self.num_disparities), "min_disparity": str(self.min_disparity)}
        status, said = _finished(self._words(values), self.timeout_s, self._name)
        if status != 0:
            last = (said.strip() or "it said nothing").splitlines()[-1]
            raise InputError(f"{self._name} {_ending(status)}: {last}")
        if not (folder / "out.pfm").is_file():
            raise InputError(f"{self._name} wrote no file at {{out}}")


def _is_file(name: str) -> bool:
    with contextlib.suppress(OSError, ValueError):
        return Path(name).is_file()
    return False


def _ending(status: int) -> str:
    """How a program left, in words; a signal has a name, and the one that ends a glutton says what it may mean.

    >>> _ending(3), _ending(-11)
    ('left with status 3', 'was ended by SIGSEGV')
    """
    if status >= 0:
        return f"left with status {status}"
    with contextlib.suppress(ValueError):
        name = signal.Signals(-status).name
        return f"was ended by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")
    return f"was ended by signal {-status}"


def _finished(words: list[str], timeout_s: float, name: str) -> tuple[int, str]:
    """Run a program to its end: (exit status, the last of what it printed).

    It runs in a session of its own: at the limit all that it started ends with it. And the kernel is told that, if
    memory runs out, this is the one to end.
    """
    try:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except (OSError, ValueError) as problem:
        raise InputError(f"{name} cannot be started: {getattr(problem, 'strerror', None) or problem}") from None
    with contextlib.suppress(OSError):
        Path(f"/proc/{process.pid}/oom_score_adj").write_text("1000")
    try:
        said = _listen(process, time.monotonic() + timeout_s)
    except subprocess.TimeoutExpired:
        raise ProgramTimeoutError(f"{name} took longer than {timeout_s:g} s and was ended") from None
    finally:
        _end(process)
    return process.returncode, said.decode(errors="replace")


def _listen(process: "subprocess.Popen[bytes]", deadline: float) -> bytes:
    """Read what the program prints until it has ended, and keep the last of it; TimeoutExpired at the deadline."""
    pipe, tail = process.stdout, b""
    with selectors.DefaultSelector() as selector:
        if pipe is not None:
            selector.register(pipe, selectors.EVENT_READ)
        while True:
            if time.monotonic() >= deadline:
                raise subprocess.TimeoutExpired(process.args, 0)
            ended = process.poll() is not None
            heard = selector.select(0 if ended else POLL_S)
            got = os.read(heard[0][0].fd, READ_BYTES) if heard else b""
            tail = (tail + got)[-TAIL_BYTES:]
            if heard and not got:
                break
            if ended and not heard:  # somebody it started holds the pipe open, and is silent
                return tail
    process.wait(max(deadline - time.monotonic(), 0))
    return tail


def _end(process: "subprocess.Popen[bytes]") -> None:
    """If it is still there, end it with all that it started; close its pipe."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _png(image: Image) -> bytes:
    """A PNG of (H, W) or (H, W, 3) uint8 or uint16 pixels, plainly: no filter, light compression.

    Source: PNG specification, 3rd ed., W3C 2025, chapters 5 and 11.2. Pillow writes no 16-bit colour.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError("a program is given PNG files; its images must be uint8 or uint16")
    flat = image[:, :, 0] if image.ndim == 3 and image.shape[2] == 1 else image
    kind = 0 if flat.ndim == 2 else 2
    header = struct.pack(">IIBBBBB", flat.shape[1], flat.shape[0], 8 * flat.dtype.itemsize, kind, 0, 0, 0)
    rows = flat.astype(flat.dtype.newbyteorder(">"))
    lines = b"".join(b"\0" + row.tobytes() for row in rows)
    chunks = ((b"IHDR", header), (b"IDAT", zlib.compress(lines, 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(body)) + name + body + struct.pack(">I", zlib.crc32(name + body)) for name, body in chunks
    )


def _read_pfm(path: Path, shape: tuple[int, ...], name: str) -> Disparity:
    """A grey PFM of that (H, W), float32, first row on top; no more of the file is read than such a map can have."""
    with path.open("rb") as file:
        head = [file.readline(64).split() for _ in range(3)]
        try:
            (magic,), (width, height), (scale,) = head
            size, order = (int(height), int(width)), "<f4" if float(scale) < 0 else ">f4"
        except ValueError:
            raise InputError(f"{name}: {{out}} is not a PFM file: its header cannot be read") from None
        if magic == b"Pf" and size != shape:
            raise WrongAnswerError("wrong-shape", f"{name} returned shape {size}; the left image has {tuple(shape)}")
        body = file.read(4 * size[0] * size[1] + 1) if magic == b"Pf" else b""
    if len(body) != 4 * size[0] * size[1]:
        raise InputError(f"{name}: {{out}} is not a grey PFM file of the size it names")
    return np.frombuffer(body, order).reshape(size)[::-1].astype(np.float32)
