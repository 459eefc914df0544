"""Which Mitsuba variant renders here: CUDA or LLVM where they really work, the scalar one everywhere.

The choice is made once a process. `TWINLENS_BACKEND` (auto, scalar, llvm, cuda) overrides it.
"""

import contextlib
import ctypes
import functools
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twinlens.errors import BackendError, InputError, unknown
from twinlens.rendering import llvm

VARIANTS = {"scalar": "scalar_rgb", "llvm": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}
_M_MMAP_THRESHOLD, _M_ARENA_MAX = -3, -8  # malloc.h
_LARGE_BLOCK = 1 << 17  # bytes; glibc's own threshold at the start
_INSTALL_LLVM = "install LLVM 17 or newer for about 3x the speed and every lens (Debian, Ubuntu: apt install libllvm19)"


@dataclass(frozen=True)
class Backend:
    """What renders, and why. `variant` is Mitsuba's name for it, `library` its LLVM, `advice` what to install."""

    name: str
    variant: str
    reason: str
    advice: str = ""
    library: str | None = None
    probes: tuple[llvm.Probe, ...] = ()

    @property
    def is_jit(self) -> bool:
        """Whether rays are traced in compiled bundles (LLVM, CUDA), which the full camera law needs."""
        return self.name != "scalar"


_activated: dict[str, Backend] = {}
"""What was set up here, by variant. An interrupt that came meanwhile is heard before `backend` can remember it."""


@functools.cache
def backend() -> Backend:
    """The backend of this process, found and set up at the first call.

    Raises InputError for an unknown TWINLENS_BACKEND, BackendError when the one asked for does not work here.
    """
    wanted = _wanted()
    chosen = _already_set() or _with_short_reason(_choose(wanted))
    _activate(chosen)
    return chosen


def doctor() -> Backend:
    """What `backend` would choose, without setting it up; its reason is the whole one, what each library said."""
    return _choose(_wanted())


def mitsuba() -> Any:
    """The mitsuba module, with the chosen variant set. Raises BackendError if somebody has set another one since."""
    chosen = backend().variant
    import mitsuba

    if mitsuba.variant() != chosen:
        raise BackendError(f"mitsuba's variant was {chosen} and has been set to {mitsuba.variant()}; set it back")
    return mitsuba


def use_threads(count: int) -> None:
    """Render with so many threads in this process, all of the machine's unless said. The images are the same."""
    if count < 1:
        raise InputError(f"a renderer needs 1 thread or more, got {count}")
    backend()
    import drjit

    drjit.set_thread_count(count)


def forget_kernels() -> None:
    """Give back the memory of compiled kernels and of scenes that nobody holds; what is used again comes from the disk.

    Every new mixture of materials is a kernel of its own, kept for the life of the process: a thousand random scenes
    would fill the memory.
    """
    if not backend().is_jit:
        return
    import drjit

    gc.collect()  # scenes hold their parts in cycles
    drjit.sync_thread()
    drjit.flush_kernel_cache()
    drjit.flush_malloc_cache()
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None)  # glibc keeps what was freed, piecemeal
    if trim is not None:
        trim(0)


def configure_malloc() -> None:
    """Have glibc give large blocks back to the system one by one, and keep small ones in one place, from now on.

    By itself it takes ever larger blocks from a heap for each thread, once such a block was freed. Among what stays
    they leave holes that are never given back: of 1,000 random scenes the last hundred took 11% more memory than the
    first, and so 6%. It holds for the whole process; where the C library is another, nothing happens.
    """
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_MMAP_THRESHOLD, _LARGE_BLOCK)
        mallopt(_M_ARENA_MAX, 1)


def _wanted() -> str:
    wanted = os.environ.get("TWINLENS_BACKEND", "auto")
    if wanted not in ("auto", *VARIANTS):
        raise unknown("TWINLENS_BACKEND", wanted, ["auto", *VARIANTS])
    return wanted


def _already_set() -> Backend | None:
    """A host program that chose a variant before us keeps it.

    Mitsuba is not imported here: with it Dr.Jit reads DRJIT_LIBLLVM_PATH, once, before we know a library that works.
    """
    if "mitsuba" not in sys.modules:
        return None
    import mitsuba

    variant = mitsuba.variant()
    for name, known in VARIANTS.items():
        if variant == known:
            return _activated.get(known) or Backend(name, known, "the variant was set before twinlens was asked")
    if variant is not None:
        raise BackendError(
            f"mitsuba's variant is already {variant}; twinlens renders with {', '.join(VARIANTS.values())}"
        )
    return None


def _choose(wanted: str) -> Backend:
    probes: list[llvm.Probe] = []
    if wanted == "scalar":
        return Backend("scalar", VARIANTS["scalar"], "TWINLENS_BACKEND asks for it")
    if wanted in ("auto", "cuda") and _has_cuda_driver():
        probes.append(llvm.probe(VARIANTS["cuda"]))
        if probes[-1].works:
            return Backend("cuda", VARIANTS["cuda"], "a CUDA device works", probes=tuple(probes))
    if wanted in ("auto", "llvm"):
        for library in llvm.candidates():
            probes.append(llvm.probe(VARIANTS["llvm"], library))
            if probes[-1].works:
                reason = f"{library.name} works"
                return Backend("llvm", VARIANTS["llvm"], reason, library=str(library), probes=tuple(probes))
    if wanted == "cuda":
        why = _why(probes) if probes else "no NVIDIA driver (libcuda.so.1) was found"
        raise BackendError(f"TWINLENS_BACKEND=cuda does not work here: {why}; unset it, and LLVM is looked for")
    if wanted == "llvm":
        raise BackendError(f"TWINLENS_BACKEND=llvm does not work here: {_why(probes)}; {_INSTALL_LLVM}")
    return Backend("scalar", VARIANTS["scalar"], _why(probes), advice=_INSTALL_LLVM, probes=tuple(probes))


def _why(probes: list[llvm.Probe]) -> str:
    if not probes:
        return "no LLVM library and no CUDA device was found"
    return "; ".join(f"{Path(probe.path).name} {probe.answer}" for probe in probes)


def _with_short_reason(chosen: Backend) -> Backend:
    """With a reason that closes the line of a command, whatever the libraries had to say."""
    if chosen.is_jit or not chosen.probes:
        return chosen
    return replace(chosen, reason="no usable LLVM; `twinlens doctor` tells why")


def _has_cuda_driver() -> bool:
    try:
        ctypes.CDLL("libcuda.so.1")
    except OSError:
        return False
    return True


def _activate(chosen: Backend) -> None:
    """Import Mitsuba with this backend. An interrupt meanwhile is heard once it is done, some tenths of a second."""
    if chosen.library is not None:
        os.environ["DRJIT_LIBLLVM_PATH"] = chosen.library
    with deferred_interrupts():
        _set_variant(chosen.variant)
        _activated[chosen.variant] = chosen


def _set_variant(variant: str) -> None:
    import mitsuba

    if mitsuba.variant() == variant:
        return
    try:
        mitsuba.set_variant(variant)
    except ImportError as error:
        raise BackendError(
            f"{variant} works by itself but not in this process: mitsuba was imported before, with another "
            "DRJIT_LIBLLVM_PATH; unset that, or render with twinlens first"
        ) from error
    mitsuba.set_log_level(mitsuba.LogLevel.Error)


@contextlib.contextmanager
def deferred_interrupts() -> Iterator[None]:
    """Keep SIGINT until the block has ended, then let its handler hear it once, however often it came.

    Only the main thread may set handlers, and only it runs them: elsewhere nothing is held. A process that ignores
    SIGINT, dies of it (SIG_DFL), or handles it outside Python goes on doing so.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came = threading.Event()
    signal.signal(signal.SIGINT, lambda *_: came.set())
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
        if came.is_set():
            signal.raise_signal(signal.SIGINT)
