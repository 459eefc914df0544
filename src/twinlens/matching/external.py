"""External matchers: Python functions and programs. Networks are in `networks`, OpenCV's matchers in `opencv`."""

import contextlib
import functools
import importlib
import importlib.util
import operator
import os
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from twinlens.errors import InputError, TwinlensError, nearest
from twinlens.matching.contract import (
    Answer,
    MatcherFailedError,
    RangeMatcher,
    checked_answer,
    file_hashes,
)
from twinlens.matching.images import Disparity, pair
from twinlens.processes import format_status, run_program
from twinlens.settings import Setting

_IMAGE_FILES = {"left": "left.png", "right": "right.png"}
_MAP_FILES = {"out": "out.pfm", "confidence": "confidence.pfm"}
"""The files of a program by their placeholders in its command."""


@dataclass(frozen=True)
class PythonFunction(RangeMatcher):
    """A Python function(left, right, *, num_disparities, min_disparity) that returns disparities (H, W).

    It receives the images unchanged. It may return (disparity, confidence); `checked_answer` checks what it returns.
    """

    function: Annotated[
        Callable[..., Any] | str,
        Setting(
            "path/to/file.py:name, relative to the current folder, or module:name of an importable module."
        ),
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
        if callable(self.function):
            return ""
        module = self._module_and_name[0]
        if module.endswith(".py"):
            return file_hashes([Path(module)])
        spec = None
        with contextlib.suppress(Exception):
            # This imports the parent packages, which may raise anything.
            spec = importlib.util.find_spec(module)
        if spec is None or not spec.has_location or not spec.origin:
            return ""
        return file_hashes([Path(spec.origin)])

    def check_parts(self) -> None:
        """InputError if there is no such function. Imports its module."""
        self._load()

    def compute(self, left: Any, right: Any) -> Answer:
        """The checked answer of the function. Raises MatcherFailedError, also for what it raises."""
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
            raise MatcherFailedError(
                f"function {name!r} failed: {type(error).__name__}: {error}"
            ) from error
        name = getattr(function, "__name__", function)
        return checked_answer(result, np.shape(left)[:2], f"function {name!r}")

    def _load(self) -> Callable[..., Any]:
        if callable(self.function):
            return self.function
        source, name = self._module_and_name
        refused = f"function {self.function!r} cannot be imported"
        module = _import_source(source, refused)
        try:
            function = operator.attrgetter(name)(module)
        except AttributeError:
            meant = nearest(name, _functions_of(module))
            hint = f"; did you mean {meant!r}?" if meant else ""
            raise InputError(
                f"{refused}: {source} has no function {name!r}{hint}"
            ) from None
        if not callable(function):
            kind = type(function).__name__
            raise InputError(
                f"function {self.function!r} is {kind}, which cannot be called"
            )
        return function  # type: ignore[no-any-return]


def _functions_of(module: Any) -> list[str]:
    """The names in a module that can be called."""
    return [name for name, value in vars(module).items() if callable(value)]


def _import_source(source: str, refused: str) -> Any:
    """The module of a .py file or of this name. Raises InputError, which starts with `refused`."""
    path = Path(source).resolve()
    is_file = source.endswith(".py")
    if is_file and not path.is_file():
        raise InputError(f"{refused}: no file {source}")
    try:
        if is_file:
            return _import_file(path, path.stat().st_mtime_ns)
        return importlib.import_module(source)
    except SyntaxError as problem:
        reason = f"its module has a syntax error; {problem}"
        raise InputError(f"{refused}: {reason}") from None
    except (ImportError, AttributeError, OSError) as problem:
        raise InputError(f"{refused}: {problem}") from None


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
        Setting(
            "Command line with {left} and {right}, PNG files to read, {out}, a grey PFM file to write, and optionally "
            "{confidence}, another one, {num_disparities} and {min_disparity}."
        ),
    ] = ""
    _: KW_ONLY
    timeout_s: Annotated[
        float, Setting("Seconds per match, after which the program is killed.", above=0)
    ] = 600.0

    def __post_init__(self) -> None:
        super().__post_init__()
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
        names = [shutil.which(program), *words]
        names += [word.rpartition("=")[2] for word in words]
        # Unlike Path.is_file, this raises nothing for a word that cannot be a path.
        files = [name for name in names if name and os.path.isfile(name)]  # noqa: PTH113
        return file_hashes(map(Path, files))

    def check_parts(self) -> None:
        """InputError if the program does not exist or is not executable. Other files are not checked."""
        program = shlex.split(self.command)[0]
        if shutil.which(program) is None:
            exists = Path(program).is_file()
            reason = "it is not executable" if exists else "no such program"
            raise InputError(f"program {program!r} cannot be started: {reason}")

    def compute(self, left: Any, right: Any) -> Answer:
        """The maps that the program writes. Raises MatcherFailedError if it fails or exceeds its time limit."""
        pair(left, right)
        shape = np.shape(left)[:2]
        words = shlex.split(self.command)
        name = f"program {words[0]!r}"
        with tempfile.TemporaryDirectory(prefix="twinlens-") as folder:
            files = {
                placeholder: Path(folder, file)
                for placeholder, file in (_IMAGE_FILES | _MAP_FILES).items()
            }
            _write_image(files["left"], left)
            _write_image(files["right"], right)
            self._run(self._filled(words, files), name)
            result: Any = _read_pfm(files["out"], shape, name)
            if "{confidence}" in self.command:
                result = result, _read_pfm(files["confidence"], shape, name)
            return checked_answer(result, shape, name)

    def _run(self, words: list[str], name: str) -> None:
        """Run the program until it ends. Raises MatcherFailedError if it fails, InputError if it cannot be started."""
        try:
            status, printed = run_program(words, self.timeout_s)
        except TimeoutError:
            message = f"{name} took longer than {self.timeout_s:g} s and was killed"
            raise MatcherFailedError(message, "time-limit") from None
        except (OSError, ValueError) as problem:
            reason = getattr(problem, "strerror", None) or problem
            raise InputError(f"{name} cannot be started: {reason}") from None
        if status != 0:
            last_line = (printed.strip() or "it printed nothing").splitlines()[-1]
            raise MatcherFailedError(f"{name} {format_status(status)}: {last_line}")

    def _filled(self, words: list[str], files: dict[str, Path]) -> list[str]:
        """The words of the command with its placeholders replaced."""
        values = {
            **files,
            "num_disparities": self.num_disparities,
            "min_disparity": self.min_disparity,
        }
        for placeholder, value in values.items():
            words = [word.replace(f"{{{placeholder}}}", str(value)) for word in words]
        return words


def _write_image(path: Path, image: Any) -> None:
    """Write an image of 8 or 16 bits as a PNG file."""
    from twinlens.dataset import write_png

    pixels = np.asarray(image)
    single_channel = pixels.shape[2:] == (1,)
    write_png(path, pixels[..., 0] if single_channel else pixels)


def _read_pfm(path: Path, shape: tuple[int, ...], name: str) -> Disparity:
    """Read a grey PFM file of this (H, W), float32, top row first. Reads no more bytes than such a map has."""
    what = f"{{{path.stem}}}"
    if not path.is_file():
        raise MatcherFailedError(f"{name} wrote no file at {what}")
    with path.open("rb") as file:
        head = [file.readline(64).split() for _ in range(3)]
        try:
            (magic,), (width, height), (scale,) = head
            size = int(height), int(width)
            # The sign of the scale is the byte order: negative is little-endian.
            order = "<f4" if float(scale) < 0 else ">f4"
        except ValueError:
            raise MatcherFailedError(
                f"{name}: {what} is not a PFM file: its header cannot be read"
            ) from None
        if magic == b"Pf" and size != shape:
            raise MatcherFailedError(
                f"{name} returned shape {size}; the left image has {shape}",
                "wrong-shape",
            )
        body = file.read(4 * size[0] * size[1] + 1) if magic == b"Pf" else b""
    if len(body) != 4 * size[0] * size[1]:
        raise MatcherFailedError(
            f"{name}: {what} is not a grey PFM file of the size in its header"
        )
    return np.frombuffer(body, order).reshape(size)[::-1].astype(np.float32)
