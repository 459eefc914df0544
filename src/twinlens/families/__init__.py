"""Random scenes: families of them, each scene a pure function of its family, its seed and what is asked of it.

    scene = random_scene("tabletop", seed=7)
    scene = random_scene("room", seed=3, depth_range=(1.0, 6.0), object_count=(10, 20))

The same seed gives the same scene on every machine. A user's own meshes, textures and environment maps are drawn from
as well, when `Assets.from_folders` names where they lie.
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

_MOST_OBJECTS = 200


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
    """A scene of a family, made from a seed.

    Parameters
    ----------
    family : str
        One of `FAMILIES`.
    seed : int or numpy.random.SeedSequence
        >= 0. All that is random in the scene derives from it.
    assets : Assets, optional
        The user's own files to draw from beside what twinlens makes.
    depth_range : (near, far), optional
        Metres between which the camera sees things; else the family's own choice. The scene's `depth_range` tells
        what is really seen, nearest and farthest.
    object_count : int or (least, most), optional
        How many objects are wanted, walls, floors and lamps not counted; fewer where no more fit.
    aspect : float
        Width over height of the picture the scene is composed for.
    width : int
        Pixels across of that picture: no texture is finer than two of them where it is seen.

    Returns
    -------
    Scene
        Named ``family-seed``, with a pose, a field of view and a baseline that suit it.

    Raises InputError for an unknown family or what cannot be asked of it.
    """
    if family not in FAMILIES:
        raise unknown("scene family", str(family), FAMILIES)
    chosen = FAMILIES[family]
    check_number("aspect", aspect, "a width over height of 0.2 to 5", least=0.2)
    check_number("width", width, "a number of pixels >= 16", least=16)
    if aspect > 5:
        raise InputError(f"aspect must be a width over height of 0.2 to 5, got {aspect:g}")
    root = _root(seed)
    wanted = _count_range(chosen if object_count is None else object_count)
    request = Request(
        name=f"{family}-{_label(seed)}",
        root=root,
        assets=assets or Assets(),
        depth_range=_depths(family, chosen, depth_range),
        count=0,
        aspect=float(aspect),
        width_px=int(width),
    )
    count = int(request.rng("count").integers(wanted[0], wanted[1] + 1))
    return chosen.compose(request.counting(count))


def _root(seed: Any) -> np.random.SeedSequence:
    if isinstance(seed, np.random.SeedSequence):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)) or seed < 0:
        raise InputError(f"seed must be a whole number >= 0 or a SeedSequence, got {format_value(seed)}")
    return np.random.SeedSequence(int(seed))


def _label(seed: int | np.random.SeedSequence) -> str:
    """The number itself, or eight digits that stand for a sequence."""
    if isinstance(seed, np.random.SeedSequence):
        return f"{int(seed.generate_state(1)[0]):08x}"
    return str(seed)


def _count_range(wanted: Any) -> tuple[int, int]:
    if isinstance(wanted, Family):
        return wanted.object_count
    numbers = tuple(wanted) if isinstance(wanted, (tuple, list)) else (wanted, wanted)
    if len(numbers) != 2:
        raise InputError(f"object_count must be a number or two, (least, most), got {format_value(wanted)}")
    least, most = numbers
    for number in numbers:
        if isinstance(number, bool) or not isinstance(number, (int, np.integer)) or not 1 <= number <= _MOST_OBJECTS:
            raise InputError(
                f"object_count must be 1 to {_MOST_OBJECTS}, or two such numbers, got {format_value(wanted)}"
            )
    if least > most:
        raise InputError(f"object_count must be (least, most), got {format_value(wanted)}")
    return int(least), int(most)


def _depths(name: str, family: Family, wanted: Any) -> tuple[float, float] | None:
    if wanted is None:
        return None
    try:
        near, far = wanted
    except (TypeError, ValueError):
        near = far = None
    for number in (near, far):
        check_number("depth_range", number, "two positive numbers of metres, near and far", above=0.0)
    if not far >= family.least_ratio * near:
        raise InputError(
            f"depth_range of a {name} scene needs far >= {family.least_ratio:g} near, got ({near:g}, {far:g})"
        )
    return float(near), float(far)
