"""The Mitsuba variant of this process: CUDA where a test render succeeds, else LLVM.

It is chosen once per process. `TWINLENS_BACKEND` (auto, llvm, cuda) overrides the choice.
"""

import ctypes
import functools
import gc
import os
import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twinlens.errors import BackendError, check_int, check_known
from twinlens.processes import deferred_interrupts
from twinlens.rendering import llvm

VARIANTS = {"llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}


@dataclass(frozen=True)
class Backend:
    """Its Mitsuba `variant`, the `reason` of the choice, its LLVM `library`, and what was tried before it, `probes`."""

    name: str
    variant: str
    reason: str
    library: str | None = None
    probes: tuple[llvm.Probe, ...] = ()


_activated: dict[str, Backend] = {}
"""Backends that were set up, by variant. An interrupt may end `backend` before it caches its result."""


@functools.cache
def backend() -> Backend:
    """The backend of this process, chosen and set up at the first call.

    Raises InputError for an unknown TWINLENS_BACKEND, BackendError when no backend, or the requested one, works.
    """
    wanted = _wanted()
    chosen = _already_set() or _choose(wanted)
    _activate(chosen)
    return chosen


def doctor() -> Backend:
    """The backend that `backend` would choose, without setting it up. Raises the errors of `backend`."""
    return _choose(_wanted())


def mitsuba() -> Any:
    """The mitsuba module with the chosen variant. Raises BackendError if another variant was set since."""
    chosen = backend().variant
    import mitsuba

    if mitsuba.variant() != chosen:
        raise BackendError(
            f"mitsuba's variant was changed from {chosen} to {mitsuba.variant()}; set it back"
        )
    return mitsuba


def use_threads(count: int) -> None:
    """Set the number of rendering threads of this process (default: all). Images do not depend on it."""
    check_int("the number of threads", count, 1)
    backend()
    import drjit

    drjit.set_thread_count(count)


def forget_kernels() -> None:
    """Free the memory of compiled kernels and of unreferenced scenes. Kernels are read from the disk cache when needed.

    Kernels stay in memory. Without `share_kernels`, most random scenes compile their own; a thousand would fill it.
    """
    backend()
    import drjit

    gc.collect()  # scenes have reference cycles
    drjit.sync_thread()
    drjit.flush_kernel_cache()
    drjit.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc keeps freed memory
    if trim is not None:
        trim(0)


def _wanted() -> str:
    wanted = os.environ.get("TWINLENS_BACKEND") or "auto"
    check_known("TWINLENS_BACKEND", wanted, ["auto", *VARIANTS])
    return wanted


def _already_set() -> Backend | None:
    """The backend of a variant that the host program has set.

    Imports mitsuba only if the host program did: Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported.
    """
    if "mitsuba" not in sys.modules:
        return None
    import mitsuba  # waits for another thread that is importing it

    variant = mitsuba.variant()
    if variant is None:
        return None
    for name, supported in VARIANTS.items():
        if variant == supported:
            by_host = Backend(name, variant, "set by the host program")
            return _activated.get(variant) or by_host
    raise BackendError(
        f"mitsuba's variant is already {variant}; twinlens renders with {', '.join(VARIANTS.values())}"
    )


def _choose(wanted: str) -> Backend:
    """The first backend that works. Raises BackendError if none does."""
    candidates: list[tuple[str, Path | None]] = []
    if wanted in ("auto", "cuda") and _has_cuda_driver():
        candidates.append(("cuda", None))
    if wanted in ("auto", "llvm"):
        candidates += (("llvm", library) for library in llvm.candidates())
    probes: list[llvm.Probe] = []
    for name, library in candidates:
        probe = llvm.probe(VARIANTS[name], library)
        probes.append(probe)
        if probe.works:
            reason = f"{library.name} works" if library else "a CUDA device works"
            path = str(library) if library else None
            return Backend(name, VARIANTS[name], reason, path, tuple(probes))
    raise BackendError(_failure(wanted, probes))


def _failure(wanted: str, probes: Sequence[llvm.Probe]) -> str:
    """One line: what was tried, and what to install."""
    answers = [f"{Path(probe.path).name} {probe.answer}" for probe in probes]
    if wanted == "cuda":
        why = "; ".join(answers) or "no NVIDIA driver (libcuda.so.1) was found"
        return f"TWINLENS_BACKEND=cuda does not work: {why}; unset it to use LLVM"
    why = "; ".join(answers) or "no LLVM library was found"
    return f"rendering needs LLVM, and {why}; install it: {_install_llvm()}"


def _install_llvm() -> str:
    """The command that installs LLVM on this kind of machine."""
    if sys.platform == "darwin":
        return "brew install llvm"
    if platform.machine() == "x86_64":
        return f"pip install {llvm.PACKAGE}=={llvm.TESTED_VERSION}"
    return "apt install libllvm19, or your distribution's package of LLVM 17 or newer"


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


def _activate(chosen: Backend) -> None:
    """Import Mitsuba with this backend."""
    if chosen.library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = chosen.library
        llvm.load_runtime_of(Path(chosen.library))
    with deferred_interrupts():  # an interrupted import of mitsuba would be unusable
        import mitsuba

        if mitsuba.variant() != chosen.variant:
            try:
                mitsuba.set_variant(chosen.variant)
            except ImportError as error:
                raise BackendError(
                    f"{chosen.variant} does not work in this process: {chosen.library} cannot be loaded, or mitsuba was"
                    " imported with another DRJIT_LIBLLVM_PATH; unset it, or render with twinlens first"
                ) from error
            mitsuba.set_log_level(mitsuba.LogLevel.Error)
        if chosen.library is not None:
            _check_loaded(Path(chosen.library))
        _activated[chosen.variant] = chosen


def _check_loaded(library: Path) -> None:
    """Raise BackendError if Dr.Jit has loaded another LLVM library than `library`.

    It does where the host program imported Mitsuba or Dr.Jit before. Some versions would abort the process at the
    first render. Loaded libraries are known on Linux only.
    """
    maps = Path("/proc/self/maps")
    if not maps.exists():
        return
    paths = {line.split(maxsplit=5)[-1] for line in maps.read_text().splitlines()}
    loaded = {Path(path).resolve() for path in paths if "libLLVM" in Path(path).name}
    if loaded and library.resolve() not in loaded:
        names = ", ".join(sorted(str(path) for path in loaded))
        raise BackendError(
            f"mitsuba was imported before twinlens's backend was set up and has loaded {names}: call"
            f" twinlens.rendering.backend() first, or set DRJIT_LIBLLVM_PATH={library}"
        )
