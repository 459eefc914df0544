"""A sampler whose errors in neighbouring pixels cancel: one scrambled Sobol sequence over all pixels of an image.

Pixels in Morton order take consecutive points of the sequence. So the points of a pixel fill the unit square evenly,
and so do those of 2x2, 4x4, ... pixels together (most evenly where the samples per pixel are a power of two). Less
error is left at low frequencies, which a denoiser keeps (Ahmed and Wonka, Screen-space blue-noise diffusion of Monte
Carlo sampling error via hierarchical ordering of pixels, 2020).

A path draws numbers and pairs of numbers. All take the first dimension or the first two of the sequence, but each with
the points in another order and with another Owen scrambling, both by a hash (Burley, Practical hash-based Owen
scrambling, 2020). In this code, the bits of places in the sequence and of coordinates are reversed, least significant
first, because the hash of `_scrambled` lets bits depend on those below them.

Importing this module sets up the backend.
"""

from typing import Any

from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

_KEYS_PER_NUMBER = 2  # calls of the TEA hash
_LAINE_KARRAS = (0x6C50B47C, 0xB82F1E52, 0xC7AFE638, 0x8D22F6E6)  # Burley's factors


class _Constant:
    """Hides a variable from Dr.Jit, which records a loop a second time to leave out variables that do not change."""

    def __init__(self, value: Any) -> None:
        self.value = value


class SobolSampler(mi.Sampler):  # type: ignore[misc, name-defined]
    """Numbers for `count` rays per pixel of a film `width` pixels wide, numbered pixel by pixel.

    All rays of an image are of one wavefront. Points may repeat in images that are more than 250 times as wide as high,
    or as high as wide.

    place : of each ray in the sequence, bits reversed.
    number : of the next number of a path.
    """

    def __init__(self, count: int, width: int) -> None:
        super().__init__(mi.Properties())
        self.set_sample_count(count)
        self.width = _Constant(dr.opaque(mi.UInt32, width))
        self.place = _Constant(dr.zeros(mi.UInt32))
        self.key = _Constant(dr.zeros(mi.UInt32))
        self.number = dr.zeros(mi.UInt32)

    def clone(self) -> "SobolSampler":
        return self

    fork = clone

    def advance(self) -> None:
        """Nothing is left to draw after the only wavefront."""

    def seed(self, seed: Any, wavefront_size: int = 0xFFFFFFFF) -> None:
        count = dr.opaque(mi.UInt32, self.sample_count())
        ray = dr.arange(mi.UInt32, wavefront_size)
        pixel = ray // count
        row = pixel // self.width.value
        self.seed_at(pixel - row * self.width.value, row, ray - pixel * count, seed)

    def seed_at(self, column: Any, row: Any, sample: Any, seed: Any) -> None:
        """Seed for rays that are this `sample` of the pixel in this `column` and `row`."""
        # Bits of the column and of the row alternate in the Morton number. So pixels of a block of 2^k x 2^k have
        # consecutive numbers, and their samples are consecutive points of the sequence.
        count = dr.opaque(mi.UInt32, self.sample_count())
        morton = _spread(column) | (_spread(row) << 1)
        place = dr.brev(morton * count + sample)
        key = dr.opaque(mi.UInt32, seed) if isinstance(seed, int) else mi.UInt32(seed)
        self.number = dr.zeros(mi.UInt32, dr.width(sample))
        dr.make_opaque(place, key, self.number)
        self.place, self.key = _Constant(place), _Constant(key)

    def next_1d(self, active: Any = True) -> Any:
        order, for_x, _ = self._keys()
        # A place is the reversed bits of its own first Sobol coordinate.
        place = dr.brev(_scrambled(self.place.value, order))
        x = _scrambled(place, for_x)
        return _unit(dr.brev(x))

    def next_2d(self, active: Any = True) -> Any:
        # Shuffling the sequence is Owen scrambling of the place itself: blocks of 2^k points stay together.
        order, for_x, for_y = self._keys()
        place = dr.brev(_scrambled(self.place.value, order))
        x = _scrambled(place, for_x)
        y = _scrambled(_second_dimension(place), for_y)
        return mi.Point2f(_unit(dr.brev(x)), _unit(dr.brev(y)))

    def _keys(self) -> tuple[Any, Any, Any]:
        """Keys of the next number: of the order of points, and of the scrambling of x and y."""
        count = _KEYS_PER_NUMBER * self.number
        order, for_x = mi.sample_tea_32(self.key.value, count)
        for_y, _ = mi.sample_tea_32(self.key.value, count + 1)
        self.number += 1
        return order, for_x, for_y

    def to_string(self) -> str:
        return "SobolSampler[]"


def _unit(bits: Any) -> Any:
    """The number in [0, 1) of the highest 24 bits, as many as float32 has."""
    return mi.Float(bits >> 8) * 2.0**-24


def _scrambled(bits: Any, key: Any) -> Any:
    """Each bit flipped or not, depending on the key and on the bits below it: Owen scrambling of reversed bits.

    Source: Laine and Karras, Stratified sampling for stochastic transparency, 2011, with the factors of Burley.
    """
    bits = bits + key
    for factor in _LAINE_KARRAS:
        bits = bits ^ (bits * factor)
    return bits


def _second_dimension(place: Any) -> Any:
    """The reversed bits of the second Sobol coordinate of `place`.

    Bit i of it is the sum, modulo 2, of the bits j >= i of the place that have an odd binomial coefficient (j over i).
    Five steps for bits in blocks of 32, 16, ... multiply by this matrix: the Sierpinski triangle is self-similar.
    """
    bits = place ^ (place >> 16)
    for shift, upper in (
        (8, 0xFF00FF00),
        (4, 0xF0F0F0F0),
        (2, 0xCCCCCCCC),
        (1, 0xAAAAAAAA),
    ):
        bits = bits ^ ((bits & upper) >> shift)
    return bits


def _spread(bits: Any) -> Any:
    """The lowest 16 bits, with a 0 before each."""
    for shift, kept in (
        (8, 0x00FF00FF),
        (4, 0x0F0F0F0F),
        (2, 0x33333333),
        (1, 0x55555555),
    ):
        bits = (bits | (bits << shift)) & kept
    return bits
