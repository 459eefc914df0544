"""Stereo networks in ONNX files as methods: `onnx:net.onnx`. They run on the processor and need the extra onnx."""

import glob
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from twinlens.errors import FileError, InputError, MissingExtraError
from twinlens.matching.external import WrongAnswerError, checked_result, content_of
from twinlens.matching.images import Disparity, Image, grey, pair
from twinlens.matching.options import amount, whole

CHANNELS = (1, 3)
_FATAL = 4  # onnxruntime's highest severity: its errors are raised, and need not be logged too


@dataclass(frozen=True)
class OnnxNetwork:
    """A stereo network in a .onnx file.

    Inputs: two float32 tensors (1, C, H, W), the left image first, C = 1 (luma) or 3 (red, green, blue). H and W may be
    fixed in the model: larger images are refused; smaller ones are padded with their edge pixels, at the top and on the
    right. Where H and W are free, images are padded to a `multiple`. Disparities are cropped to the image.
    Output: (1, 1, H, W), (1, H, W) or (H, W), in pixels of the input, u_left - u_right after multiplication by `sign`.
    +inf is unknown; NaN and -inf are refused.

    A network searches the range it was trained for: it has no options num_disparities and min_disparity.
    """

    model: Annotated[str, "The .onnx file."] = ""
    scale: Annotated[float, "Largest value of the input, for 8-bit and 16-bit images: 1 for 0..1, 255 for 0..255."] = (
        1.0
    )
    multiple: Annotated[int, "Images are padded to a multiple of this, in pixels, where the model's size is free."] = 32
    output: Annotated[int, "Index of the output that is the disparity; -1: the last."] = -1
    sign: Annotated[int, "1, or -1 for a network whose disparities are negative."] = 1

    def __post_init__(self) -> None:
        if not str(self.model).endswith(".onnx"):
            raise InputError(f"model is {self.model!r}; name an .onnx file, as in onnx:net.onnx")
        amount("scale", self.scale, above=True)
        whole("multiple", self.multiple, 1)
        whole("output", self.output)
        if self.sign not in (1, -1):
            raise InputError(f"sign is {self.sign!r}; use 1, or -1 for a network whose disparities are negative")

    @property
    def content(self) -> str:
        """The hashes of the model's file and of external data in `net.onnx.data` or `net.onnx_data`."""
        path = Path(self.model)
        return content_of([path, *path.parent.glob(f"{glob.escape(path.name)}[._]data*")])

    def check_parts(self) -> None:
        """FileError if there is no such file, MissingExtraError if onnxruntime is not installed."""
        _written_ns(str(self.model))
        _onnxruntime()

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """The network's disparities; see `options.Matcher.match`. The range is not used."""
        pair(left, right)
        session = _session(str(self.model), _written_ns(str(self.model)))
        height, width = np.shape(left)[:2]
        feeds = {
            node.name: self._tensor(np.asarray(image), node)
            for node, image in zip(_inputs(session, self.model), (left, right), strict=True)
        }
        found = np.asarray(self._run(session, feeds))
        plane = self.sign * _without_unit_axes(found, self.model)
        full = checked_result(plane, next(iter(feeds.values())).shape[2:], self._name)
        return np.ascontiguousarray(full[full.shape[0] - height :, :width])

    @property
    def _name(self) -> str:
        return f"model {Path(self.model).name!r}"

    def _tensor(self, image: Image, node: Any) -> Image:
        """The image as the input takes it: (1, C, H, W) float32, padded at the top and on the right."""
        channels = _channels(node, self.model)
        levels = _normalised(image) * np.float32(self.scale)
        planes = _planes(levels, channels)
        height, width = (
            _padded_size(size, wanted, self.multiple, self._name)
            for size, wanted in zip(image.shape[:2], node.shape[2:], strict=True)
        )
        room = ((0, 0), (height - image.shape[0], 0), (0, width - image.shape[1]))
        return np.ascontiguousarray(np.pad(planes, room, mode="edge")[None])

    def _run(self, session: Any, feeds: dict[str, Image]) -> Any:
        nodes = session.get_outputs()
        if not -len(nodes) <= self.output < len(nodes):
            raise InputError(f"{self._name} has {len(nodes)} outputs; output is {self.output}")
        try:
            return session.run([nodes[self.output].name], feeds)[0]
        except Exception as problem:  # onnxruntime's own errors have no common base
            raise InputError(f"{self._name} failed: {_one_line(problem)}") from None


def _onnxruntime() -> Any:
    try:
        import onnxruntime
    except ImportError:
        raise MissingExtraError("onnxruntime is not installed; pip install 'twinlens[onnx]'") from None
    return onnxruntime


def _written_ns(model: str) -> int:
    """When the file was last written; a changed file is loaded again."""
    try:
        return Path(model).stat().st_mtime_ns
    except OSError as problem:
        raise FileError(f"{model}: {problem.strerror}") from None


@lru_cache(maxsize=4)
def _session(model: str, written_ns: int) -> Any:
    """The loaded model; loading takes longer than running it."""
    runtime = _onnxruntime()
    options = runtime.SessionOptions()
    options.log_severity_level = _FATAL
    try:
        return runtime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    except Exception as problem:  # see _run
        raise FileError(f"{model}: not an ONNX model that can be run: {_one_line(problem)}") from None


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200]


def _inputs(session: Any, model: str) -> list[Any]:
    """The two inputs, left first, if they are images."""
    nodes = session.get_inputs()
    if len(nodes) != 2:
        raise InputError(f"{model}: has {len(nodes)} inputs; a stereo model has two, left and right")
    for node in nodes:
        if node.type != "tensor(float)" or len(node.shape) != 4:
            raise InputError(f"{model}: input {node.name!r} is {node.type} {node.shape}; expected float (1, C, H, W)")
    return list(nodes)


def _channels(node: Any, model: str) -> int:
    channels = node.shape[1]
    if not isinstance(channels, int):
        return 3
    if channels not in CHANNELS:
        raise InputError(f"{model}: input {node.name!r} has {channels} channels; images have 1 or 3")
    return channels


def _normalised(image: Image) -> Image:
    """Integers divided by their largest value; floating-point images are expected in 0..1."""
    largest = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
    return image.astype(np.float32) / np.float32(largest)


def _planes(levels: Image, channels: int) -> Image:
    """(C, H, W) from (H, W) or (H, W, 1 or 3)."""
    flat = levels[..., 0] if levels.ndim == 3 and levels.shape[2] == 1 else levels
    if channels == 1:
        return grey(flat)[None]
    return np.moveaxis(flat, 2, 0) if flat.ndim == 3 else np.stack([flat] * 3)


def _padded_size(size: int, wanted: Any, multiple: int, name: str) -> int:
    if not isinstance(wanted, int):
        return -(-size // multiple) * multiple
    if wanted < size:
        raise InputError(f"{name} takes images of up to {wanted} pixels a side; this one has {size}")
    return wanted


def _without_unit_axes(found: Image, model: str) -> Image:
    """(H, W) of (H, W), (1, H, W) or (1, 1, H, W)."""
    if not 2 <= found.ndim <= 4 or any(size != 1 for size in found.shape[:-2]):
        raise WrongAnswerError(
            "wrong-shape", f"{model}: returned shape {found.shape}; expected (1, 1, H, W), (1, H, W) or (H, W)"
        )
    return found.reshape(found.shape[-2:])
