"""Random scenes in four families; a scene is a pure function of its family, its seed and its settings.

    scene = random_scene("tabletop", seed=7)
    scene = random_scene("room", seed=3, depth_range=(1.0, 6.0), object_count=(10, 20))

The same seed gives the same scene. `Assets.from_folders` adds a user's own meshes, textures and environment maps to
those that twinlens makes.
"""

from typing import Any

import numpy as np

from twinlens.errors import InputError, check_number, format_value, unknown
from twinlens.families import cards, flying, room, tabletop
from twinlens.families.assets import Assets
from twinlens.families.family import Family, Request
from twinlens.scenes.scene import Scene

__all__ = ["FAMILIES", "Assets", "Family", "random_scene"]

FAMILIES: dict[str, Family] = {
    "tabletop": tabletop.FAMILY,
    "flying": flying.FAMILY,
    "room": room.FAMILY,
    "cards": cards.FAMILY,
}
"""Every family by its name."""

_MAX_OBJECTS = 200


def random_scene(
    family: str,
    seed: int | np.random.SeedSequence,
    *,
    assets: Assets | None = None,
    depth_range: tuple[float, float] | None = None,
    object_count: int | tuple[int, int] | None = None,
    aspect: float = 4 / 3,
    width: int = 640,
) -> Scene:
    """A random scene of a family.

    Parameters
    ----------
    family : str
        One of `FAMILIES`.
    seed : int or numpy.random.SeedSequence
        >= 0. Determines everything random in the scene.
    assets : Assets, optional
        The user's own files, used in addition to what twinlens makes.
    depth_range : (near, far), optional
        The range of depths in the picture, metres; by default the family draws it. The scene's `depth_range` is the
        range measured in the composed scene.
    object_count : int or (min, max), optional
        How many objects, without walls, floors, furniture and lamps. Fewer where no more fit.
    aspect : float
        Width over height of the picture that the scene is composed for, 0.2 to 5.
    width : int
        Width of that picture in pixels, >= 16. No visible texture has detail finer than two pixels.

    Returns
    -------
    Scene
        Named ``family-seed``, with a pose, a field of view and a baseline that suit it.

    Raises
    ------
    InputError
        For an unknown family, and for a setting out of its range.
    """
    if family not in FAMILIES:
        raise unknown("scene family", str(family), FAMILIES)
    chosen = FAMILIES[family]
    check_number("aspect", aspect, "a width over height of 0.2 to 5", least=0.2, most=5)
    check_number("width", width, "a number of pixels >= 16", least=16)
    root, label = _seed_sequence(seed)
    low, high = chosen.object_count if object_count is None else _count_range(object_count)
    depths = None if depth_range is None else _depths(family, depth_range)

    def request(count: int) -> Request:
        return Request(f"{family}-{label}", root, assets or Assets(), depths, count, float(aspect), int(width))

    return chosen.compose(request(int(request(0).rng("count").integers(low, high + 1))))


def _seed_sequence(seed: Any) -> tuple[np.random.SeedSequence, str]:
    """The seed as a sequence, and its name: the number, or eight hexadecimal digits of a sequence."""
    if isinstance(seed, np.random.SeedSequence):
        return seed, f"{int(seed.generate_state(1)[0]):08x}"
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number >= 0 or a SeedSequence, got {format_value(seed)}")
    return np.random.SeedSequence(int(seed)), str(seed)


def _count_range(wanted: Any) -> tuple[int, int]:
    numbers = tuple(wanted) if isinstance(wanted, (tuple, list)) else (wanted, wanted)
    whole = all(isinstance(number, (int, np.integer)) and not isinstance(number, bool) for number in numbers)
    if len(numbers) != 2 or not whole or not 1 <= numbers[0] <= numbers[1] <= _MAX_OBJECTS:
        allowed = f"a whole number of 1 to {_MAX_OBJECTS}, or (min, max) of two"
        raise InputError(f"object_count must be {allowed}, got {format_value(wanted)}")
    return int(numbers[0]), int(numbers[1])


def _depths(family: str, wanted: Any) -> tuple[float, float]:
    try:
        near, far = wanted
    except (TypeError, ValueError):
        near = far = None
    for number in (near, far):
        check_number("depth_range", number, "two positive numbers of metres, (near, far)", above=0.0)
    least = FAMILIES[family].least_ratio
    if not far >= least * near:
        raise InputError(f"depth_range of a {family} scene needs far >= {least:g} near, got ({near:g}, {far:g})")
    return float(near), float(far)
