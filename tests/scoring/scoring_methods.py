"""A sample, and well-behaved and faulty matchers at module level, so that a worker process can import them."""

import contextlib
import ctypes
import functools
import os
import signal
import subprocess
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twinlens.errors import InputError
from twinlens.scoring import Pair
from twinlens.scoring.runners import WARM_UP_ROWS


def pair(name="a", seed=0, truth=4.0, mask=True):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 255, (40, 30, 3), np.uint8)
    gt = np.full((40, 30), truth, np.float32)
    gt[0] = np.inf
    seen = np.full(gt.shape, 255, np.uint8)
    seen[:, :5], seen[0] = 128, 0
    return Pair(name, image, image.copy(), gt, seen if mask else None, 16)


@dataclass(frozen=True)
class Constant:
    """Returns a constant disparity, +inf in the first `holes` columns."""

    name: str
    value: float
    holes: int = 0

    @property
    def spec(self):
        return f"constant {self.value} {self.holes}"

    def match(self, left, right, *, num_disparities, min_disparity):
        if min_disparity < 0:
            raise InputError("min_disparity < 0 is not supported")
        disp = np.full(left.shape[:2], self.value, np.float32)
        disp[:, : self.holes] = np.inf
        return disp


class Counting:
    """Counts its calls, and records the rows and the range of each."""

    def __init__(self, name, value, spec="v1"):
        self.name, self.value, self.spec = name, value, spec
        self.rows_and_ranges = []

    @property
    def calls(self):
        return len(self.rows_and_ranges)

    def match(self, left, right, *, num_disparities, min_disparity):
        self.rows_and_ranges.append((len(left), num_disparities))
        return np.full(left.shape[:2], self.value, np.float32)


@dataclass(frozen=True)
class Slow:
    """Its first call in a process takes `compiling` seconds, like compilation."""

    name: str
    compiling: float

    def match(self, left, right, *, num_disparities, min_disparity):
        if self.name not in _COMPILED:
            _COMPILED.add(self.name)
            time.sleep(self.compiling)
        return np.zeros(left.shape[:2], np.float32)


_COMPILED = set()


@dataclass(frozen=True)
class Hangs:
    """Records the number of rows and sleeps for `seconds`."""

    name: str
    note: Path
    seconds: float = 1000

    def match(self, left, right, *, num_disparities, min_disparity):
        with self.note.open("a") as file:
            file.write(f"{len(left)}\n")
        time.sleep(self.seconds)
        return np.zeros(left.shape[:2], np.float32)


@dataclass(frozen=True)
class Starts:
    """Starts `sleep`, records its process id, and waits for it; `deaf`: with SIGTERM blocked."""

    name: str
    note: Path
    deaf: bool = False
    session: bool = False

    def match(self, left, right, *, num_disparities, min_disparity):
        if self.deaf:
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
        with tempfile.TemporaryDirectory(dir=self.note.parent):
            process = subprocess.Popen(
                ["sleep", "1000"], start_new_session=self.session
            )
            self.note.write_text(str(process.pid))
            try:
                process.wait()
            finally:
                process.kill()
                process.wait()
        return np.zeros(left.shape[:2], np.float32)


@dataclass(frozen=True)
class Signed:
    """Returns a constant disparity, with the search range in the first two pixels."""

    name: str
    value: float

    def match(self, left, right, *, num_disparities, min_disparity):
        disp = np.full(left.shape[:2], self.value, np.float32)
        disp[0, :2] = num_disparities, min_disparity
        return disp


@dataclass(frozen=True)
class Trouble:
    """Has the fault that its name states."""

    name: str

    def match(self, left, right, *, num_disparities, min_disparity):
        return getattr(self, self.name.replace("-", "_"))(left)

    def raises(self, left):
        raise RuntimeError("out of\nluck")

    def exits(self, left):
        raise SystemExit(3)

    def hangs(self, left):
        time.sleep(1000)

    def dies(self, left):
        os.abort()

    def segfaults(self, left):
        ctypes.string_at(0)

    def hoards(self, left):
        kept = []
        while True:
            kept.append(np.ones(2**24))  # 128 MiB each, written to

    def asks_for_too_much(self, left):
        return np.empty((2**20, 2**20, 2**10))

    def talks(self, left):
        line = b"never mind " * 6000 + b"\n"
        for _ in range(2000):  # 130 MB to each stream
            os.write(1, line)
            os.write(2, line)
        return np.zeros(left.shape[:2], np.float32)

    def wrong_size(self, left):
        return np.zeros((3, 3), np.float32)

    def integers(self, left):
        return np.zeros(left.shape[:2], np.int16)

    def nothing(self, left):
        return None

    def nan(self, left):
        return np.full(left.shape[:2], np.nan, np.float32)

    def minus_inf(self, left):
        return np.full(left.shape[:2], -np.inf, np.float32)

    def scribbles(self, left):
        left[:] = 0
        return np.zeros(left.shape[:2], np.float32)


@dataclass(frozen=True)
class Unloadable:
    """Can be pickled; unpickling raises `error` as the cause of an InputError."""

    name: str
    error: type

    def __reduce__(self):
        return _hungry, (self.error,)

    def match(self, left, right, *, num_disparities, min_disparity):
        raise NotImplementedError


def _hungry(error):
    try:
        raise error("no memory: failed to map segment from shared object")
    except error as cause:
        raise InputError("the library is not installed") from cause


class DiesBetween:
    """Ends its process by a signal a moment after the warm-up, while the next images are sent."""

    name = "between"

    def match(self, left, right, *, num_disparities, min_disparity):
        if len(left) == WARM_UP_ROWS:
            kill = functools.partial(os.kill, os.getpid(), signal.SIGSEGV)
            threading.Timer(0.02, kill).start()
        else:
            time.sleep(5)
        return np.full(left.shape[:2], 4, np.float32)


@dataclass(frozen=True)
class Starving:
    """Uses up its process's memory in the warm-up, so that the next images cannot be received."""

    name: str

    def match(self, left, right, *, num_disparities, min_disparity):
        import resource

        resource.setrlimit(
            resource.RLIMIT_DATA, (2**17, resource.getrlimit(resource.RLIMIT_DATA)[1])
        )
        kept = []
        with contextlib.suppress(MemoryError):
            while True:
                kept.append(bytes(2**15))
        del kept[-64:]  # 2 MiB, so that the worker can answer
        self.__dict__["kept"] = kept
