"""Random scenes in five families; a scene is a pure function of its family, its seed and its settings."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from twinlens.errors import (
    InputError,
    check_int,
    check_known,
    check_number,
    format_value,
)
from twinlens.families import cards, flying, room, street, tabletop
from twinlens.families.assets import Assets as Assets
from twinlens.families.composition import Composition, Family
from twinlens.scenes.scene import Scene

FAMILIES: dict[str, Family] = {
    "tabletop": Family(
        "bodies at rest on a table",
        (4, 30),
        tabletop.compose,
        1.8,
        10.0,
        tabletop.NAMES,
        True,
    ),
    "flying": Family(
        "things in the air, at disparities spread evenly",
        (6, 34),
        flying.compose,
        1.3,
        10.0,
        flying.NAMES,
    ),
    "room": Family(
        "a furnished room",
        (6, 48),
        room.compose,
        2.5,
        12.0,
        room.NAMES,
        True,
    ),
    "cards": Family(
        "test charts, steps and waves at set distances and slants",
        (4, 16),
        cards.compose,
        1.8,
        20.0,
        cards.NAMES,
    ),
    "street": Family(
        "a street or a path by day or night, with houses, trees and cars",
        (4, 14),
        street.compose,
        2.5,
        150.0,
        street.NAMES,
        True,
    ),
}
"""Every family by its name."""

WIDEST_FOV_DEG = 65.0
"""The widest view, horizontally, that scenes are composed for; wider cameras see the ends of rooms and tables."""
ALL = "all"
"""The name that stands for all families in a list of them."""
_MAX_OBJECTS = 200


def family_names(names: Iterable[str]) -> list[str]:
    """A list of families with the name "all" replaced by all of `FAMILIES`, in their order.

    >>> family_names(["all"]) == list(FAMILIES)
    True
    >>> family_names(["room"])
    ['room']
    """
    listed: list[str] = []
    for name in names:
        listed += FAMILIES if name == ALL else [name]
    return listed


def random_scene(
    family: str,
    seed: int | np.random.SeedSequence,
    *,
    assets: Assets | None = None,
    depth_range: tuple[float, float] | None = None,
    object_count: int | tuple[int, int] | None = None,
    aspect: float = 4 / 3,
    width: int = 640,
    own_lights: bool = True,
    plain_surfaces: bool = True,
) -> Scene:
    """A random scene of a family.

    Parameters
    ----------
    family : str
        One of `FAMILIES`.
    seed : int or numpy.random.SeedSequence
        >= 0. Determines everything random in the scene.
    assets : Assets, optional
        The user's own meshes, textures and environment maps, used in addition to those that twinlens makes.
    depth_range : (near, far), optional
        The range of depths in the picture, metres; by default the family draws it. The scene's `depth_range` is the
        range measured in the composed scene.
    object_count : int or (min, max), optional
        How many objects, without walls, floors, furniture and lamps. Fewer if no more fit. 0 is allowed in tabletop,
        room and street.
    aspect : float
        Width over height of the picture that the scene is composed for, 0.2 to 5.
    width : int
        Width of that picture in pixels, >= 16. No visible texture has detail finer than two pixels.
    own_lights : bool
        False leaves out the lights outside the picture, and the wall behind the camera, for a scene that is lit by a
        sky (`Scene.lit_by`). Lamps and windows in the picture remain.
    plain_surfaces : bool
        False gives walls, table tops and floors that would be plain a pattern; nothing else changes.

    Returns
    -------
    Scene
        Named ``family-seed``, with a pose, a field of view and a baseline that suit it.

    Raises
    ------
    InputError
        For an unknown family, and for a setting out of its range.
    """
    check_known("scene family", family, FAMILIES)
    chosen = FAMILIES[family]
    root, label = _root_and_label(seed)
    counts = _range_of_counts(chosen, object_count)
    if depth_range is not None:
        _check_pair("depth_range", depth_range)
    check_view(family, aspect, width, depth_range, "depth_range")
    keeps_scale = assets is not None and assets.keep_scale
    if depth_range is not None and keeps_scale:
        raise InputError(
            "depth_range scales the whole scene; it cannot be used with keep_scale"
        )
    depths = None
    if depth_range is not None:
        near, far = depth_range
        depths = float(near), float(far)
    scene = Composition(
        name=f"{family}-{label}",
        root=root,
        assets=assets or Assets(),
        depth_range=depths,
        counts=counts,
        aspect=float(aspect),
        width_px=int(width),
        own_lights=own_lights,
        plain_surfaces=plain_surfaces,
    )
    chosen.compose(scene)
    return scene.scene(chosen.about)


def _root_and_label(
    seed: int | np.random.SeedSequence,
) -> tuple[np.random.SeedSequence, str]:
    """The root of all random streams of a scene, and the seed's text in its name."""
    if isinstance(seed, np.random.SeedSequence):
        return seed, f"{int(seed.generate_state(1)[0]):08x}"
    check_int("seed", seed, 0)
    return np.random.SeedSequence(int(seed)), str(seed)


def _range_of_counts(family: Family, object_count: Any) -> tuple[int, int]:
    """The least and the largest number of objects: those of the family unless the user gave one or two."""
    counts = family.object_count if object_count is None else object_count
    if np.ndim(counts) == 0:
        counts = counts, counts
    _check_pair("object_count", counts)
    least, most = counts
    check_int("object_count", least, 0 if family.may_be_empty else 1, _MAX_OBJECTS)
    check_int("object_count", most, least, _MAX_OBJECTS)
    return least, most


def _check_pair(name: str, pair: Any) -> None:
    if np.shape(pair) != (2,):
        raise InputError(f"{name} must have two values, got {format_value(pair)}")


def check_view(
    family: str, aspect: float, width: int, depths: tuple[float, float] | None, key: str
) -> None:
    """Raise InputError unless a family has scenes for these settings of `random_scene`; `key` names the depths."""
    check_number("width", width, "a number of pixels >= 16", least=16)
    check_number("aspect (width / height)", aspect, "from 0.2 to 5", least=0.2, most=5)
    if depths is not None:
        (near, far), ratio = depths, FAMILIES[family].least_ratio
        check_number(
            key, near, "two positive numbers of metres, (near, far)", above=0.0
        )
        allowed = f"(near, far) with far >= {ratio:g} near in {family} scenes"
        check_number(key, far, allowed, least=ratio * near)
