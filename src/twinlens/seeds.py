"""Independent random streams: every random quantity has its own stream, named by a seed and a key."""

import zlib

import numpy as np


def seed_sequence(seed: int, *key: int | str) -> np.random.SeedSequence:
    """The seed sequence of one purpose: independent between seeds and between keys.

    Words of the key are hashed with CRC-32, so that a stream is named by what it is used for.

    >>> seed_sequence(3, "noise", 0).spawn_key
    (4255749673, 0)
    """
    words = tuple(
        zlib.crc32(part.encode()) if isinstance(part, str) else part for part in key
    )
    return np.random.SeedSequence(seed, spawn_key=words)


def generator(seed: int, *key: int | str) -> np.random.Generator:
    """A random generator seeded by `seed_sequence`."""
    return np.random.default_rng(seed_sequence(seed, *key))


def derived_seed(seed: int, *key: int | str) -> int:
    """A seed of 32 bits, for programs that take one integer; drawn from `seed_sequence`."""
    return int(seed_sequence(seed, *key).generate_state(1)[0])
