"""The values of sample i, which depend on the recipe, its seed, and i only.

Random values come from streams named by seed, index, attempt and key path. Lists of scenes without weights, and sweeps,
are indexed in mixed radix and make a full factorial: the scene changes fastest, then the first sweep in the order of
`DRAWN` and of the recipe's own keys. After the last combination the first one follows, with other random values.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from twinlens.errors import check_int
from twinlens.factory.draws import Leaf, leaves, resolve
from twinlens.factory.recipe import Recipe
from twinlens.seeds import generator

_SEED_BITS = 53  # exact in JSON


@dataclass(frozen=True)
class SampleSpec:
    """Everything needed to make one sample, as plain values; ``dataclasses.asdict(spec)`` is in its sample.json.

    index, attempt : sample and draw; earlier draws were rejected.
    name : of the folder.
    split : train, ..., or None.
    seed : of everything random in the sample.
    kind, scene : "scene" and a name or file, or "family" and its name.
    drawn : the recipe's drawn keys, with values in place of distributions.
    ndisp : bound of the disparities, or None.
    keep : optional outputs ("models", "radiance").
    """

    index: int
    attempt: int
    name: str
    split: str | None
    seed: int
    kind: str
    scene: str
    drawn: Mapping[str, Any]
    ndisp: int | None = None
    keep: tuple[str, ...] = ()


def plan(recipe: Recipe, index: int, attempt: int = 0) -> SampleSpec:
    """The spec of sample `index` of `recipe`, in its `attempt`-th draw.

    >>> from twinlens.factory.recipe import recipe_from_table
    >>> recipe = recipe_from_table({"seed": 3, "count": 2, "scenes": ["staircase"], "spp": {"sweep": [16, 32]}})
    >>> [plan(recipe, i).drawn["spp"] for i in range(4)]
    [16, 32, 16, 32]

    Raises InputError for a negative index.
    """
    check_int("the index of a sample", index, 0)
    digits = _digits(recipe, index)
    if recipe.weights:
        rng = generator(recipe.seed, "subject", index, attempt)
        chosen = int(rng.choice(len(recipe.names), p=recipe.weights))
    else:
        chosen = digits[_SUBJECT]

    def choose(leaf: Leaf, *copy: int) -> Any:
        if leaf.kind == "sweep":
            return leaf.distribution.values[digits[leaf.key]]
        if leaf.kind == "per_scene":
            return leaf.distribution.values[chosen]
        # A stream for each key, so that a new distribution does not change the others.
        rng = generator(recipe.seed, "draw", index, attempt, leaf.key, *copy)
        return leaf.distribution.draw(rng)

    rng = generator(recipe.seed, "sample", index, attempt)
    seed = int(rng.integers(1 << _SEED_BITS))
    once = resolve(recipe.drawn, choose)
    return SampleSpec(
        index=index,
        attempt=attempt,
        name=sample_name(index),
        split=split_of(recipe, index),
        seed=seed,
        kind=recipe.kind,
        scene=recipe.names[chosen],
        drawn=_with_copies(recipe, once, choose, (index, attempt)),
        ndisp=recipe.ndisp,
        keep=recipe.keep,
    )


_SUBJECT = ""
"""The digit of the scene or family in `_digits`; no key of a recipe is empty."""


def _digits(recipe: Recipe, index: int) -> dict[str, int]:
    """The positions in the list of scenes and in each sweep, by key, of a sample.

    They are the digits of the index in a mixed base, so that samples count through all combinations. The scene changes
    fastest. With weights it is drawn, and has no digit.
    """
    sizes = {} if recipe.weights else {_SUBJECT: len(recipe.names)}
    for leaf in leaves(recipe.drawn):
        if leaf.kind == "sweep":
            sizes[leaf.key] = len(leaf.distribution.values)
    digits, rest = {}, index
    for key, size in sizes.items():
        rest, digits[key] = divmod(rest, size)
    return digits


def _with_copies(
    recipe: Recipe,
    drawn: dict[str, Any],
    choose: Callable[..., Any],
    draw: tuple[int, int],
) -> dict[str, Any]:
    """The drawn values with a list of tables for each of the recipe's objects, one for each copy, and its mesh."""
    scene = drawn.get("scene", {})
    if not scene.get("objects"):
        return drawn
    # Where the whole table `scene` is a distribution, its objects have constants only, which are the drawn values.
    written: Any = recipe.drawn["scene"]
    written = written.get("objects") if isinstance(written, dict) else None
    copies = {}
    for name, table in scene["objects"].items():
        tree = written[name] if isinstance(written, dict) else table
        several = {"count": table["count"]} if "count" in table else {}
        drawn_tables = (
            resolve(tree, partial(_of_copy, choose, i))
            for i in range(table.get("count", 1))
        )
        copies[name] = [copy | several for copy in drawn_tables]
        for i, copy in enumerate(copies[name]):
            if "folder" in copy:
                meshes = recipe.sources.meshes(copy["folder"])
                copy["file"] = meshes[
                    generator(recipe.seed, "mesh", *draw, name, i).integers(len(meshes))
                ]
    return {**drawn, "scene": {**scene, "objects": copies}}


def _of_copy(choose: Callable[..., Any], copy: int, leaf: Leaf) -> Any:
    """The first copy has the streams of a single object."""
    return choose(leaf, copy) if copy else choose(leaf)


def is_fixed(recipe: Recipe) -> bool:
    """Whether all draws of a sample differ in noise only: the scene is from a file, and nothing else is random."""
    return (
        _has_fixed_scene(recipe)
        and not _is_random(recipe.drawn)
        and not recipe.random_places
    )


_PLACING = {"count", "translate", "within", "in_view", "material"}
"""Keys of an object that change neither its size nor its stable poses."""


def has_fixed_size(recipe: Recipe, name: str) -> bool:
    """Whether the object `name` of the recipe, and what it rests on, have the same size in all draws of a sample."""
    scene = recipe.drawn.get("scene")
    if not _has_fixed_scene(recipe) or not isinstance(scene, dict):
        return False
    objects = scene.get("objects", {})
    table = objects.get(name, {})
    shape = {key: value for key, value in table.items() if key not in _PLACING}
    if "folder" in table or _is_random(shape) or not _is_always_there(table):
        return False
    carrier = table.get("resting_on")
    return carrier not in objects or has_fixed_size(recipe, carrier)


def _is_always_there(table: Mapping[str, Any]) -> bool:
    """Whether every draw has a copy of an object."""
    count = table.get("count", 1)
    counts = count.distribution.values if isinstance(count, Leaf) else (count,)
    return all(number > 0 for number in counts)


def _has_fixed_scene(recipe: Recipe) -> bool:
    """Whether all draws of a sample have the same scene file."""
    is_chosen = recipe.weights is None or len(recipe.names) == 1
    return is_chosen and recipe.kind == "scene"


def _is_random(tree: Any) -> bool:
    """Whether a template has a value that differs between the draws of a sample."""
    return any(leaf.kind not in ("sweep", "per_scene") for leaf in leaves(tree))


def sample_name(index: int) -> str:
    """The folder of a sample: its index in seven digits, so that names sort."""
    return f"{index:07d}"


def split_of(recipe: Recipe, index: int) -> str | None:
    """The split of a sample; it does not change when `count` grows."""
    if not recipe.splits:
        return None
    bounds = np.cumsum(list(recipe.splits.values()))
    drawn = generator(recipe.seed, "split", index).random()
    return list(recipe.splits)[
        min(int(np.searchsorted(bounds, drawn, side="right")), len(bounds) - 1)
    ]
