"""Samplers of light paths by name, and the passes in which an image is rendered with them."""

import functools
from collections.abc import Iterator
from typing import Any, Literal, get_args

import numpy as np

from twinlens.camera import Camera
from twinlens.rendering.backends import mitsuba

Pass = tuple[str, int, int]
"""Sampler, samples per pixel, seed."""

Sampler = Literal[
    "multijitter", "sobol", "independent", "stratified", "orthogonal", "ldsampler"
]
"""Mitsuba's, and `sobol`, which is ours."""

SAMPLERS: tuple[str, ...] = get_args(Sampler)
PLAIN_SAMPLER: Sampler = "multijitter"
"""Of images that are not denoised, of guides, and of lenses that share paths."""

RAYS_PER_PASS = 1 << 23


def default_sampler(denoise: bool) -> str:
    """The sampler of images that are denoised, or not.

    The errors of `sobol` are of higher spatial frequencies, which denoisers remove.
    """
    return "sobol" if denoise else PLAIN_SAMPLER


def load_sampler(kind: str, count: int, width: int) -> Any:
    """The sampler of a film `width` pixels wide, with `count` samples per pixel."""
    if kind == "sobol":
        from twinlens.rendering.sobol import SobolSampler  # sets up the backend

        return SobolSampler(count, width)
    return mitsuba().load_dict({"type": kind, "sample_count": count})


@functools.cache
def sampler_supports(kind: str, count: int) -> bool:
    """Whether a sampler supports `count` samples per pixel without rounding."""
    return bool(load_sampler(kind, count, 1).sample_count() == count)


def passes_of(
    camera: Camera, spp: int, seeds: np.random.SeedSequence, sampler: str
) -> Iterator[Pass]:
    """(sampler, samples per pixel, seed) of each pass; `spp` samples in total, bounded in memory.

    Mitsuba's samplers round sample counts, so each of their passes has a power of two that its sampler does not round.
    The rest is drawn independently. `sobol` takes any number in one pass if memory permits.
    """
    largest = max(1, RAYS_PER_PASS // (camera.width * camera.height))
    remaining = spp
    while remaining:
        sizes = [
            1 << power
            for power in reversed(range(min(remaining, largest).bit_length()))
        ]
        if sampler == "sobol" and remaining <= largest:
            sizes = [remaining]
        count = next(
            (count for count in sizes if sampler_supports(sampler, count)), None
        )
        kind, size = (
            ("independent", min(remaining, largest))
            if count is None
            else (sampler, count)
        )
        yield kind, size, int(seeds.spawn(1)[0].generate_state(1)[0])
        remaining -= size
