"""The LLVM library with which Dr.Jit compiles kernels: that of the environment, or one of the system that works.

pip installs the environment's with twinlens. It is one tested version, and is loaded as it is. A library of the system
may be of any version, and some versions abort the process at the first render: each is tried in a child process. The
results are cached in the folder of Dr.Jit's kernel cache, by the size and time of the library.
"""

import contextlib
import ctypes
import glob
import importlib.metadata
import itertools
import os
import re
import signal
import subprocess
import sys
import textwrap
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

PACKAGE, TESTED_VERSION = "karellen-llvm-core", "19.1.7"
"""The distribution that holds libLLVM.so, a dependency of twinlens on Linux x86-64 (pyproject.toml)."""

_RUNTIME = ("libunwind.so.1", "libc++abi.so.1", "libc++.so.1")
"""C++ libraries that PACKAGE's libLLVM needs, in the order of their own needs."""

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
    """The LLVM libraries of this machine: the user's DRJIT_LIBLLVM_PATH, the environment's, then the system's."""
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    packaged = environment_library()
    libraries = [Path(named)] if named else []
    libraries += [packaged] if packaged else []
    libraries += _system_libraries()
    return list(dict.fromkeys(libraries))


def environment_library() -> Path | None:
    """The library that pip installed with PACKAGE; None without it."""
    return _packaged("libLLVM.so")


def is_tested(library: Path) -> bool:
    """Whether this is the environment's library in the version that twinlens is tested with: it needs no probe."""
    packaged = environment_library()
    if packaged is None or not library.exists() or not library.samefile(packaged):
        return False
    return importlib.metadata.version(PACKAGE) == TESTED_VERSION


def load_runtime_of(library: Path) -> None:
    """Load the C++ libraries that the environment's libLLVM needs, so that the linker finds them; no other needs them.

    libLLVM asks for libc++.so.1, but the wheel holds libc++.so.1.0: wheels have no symbolic links, and a .pth file of
    PACKAGE makes them when Python starts. That fails where the environment is read-only, and `python -S` skips it.
    """
    packaged = environment_library()
    if packaged is None or not library.exists() or not library.samefile(packaged):
        return
    for name in _RUNTIME:
        runtime = _packaged(name)
        if runtime is not None:
            ctypes.CDLL(str(runtime))


def _packaged(name: str) -> Path | None:
    """The file `name`, or `name` and further version numbers, of PACKAGE."""
    try:
        files = importlib.metadata.files(PACKAGE) or []
    except importlib.metadata.PackageNotFoundError:
        return None
    for file in files:
        if re.fullmatch(rf"{re.escape(name)}(\.\d+)*", file.name):
            path = Path(str(file.locate())).resolve()
            if path.is_file():
                return path
    return None


def _system_libraries() -> list[Path]:
    """The LLVM libraries in the usual folders of the system, newest version first."""
    libraries: set[Path] = set()
    for folder, name in itertools.product(_FOLDERS, _NAMES):
        files = glob.glob(f"{folder}/{name}")  # noqa: PTH207
        libraries.update(Path(file).resolve() for file in files)
    return sorted(libraries, key=_version_and_path, reverse=True)


def _version_and_path(library: Path) -> tuple[list[int], str]:
    numbers = re.findall(r"\d+", library.name)
    return [int(number) for number in numbers], str(library)


def probe(variant: str, library: Path | None = None) -> Probe:
    """Whether rendering works with this LLVM library, or with CUDA (None): a small image in a child process shows it.

    The tested library of the environment is not tried.
    """
    if library is not None and is_tested(library):
        return Probe(str(library), True, f"works: {PACKAGE} {TESTED_VERSION}")
    home = os.environ.get("DRJIT_CACHE_DIR") or os.path.expanduser("~/.drjit")  # noqa: PTH111  never raises
    file = Path(home) / "twinlens-backends.json"
    key = f"{variant}|{library}|{_stamp(library)}|mitsuba {importlib.metadata.version('mitsuba')}"
    rows: dict[str, Probe] = {}
    with contextlib.suppress(OSError, ValueError):  # the file is missing or damaged
        rows = _ROWS.validate_json(file.read_bytes())
    if key in rows:
        return rows[key]
    answer = _run(variant, library)
    result = Probe(str(library or variant), answer == "works", answer)
    if not answer.startswith(_TRANSIENT):
        with contextlib.suppress(
            OSError
        ):  # without a writable folder, every process probes again
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_bytes(_ROWS.dump_json(rows | {key: result}, indent=1))
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
    if library:
        return ""
    return (
        f"{driver}|{os.environ.get('CUDA_VISIBLE_DEVICES', '')}|{os.uname().nodename}"
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
