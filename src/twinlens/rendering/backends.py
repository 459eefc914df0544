"""The Mitsuba variant of this process: CUDA or LLVM where a test render succeeds, else scalar.

It is chosen once per process. `TWINLENS_BACKEND` (auto, scalar, llvm, cuda) overrides the choice.
"""

import ctypes
import functools
import gc
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twinlens.errors import BackendError, check_int, check_known
from twinlens.interrupts import deferred_interrupts
from twinlens.rendering import llvm

VARIANTS = {"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}
_INSTALL_LLVM = "install LLVM 17 or newer: about 3x faster, and all lenses (Debian, Ubuntu: apt install libllvm19)"


@dataclass(frozen=True)
class Backend:
    """Its Mitsuba `variant`, the `reason` of the choice, its LLVM `library`, and `advice` on what to install."""

    name: str
    variant: str
    reason: str
    advice: str = ""
    library: str | None = None
    probes: tuple[llvm.Probe, ...] = ()

    @property
    def is_jit(self) -> bool:
        """Whether kernels are compiled (LLVM, CUDA), which most cameras and lenses need."""
        return self.name != "scalar"


_activated: dict[str, Backend] = {}
"""Backends that were set up, by variant. An interrupt may end `backend` before it caches its result."""


@functools.cache
def backend() -> Backend:
    """The backend of this process, chosen and set up at the first call.

    Raises InputError for an unknown TWINLENS_BACKEND, BackendError when the requested backend does not work.
    """
    wanted = _wanted()
    chosen = _already_set() or _choose(wanted)
    if chosen.probes and not chosen.is_jit:
        chosen = replace(
            chosen, reason="no usable LLVM; see `twinlens doctor`"
        )  # one line, for every command
    _activate(chosen)
    return chosen


def doctor() -> Backend:
    """The backend that `backend` would choose, without setting it up. Its reason lists the result of each library."""
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
    if not backend().is_jit:
        return
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
    for name, known in VARIANTS.items():
        if variant == known:
            return _activated.get(known) or Backend(
                name, known, "set by the host program"
            )
    raise BackendError(
        f"mitsuba's variant is already {variant}; twinlens renders with {', '.join(VARIANTS.values())}"
    )


def _choose(wanted: str) -> Backend:
    if wanted == "scalar":
        return Backend("scalar", VARIANTS["scalar"], "set by TWINLENS_BACKEND")
    tried: list[tuple[str, Path | None]] = []
    if wanted in ("auto", "cuda") and _has_cuda_driver():
        tried.append(("cuda", None))
    if wanted in ("auto", "llvm"):
        tried += (("llvm", library) for library in llvm.candidates())
    probes: list[llvm.Probe] = []
    for name, library in tried:
        probes.append(llvm.probe(VARIANTS[name], library))
        if probes[-1].works:
            reason = f"{library.name} works" if library else "a CUDA device works"
            path = str(library) if library else None
            return Backend(
                name, VARIANTS[name], reason, library=path, probes=tuple(probes)
            )
    why = "; ".join(f"{Path(probe.path).name} {probe.answer}" for probe in probes)
    if wanted == "cuda":
        why = why or "no NVIDIA driver (libcuda.so.1) was found"
        raise BackendError(
            f"TWINLENS_BACKEND=cuda does not work: {why}; unset it to use LLVM"
        )
    why = why or "no LLVM library and no CUDA device was found"
    if wanted == "llvm":
        raise BackendError(
            f"TWINLENS_BACKEND=llvm does not work: {why}; {_INSTALL_LLVM}"
        )
    return Backend(
        "scalar", VARIANTS["scalar"], why, advice=_INSTALL_LLVM, probes=tuple(probes)
    )


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
    with deferred_interrupts():  # an interrupted import of mitsuba would be unusable
        import mitsuba

        if mitsuba.variant() != chosen.variant:
            try:
                mitsuba.set_variant(chosen.variant)
            except ImportError as error:
                raise BackendError(
                    f"{chosen.variant} does not work in this process, because mitsuba was imported with another "
                    "DRJIT_LIBLLVM_PATH; unset it, or render with twinlens first"
                ) from error
            mitsuba.set_log_level(mitsuba.LogLevel.Error)
        _activated[chosen.variant] = chosen
