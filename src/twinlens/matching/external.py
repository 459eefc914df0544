"""Other people's matchers behind the same two words, `match(left, right)`: OpenCV, any program, any Python function.

What comes back is checked: the left image's size, no NaN, no -inf; +inf means unknown.
"""

import importlib
import os
import shlex
import signal
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import InputError, MissingExtraError, unknown
from twinlens.matching.checks import amount, check_block_size, whole
from twinlens.matching.images import Disparity, Image, pair
from twinlens.matching.supports import levels

SIXTEENTHS = 16  # OpenCV's fixed point, and the multiple its ranges come in
MODES = {"default": "STEREO_SGBM_MODE_SGBM", "hh": "STEREO_SGBM_MODE_HH", "3way": "STEREO_SGBM_MODE_SGBM_3WAY"}


class ProgramTimeoutError(InputError, TimeoutError):
    """A program took longer than it may, and was ended."""


def checked_result(result: Any, shape: tuple[int, ...], name: str) -> Disparity:
    """The result as float32 (H, W), or an InputError that says what `name` did wrong."""
    try:
        disparity = np.asarray(result, dtype=np.float32)
    except (TypeError, ValueError):
        raise InputError(f"{name} returned {type(result).__name__}, not an array of disparities") from None
    if disparity.shape != shape:
        raise InputError(f"{name} returned shape {disparity.shape}; the left image has {shape}")
    wrong = np.isnan(disparity) | np.isneginf(disparity)
    if wrong.any():
        y, x = np.argwhere(wrong)[0]
        raise InputError(f"{name} returned {disparity[y, x]} at [{y}, {x}]; unknown disparities are +inf")
    return disparity


def _opencv() -> Any:
    try:
        import cv2
    except ImportError:
        raise MissingExtraError("OpenCV is not installed; pip install 'twinlens[opencv]'") from None
    return cv2


def _eight_bit(left: Any, right: Any) -> tuple[Image, Image]:
    one, other = levels(*pair(left, right))
    return one.astype(np.uint8), other.astype(np.uint8)


def _from_sixteenths(fixed: Image, low: int) -> Disparity:
    return np.where(fixed < low * SIXTEENTHS, np.inf, fixed / SIXTEENTHS).astype(np.float32)


@dataclass(frozen=True)
class OpenCVBlock:
    """OpenCV's StereoBM: SAD of clipped Sobel images or, prefilter=False, of its locally normalised images.

    num_disparities is rounded up to a multiple of 16, block_size is 5 or more; images become 8-bit grey. texture and
    uniqueness are OpenCV's textureThreshold and uniquenessRatio; 0 is off.
    """

    block_size: int = 9
    num_disparities: int = 64
    min_disparity: int = 0
    prefilter: bool = True
    texture: int = 10
    uniqueness: int = 15

    def __post_init__(self) -> None:
        if check_block_size("block_size", self.block_size) < 5:
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs 5 or more")
        whole("texture", self.texture, 0)
        whole("uniqueness", self.uniqueness, 0)
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        if self.block_size >= min(images[0].shape):
            raise InputError(f"block_size is {self.block_size}; OpenCV's StereoBM needs a larger image than that")
        matcher = cv2.StereoBM.create(-(-self.num_disparities // SIXTEENTHS) * SIXTEENTHS, self.block_size)
        matcher.setMinDisparity(self.min_disparity)
        matcher.setTextureThreshold(self.texture)
        matcher.setUniquenessRatio(self.uniqueness)
        if not self.prefilter:
            matcher.setPreFilterType(cv2.STEREO_BM_PREFILTER_NORMALIZED_RESPONSE)
            matcher.setPreFilterSize(5)
            matcher.setPreFilterCap(63)
        return _from_sixteenths(matcher.compute(*images), self.min_disparity)


@dataclass(frozen=True)
class OpenCVSemiGlobal:
    """OpenCV's StereoSGBM. mode: "default" (5 paths), "hh" (8 paths) or "3way".

    num_disparities is rounded up to a multiple of 16; images become 8-bit grey; P1 and P2 are 8 and 32 block_size^2.
    """

    block_size: int = 3
    num_disparities: int = 64
    min_disparity: int = 0
    mode: str = "default"
    uniqueness: int = 0

    def __post_init__(self) -> None:
        check_block_size("block_size", self.block_size)
        whole("uniqueness", self.uniqueness, 0)
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        if self.mode not in MODES:
            raise unknown("mode", str(self.mode), MODES)

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        cv2, images = _opencv(), _eight_bit(left, right)
        matcher = cv2.StereoSGBM.create(
            minDisparity=self.min_disparity,
            numDisparities=-(-self.num_disparities // SIXTEENTHS) * SIXTEENTHS,
            blockSize=self.block_size,
            P1=8 * self.block_size**2,
            P2=32 * self.block_size**2,
            uniquenessRatio=self.uniqueness,
            mode=getattr(cv2, MODES[self.mode]),
        )
        return _from_sixteenths(matcher.compute(*images), self.min_disparity)


@dataclass(frozen=True)
class PythonFunction:
    """A Python function(left, right, num_disparities=..., min_disparity=...) that returns (H, W) disparities.

    function: the function itself, or "module:name". It is given the images as they are.
    """

    function: Callable[..., Any] | str = ""
    num_disparities: int = 64
    min_disparity: int = 0

    def __post_init__(self) -> None:
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        if isinstance(self.function, str) and ":" not in self.function:
            raise InputError(f"function is {self.function!r}; write module:name")

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        function = self.function if callable(self.function) else _imported(self.function)
        result = function(left, right, num_disparities=self.num_disparities, min_disparity=self.min_disparity)
        return checked_result(result, np.shape(left)[:2], f"function {getattr(function, '__name__', function)!r}")


def _imported(place: str) -> Callable[..., Any]:
    module, _, name = place.partition(":")
    try:
        found: Any = importlib.import_module(module)
        for part in name.split("."):
            found = getattr(found, part)
    except (ImportError, AttributeError) as problem:
        raise InputError(f"function {place!r} cannot be imported: {problem}") from None
    if not callable(found):
        raise InputError(f"function {place!r} is {type(found).__name__}, which cannot be called")
    return found  # type: ignore[no-any-return]


@dataclass(frozen=True)
class Program:
    """Any program that reads two images and writes a disparity map.

    command: its command line, with {left}, {right} (PNG files it is given), {out} (the file it must write: a grey PFM)
    and, where it wants them, {num_disparities} and {min_disparity}. No shell reads it. In the PFM +inf is unknown.
    timeout_s: how long it may take.
    """

    command: str = ""
    num_disparities: int = 64
    min_disparity: int = 0
    timeout_s: float = 600.0

    def __post_init__(self) -> None:
        whole("num_disparities", self.num_disparities, 1)
        whole("min_disparity", self.min_disparity)
        amount("timeout_s", self.timeout_s, above=True)
        for place in ("{left}", "{right}", "{out}"):
            if place not in self.command:
                raise InputError(
                    f"command is {self.command!r}; it must name {place}, as 'prog {{left}} {{right}} {{out}}'"
                )
        self._words({})

    def _words(self, values: dict[str, str]) -> list[str]:
        try:
            words = shlex.split(self.command)
        except ValueError as problem:
            raise InputError(f"command {self.command!r} cannot be read: {problem}") from None
        for name, value in values.items():
            words = [word.replace(f"{{{name}}}", value) for word in words]
        return words

    def match(self, left: Any, right: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        from PIL import Image as Picture

        pair(left, right)
        with tempfile.TemporaryDirectory(prefix="twinlens-") as folder:
            files = {name: os.path.join(folder, name) for name in ("left.png", "right.png", "out.pfm")}  # noqa: PTH118
            for name, image in (("left.png", left), ("right.png", right)):
                if np.asarray(image).dtype not in (np.uint8, np.uint16):
                    raise InputError("a program is given PNG files; its images must be uint8 or uint16")
                Picture.fromarray(np.asarray(image)).save(files[name])
            self._run(files)
            return checked_result(read_pfm(Path(files["out.pfm"])), np.shape(left)[:2], self._name)

    @property
    def _name(self) -> str:
        return f"program {self._words({})[0]!r}"

    def _run(self, files: dict[str, str]) -> None:
        values = {"left": files["left.png"], "right": files["right.png"], "out": files["out.pfm"]}
        values |= {"num_disparities": str(self.num_disparities), "min_disparity": str(self.min_disparity)}
        done = _finished(self._words(values), self.timeout_s, self._name)
        if done.returncode != 0:
            last = (done.stderr.strip() or done.stdout.strip() or "it said nothing").splitlines()[-1]
            raise InputError(f"{self._name} left with status {done.returncode}: {last}")
        if not Path(files["out.pfm"]).is_file():
            raise InputError(f"{self._name} wrote no file at {{out}}")


def _finished(words: list[str], timeout_s: float, name: str) -> "subprocess.CompletedProcess[str]":
    """Run a program to its end, in a session of its own: at the limit all that it started ends with it."""
    try:
        process = subprocess.Popen(
            words,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            errors="replace",
            start_new_session=True,
        )
    except OSError as problem:
        raise InputError(f"{name} cannot be started: {problem.strerror}") from None
    try:
        out, err = process.communicate(timeout=timeout_s)
    except subprocess.TimeoutExpired:
        raise ProgramTimeoutError(f"{name} took longer than {timeout_s:g} s and was ended") from None
    finally:
        if process.returncode is None:
            os.killpg(process.pid, signal.SIGKILL)
            process.communicate()
    return subprocess.CompletedProcess(words, process.returncode, out, err)


def read_pfm(path: Path) -> Disparity:
    """A grey PFM, (H, W) float32, first row on top. A matcher's own exchange format: strict, and nothing else."""
    with path.open("rb") as file:
        head = [file.readline(64).split() for _ in range(3)]
        body = file.read()
    try:
        (magic,), (width, height), (scale,) = head
        size, order = (int(height), int(width)), "<f4" if float(scale) < 0 else ">f4"
    except ValueError:
        raise InputError("the program's {out} is not a PFM file: its header cannot be read") from None
    if magic != b"Pf" or min(size) < 1 or len(body) != 4 * size[0] * size[1]:
        raise InputError("the program's {out} is not a grey PFM file of the size it names")
    return np.frombuffer(body, order).reshape(size)[::-1].astype(np.float32)
