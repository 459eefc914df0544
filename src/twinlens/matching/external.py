"""External matchers: Python functions, programs, and stereo networks in ONNX files."""

import contextlib
import functools
import glob
import hashlib
import importlib
import importlib.util
import operator
import os
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable
from dataclasses import KW_ONLY, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import (
    FileError,
    InputError,
    TwinlensError,
    check_int,
    check_number,
)
from twinlens.interrupts import deferred_interrupts
from twinlens.matching.images import Confidence, Disparity, Image, grey, pair
from twinlens.matching.options import RangeMatcher, as_pair, import_extra

HASH_DIGITS = 16  # hexadecimal digits kept of a file's SHA-256
TAIL_BYTES = 4096  # of a program's output, kept for the message if it fails
_PROGRAM_FILES = (
    "left.png",
    "right.png",
    "out.pfm",
    "confidence.pfm",
)  # by the placeholders of a command
CHILD_S = 0.1  # seconds to wait for output after a program has ended: its children may keep the pipe open


class MatcherFailedError(InputError):
    """A program or a model failed while it ran."""

    exit_code = 1


class WrongAnswerError(MatcherFailedError):
    """User code did not return a disparity map; kind: wrong-type, wrong-shape or not-a-number."""

    def __init__(self, kind: str, message: str) -> None:
        super().__init__(message)
        self.kind = kind


class FunctionError(TwinlensError):
    """A Python function raised an exception, the cause of this one."""

    exit_code = 1


class ProgramTimeoutError(MatcherFailedError, TimeoutError):
    """A program exceeded its time limit and was killed."""


def checked_result(result: Any, shape: tuple[int, ...], name: str) -> Disparity:
    """The disparity map that `name` returned, as float32 of this shape (H, W).

    Raises WrongAnswerError for another type or shape, and for NaN and -inf; unknown disparities are +inf.
    """
    try:
        values = np.asarray(
            "None" if result is None else result
        )  # NumPy converts None to NaN
        if values.dtype.kind == "c":
            raise TypeError
        disparity = values.astype(np.float32, copy=False)
    except (TypeError, ValueError):
        message = (
            f"{name} returned {type(result).__name__}, not an array of real disparities"
        )
        raise WrongAnswerError("wrong-type", message) from None
    if disparity.shape != shape:
        raise WrongAnswerError(
            "wrong-shape",
            f"{name} returned shape {disparity.shape}; the left image has {shape}",
        )
    wrong = np.isnan(disparity) | np.isneginf(disparity)
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        message = f"{name} returned {disparity[y, x]} at [{y}, {x}]; unknown disparities are +inf"
        raise WrongAnswerError("not-a-number", message)
    return disparity


def checked_pair(
    result: Any, shape: tuple[int, ...], name: str
) -> tuple[Disparity, Confidence | None]:
    """The map, or the pair (disparity, confidence), that `name` returned, as float32 of this shape (H, W).

    Raises WrongAnswerError as `checked_result` does, and for a confidence of another type or shape, or with NaN.
    """
    disparity, confidence = as_pair(result)
    checked = checked_result(disparity, shape, name)
    if confidence is None:
        return checked, None
    values = np.asarray(confidence)
    if values.dtype.kind not in "biuf":
        raise WrongAnswerError(
            "wrong-type",
            f"{name} returned a confidence of {values.dtype}, not real numbers",
        )
    if values.shape != shape:
        raise WrongAnswerError(
            "wrong-shape",
            f"{name} returned a confidence of shape {values.shape}; expected {shape}",
        )
    values = values.astype(np.float32, copy=False)
    if np.isnan(values).any():
        raise WrongAnswerError("not-a-number", f"{name} returned a confidence with NaN")
    return checked, values


def file_hashes(paths: Iterable[Path]) -> str:
    """Comma-separated `name=hash` of the files, sorted by path; `name=absent` for a file that cannot be read.

    A board stores this text, and rescores a network or program whose files have changed.

    >>> file_hashes([Path("no-such-file")]), file_hashes([])
    ('no-such-file=absent', '')
    """
    return ",".join(f"{path.name}={_hash(path)}" for path in sorted(set(paths)))


def _hash(path: Path) -> str:
    try:
        status = path.stat()
        return _cached_hash(path, status.st_mtime_ns, status.st_size)
    except OSError:
        return "absent"


@functools.lru_cache(maxsize=256)
def _cached_hash(path: Path, _written_ns: int, _size: int) -> str:
    """The hash of a file until its time or size changes; a board needs it for every sample."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:HASH_DIGITS]


@dataclass(frozen=True)
class PythonFunction(RangeMatcher):
    """A Python function(left, right, *, num_disparities, min_disparity) that returns disparities (H, W).

    It receives the images unchanged. It may return (disparity, confidence); `checked_pair` checks what it returns.
    """

    function: Annotated[
        Callable[..., Any] | str,
        "path/to/file.py:name, relative to the current folder, or module:name of an importable module.",
    ] = ""

    def __post_init__(self) -> None:
        super().__post_init__()
        if isinstance(self.function, str) and not all(self._module_and_name):
            raise InputError(
                f"function is {self.function!r}; write path/to/file.py:name or module:name"
            )

    @property
    def _module_and_name(self) -> tuple[str, str]:
        """(file or module, name) of a function given as text."""
        module, _, name = str(self.function).rpartition(":")
        return module, name

    @property
    def content(self) -> str:
        """The hash of the file of a function given as text; other files that it imports are not hashed."""
        module = "" if callable(self.function) else self._module_and_name[0]
        if module.endswith(".py"):
            return file_hashes([Path(module)])
        spec = None
        with contextlib.suppress(
            Exception
        ):  # imports the parent packages, which may raise anything
            spec = importlib.util.find_spec(module)
        return (
            file_hashes([Path(spec.origin)])
            if spec and spec.has_location and spec.origin
            else ""
        )

    def check_parts(self) -> None:
        """InputError if there is no such function. Imports its module."""
        self._load()

    def _load(self) -> Callable[..., Any]:
        if callable(self.function):
            return self.function
        source, name = self._module_and_name
        path, is_file = Path(source).resolve(), source.endswith(".py")
        if is_file and not path.is_file():
            raise InputError(
                f"function {self.function!r} cannot be imported: no file {source}"
            )
        try:
            module = (
                _import_file(path, path.stat().st_mtime_ns)
                if is_file
                else importlib.import_module(source)
            )
        except (ImportError, AttributeError, OSError, SyntaxError) as problem:
            reason = (
                "its module has a syntax error; "
                if isinstance(problem, SyntaxError)
                else ""
            )
            raise InputError(
                f"function {self.function!r} cannot be imported: {reason}{problem}"
            ) from None
        try:
            function = operator.attrgetter(name)(module)
        except AttributeError:
            reason = f"{source} has no function {name!r}"
            raise InputError(
                f"function {self.function!r} cannot be imported: {reason}"
            ) from None
        if not callable(function):
            raise InputError(
                f"function {self.function!r} is {type(function).__name__}, which cannot be called"
            )
        return function  # type: ignore[no-any-return]

    def _match(self, left: Any, right: Any) -> tuple[Disparity, Confidence | None]:
        try:
            function = self._load()
            result = function(
                left,
                right,
                num_disparities=self.num_disparities,
                min_disparity=self.min_disparity,
            )
        except (TwinlensError, MemoryError):
            raise
        except (Exception, SystemExit) as error:
            name = getattr(self.function, "__name__", self.function)
            raise FunctionError(
                f"function {name!r} failed: {type(error).__name__}: {error}"
            ) from error
        return checked_pair(
            result,
            np.shape(left)[:2],
            f"function {getattr(function, '__name__', function)!r}",
        )


@functools.lru_cache(maxsize=32)
def _import_file(path: Path, _written_ns: int) -> Any:
    """The module of a .py file, imported again if the file has changed. Its folder is added to sys.path."""
    spec = importlib.util.spec_from_file_location(f"twinlens_method_{path.stem}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} is not a Python file")
    module = importlib.util.module_from_spec(spec)
    if str(path.parent) not in sys.path:
        sys.path.append(str(path.parent))
    sys.modules[spec.name] = module
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Program(RangeMatcher):
    """A program that reads two PNG files and writes a disparity map, a PFM file (+inf unknown); see `command`.

    It may write a confidence too, a PFM file, if its command has {confidence}.
    It runs without a shell. Its output is shown only if it fails.
    """

    command: Annotated[
        str,
        "Command line with {left} and {right}, PNG files to read, {out}, a grey PFM file to write, and optionally "
        "{confidence}, another one, {num_disparities} and {min_disparity}.",
    ] = ""
    _: KW_ONLY
    timeout_s: Annotated[
        float, "Seconds per match, after which the program is killed."
    ] = 600.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("timeout_s", self.timeout_s, "a number above 0", above=0)
        for placeholder in ("{left}", "{right}", "{out}"):
            if placeholder not in self.command:
                raise InputError(
                    f"command {self.command!r} needs {placeholder}: 'prog {{left}} {{right}} {{out}}'"
                )
        try:
            shlex.split(self.command)
        except ValueError as problem:
            raise InputError(
                f"command {self.command!r} cannot be read: {problem}"
            ) from None

    @property
    def content(self) -> str:
        """The hashes of the program's file and of every file that its command names, such as `--weights=net.bin`.

        Files in folders that it names, and files that those files load, are not hashed.
        """
        program, *words = shlex.split(self.command)
        named = [
            shutil.which(program),
            *(part for word in words for part in {word, word.rpartition("=")[2]}),
        ]
        files = [name for name in named if name and os.path.isfile(name)]  # noqa: PTH113
        return file_hashes(map(Path, files))  # never raises

    def check_parts(self) -> None:
        """InputError if the program does not exist or is not executable. Other files are not checked."""
        program = shlex.split(self.command)[0]
        if shutil.which(program) is None:
            reason = (
                "it is not executable" if Path(program).is_file() else "no such program"
            )
            raise InputError(f"program {program!r} cannot be started: {reason}")

    def _match(self, left: Any, right: Any) -> tuple[Disparity, Confidence | None]:
        from twinlens.dataset import write_png

        pair(left, right)
        words, shape = shlex.split(self.command), np.shape(left)[:2]
        name = f"program {words[0]!r}"
        with tempfile.TemporaryDirectory(prefix="twinlens-") as folder:
            files = {Path(file).stem: Path(folder, file) for file in _PROGRAM_FILES}
            for key, image in (("left", left), ("right", right)):
                pixels = np.asarray(image)
                write_png(
                    files[key], pixels[..., 0] if pixels.shape[2:] == (1,) else pixels
                )
            search = {
                "num_disparities": self.num_disparities,
                "min_disparity": self.min_disparity,
            }
            for key, value in {**files, **search}.items():
                words = [word.replace(f"{{{key}}}", str(value)) for word in words]
            status, printed = _run_process(words, self.timeout_s, name)
            if status != 0:
                last = (printed.strip() or "it printed nothing").splitlines()[-1]
                raise MatcherFailedError(f"{name} {format_status(status)}: {last}")
            written = (
                ("out", "confidence") if "{confidence}" in self.command else ("out",)
            )
            maps = [_read_pfm(files[key], shape, name) for key in written]
            return checked_pair((*maps, None)[:2], shape, name)


def format_status(status: int) -> str:
    """How a process ended, from its exit status; negative: a signal."""
    if status >= 0:
        return f"exited with status {status}"
    name = next(
        (each.name for each in signal.Signals if each == -status), f"signal {-status}"
    )
    return f"was killed by {name}" + (" (out of memory?)" if name == "SIGKILL" else "")


def _run_process(words: list[str], timeout_s: float, name: str) -> tuple[int, str]:
    """Run a program: (exit status, the end of its output).

    It runs in its own session, so that its children are killed with it at the time limit. If memory runs out, Linux
    kills it before other processes.
    """
    pipes = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.STDOUT,
    }
    try:
        process = subprocess.Popen(words, **pipes, start_new_session=True, bufsize=0)  # type: ignore[call-overload]
    except (OSError, ValueError) as problem:
        raise InputError(
            f"{name} cannot be started: {getattr(problem, 'strerror', None) or problem}"
        ) from None
    with contextlib.suppress(OSError):
        Path(f"/proc/{process.pid}/oom_score_adj").write_text("1000")
    tail = bytearray()

    def drain() -> None:
        with process.stdout as pipe:
            while output := pipe.read(1 << 16):
                tail.extend(output)
                del tail[:-TAIL_BYTES]

    reader = threading.Thread(target=drain, daemon=True)
    reader.start()
    try:
        process.wait(timeout_s)
    except subprocess.TimeoutExpired:
        raise ProgramTimeoutError(
            f"{name} took longer than {timeout_s:g} s and was killed"
        ) from None
    finally:
        with deferred_interrupts():  # a second Ctrl-C
            if process.poll() is None:
                with contextlib.suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
                process.wait()
    reader.join(CHILD_S)
    return process.returncode, tail.decode(errors="replace")


def _read_pfm(path: Path, shape: tuple[int, ...], name: str) -> Disparity:
    """Read a grey PFM file of this (H, W), float32, top row first. Reads no more bytes than such a map has."""
    what = f"{{{path.stem}}}"
    if not path.is_file():
        raise MatcherFailedError(f"{name} wrote no file at {what}")
    with path.open("rb") as file:
        head = [file.readline(64).split() for _ in range(3)]
        try:
            (magic,), (width, height), (scale,) = head
            size, order = (
                (int(height), int(width)),
                "<f4" if float(scale) < 0 else ">f4",
            )
        except ValueError:
            raise MatcherFailedError(
                f"{name}: {what} is not a PFM file: its header cannot be read"
            ) from None
        if magic == b"Pf" and size != shape:
            raise WrongAnswerError(
                "wrong-shape",
                f"{name} returned shape {size}; the left image has {shape}",
            )
        body = file.read(4 * size[0] * size[1] + 1) if magic == b"Pf" else b""
    if len(body) != 4 * size[0] * size[1]:
        raise MatcherFailedError(
            f"{name}: {what} is not a grey PFM file of the size in its header"
        )
    return np.frombuffer(body, order).reshape(size)[::-1].astype(np.float32)


@dataclass(frozen=True)
class OnnxNetwork:
    """A stereo network in a .onnx file. It runs on the processor and needs the extra onnx.

    Inputs: two float32 tensors (1, C, H, W), the left image first, C = 1 (luma) or 3 (red, green, blue). Images are
    padded with their edge pixels, at the top and on the right, to the model's H and W or, where these are free, to a
    `multiple`; larger images are refused. Output: (1, 1, H, W), (1, H, W) or (H, W), cropped to the image, in pixels,
    u_left - u_right after multiplication by `sign`; +inf is unknown. A network searches the range it was trained for.
    """

    model: Annotated[str, "The .onnx file."] = ""
    scale: Annotated[
        float,
        "Largest input value for 8-bit and 16-bit images: 1 for 0..1, 255 for 0..255.",
    ] = 1.0
    multiple: Annotated[
        int,
        "Images are padded to a multiple of this, in pixels, where the model's size is free.",
    ] = 32
    output: Annotated[
        int, "Index of the output that is the disparity; -1: the last."
    ] = -1
    sign: Annotated[int, "1, or -1 for a network whose disparities are negative."] = 1
    confidence: Annotated[
        int | None,
        "Index of the output that is the confidence, of the same shape; none: none.",
    ] = None

    def __post_init__(self) -> None:
        if not str(self.model).endswith(".onnx"):
            raise InputError(
                f"model is {self.model!r}; name an .onnx file, as in onnx:net.onnx"
            )
        check_number("scale", self.scale, "a number above 0", above=0)
        check_int("multiple", self.multiple, 1)
        check_int("output", self.output)
        check_int("confidence", 0 if self.confidence is None else self.confidence)
        if self.sign not in (1, -1):
            raise InputError(
                f"sign is {self.sign!r}; use 1, or -1 for a network whose disparities are negative"
            )

    @property
    def content(self) -> str:
        """The hashes of the model's file and of external data in `net.onnx.data` or `net.onnx_data`."""
        return model_hashes(self.model)

    def check_parts(self) -> None:
        """FileError if there is no such network, MissingExtraError if onnxruntime is not installed."""
        check_model(self.model)

    def match(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> Disparity:
        """The network's disparities; see `matching.Matcher.match`. The range is not used."""
        return replace(self, confidence=None).match_with_confidence(left, right)[0]

    def match_with_confidence(
        self,
        left: Any,
        right: Any,
        *,
        num_disparities: int | None = None,
        min_disparity: int | None = None,
    ) -> tuple[Disparity, Confidence | None]:
        """As `match`, with the confidence if an output is chosen for it."""
        pair(left, right)
        session = _session(self.model, _written_ns(self.model))
        inputs, outputs = session.get_inputs(), session.get_outputs()
        self._check(inputs, outputs)
        images = np.asarray(left), np.asarray(right)
        feeds = {
            node.name: self._tensor(image, node)
            for node, image in zip(inputs, images, strict=True)
        }
        try:
            results = session.run(
                [outputs[index].name for index in self._outputs], feeds
            )
        except (
            Exception
        ) as problem:  # the errors of onnxruntime have no common base class
            raise MatcherFailedError(
                f"{self._name} failed: {_one_line(problem)}"
            ) from None
        disparity, *rest = (self._plane(np.asarray(result)) for result in results)
        found = self.sign * disparity, rest[0] if rest else None
        full, trust = checked_pair(found, feeds[inputs[0].name].shape[2:], self._name)
        height, width = np.shape(left)[:2]
        inside = np.s_[-height:, :width]
        return np.ascontiguousarray(
            full[inside]
        ), None if trust is None else np.ascontiguousarray(trust[inside])

    @property
    def _outputs(self) -> tuple[int, ...]:
        """The indices of the outputs that are read."""
        return (
            (self.output,)
            if self.confidence is None
            else (self.output, self.confidence)
        )

    def _plane(self, output: Image) -> Image:
        if not 2 <= output.ndim <= 4 or any(size != 1 for size in output.shape[:-2]):
            message = f"{self.model}: returned shape {output.shape}; expected (1, 1, H, W), (1, H, W) or (H, W)"
            raise WrongAnswerError("wrong-shape", message)
        return output.reshape(output.shape[-2:])

    @property
    def _name(self) -> str:
        return f"model {Path(self.model).name!r}"

    def _check(self, inputs: list[Any], outputs: list[Any]) -> None:
        """InputError unless the model has two images as inputs, and the selected output."""
        if len(inputs) != 2:
            remedy = (
                f"; a descriptor network is a cost: sgm:cost=onnx:{self.model}"
                if len(inputs) == 1
                else ""
            )
            raise InputError(
                f"{self.model}: has {len(inputs)} inputs; a stereo model has two, left and right{remedy}"
            )
        for node in inputs:
            where = f"{self.model}: input {node.name!r}"
            if node.type != "tensor(float)" or len(node.shape) != 4:
                raise InputError(
                    f"{where} is {node.type} {node.shape}; expected float (1, C, H, W)"
                )
            if isinstance(node.shape[1], int) and node.shape[1] not in (1, 3):
                raise InputError(
                    f"{where} has {node.shape[1]} channels; images have 1 or 3"
                )
        for option, index in zip(("output", "confidence"), self._outputs, strict=False):
            if not -len(outputs) <= index < len(outputs):
                raise InputError(
                    f"{self._name} has {len(outputs)} outputs; {option} is {index}"
                )

    def _tensor(self, image: Image, node: Any) -> Image:
        """The padded image for an input, (1, C, H, W). Integers are divided by their largest value; floats are 0..1."""
        largest = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
        levels = image.astype(np.float32) / np.float32(largest) * np.float32(self.scale)
        levels = levels.reshape(*image.shape[:2], -1)
        if node.shape[1] == 1:
            levels = grey(levels)[..., None]
        elif levels.shape[2] == 1:
            levels = np.repeat(levels, 3, axis=2)
        padding = []
        for size, wanted in zip(image.shape[:2], node.shape[2:], strict=True):
            if isinstance(wanted, int) and wanted < size:
                raise InputError(
                    f"{self._name} takes images of up to {wanted} pixels a side; this one has {size}"
                )
            padding.append(
                (
                    wanted
                    if isinstance(wanted, int)
                    else -(-size // self.multiple) * self.multiple
                )
                - size
            )
        padded = np.pad(levels, ((padding[0], 0), (0, padding[1]), (0, 0)), mode="edge")
        return np.ascontiguousarray(np.moveaxis(padded, 2, 0)[None])


def model_hashes(model: str) -> str:
    """The hashes of the model's file and of external data in `net.onnx.data` or `net.onnx_data`."""
    path = Path(model)
    return file_hashes([path, *path.parent.glob(f"{glob.escape(path.name)}[._]data*")])


def check_model(model: str) -> None:
    """FileError if there is no such file or it is not a network, MissingExtraError if onnxruntime is not installed."""
    written = _written_ns(model)
    import_extra("onnxruntime", "onnx")
    _session(model, written)


def descriptors(model: str, image: Image) -> NDArray[np.float32]:
    """The descriptors (H, W, C) that a network computes for the pixels of an image (H, W).

    The network has one float32 input (1, 1, H, W), the grey levels from 0 to 1, and one output (1, C, H, W), whose
    descriptors should have unit length. Raises FileError and MissingExtraError as `check_model` does, InputError for
    another input, and MatcherFailedError if the network fails or returns another shape, NaN or infinity.
    """
    session, name = _session(model, _written_ns(model)), f"model {Path(model).name!r}"
    inputs = session.get_inputs()
    if [(node.type, len(node.shape), node.shape[1:2]) for node in inputs] != [
        ("tensor(float)", 4, [1])
    ]:
        found = ", ".join(f"{node.type} {node.shape}" for node in inputs)
        raise InputError(
            f"{model}: a descriptor network has one input, float (1, 1, H, W); this one has {found}"
        )
    largest = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
    tensor = np.ascontiguousarray(image[None, None] / np.float32(largest), np.float32)
    try:
        output = np.asarray(session.run(None, {inputs[0].name: tensor})[0])
    except Exception as problem:  # the errors of onnxruntime have no common base class
        raise MatcherFailedError(f"{name} failed: {_one_line(problem)}") from None
    if output.ndim != 4 or len(output) != 1 or output.shape[2:] != image.shape:
        wanted = f"(1, C, {image.shape[0]}, {image.shape[1]})"
        raise MatcherFailedError(
            f"{name} returned descriptors of shape {output.shape}; expected {wanted}"
        )
    if not np.isfinite(output).all():
        raise MatcherFailedError(f"{name} returned descriptors that are not finite")
    return np.ascontiguousarray(np.moveaxis(output[0], 0, 2), np.float32)


def _written_ns(model: str) -> int:
    """When the file was last written; a changed file is loaded again."""
    try:
        return Path(model).stat().st_mtime_ns
    except OSError as problem:
        raise FileError(f"{model}: {problem.strerror}") from None


@functools.lru_cache(maxsize=4)
def _session(model: str, _written_ns: int) -> Any:
    """The loaded model; loading takes longer than running it."""
    runtime = import_extra("onnxruntime", "onnx")
    options = runtime.SessionOptions()
    options.log_severity_level = 4  # fatal only: its errors are raised
    try:
        return runtime.InferenceSession(
            model, options, providers=["CPUExecutionProvider"]
        )
    except Exception as problem:  # see match
        raise FileError(
            f"{model}: not an ONNX model that can be run: {_one_line(problem)}"
        ) from None


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200]
