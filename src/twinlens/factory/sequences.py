"""Frames of a sequence whose light follows from that of earlier frames.

The light of a projector is linear in its pattern, and all frames have the same light paths: with A that of everything
else and L(p) that of a pattern, a frame has I(p) = A + L(p). Of complementary patterns, p + q = 1, the sum I(p) + I(q)
is that of every such pair. Once there is a pair a, b, the inverse of an earlier frame c is not rendered:

    I(1 - c) = I(a) + I(b) - I(c)

so that a Gray code of n bits takes n + 1 images in place of 2 n.
"""

from collections.abc import Sequence

import numpy as np

from twinlens.camera import Rig

_ROUNDING = 1e-6


def frame_sums(rigs: Sequence[Rig]) -> list[tuple[int, int, int] | None]:
    """For each frame, with the patterns of its rig, the earlier frames (a, b, c) of which it is a + b - c; or None."""
    sums: list[tuple[int, int, int] | None] = []
    pair = None
    for number, rig in enumerate(rigs):
        inverse = _inverse_of(rig, rigs[:number])
        if inverse is not None and pair is not None:
            sums.append((*pair, inverse))
            continue
        sums.append(None)
        if inverse is not None:
            pair = (inverse, number)
    return sums


def _inverse_of(rig: Rig, earlier: Sequence[Rig]) -> int | None:
    """The first of the earlier frames whose patterns are the complements of those of `rig`; None if there is none."""
    for number, previous in enumerate(earlier):
        pairs = zip(rig.projectors, previous.projectors, strict=True)
        if all(
            np.allclose(a.pattern + b.pattern, 1.0, rtol=0, atol=_ROUNDING)
            for a, b in pairs
            if a is not b
        ):
            return number
    return None
