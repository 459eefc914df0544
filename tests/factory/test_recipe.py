import contextlib
import copy
import datetime
import tomllib
from collections import Counter

import pytest
from hypothesis import given, settings, strategies as st

from twinlens.errors import InputError, TwinlensError
from twinlens.factory import plan, read_recipe, recipe_from_table
from twinlens.factory.recipe import differences
from twinlens.families import FAMILIES

SMALLEST = """
seed = 3
count = 2
scenes = ["staircase"]                       # or families = ["tabletop"]
width = 320
height = 240
spp = 16
"""
FULL = {
    "seed": 3,
    "count": 2,
    "families": ["tabletop", "room"],
    "weights": [2, 1],
    "width": {"choice": [320, 640]},
    "height": 240,
    "spp": {"integers": [4, 16]},
    "ndisp": 64,
    "diffraction": {"choice": [True, False]},
    "sky_disparity": False,
    "keep": ["models", "radiance"],
    "rig": {
        "layout": "toed_in",
        "baseline": {"log_uniform": [0.05, 0.2]},
        "distance": 2.0,
        "fx": {"uniform": [300, 400]},
        "distortion": {
            "model": "brown-conrady",
            "k1": {"normal": [0, 0.05], "clip": [-0.1, 0.1]},
        },
        "misalignment": {"roll_deg": {"uniform": [-1, 1]}},
    },
    "lenses": [
        {"kind": "pinhole"},
        {
            "kind": "thin",
            "f_number": {"sweep": [2, 4]},
            "focus": {"choice": ["near", "object", 2.0, float("inf")]},
        },
        {
            "kind": "thin",
            "aperture_mm": 4,
            "shape": {"kind": "polygon", "blades": {"integers": [5, 9]}},
        },
        {"kind": "hole", "aperture_mm": 0.35, "film_mm": 50},
    ],
    "sensor": {
        "preset": {"choice": ["phone", "ideal"]},
        "read_noise": 4,
        "mismatch": {"gain": {"uniform": [0.9, 1]}},
    },
    "exposure": {"time": {"log_uniform": [0.001, 0.1]}, "gain": 2},
    "scene": {
        "jitter": {"yaw_deg": {"uniform": [-5, 5]}},
        "object_count": {"integers": [3, 9]},
        "depth_range": [1, 5],
    },
    "gates": {"attempts": 5, "texture": 0.2, "inside": False},
    "splits": {"train": 0.9, "test": 0.1},
    "about": {"name": "A set", "license": "CC-BY-4.0"},
}


def changed(place, value):
    """FULL with another value at a dotted place; `...` takes the key away."""
    table = copy.deepcopy(FULL)
    *path, last = place.split(".")
    part = table
    for key in path:
        part = part[key]
    if value is ...:
        del part[last]
    else:
        part[last] = value
    return table


def test_the_smallest_recipe_works_as_it_is(tmp_path):
    (tmp_path / "recipe.toml").write_text(SMALLEST)
    recipe = read_recipe(tmp_path / "recipe.toml")
    assert (recipe.seed, recipe.count) == (3, 2)
    assert plan(recipe, 0).drawn == {"width": 320, "height": 240, "spp": 16}


@pytest.mark.parametrize("unmeasured", [{"denoise": False}, {"spp": 1}])
def test_the_noise_gate_needs_a_measurement(unmeasured):
    table = {"seed": 1, "count": 1, "scenes": ["staircase"], "gates": {"noise": 0.5}}
    measured = table | {"denoise": False, "noise": 0.3}
    for written in (table, measured):
        assert recipe_from_table(written).gates.noise == 0.5
    with pytest.raises(InputError, match=r"gates\.noise: the noise is measured with"):
        recipe_from_table(table | unmeasured)


def test_every_key_is_read():
    recipe = recipe_from_table(FULL)
    assert recipe.ndisp == 64
    assert recipe.gates.attempts == 5
    assert len(plan(recipe, 0).drawn["lenses"]) == 4


SPLIT_NAMES = ("", "train ", "../x", "a/b", "a\\b", "..", ".train", "a\nb", "a" * 256)
MISTAKES = r"""
sede = 3 | recipe.toml: unknown key 'sede'; did you mean 'seed'?
count = { uniform = [1, 2] } | count: must be a whole number
scenes = ["cards"] | give 'scenes' or 'families', not both
families = ["room", "room"] | families: 'room' is listed twice
families = ["all", "room"] | families: 'room' is listed twice
families = ["al"] | families.*unknown family 'al'; did you mean 'all'
weights = [0, 0] | recipe.toml: weights: at least one must be > 0, got
dual_pixel = true | dual_pixel and diffraction exclude each other
width = 12 | recipe.toml: width must be a number of pixels >= 16, got 12
width = { choice = [320, 1600] } | aspect .* must be from 0.2 to 5, got 6.6
width = { uniform = [320, 640] } | 'uniform' draws any number, use \{ integers
rig.baseline = { uniform = [-0.1, 0.2] } | rig.baseline: must be > 0, got -0
rig.baseline = { unifrom = [1, 2] } | mean the distribution 'uniform'\?$
rig.baseline = { gauss = [0.1, 0.2] } | distributions are uniform, .*per_scene$
rig.baseline = { per_scene = [1, 1, 1, 1, 1, 1, 1, 1, 1] } | per_scene needs . values, .* got 9
rig.basline = 0.1 | rig: unknown key 'basline'; did you mean 'baseline'?
lenses = { kind = "pinhole" } | lenses: must be a list of tables: write \[\[lenses\]\] above each lens
lenses = [{ kind = "thin" }] | exactly one of 'aperture_mm' and 'f_number'
lenses = [{ kind = "thin", f_number = 2, focus = "midle" }] | did you mean 'middle'?
lenses = [{ kind = "thin", f_number = 2, focus = -1 }] | \[0\].focus: must be a number of metres
sensor.read_noise = { uniform = [-1, 3] } | read_noise: must be .* got -1
sensor.mismatch = { gian = 1 } | mismatch: unknown key 'gian'; .* 'gain'?
sensor.mismatch = { seed = 5 } | seed needs a level that is drawn
sensor.mismatch = { choice = ["typical", 3] } | mismatch: must be a table
scene.depth_range = [5, 1] | scene.depth_range: must be \[near, far\]
scene.depth_range = [1, 1.01] | with far >= 1.8 near in tabletop scenes
splits = { train = 0.8, test = 0.1 } | splits: the shares must add up to 1
assets = { meshes = "nowhere/" } | assets.meshes: no file or folder 'nowhere/'
"""


def value_at(table, place):
    """The value at a dotted place of a table."""
    for key in place.split("."):
        table = table[key]
    return table


def assert_refused(place, value, message):
    with pytest.raises(InputError, match=message) as caught:
        recipe_from_table(changed(place, value))
    assert str(caught.value).startswith("recipe.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("row", MISTAKES.strip().splitlines())
def test_mistakes_are_named_with_their_place_and_the_nearest_key(row):
    """Each in the full recipe."""
    line, message = row.split(" | ")
    place = line.partition(" = ")[0]
    assert_refused(place, value_at(tomllib.loads(line), place), message)


def test_missing_keys_and_names_of_splits_that_no_folder_has_are_named():
    assert_refused("seed", ..., "missing key 'seed'")
    one_source = "needs .*exactly one of 'scenes' .* and 'families'"
    assert_refused("families", ..., one_source)
    for name in SPLIT_NAMES:
        assert_refused("splits", {name: 1.0}, "a split's name must be usable")


@pytest.mark.parametrize("key", ["diffraction", "dual_pixel"])
def test_what_needs_an_aperture_is_refused_where_no_lens_has_a_width(key):
    recipe = {"seed": 1, "count": 1, "scenes": ["cards"]}
    recipe[key] = {"choice": [False, True]}
    pinhole, closed = {"kind": "pinhole"}, {"kind": "thin", "aperture_mm": 0}
    has_no_effect = rf"^recipe.toml: {key}: has no effect, every lens is a pinhole"
    with pytest.raises(InputError, match=has_no_effect):
        recipe_from_table(recipe)
    with pytest.raises(InputError, match=has_no_effect):
        recipe_from_table({**recipe, "lenses": [pinhole, closed]})
    for last in (
        closed | {"aperture_mm": {"choice": [0, 8]}},
        {"choice": [closed, closed | {"aperture_mm": 1}]},
    ):
        recipe_from_table({**recipe, "lenses": [pinhole, last]})


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("stairs", r"scenes\[0\]: unknown scene 'stairs'; did you mean 'staircase'"),
        ("staircase.xml", r"scenes\[0\]: no such file next to the recipe, in [^?]*$"),
    ],
)
def test_a_scene_that_is_not_there_is_named(tmp_path, name, message):
    with pytest.raises(InputError, match=message):
        recipe_of_scene(tmp_path, scenes=[name])


def recipe_of_scene(folder, **more):
    table = {"seed": 1, "count": 1, **more}
    return recipe_from_table(table, folder / "recipe.toml")


def test_differences_name_the_place():
    assert differences(
        {"count": 1, "rig": {"a": 1}}, {"count": 2, "rig": {"a": 2, "b": 3}}
    ) == [
        "rig.a: 1 -> 2",
        "rig.b: absent -> 3",
    ]
    assert differences({"rig": {"count": 2}}, {"rig": {"count": 3}}) == [
        "rig.count: 2 -> 3"
    ]


numbers = st.one_of(st.integers(-(10**30), 10**30), st.floats(), st.booleans())
scalars = st.one_of(
    numbers,
    st.text(max_size=8),
    st.sampled_from(
        [
            "cards",
            "room",
            "thin",
            "pinhole",
            "middle",
            "polygon",
            "parallel",
            "grid",
            "phone",
            "raw",
            "../x",
        ]
    ),
    st.just(datetime.date(2026, 1, 1)),
)
kinds = st.sampled_from(
    ["uniform", "log_uniform", "integers", "normal", "choice", "sweep", "per_scene"]
)
distributions = st.builds(
    lambda kind, values, rest: {kind: values, **rest},
    kinds,
    st.lists(scalars, max_size=3),
    st.dictionaries(
        st.sampled_from(["clip", "weights"]), st.lists(numbers, max_size=3), max_size=1
    ),
)
leaves = st.one_of(scalars, distributions)
allowed = sorted(
    {
        "seed",
        "scenes",
        "sweep",
        "kind",
        "focus",
        "k1",
        "gain",
        "time",
        "count",
        *FULL,
        *FULL["rig"],
    }
)
keys = st.one_of(st.sampled_from(allowed), st.text(max_size=5))
values = st.recursive(
    leaves,
    lambda inner: st.one_of(
        st.lists(inner, max_size=3), st.dictionaries(keys, inner, max_size=3)
    ),
    max_leaves=6,
)
tables = st.one_of(
    st.dictionaries(keys, values, max_size=5),
    st.builds(
        lambda table, key, value: {**table, key: value}, st.just(FULL), keys, values
    ),
    st.builds(
        lambda section, key, value: {**FULL, section: {**FULL[section], key: value}},
        st.sampled_from(
            ["rig", "sensor", "exposure", "scene", "gates", "splits", "about"]
        ),
        keys,
        values,
    ),
)


def reads_or_refuses(table):
    try:
        recipe = recipe_from_table(table)
    except TwinlensError as error:
        printed = str(error)
    else:
        printed = ""
        specs = [plan(recipe, index) for index in (0, 1, 10**6)]
        assert specs == [plan(recipe, index) for index in (0, 1, 10**6)]
    assert "\n" not in printed


@settings(max_examples=200)
@given(tables)
def test_any_table_is_read_or_refused(table):
    reads_or_refuses(table)


damage = st.tuples(st.integers(0, 200), st.integers(0, 20), st.binary(max_size=12))


@given(damage)
@settings(max_examples=200)
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, cut):
    start, length, put = cut
    text = SMALLEST.encode()
    path = tmp_path_factory.getbasetemp() / "recipe.toml"
    path.write_bytes(text[:start] + put + text[start + length :])
    with contextlib.suppress(TwinlensError):
        read_recipe(path)


def test_all_families_are_drawn_alike():
    table = {"seed": 3, "count": 4 * len(FAMILIES), "families": ["all"]}
    recipe = recipe_from_table(table)
    drawn = Counter(plan(recipe, k).scene for k in range(recipe.count))
    assert drawn == dict.fromkeys(FAMILIES, 4)
    assert recipe.written["families"] == list(FAMILIES)


def test_weights_of_all_families_are_in_their_order():
    weights = [0] * (len(FAMILIES) - 1) + [1]
    table = {"seed": 3, "count": 8, "families": ["all"], "weights": weights}
    recipe = recipe_from_table(table)
    assert {plan(recipe, k).scene for k in range(8)} == {list(FAMILIES)[-1]}


def test_assets_and_depths_belong_to_families(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.png").touch()
    assets, depths = {"textures": "mine"}, {"depth_range": [1, 2]}
    recipe = recipe_of_scene(tmp_path, assets=assets, families=["cards"])
    assert recipe.sources.assets
    refused = r"recipe\.toml: assets: can be used with 'families' only"
    with pytest.raises(InputError, match=refused):
        recipe_of_scene(tmp_path, assets=assets, scenes=["cards"])
    refused = r"scene\.depth_range: can be used with 'families' only"
    with pytest.raises(InputError, match=refused):
        recipe_of_scene(tmp_path, scene=depths, scenes=["cards"])
