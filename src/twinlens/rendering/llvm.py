"""Finds a working LLVM library. Some versions abort the process at the first render: each is tried in a child process.

Results are cached in the folder of Dr.Jit's kernel cache, by the size and time of the library.
"""

import contextlib
import glob
import importlib.metadata
import os
import re
import signal
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

_FOLDERS = (
    "/usr/lib/x86_64-linux-gnu",
    "/usr/lib/aarch64-linux-gnu",
    "/usr/lib64",
    "/usr/lib",
    "/usr/lib*/llvm*/lib",
    "/usr/local/lib",
    "/opt/homebrew/opt/llvm*/lib",
    "/usr/local/opt/llvm*/lib",
)
_NAMES = ("libLLVM.so*", "libLLVM-*.so*", "libLLVM.dylib")
_PROBE_SECONDS = 120
_STOPPED = (
    signal.SIGKILL,
    signal.SIGTERM,
    signal.SIGINT,
)  # sent by a user or the system, not by the library
_MAX_MESSAGE = 400  # characters of the last line of output
_TRANSIENT = (
    "did not answer",
    "was stopped",
)  # results that may differ next time, and are not cached

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
    """The result for one library: whether it `works`, and a message, `answer`."""

    path: str
    works: bool
    answer: str


_ROWS = TypeAdapter(dict[str, Probe])


def candidates() -> list[Path]:
    """The LLVM libraries of this machine: DRJIT_LIBLLVM_PATH first, then by version, newest first."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    found = {
        Path(file).resolve()
        for folder in _FOLDERS
        for name in _NAMES
        for file in glob.glob(f"{folder}/{name}")  # noqa: PTH207
    }
    ranked = sorted(
        found,
        key=lambda path: ([int(n) for n in re.findall(r"\d+", path.name)], str(path)),
        reverse=True,
    )
    return ([Path(named)] if named else []) + [
        path for path in ranked if str(path) != named
    ]


def probe(variant: str, library: Path | None = None) -> Probe:
    """Render a small image in a child process with this LLVM library (or CUDA), and report whether that works."""
    home = os.environ.get("DRJIT_CACHE_DIR") or os.path.expanduser("~/.drjit")  # noqa: PTH111  never raises
    file = Path(home) / "twinlens-backends.json"
    key = f"{variant}|{library}|{_stamp(library)}|mitsuba {importlib.metadata.version('mitsuba')}"
    known: dict[str, Probe] = {}
    with contextlib.suppress(OSError, ValueError):  # the file is missing or damaged
        known = _ROWS.validate_json(file.read_bytes())
    if key in known:
        return known[key]
    answer = _run(variant, library)
    result = Probe(str(library or variant), answer == "works", answer)
    if not answer.startswith(_TRANSIENT):
        with contextlib.suppress(
            OSError
        ):  # without a writable folder, every process probes again
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(_ROWS.dump_json(known | {key: result}, indent=1))
    return result


def _stamp(library: Path | None) -> str:
    """Identifies the library file or, for CUDA, driver, devices and machine: machines may share the cache's folder."""
    try:
        if library is not None:
            status = library.stat()
            return f"{status.st_size}:{status.st_mtime_ns}"
        driver = Path("/proc/driver/nvidia/version").read_text().partition("\n")[0]
    except OSError:
        driver = ""
    return (
        ""
        if library
        else f"{driver}|{os.environ.get('CUDA_VISIBLE_DEVICES', '')}|{os.uname().nodename}"
    )


def _run(variant: str, library: Path | None) -> str:
    """Run the test in a child process; returns "works", or a description of the failure."""
    environment = dict(os.environ)
    if library is not None:
        if os.sep in str(library) and not os.path.exists(library):  # noqa: PTH110  never raises
            return "fails: no such file"
        environment["DRJIT_LIBLLVM_PATH"] = str(library)
    command = [sys.executable, "-P", "-c", _PROBE.format(variant=variant)]
    try:
        child = subprocess.run(
            command,
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
    lines = child.stderr.split("\n")
    last = next((line.strip() for line in reversed(lines) if line.strip()), "")
    if not last:
        return f"fails with exit code {child.returncode}"
    last = re.split(r"(?<=[.!]) ", last)[0]  # the first sentence
    return f"fails: {textwrap.shorten(last, _MAX_MESSAGE, placeholder=' ...')}"
