"""Networks in ONNX files: stereo networks as matchers, descriptor networks, and the cost of descriptors.

Everything needs the extra onnx and runs on the processor. The cost of descriptors is 1 - their product.
"""

import functools
import glob
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Self

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import FileError, InputError, counted, import_extra
from twinlens.matching.box import Rows, Volume
from twinlens.matching.contract import (
    Answer,
    BaseMatcher,
    MatcherFailedError,
    checked_answer,
    file_hashes,
)
from twinlens.matching.images import Image, grey, pair
from twinlens.settings import Setting, Settings

TILE = 32
"""Columns of one matrix product: so few that BLAS starts no threads, because the strips already run in parallel."""


@dataclass(frozen=True)
class OnnxNetwork(Settings, BaseMatcher, noun="option"):
    """A stereo network in a .onnx file. It runs on the processor and needs the extra onnx.

    Inputs: two float32 tensors (1, C, H, W), the left image first, C = 1 (luma) or 3 (red, green, blue). Images are
    padded with their edge pixels, at the top and on the right, to the model's H and W or, where these are free, to a
    `multiple`; larger images are refused. Output: (1, 1, H, W), (1, H, W) or (H, W), cropped to the image, in pixels,
    u_left - u_right after multiplication by `sign`; +inf is unknown. A network searches the range it was trained for.
    """

    model: Annotated[str, Setting("The .onnx file.")] = ""
    scale: Annotated[
        float,
        Setting(
            "Largest input value for 8-bit and 16-bit images: 1 for 0..1, 255 for 0..255.",
            above=0,
        ),
    ] = 1.0
    multiple: Annotated[
        int,
        Setting(
            "Images are padded to a multiple of this, in pixels, where the model's size is free.",
            least=1,
        ),
    ] = 32
    output: Annotated[
        int, Setting("Index of the output that is the disparity; -1: the last.")
    ] = -1
    sign: Annotated[
        int,
        Setting(
            "1, or -1 for a network whose disparities are negative.", choices=(1, -1)
        ),
    ] = 1
    confidence: Annotated[
        int | None,
        Setting(
            "Index of the output that is the confidence, of the same shape; none: none."
        ),
    ] = None

    def __post_init__(self) -> None:
        if not str(self.model).endswith(".onnx"):
            raise InputError(
                f"model is {self.model!r}; name an .onnx file, as in onnx:net.onnx"
            )
        super().__post_init__()

    @property
    def content(self) -> str:
        """The hashes of the model's file and of external data in `net.onnx.data` or `net.onnx_data`."""
        return model_hashes(self.model)

    def check_parts(self) -> None:
        """FileError if there is no such network, MissingExtraError if onnxruntime is not installed."""
        check_model(self.model)

    def without_confidence(self) -> Self:
        return replace(self, confidence=None)

    def compute(self, left: Any, right: Any) -> Answer:
        """The network's answer. Raises MatcherFailedError if it fails, InputError for images that it does not take."""
        pair(left, right)
        network = _Network.of(self.model)
        inputs, outputs = network.session.get_inputs(), network.session.get_outputs()
        self._check(inputs, outputs)
        images = np.asarray(left), np.asarray(right)
        tensors = {
            node.name: self._tensor(image, node)
            for node, image in zip(inputs, images, strict=True)
        }
        names = [outputs[index].name for index in self._outputs]
        planes = [self._plane(output) for output in network.run(names, tensors)]
        planes[0] = self.sign * planes[0]
        padded_shape = tensors[inputs[0].name].shape[2:]
        result = planes[0] if len(planes) == 1 else tuple(planes)
        answer = checked_answer(result, padded_shape, self._name)
        # The padding is above and to the right of the image.
        height, width = np.shape(left)[:2]
        cropped = [
            np.ascontiguousarray(plane[-height:, :width])
            for plane in answer
            if plane is not None
        ]
        return Answer(*cropped)

    @property
    def _outputs(self) -> tuple[int, ...]:
        """The indices of the outputs that are read."""
        if self.confidence is None:
            return (self.output,)
        return (self.output, self.confidence)

    def _plane(self, output: Image) -> Image:
        if not 2 <= output.ndim <= 4 or any(size != 1 for size in output.shape[:-2]):
            message = f"{self.model}: returned shape {output.shape}; expected (1, 1, H, W), (1, H, W) or (H, W)"
            raise MatcherFailedError(message, "wrong-shape")
        return output.reshape(output.shape[-2:])

    @property
    def _name(self) -> str:
        return f"model {Path(self.model).name!r}"

    def _check(self, inputs: list[Any], outputs: list[Any]) -> None:
        """InputError unless the model has two images as inputs, and the selected output."""
        if len(inputs) != 2:
            remedy = ""
            if len(inputs) == 1:
                remedy = f"; a descriptor network is a cost: sgm:cost=onnx:{self.model}"
            raise InputError(
                f"{self.model}: has {counted(len(inputs), 'input')}; a stereo model has two, left and right{remedy}"
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
                    f"{self._name} has {counted(len(outputs), 'output')}; {option} is {index}"
                )

    def _tensor(self, image: Image, node: Any) -> Image:
        """The padded image for an input, (1, C, H, W). Integers are divided by their largest value; floats are 0..1."""
        levels = _unit_levels(image) * np.float32(self.scale)
        levels = levels.reshape(*image.shape[:2], -1)
        if node.shape[1] == 1:
            levels = grey(levels)[..., None]
        elif levels.shape[2] == 1:
            levels = np.repeat(levels, 3, axis=2)
        height, width = image.shape[:2]
        above = self._padded(height, node.shape[2]) - height
        right = self._padded(width, node.shape[3]) - width
        padded = np.pad(levels, ((above, 0), (0, right), (0, 0)), mode="edge")
        return np.ascontiguousarray(np.moveaxis(padded, 2, 0)[None])

    def _padded(self, size: int, fixed: Any) -> int:
        """The padded size of an image's side; `fixed`: the model's, an integer, or a name where it is free."""
        if not isinstance(fixed, int):
            return -(-size // self.multiple) * self.multiple
        if fixed < size:
            raise InputError(
                f"{self._name} takes images of up to {fixed} pixels a side; this one has {size}"
            )
        return fixed


def _unit_levels(image: Image) -> NDArray[np.float32]:
    """Integers divided by the largest value of their dtype; floats unchanged, which are 0..1."""
    largest = np.iinfo(image.dtype).max if image.dtype.kind == "u" else 1
    return image.astype(np.float32) / np.float32(largest)


def model_hashes(model: str) -> str:
    """The hashes of the model's file and of external data in `net.onnx.data` or `net.onnx_data`."""
    path = Path(model)
    return file_hashes([path, *path.parent.glob(f"{glob.escape(path.name)}[._]data*")])


def check_model(model: str) -> None:
    """FileError if there is no such file or it is not a network, MissingExtraError if onnxruntime is not installed."""
    import_extra("onnxruntime", "onnx")
    _Network.of(model)


@dataclass(frozen=True)
class _Network:
    """A loaded .onnx file; `name` is what messages call it."""

    name: str
    session: Any

    @classmethod
    def of(cls, model: str) -> "_Network":
        """The network of a file. It is loaded again when the file has changed."""
        try:
            written_ns = Path(model).stat().st_mtime_ns
        except OSError as problem:
            raise FileError(f"{model}: {problem.strerror}") from None
        return cls(f"model {Path(model).name!r}", _session(model, written_ns))

    def run(
        self, outputs: list[str] | None, tensors: dict[str, Any]
    ) -> list[NDArray[Any]]:
        """The outputs of these names, None for all. Raises MatcherFailedError if the network fails."""
        try:
            results = self.session.run(outputs, tensors)
        except Exception as problem:  # onnxruntime's errors have no common base class
            reason = _one_line(problem)
            raise MatcherFailedError(f"{self.name} failed: {reason}") from None
        return [np.asarray(result) for result in results]


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
    except Exception as problem:  # onnxruntime's errors have no common base class
        raise FileError(
            f"{model}: not an ONNX model that can be run: {_one_line(problem)}"
        ) from None


def _one_line(problem: Exception) -> str:
    return " ".join(str(problem).split())[:200]


def descriptors(model: str, image: Image) -> NDArray[np.float32]:
    """The descriptors (H, W, C) that a network computes for the pixels of an image (H, W).

    The network has one float32 input (1, 1, H, W), the grey levels from 0 to 1, and one output (1, C, H, W), whose
    descriptors should have unit length. Raises FileError and MissingExtraError as `check_model` does, InputError for
    another input, and MatcherFailedError if the network fails or returns another shape, NaN or infinity.
    """
    network = _Network.of(model)
    inputs = network.session.get_inputs()
    kinds = [(node.type, len(node.shape), node.shape[1:2]) for node in inputs]
    if kinds != [("tensor(float)", 4, [1])]:
        listed = ", ".join(f"{node.type} {node.shape}" for node in inputs)
        raise InputError(
            f"{model}: a descriptor network has one input, float (1, 1, H, W); this one has {listed}"
        )
    tensor = np.ascontiguousarray(_unit_levels(image)[None, None])
    output = network.run(None, {inputs[0].name: tensor})[0]
    if output.ndim != 4 or len(output) != 1 or output.shape[2:] != image.shape:
        wanted = f"(1, C, {image.shape[0]}, {image.shape[1]})"
        raise MatcherFailedError(
            f"{network.name} returned descriptors of shape {output.shape}; expected {wanted}"
        )
    if not np.isfinite(output).all():
        raise MatcherFailedError(
            f"{network.name} returned descriptors that are not finite"
        )
    return np.ascontiguousarray(np.moveaxis(output[0], 0, 2), np.float32)


def descriptor_costs(
    left: NDArray[np.float32],
    right: NDArray[np.float32],
    side: int,
    low: int,
    depth: int,
) -> Rows:
    """rows(start, stop): the costs (stop - start, W, depth), float64, of descriptors (H, W, C).

    The cost of a pixel is 1 - l . r, from 0 to 2 for descriptors of unit length; that of a window, the sum over its
    side^2 pixels. Candidate j has disparity low + j. Outside the image its edge pixels are repeated.
    """
    height, width, _ = left.shape
    radius = side // 2
    ours = np.clip(np.arange(-radius, width + radius), 0, width - 1)
    theirs = np.clip(
        np.arange(-radius - low - depth + 1, width + radius - low), 0, width - 1
    )

    def rows(start: int, stop: int) -> Volume:
        volume = np.zeros((stop - start, width, depth))
        # Each image row adds its sums along the row to the windows that contain it.
        for y in range(start - radius, stop + radius):
            inside = min(max(y, 0), height - 1)
            products = _products(left[inside, ours], right[inside, theirs], depth)
            first = max(y - radius - start, 0)
            last = max(y + radius + 1 - start, 0)
            volume[first:last] += side - _window_sums(products, side)
        return volume

    return rows


def _products(
    left: NDArray[np.float32], right: NDArray[np.float32], depth: int
) -> NDArray[np.float32]:
    """(W, depth): the products of the left descriptors (W, C) with those at right[u + depth - 1 - j], j < depth."""
    products = np.empty((len(left), depth), np.float32)
    for first in range(0, len(left), TILE):
        tile = left[first : first + TILE]
        count = len(tile)
        table = tile @ right[first : first + count + depth - 1].T
        # Row u of the table holds its candidate j in column u + depth - 1 - j: a diagonal band, read without a copy.
        row_step, column_step = table.strides
        band = np.lib.stride_tricks.as_strided(
            table[:, depth - 1 :],
            (count, depth),
            (row_step + column_step, -column_step),
            writeable=False,
        )
        products[first : first + count] = band
    return products


def _window_sums(line: NDArray[np.float32], side: int) -> NDArray[np.float64]:
    """The sums over `side` columns in a row, (W - side + 1, depth)."""
    total = line[: len(line) - side + 1].astype(np.float64)
    for shift in range(1, side):
        total += line[shift : len(total) + shift]
    return total
