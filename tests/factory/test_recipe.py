import datetime
from pathlib import Path

import pytest
from hypothesis import given, settings, strategies as st

from twinlens.errors import InputError, TwinlensError
from twinlens.factory import plan, read_recipe, recipe_from_table
from twinlens.factory.recipe import differences

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
    table = {
        key: dict(entry) if isinstance(entry, dict) else entry
        for key, entry in FULL.items()
    }
    *path, last = place.split(".")
    at = table
    for key in path:
        at = at[key]
    if value is ...:
        del at[last]
    else:
        at[last] = value
    return table


def test_the_smallest_recipe_works_as_it_is(tmp_path):
    (tmp_path / "recipe.toml").write_text(SMALLEST)
    recipe = read_recipe(tmp_path / "recipe.toml")
    assert (recipe.seed, recipe.count) == (3, 2)
    assert plan(recipe, 0).drawn == {"width": 320, "height": 240, "spp": 16}


def test_the_noise_gate_needs_a_measurement():
    table = {"seed": 1, "count": 1, "scenes": ["staircase"], "gates": {"noise": 0.5}}
    assert recipe_from_table(table).gates.noise == 0.5
    assert (
        recipe_from_table(table | {"denoise": False, "noise": 0.3}).gates.noise == 0.5
    )
    for unmeasured in ({"denoise": False}, {"spp": 1}):
        with pytest.raises(
            InputError,
            match=r"gates\.noise: the noise is measured with spp >= 2 and denoise",
        ):
            recipe_from_table(table | unmeasured)


def test_every_key_is_read():
    recipe = recipe_from_table(FULL)
    assert recipe.ndisp == 64
    assert recipe.gates.attempts == 5
    assert len(plan(recipe, 0).drawn["lenses"]) == 4


@pytest.mark.parametrize(
    ("place", "value", "message"),
    [
        ("sede", 3, "recipe.toml: unknown key 'sede'; did you mean 'seed'?"),
        ("seed", ..., "missing key 'seed'"),
        ("seed", -1, "seed: must be >= 0, got -1"),
        ("count", 0, "count: must be >= 1, got 0"),
        ("count", {"uniform": [1, 2]}, "count: must be a whole number"),
        ("families", ..., "needs .*exactly one of 'scenes' .* and 'families'"),
        ("scenes", ["cards"], "give 'scenes' or 'families', not both"),
        (
            "families",
            ["tabeltop"],
            r"families\[0\]: unknown family 'tabeltop'; did you mean 'tabletop'?",
        ),
        ("families", ["room", "room"], "families: 'room' is listed twice"),
        ("weights", [1], r"recipe.toml: weights: must have length 2, got \[1\.0\]"),
        ("weights", [0, 0], "recipe.toml: weights: at least one must be > 0, got"),
        ("width", {"choice": [320, 0]}, "width: must be >= 1, got 0"),
        ("dual_pixel", True, "dual_pixel and diffraction exclude each other"),
        ("width", 12, "recipe.toml: width must be a number of pixels >= 16, got 12"),
        (
            "width",
            {"choice": [320, 1600]},
            r"toml: aspect \(width / height\) must be from 0.2 to 5, got 6.6",
        ),
        (
            "height",
            {"integers": [240, 1700]},
            r"toml: aspect \(width / height\) must be from 0.2 to 5, got 0.188",
        ),
        ("spp", {"uniform": [4, 16]}, "spp: must be a whole number"),
        ("spp", {"choice": [4.5]}, "spp: must be a whole number from .*, got 4.5$"),
        (
            "sensor.read_noise",
            {"uniform": [-2, 3]},
            "sensor.read_noise: must be [^;]*$",
        ),
        (
            "rig.distortion",
            {"k9": 1},
            r"rig.distortion: unknown key 'k9' \(known: k1, k2",
        ),
        (
            "rig.baseline",
            {"uniform": [-0.1, 0.2]},
            r"recipe.toml: rig.baseline: must be > 0, got -0.1",
        ),
        ("rig.basline", 0.1, "rig: unknown key 'basline'; did you mean 'baseline'?"),
        ("rig.layout", "circle", "rig.layout: must be one of .*, got 'circle'"),
        ("rig.distortion", {"k1": {"choice": [0, -9]}}, "rig"),
        (
            "lenses",
            [{"kind": "thim"}],
            r"lenses\[0\].kind: must be one of .* got 'thim'; did you mean 'thin'?",
        ),
        (
            "lenses",
            [{"kind": "thin"}],
            r"lenses\[0\]: a thin lens needs exactly one of 'aperture_mm' and 'f_number'",
        ),
        (
            "lenses",
            [{"kind": "pinhole", "focus": 2}],
            r"lenses\[0\]: unknown key 'focus'",
        ),
        (
            "lenses",
            [{"kind": "thin", "f_number": 2, "focus": "midle"}],
            "did you mean 'middle'?",
        ),
        (
            "lenses",
            [{"kind": "thin", "f_number": 2, "focus": -1}],
            r"lenses\[0\].focus: must be a number of metres",
        ),
        (
            "lenses",
            [{"kind": "thin", "f_number": 2, "shape": {"kind": "polygon"}}],
            "missing key 'blades'",
        ),
        ("lenses", [], "lenses: must be a list of at least 1 value"),
        (
            "sensor.read_nois",
            3,
            "sensor: unknown key 'read_nois'; did you mean 'read_noise'?",
        ),
        (
            "sensor.read_noise",
            {"uniform": [-1, 3]},
            "sensor.read_noise: must be .* got -1",
        ),
        (
            "sensor.preset",
            "fone",
            "sensor.preset: must be one of .* got 'fone'; did you mean 'phone'?",
        ),
        ("sensor.adc_bits", 99, "sensor.adc_bits: must be .*from 8 to 16"),
        ("sensor.shot_noise", 1, "sensor.shot_noise: must be true or false"),
        (
            "sensor.quantum_efficiency",
            [0.5],
            "sensor.quantum_efficiency: must be three numbers > 0 and <= 1",
        ),
        (
            "sensor.mismatch",
            {"gian": 1},
            "sensor.mismatch: unknown key 'gian'; did you mean 'gain'?",
        ),
        (
            "sensor.mismatch",
            "typcal",
            "sensor.mismatch: must be one of none, .*; did you mean 'typical'?",
        ),
        (
            "sensor.mismatch",
            {"seed": 5},
            "sensor.mismatch: seed needs a level that is drawn",
        ),
        (
            "sensor.mismatch",
            {"choice": ["typical", 3]},
            "sensor.mismatch: must be a table",
        ),
        (
            "sensor.mismatch",
            {"blur_px": {"uniform": [-1, 1]}},
            "sensor.mismatch.blur_px: must be .* got -1",
        ),
        ("exposure", {"gain": 2}, "exposure: missing key 'time'"),
        (
            "scene.jitter",
            {"roll": 1},
            "scene.jitter: unknown key 'roll'; did you mean 'roll_deg'?",
        ),
        ("scene.depth_range", [5, 1], r"scene.depth_range: must be \[near, far\]"),
        (
            "scene.depth_range",
            [1, 1.01],
            r"toml: scene.depth_range must be \(near, far\) with far >= 1.8 near in tabletop scenes, got 1.01",
        ),
        ("gates.attempts", 0, "gates.attempts: must be >= 1"),
        ("gates.texture", 2, "gates.texture: must be <= 1"),
        ("gates.noise", 0, "gates.noise: must be "),
        ("splits", {"train": 0.8, "test": 0.1}, "splits: the shares must add up to 1"),
        *(
            (
                "splits",
                {name: 1.0},
                r"splits: a split's name must be usable as a folder's, such as train, got ",
            )
            for name in (
                "",
                " ",
                "train ",
                "../x",
                "a/b",
                "a\\b",
                ".",
                "..",
                ".train",
                "a\nb",
                "a" * 256,
            )
        ),
        (
            "rig.baseline",
            {"unifrom": [0.1, 0.2]},
            r"rig.baseline: .* got .*; did you mean the distribution 'uniform'\?$",
        ),
        (
            "spp",
            {"interger": [4, 16]},
            r"spp: must be a whole number .*; did you mean the distribution 'integers'\?$",
        ),
        (
            "sensor.adc_bits",
            {"choise": [8, 10]},
            r"adc_bits: .*; did you mean the distribution 'choice'\?$",
        ),
        (
            "scene.depth_range",
            {"swep": [[1, 5]]},
            r"depth_range: .*; did you mean the distribution 'sweep'\?$",
        ),
        (
            "diffraction",
            {"choose": [True]},
            r"diffraction: must be true or false.* distribution 'choice'\?$",
        ),
        (
            "rig.baseline",
            {"gauss": [0.1, 0.2]},
            "rig.baseline: .*; distributions are uniform, log_uniform, integers, normal, choice, sweep, per_scene$",
        ),
        (
            "rig.baseline",
            {"per_scene": [0.1] * 9},
            "rig.baseline: per_scene needs . values, one for each .*, got 9",
        ),
        (
            "width",
            {"uniform": [320, 640]},
            r"width: must be a whole number, .*; 'uniform' draws any number, use \{ integers =",
        ),
        (
            "sensor.adc_bits",
            {"normal": [10, 1], "clip": [8, 12]},
            r"adc_bits: .*'normal' draws .* \{ integers = \[low, hi",
        ),
        (
            "assets",
            {"meshes": "nowhere/"},
            "assets.meshes: no file or folder 'nowhere/' next to the recipe",
        ),
        ("about", {"licence": "MIT"}, "unknown key 'licence'; did you mean 'license'?"),
        (
            "keep",
            ["radiances"],
            r"keep\[0\]: must be one of .*'radiances'; did you mean 'radiance'?",
        ),
    ],
)
def test_mistakes_are_named_with_their_place_and_the_nearest_key(place, value, message):
    with pytest.raises(InputError, match=message) as caught:
        recipe_from_table(changed(place, value))
    assert str(caught.value).startswith("recipe.toml: ")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("recipe", [{}, {"width": 64}, {"seed": 1, "count": 1}])
def test_a_recipe_without_content_is_told_all_that_it_needs(recipe):
    with pytest.raises(
        InputError,
        match=r"^recipe.toml: a recipe needs 'seed', 'count', and exactly one of",
    ):
        recipe_from_table(recipe)


@pytest.mark.parametrize("key", ["diffraction", "dual_pixel"])
def test_what_needs_an_aperture_is_refused_where_no_lens_has_a_width(key):
    recipe = {
        "seed": 1,
        "count": 1,
        "scenes": ["cards"],
        key: {"choice": [False, True]},
    }
    thin = {"kind": "thin", "aperture_mm": 0}
    for lenses in ({}, {"lenses": [{"kind": "pinhole"}]}, {"lenses": [thin]}):
        with pytest.raises(
            InputError,
            match=rf"^recipe.toml: {key}: has no effect, every lens is a pinhole",
        ):
            recipe_from_table({**recipe, **lenses})
    for last in (
        thin | {"aperture_mm": {"choice": [0, 8]}},
        {"choice": [thin, thin | {"aperture_mm": 1}]},
    ):
        recipe_from_table({**recipe, "lenses": [{"kind": "pinhole"}, last]})


def test_depths_of_a_scene_from_a_file_are_not_the_recipes():
    with pytest.raises(
        InputError, match=r"scene\.depth_range: can be used with 'families' only"
    ):
        recipe_from_table(
            {
                "seed": 1,
                "count": 1,
                "scenes": ["cards"],
                "scene": {"depth_range": [1, 2]},
            }
        )


def test_a_scene_that_is_not_there_is_named_with_the_nearest_one():
    with pytest.raises(
        InputError,
        match=r"scenes\[0\]: unknown scene 'stairs'; did you mean 'staircase'",
    ):
        recipe_from_table({"seed": 1, "count": 1, "scenes": ["stairs"]})


@pytest.mark.parametrize(
    "name", ["nofile.toml", "stairs/scene.toml", "..\\stairs", "staircase.xml"]
)
def test_a_scene_file_that_is_not_there_is_told_with_the_folder_and_no_bundled_name(
    tmp_path, name
):
    with pytest.raises(InputError) as printed:
        recipe_from_table(
            {"seed": 1, "count": 1, "scenes": [name]}, tmp_path / "recipe.toml"
        )
    assert str(printed.value) == (
        f"{tmp_path / 'recipe.toml'}: scenes[0]: no such file next to the recipe, in {tmp_path}: {name!r}"
    )


@pytest.mark.parametrize(
    "text",
    [
        "seed = ",
        "seed = 1\nseed = 2",
        "a = " + "[" * 5000,
        "x = " + "9" * 5000,
        "\x00",
        "é",
    ],
)
def test_what_is_no_toml_is_told_as_such(tmp_path, text):
    (tmp_path / "recipe.toml").write_text(text)
    with pytest.raises(InputError, match=r"recipe\.toml: "):
        read_recipe(tmp_path / "recipe.toml")


def test_a_byte_order_mark_is_no_part_of_the_text(tmp_path):
    plain, marked = tmp_path / "plain.toml", tmp_path / "marked.toml"
    plain.write_text(SMALLEST, encoding="utf-8")
    marked.write_text(SMALLEST, encoding="utf-8-sig")
    assert marked.read_bytes()[:3] == b"\xef\xbb\xbf"
    assert read_recipe(marked).written == read_recipe(plain).written


def test_a_missing_recipe_is_told(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.toml"):
        read_recipe(tmp_path / "nowhere.toml")


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
known = sorted(
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
keys = st.one_of(st.sampled_from(known), st.text(max_size=5))
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


@pytest.mark.slow
@settings(max_examples=10_000)
@given(tables)
def test_any_of_many_tables_is_read_or_refused(table):
    reads_or_refuses(table)


def bytes_are_read_or_refused(folder: Path, data: bytes):
    path = folder / "recipe.toml"
    path.write_bytes(data)
    try:
        read_recipe(path)
    except TwinlensError:
        return


damage = st.tuples(st.integers(0, 200), st.integers(0, 20), st.binary(max_size=12))


@settings(max_examples=200)
@given(damage)
def test_a_damaged_file_is_read_or_refused(tmp_path_factory, cut):
    start, length, put = cut
    data = SMALLEST.encode()
    bytes_are_read_or_refused(
        tmp_path_factory.getbasetemp(), data[:start] + put + data[start + length :]
    )


@pytest.mark.slow
@settings(max_examples=10_000)
@given(damage)
def test_many_damaged_files_are_read_or_refused(tmp_path_factory, cut):
    start, length, put = cut
    data = SMALLEST.encode()
    bytes_are_read_or_refused(
        tmp_path_factory.getbasetemp(), data[:start] + put + data[start + length :]
    )


def test_a_scene_from_a_file_may_be_as_narrow_as_it_likes():
    recipe_from_table(
        {"seed": 1, "count": 1, "scenes": ["cards"], "width": 8, "height": 80}
    )


def test_assets_belong_to_families(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.png").touch()
    table = {"seed": 1, "count": 1, "assets": {"textures": "mine"}}
    assert recipe_from_table(
        {**table, "families": ["cards"]}, tmp_path / "recipe.toml"
    ).sources.assets
    with pytest.raises(
        InputError, match=r"recipe\.toml: assets: can be used with 'families' only"
    ):
        recipe_from_table({**table, "scenes": ["cards"]}, tmp_path / "recipe.toml")


def test_a_folder_without_a_file_of_the_kind_is_named_as_the_recipe_does(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "a.txt").touch()
    for kind in ("meshes", "textures", "hdris"):
        table = {
            "seed": 1,
            "count": 1,
            "families": ["cards"],
            "assets": {kind: ["mine"]},
        }
        with pytest.raises(
            InputError,
            match=rf"recipe\.toml: assets\.{kind}: 'mine' contains no \.\w+, .* file",
        ):
            recipe_from_table(table, tmp_path / "recipe.toml")


@pytest.mark.parametrize(("table", "message"), [
    ({"scene": {"objects": {"bit": "a.glb"}}}, "scene.objects.bit: must be a table of keys and values, got 'a.glb'"),
    ({"scene": {"objects": {"bit": {"folder": "/tmp"}}}}, "scene.objects.bit: folder: '/tmp' leads outside"),
    ({"assets": {"meshes": 5}}, "assets.meshes: must be a string or a list of strings, got 5"),
    ({"sky": {"file": "a.glb"}}, "sky.file: 'a.glb' is not a .hdr, .exr, .png file"),
    ({"sky": {"file": "a.hdr", "scale": 1e-30}}, "sky.scale: must be >= 1e-09, got 1e-30"),
    ({"camera": {"preset": "realsense-d435"}, "width": 160, "height": 120},
     "recipe.toml: height: the sensor has 100 rows at a width of 160, got 120; use at most 100"),
])  # fmt: skip
def test_wrong_types_and_places_are_named(tmp_path, table, message):
    (tmp_path / "a.glb").touch()
    with pytest.raises(InputError, match=message):
        recipe_from_table(
            {"seed": 1, "count": 1, "families": ["flying"], **table},
            tmp_path / "recipe.toml",
        )
