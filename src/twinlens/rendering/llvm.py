"""Finds an LLVM library that works. Some versions abort the process at the first render, so each is tried in a child.

Results are cached next to Dr.Jit's kernel cache, keyed by the file's size and time.
"""

import glob
import importlib.metadata
import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import textwrap
from dataclasses import asdict, dataclass
from pathlib import Path

_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib/llvm*/lib",
    "/usr/lib64/llvm*/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_NAMES = ("libLLVM.so*", "libLLVM-*.so*", "libLLVM.dylib")
_PROBE_SECONDS = 120
_STOPPED = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)  # by a person or the system, not by the library
_LONGEST_ANSWER = 400
"""Characters of the last line of output of a library."""
_PASSING = ("did not answer", "was stopped")  # results that may change, and are not cached

_PROBE = """
import resource
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
import mitsuba as mi
mi.set_variant("{variant}")
mi.set_log_level(mi.LogLevel.Error)
scene = mi.load_dict(mi.cornell_box())
image = mi.render(scene, sensor=scene.sensors()[0], spp=1).numpy()
mean = float(image.mean())
raise SystemExit(0 if 0.01 < mean < 10 else 3)
"""


@dataclass(frozen=True)
class Probe:
    """The result of one library: whether it `works`, and a message."""

    path: str
    works: bool
    answer: str


def candidates() -> list[Path]:
    """The LLVM libraries of this machine: DRJIT_LIBLLVM_PATH first, then by version, newest first."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    found = {
        Path(file).resolve()
        for folder in _FOLDERS
        for name in _NAMES
        for file in glob.glob(f"{folder}/{name}")  # noqa: PTH207
    }
    ranked = sorted(found, key=lambda path: (_version(path), str(path)), reverse=True)
    return ([Path(named)] if named else []) + [path for path in ranked if str(path) != named]


def probe(variant: str, library: Path | None = None) -> Probe:
    """Render a small image in a child process with this LLVM library (or CUDA), and report whether that works."""
    if library is not None and _is_missing(library):
        return Probe(str(library), False, "fails: no such file")
    cache = _ProbeCache(variant, library)
    if (known := cache.load()) is not None:
        return known
    environment = dict(os.environ)
    if library is not None:
        environment["DRJIT_LIBLLVM_PATH"] = str(library)
    answer = _run(_PROBE.format(variant=variant), environment)
    result = Probe(str(library or variant), answer == "works", answer)
    if not answer.startswith(_PASSING):
        cache.store(result)
    return result


def _run(script: str, environment: dict[str, str]) -> str:
    try:
        child = subprocess.run(
            [sys.executable, "-P", "-c", script],
            env=environment,
            capture_output=True,
            text=True,
            timeout=_PROBE_SECONDS,
        )
    except subprocess.TimeoutExpired:
        return f"did not answer within {_PROBE_SECONDS} s"
    if child.returncode == 0:
        return "works"
    if -child.returncode in _STOPPED:
        return f"was stopped (signal {-child.returncode})"
    if child.returncode < 0:
        return f"aborts the process (signal {-child.returncode})"
    lines = [line.strip() for line in child.stderr.splitlines() if line.strip()]
    if not lines:
        return f"fails with exit code {child.returncode}"
    return f"fails: {textwrap.shorten(lines[-1], _LONGEST_ANSWER, placeholder=' ...')}"


def _is_missing(library: Path) -> bool:
    """Whether the file does not exist. A name without a folder is searched for by the system's loader."""
    try:
        library.stat()
    except (FileNotFoundError, NotADirectoryError):
        return os.sep in str(library)
    except OSError:
        return False
    return False


def _version(path: Path) -> tuple[int, ...]:
    numbers = re.findall(r"\d+", path.name)
    return tuple(int(n) for n in numbers) or (0,)


_ROW = {"path": str, "works": bool, "answer": str}


class _ProbeCache:
    """One cached result in the kernel cache folder. If the folder is not writable, every process probes again."""

    def __init__(self, variant: str, library: Path | None) -> None:
        home = os.environ.get("DRJIT_CACHE_DIR") or os.path.expanduser("~/.drjit")  # noqa: PTH111  never raises
        self._file = Path(home) / "twinlens-backends.json"
        stamp = _cuda_stamp() if library is None else _file_stamp(library)
        self._key = f"{variant}|{library}|{stamp}|mitsuba {importlib.metadata.version('mitsuba')}"

    def _read(self) -> dict[str, dict[str, object]]:
        try:
            kept = json.loads(self._file.read_text())
        except (OSError, ValueError):
            return {}
        return kept if isinstance(kept, dict) else {}

    def load(self) -> Probe | None:
        row = self._read().get(self._key)
        if not isinstance(row, dict) or {name: type(value) for name, value in row.items()} != _ROW:
            return None
        return Probe(**row)  # type: ignore[arg-type]

    def store(self, result: Probe) -> None:
        rows = self._read() | {self._key: asdict(result)}
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryDirectory(dir=self._file.parent) as aside:
                written = Path(aside) / self._file.name
                written.write_text(json.dumps(rows, indent=1))
                written.replace(self._file)
        except OSError:
            return


def _file_stamp(library: Path) -> str:
    try:
        status = library.stat()
    except OSError:
        return ""
    return f"{status.st_size}:{status.st_mtime_ns}"


def _cuda_stamp() -> str:
    """The driver and devices of this process, because machines may share a home folder."""
    try:
        driver = Path("/proc/driver/nvidia/version").read_text().splitlines()[0]
    except (OSError, IndexError):
        driver = ""
    return f"{driver}|{os.environ.get('CUDA_VISIBLE_DEVICES', '')}|{os.uname().nodename}"
