"""Sequences of patterns that code the projector's columns or rows, and their decoding from images.

    Gray code      bit b of g(u) = u xor (u >> 1), each bit's pattern followed by its inverse; bit = image > inverse.
                   Between two pixel centres one bit changes; its difference, linear there, has the sub-pixel position
    phase shift    I_k(u) = (1 + cos(2 pi (u/period - k/steps))) / 2,  u = period/(2 pi) arg sum I_k exp(2 pi i k/steps)

A sequence is a tuple of codes: `GrayCode`, `PhaseShift`, and `Still` for one image that carries no code.

Sources: Inokuchi, Sato and Matsuda, Range imaging system for 3-D object recognition, ICPR 1984 (Gray code); Geng,
Structured-light 3D surface imaging: a tutorial, Advances in Optics and Photonics 3(2), 2011 (both).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.intrinsics import check_size
from twinlens.camera.patterns import (
    AXES,
    Pattern,
    checked_pattern,
    gray_code,
    gray_code_bits,
    phase_shift,
)
from twinlens.errors import (
    InputError,
    check_int,
    check_known,
    check_number,
    counted,
    format_value,
)
from twinlens.geometry import Float, float_array

_BRIGHT_PERCENTILE = 99


@dataclass(frozen=True)
class GrayCode:
    """Gray code of the columns (axis "u") or rows ("v") of a projector of width x height pixels."""

    width: int
    height: int
    axis: str = "u"

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        check_known("axis", self.axis, AXES)

    @property
    def count(self) -> int:
        """The number of positions that are coded."""
        return self.width if self.axis == "u" else self.height

    @property
    def bits(self) -> int:
        """The number of bits, >= 1."""
        return gray_code_bits(self.count)

    @property
    def num_patterns(self) -> int:
        """2 * bits."""
        return 2 * self.bits

    def pattern(self, frame: int) -> Pattern:
        """Pattern `frame` of `patterns`."""
        return gray_code(self.width, self.height, frame, self.axis)

    @property
    def patterns(self) -> list[Pattern]:
        """2 * bits patterns float32 (H, W): the highest bit first, each followed by its inverse."""
        return [self.pattern(frame) for frame in range(self.num_patterns)]

    def _decode(self, images: Float) -> tuple[Float, Float]:
        """Positions, +inf for a code that is not in use, and modulation (H, W)."""
        differences = images[0::2] - images[1::2]
        pixel = self._pixel(differences)
        contrasts = np.abs(differences)
        modulation = contrasts.max(axis=0)
        coded = (pixel < self.count) & (modulation > 0)
        # Light at the fraction x of the way from the middle of a pixel to its border: the bit that changes there has
        # the contrast M (1 - x), since the pattern is interpolated. So x at the right border less that at the left one
        # is (left - right) / M, and half of it is the distance from the middle in pixels.
        left = self._contrast_at(pixel, contrasts, modulation)
        right = self._contrast_at(pixel + 1, contrasts, modulation)
        step = 0.5 * (left - right) / np.where(coded, modulation, 1.0)
        return np.where(coded, pixel + step, np.inf), modulation

    def _pixel(self, differences: Float) -> NDArray[np.int64]:
        """The pixel whose code is seen, from the differences of each pattern and its inverse: b_i = g_i xor b_(i-1)."""
        pixel = np.zeros(differences.shape[1:], dtype=np.int64)
        bit = np.zeros_like(pixel)
        for difference in differences:
            bit = bit ^ (difference > 0)
            pixel = 2 * pixel + bit
        return pixel

    def _contrast_at(
        self, border: NDArray[np.int64], contrasts: Float, modulation: Float
    ) -> Float:
        """Contrast of the bit that changes between pixels border - 1 and border; the modulation at the ends."""
        inner = (border > 0) & (border < self.count)
        # The Gray codes of n - 1 and n differ in the bit whose place is that of the lowest 1 in n.
        lowest_set = np.where(inner, border & -border, 1)
        changing = np.log2(lowest_set).astype(np.int64)
        place = (self.bits - 1 - changing)[None]
        contrast = np.take_along_axis(contrasts, place, axis=0)[0]
        return np.where(inner, contrast, modulation)


@dataclass(frozen=True)
class PhaseShift:
    """Sinusoids along an axis of a projector of width x height pixels, each shifted by period / steps.

    period : pixels, > 2. A period shorter than the axis leaves the position modulo the period (`decode`'s `coarse`).
    steps : number of patterns, >= 3.
    """

    width: int
    height: int
    period: float
    steps: int = 4
    axis: str = "u"

    def __post_init__(self) -> None:
        check_size(self.width, self.height)
        check_known("axis", self.axis, AXES)
        check_number(
            "the period of a phase shift",
            self.period,
            "a number of pixels > 2",
            above=2,
        )
        check_int("the steps of a phase shift", self.steps, 3)
        object.__setattr__(self, "period", float(self.period))

    @property
    def count(self) -> int:
        """The number of positions along the axis."""
        return self.width if self.axis == "u" else self.height

    @property
    def num_patterns(self) -> int:
        """`steps`."""
        return self.steps

    def pattern(self, frame: int) -> Pattern:
        """Pattern `frame` of `patterns`."""
        return phase_shift(
            self.width, self.height, frame, self.period, self.steps, self.axis
        )

    @property
    def patterns(self) -> list[Pattern]:
        """`steps` patterns, float32 (H, W)."""
        return [self.pattern(frame) for frame in range(self.steps)]

    def _decode(self, images: Float) -> tuple[Float, Float]:
        """Positions in [-0.5, period - 0.5) and modulation (H, W)."""
        # Image k of N is I_k = A + M (1 + cos(phi - 2 pi k / N)) / 2 with phi = 2 pi position / period. Its first
        # harmonic over the shifts is sum_k I_k exp(2 pi i k / N) = (N M / 4) exp(i phi): the ambient light A and the
        # mean drop out. Source: Srinivasan, Liu and Halioua, Applied Optics 23(18), 1984.
        turns = np.exp(2j * np.pi * np.arange(self.steps) / self.steps)
        phasor = np.tensordot(turns, images, axes=1)
        position = np.angle(phasor) / (2 * np.pi) * self.period
        # Into [-0.5, period - 0.5), so that the first pixel is whole.
        position = (position + 0.5) % self.period - 0.5
        return position, np.abs(phasor) * (4 / self.steps)


@dataclass(frozen=True, eq=False)
class Still:
    """One image of a sequence that carries no code, such as a white one.

    image : float32 (H, W) in [0, 1].
    """

    image: Pattern

    def __post_init__(self) -> None:
        object.__setattr__(self, "image", checked_pattern(self.image))

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.image.shape[1])

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.image.shape[0])

    @property
    def num_patterns(self) -> int:
        """1."""
        return 1

    def pattern(self, frame: int) -> Pattern:
        """The image, for every `frame`."""
        return self.image


Code = GrayCode | PhaseShift | Still
"""A part of a sequence of patterns: `num_patterns` images, `pattern(frame)`."""


@dataclass(frozen=True, eq=False)
class Decoded:
    """Decoded positions of the pixels of a camera.

    position : float64 (H, W), projector pixels along the code's axis, pixel centres at integers; +inf where not valid.
    modulation : float64 (H, W), the difference of a fully lit and a dark projector pixel, in the units of the images.
    """

    position: NDArray[np.float64]
    modulation: NDArray[np.float64]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Where there is a position, bool (H, W)."""
        return np.isfinite(self.position)


def decode(
    images: Sequence[ArrayLike],
    code: GrayCode | PhaseShift,
    coarse: ArrayLike | None = None,
    least: float = 0.05,
) -> Decoded:
    """The projector position that each pixel of a camera sees, from one image per pattern of `code`.

    images : (H, W) or (H, W, 3), whose channels are averaged. Linear in light, as those of `render`: sRGB-encoded ones
        bias a phase shift.
    coarse : positions (H, W) known to better than half a period, such as those of a Gray code; unwraps a phase shift.
        Pixels where it is not finite get +inf.
    least : the modulation that a pixel needs, as a fraction of that of the image's bright pixels (99th percentile).

    Raises InputError for another number of images than patterns, images that differ in shape or are not finite, and
    `coarse` with a Gray code.
    """
    if not isinstance(code, GrayCode | PhaseShift):
        raise InputError(
            f"decode needs a GrayCode or a PhaseShift, got {format_value(code)}"
        )
    check_number("least", least, "a fraction from 0 to 1", least=0, most=1)
    if coarse is not None and isinstance(code, GrayCode):
        raise InputError(
            "coarse positions unwrap a phase shift; a Gray code has none to unwrap: leave them out"
        )
    position, modulation = code._decode(_grey_stack(images, code))
    if coarse is not None and isinstance(code, PhaseShift):
        position = _unwrapped(position, coarse, code.period)
    bright = np.percentile(modulation, _BRIGHT_PERCENTILE)
    position = np.where(modulation > least * bright, position, np.inf)
    return Decoded(position, modulation)


def decode_sequence(
    images: Sequence[ArrayLike], sequence: Sequence[Code], least: float = 0.05
) -> dict[str, Decoded]:
    """The positions that each pixel of a camera sees, along each axis that a sequence codes: "u", "v" or both.

    The Gray code of an axis comes first, then its phase shifts from the longest period to the shortest; the positions
    of each code unwrap the next one. Without a Gray code, the longest period must span the axis. The modulation is that
    of the last code.

    images : one for each pattern of the sequence, as for `decode`, which has `least`.

    Raises InputError as `decode` does, for a sequence without a code, and for a phase shift that nothing unwraps.
    """
    expected = sum(code.num_patterns for code in sequence)
    if len(images) != expected:
        raise InputError(
            f"this sequence has {expected} patterns, got {len(images)} images"
        )
    by_axis: dict[str, list[tuple[GrayCode | PhaseShift, Sequence[ArrayLike]]]] = {}
    first = 0
    for code in sequence:
        of_code = images[first : first + code.num_patterns]
        first += code.num_patterns
        if not isinstance(code, Still):
            by_axis.setdefault(code.axis, []).append((code, of_code))
    if not by_axis:
        raise InputError(
            "a sequence to decode needs a Gray code or a phase shift, got patterns without a code only"
        )
    return {
        axis: _decoded_axis(codes, least) for axis, codes in sorted(by_axis.items())
    }


def _decoded_axis(
    codes: Sequence[tuple[GrayCode | PhaseShift, Sequence[ArrayLike]]], least: float
) -> Decoded:
    """The positions along one axis, by codes from coarse to fine."""

    def fineness(part: tuple[GrayCode | PhaseShift, Sequence[ArrayLike]]) -> float:
        code = part[0]
        return -np.inf if isinstance(code, GrayCode) else -code.period

    coarse = None
    for code, images in sorted(codes, key=fineness):
        if isinstance(code, GrayCode):
            decoded = decode(images, code, least=least)
        elif coarse is None and code.period < code.count:
            raise InputError(
                f"a phase shift of {code.period:g} pixels repeats across {code.count}: add a Gray code of the axis"
                f" {code.axis!r}, or a phase shift with a period of {code.count} or more"
            )
        else:
            decoded = decode(images, code, coarse, least)
        coarse = decoded.position
    return decoded


def _grey_stack(images: Sequence[ArrayLike], code: GrayCode | PhaseShift) -> Float:
    """The images as grey ones, (N, H, W), N patterns of the code."""
    if not isinstance(images, Sequence | np.ndarray):
        raise InputError(f"decode needs a list of images, got {format_value(images)}")
    arrays = [float_array(f"images[{i}]", image) for i, image in enumerate(images)]
    expected = 2 * code.bits if isinstance(code, GrayCode) else code.steps
    if len(arrays) != expected:
        raise InputError(
            f"this code has {counted(expected, 'pattern')}, got {counted(len(arrays), 'image')}"
        )
    shapes = sorted({array.shape for array in arrays})
    if len(shapes) != 1 or arrays[0].ndim not in (2, 3) or not arrays[0].size:
        raise InputError(
            f"decode needs images (H, W) or (H, W, 3) of one shape, got {' and '.join(map(str, shapes))}"
        )
    stack = np.stack(
        [array if array.ndim == 2 else array.mean(axis=2) for array in arrays]
    )
    if not np.isfinite(stack).all():
        raise InputError("decode needs finite images")
    return stack


def _unwrapped(position: Float, coarse: ArrayLike, period: float) -> Float:
    """Positions modulo `period`, moved by whole periods to the coarse ones; +inf where these are not finite."""
    rough = float_array("coarse positions", coarse)
    if rough.shape != position.shape:
        raise InputError(
            f"coarse positions must have the shape {position.shape} of the images, got {rough.shape}"
        )
    finite = np.isfinite(rough)
    periods = np.round((np.where(finite, rough, 0.0) - position) / period)
    return np.where(finite, position + period * periods, np.inf)
