"""Any program as a method. It reads two PNG files and writes a PFM file, in a temporary folder."""

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
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError
from twinlens.matching.external import WrongAnswerError, checked_result, content_of
from twinlens.matching.images import Disparity, Image, pair
from twinlens.matching.options import MinDisparity, NumDisparities, amount, check_range, with_range

PLACEHOLDERS = ("{left}", "{right}", "{out}")
TAIL_BYTES = 4096
"""How much of a program's output is kept for the message if it fails."""
READ_BYTES = 1 << 16
POLL_S = 0.1


class ProgramTimeoutError(InputError, TimeoutError):
    """A program exceeded its time limit and was killed."""


@dataclass(frozen=True)
class Program:
    """A program that reads two images and writes a disparity map; see `command`.

    The program runs without a shell. In its PFM file +inf is unknown. Its output is shown only if it fails.
    """

    command: Annotated[
        str,
        "Command line with {left} and {right}, PNG files to read, {out}, a grey PFM file to write, and optionally "
        "{num_disparities} and {min_disparity}.",
    ] = ""
    num_disparities: NumDisparities = 64
    min_disparity: MinDisparity = 0
    timeout_s: Annotated[float, "Seconds per match, after which the program is killed."] = 600.0

    def __post_init__(self) -> None:
        check_range(self.num_disparities, self.min_disparity)
        amount("timeout_s", self.timeout_s, above=True)
        for placeholder in PLACEHOLDERS:
            if placeholder not in self.command:
                raise InputError(
                    f"command is {self.command!r}; it needs {placeholder}, as in 'prog {{left}} {{right}} {{out}}'"
                )
        self._words({})

    @property
    def content(self) -> str:
        """The hashes of the program's file and of every file that its command names, such as `--weights=net.bin`.

        Files in folders that it names, and files that those files load, are not seen.
        """
        words = self._words({})
        named = [part for word in words[1:] for part in {word, word.rpartition("=")[2]}]
        return content_of(Path(name) for name in (shutil.which(words[0]), *named) if name and _is_file(name))

    def check_parts(self) -> None:
        """InputError if the program does not exist or is not executable. Other files are not checked."""
        name = self._words({})[0]
        if shutil.which(name) is None:
            reason = "it is not executable" if Path(name).is_file() else "no such program"
            raise InputError(f"{self._name} cannot be started: {reason}")

    def _words(self, values: dict[str, str]) -> list[str]:
        try:
            words = shlex.split(self.command)
        except ValueError as problem:
            raise InputError(f"command {self.command!r} cannot be read: {problem}") from None
        for name, value in values.items():
            words = [word.replace(f"{{{name}}}", value) for word in words]
        return words

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """The program's disparities; see `options.Matcher.match`."""
        pair(left, right)
        task = with_range(self, num_disparities, min_disparity)
        with tempfile.TemporaryDirectory(prefix="twinlens-") as place:
            folder = Path(place)
            for name, image in (("left.png", left), ("right.png", right)):
                (folder / name).write_bytes(_png(np.asarray(image)))
            task._run(folder)
            shape = np.shape(left)[:2]
            return checked_result(_read_pfm(folder / "out.pfm", shape, self._name), shape, self._name)

    @property
    def _name(self) -> str:
        return f"program {self._words({})[0]!r}"

    def _run(self, folder: Path) -> None:
        values = {"left": str(folder / "left.png"), "right": str(folder / "right.png"), "out": str(folder / "out.pfm")}
        values |= {"num_disparities": str(self.num_disparities), "min_disparity": str(self.min_disparity)}
        status, printed = _run_process(self._words(values), self.timeout_s, self._name)
        if status != 0:
            last = (printed.strip() or "it printed nothing").splitlines()[-1]
            raise InputError(f"{self._name} {_format_status(status)}: {last}")
        if not (folder / "out.pfm").is_file():
            raise InputError(f"{self._name} wrote no file at {{out}}")


def _is_file(name: str) -> bool:
    with contextlib.suppress(OSError, ValueError):
        return Path(name).is_file()
    return False


def _format_status(status: int) -> str:
    """How a program ended, from its exit status.

    >>> _format_status(3), _format_status(-11)
    ('exited with status 3', 'was killed by SIGSEGV')
    """
    if status >= 0:
        return f"exited with status {status}"
    with contextlib.suppress(ValueError):
        name = signal.Signals(-status).name
        return f"was killed by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")
    return f"was killed by signal {-status}"


def _run_process(words: list[str], timeout_s: float, name: str) -> tuple[int, str]:
    """Run a program: (exit status, the end of its output).

    It runs in a session of its own, so that its children are killed with it at the time limit. If memory runs out, the
    kernel kills it first.
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
        printed = _read_output(process, time.monotonic() + timeout_s)
    except subprocess.TimeoutExpired:
        raise ProgramTimeoutError(f"{name} took longer than {timeout_s:g} s and was killed") from None
    finally:
        _kill(process)
    return process.returncode, printed.decode(errors="replace")


def _read_output(process: "subprocess.Popen[bytes]", deadline: float) -> bytes:
    """Read the program's output until it ends and return the end of it; TimeoutExpired at the deadline."""
    pipe, tail = process.stdout, b""
    with selectors.DefaultSelector() as selector:
        if pipe is not None:
            selector.register(pipe, selectors.EVENT_READ)
        while True:
            if time.monotonic() >= deadline:
                raise subprocess.TimeoutExpired(process.args, 0)
            ended = process.poll() is not None
            ready = selector.select(0 if ended else POLL_S)
            got = os.read(ready[0][0].fd, READ_BYTES) if ready else b""
            tail = (tail + got)[-TAIL_BYTES:]
            if ready and not got:
                break
            if ended and not ready:  # a child of the program still holds the pipe open
                return tail
    process.wait(max(deadline - time.monotonic(), 0))
    return tail


def _kill(process: "subprocess.Popen[bytes]") -> None:
    """Kill the program and its children if it still runs; close its pipe."""
    if process.poll() is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    if process.stdout is not None:
        process.stdout.close()


def _png(image: Image) -> bytes:
    """A PNG file of (H, W), (H, W, 1) or (H, W, 3) uint8 or uint16 pixels, with light compression.

    Source: PNG specification, 3rd ed., W3C 2025, chapters 5 and 11.2. Pillow cannot write 16-bit colour.
    """
    if image.dtype not in (np.uint8, np.uint16):
        raise InputError("programs read PNG files: the images must be uint8 or uint16")
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
    """A grey PFM file of this (H, W), float32, first row on top. At most the bytes of such a map are read."""
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
        raise InputError(f"{name}: {{out}} is not a grey PFM file of the size in its header")
    return np.frombuffer(body, order).reshape(size)[::-1].astype(np.float32)
