"""Materials of random scenes: shares, roughness and gloss as documented."""

from collections import Counter

import numpy as np
import pytest

from twinlens.factory import generate, read_recipe
from twinlens.families import FAMILIES, Assets
from twinlens.families.composition import Composition
from twinlens.families.kinds import KINDS, METALLIC, SOFT, Body
from twinlens.families.materials import FINISHES, PLAIN
from twinlens.families.patterns import pattern
from twinlens.families.surfaces import FLOORS, TOPS, WALLS, surface_pattern
from twinlens.scoring import STATISTICS, open_pairs, pair_statistics, summarize

DRAWS = 3000
GLASS_INDEX = (
    1.567  # of the standard of gloss meters, polished black glass of 100 units
)


def finish_of(material):
    """The finish that a material has according to its parameters."""
    if material.model != "principled":
        return {"glass": "glass", "metal": "mirror"}[material.model]
    weights = {
        "metal": material.metallic,
        "fabric": material.sheen,
        "clearcoat": material.coat,
    }
    for finish, weight in weights.items():
        if weight > 0.1:
            return finish
    return next(
        name
        for name in ("matte", "satin", "glossy")
        if material.roughness >= FINISHES[name][1]
    )


def within(count, draws, share):
    """Whether a count of draws agrees with a probability, at four standard deviations."""
    return abs(count - share * draws) < 4 * np.sqrt(draws * share * (1 - share))


def composition(seed):
    """A scene without anything in it."""
    root = np.random.SeedSequence(seed)
    return Composition("empty", root, Assets(), None, (1, 1), 4 / 3, 80)


@pytest.fixture(scope="module")
def balls():
    """Materials of balls, which may have every finish."""
    scene = composition(1)
    solid = KINDS["ball"].make(np.random.default_rng(0))
    return [
        Body("ball", "ball", solid, 0.1, scene, (index,)).material(0.01)
        for index in range(DRAWS)
    ]


def test_finishes_have_the_stated_shares(balls):
    counts = Counter(map(finish_of, balls))
    assert counts.keys() == FINISHES.keys()
    assert all(
        within(counts[name], DRAWS, share) for name, (share, *_) in FINISHES.items()
    )


def test_roughness_spans_the_stated_ranges(balls):
    for finish, (_, low, high) in list(FINISHES.items())[:6]:  # not glass and mirrors
        drawn = [ball.roughness for ball in balls if finish_of(ball) == finish]
        assert low <= min(drawn) < low + 0.1 * (high - low)
        assert high - 0.1 * (high - low) < max(drawn) <= high


def test_only_suitable_kinds_are_of_fabric_or_metal():
    scene = composition(2)
    for kind in ("apple", "book", "gear"):
        solid = KINDS[kind].make(np.random.default_rng(0))
        found = {
            finish_of(Body(kind, kind, solid, 0.1, scene, (kind, i)).material(0.01))
            for i in range(200)
        }
        assert ("fabric" in found, "metal" in found) == (kind in SOFT, kind in METALLIC)


def test_the_scenes_share_of_bodies_is_plain(balls):
    """A plain body has one colour, of varying lightness; the patterns of balls have more."""
    dull = [
        ball.base_color.pixels
        for ball in balls
        if finish_of(ball) in ("matte", "satin", "fabric")
    ]
    unclipped = [
        pixels[((pixels > 0.0101) & (pixels < 0.8799)).all(axis=-1)].astype(float)
        for pixels in dull
    ]
    plain = sum(
        float((texels / texels.sum(axis=-1, keepdims=True)).std(axis=0).max()) < 1e-4
        for texels in unclipped
    )
    listed = KINDS["ball"].patterns
    share = composition(1).plain_share(PLAIN)
    others = listed.count("plain") / len(listed)
    assert within(plain, len(dull), share + (1 - share) * others)


def test_a_stated_share_of_surfaces_is_plain_over_many_scenes():
    rng = np.random.default_rng(3)
    scenes = [composition(seed) for seed in range(DRAWS)]
    for patterns in (WALLS, TOPS, FLOORS):
        names = [surface_pattern(scene, rng, patterns)[0] for scene in scenes]
        assert within(names.count("plain"), DRAWS, patterns[0])


def test_some_scenes_are_bare_and_some_have_patterns_alone():
    shares = [composition(seed).plain_share(0.5) for seed in range(DRAWS)]
    low, high = np.quantile(shares, (0.1, 0.9))
    assert low < 0.12
    assert high > 0.88


def grain(name, n, seed=0):
    """The standard deviation of the logarithm of a pattern of one grey, averaged to 128 texels."""
    texels = pattern(name, n, np.random.default_rng(seed), np.full((4, 3), 0.3))[..., 0]
    return float(
        np.log(texels.reshape(128, n // 128, 128, n // 128).mean(axis=(1, 3))).std()
    )


def test_plain_paint_has_fainter_grain_than_other_surfaces():
    plain, cloudy = (
        np.array([grain(name, 128, seed) for seed in range(40)])
        for name in ("plain", "cloudy")
    )
    assert 0.005 < plain.min() < 0.03
    assert 0.08 < plain.max() < 0.14
    assert cloudy.min() > 0.1


def test_grain_of_a_size_has_the_same_contrast_at_every_resolution():
    assert [grain("plain", n) for n in (256, 512, 1024)] == pytest.approx(
        [grain("plain", 128)] * 3, rel=0.05
    )


def gloss(roughness, rays=400_000):
    """Gloss units at 60 degrees (ISO 2813) of a rough surface of index 1.5: GGX with alpha = roughness^2, by sampling.

    Apertures of the receptor are 4.4 x 11.7 degrees, of the source 0.75 x 2.5 degrees.
    """
    rng, alpha = np.random.default_rng(0), roughness**2

    def fresnel(cosine, index):
        g = np.sqrt(index**2 - 1 + cosine**2)
        ratio = (cosine * (g + cosine) - 1) / (cosine * (g - cosine) + 1)
        return 0.5 * ((g - cosine) / (g + cosine)) ** 2 * (1 + ratio**2)

    def shadowing(cosine):
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / np.maximum(cosine, 1e-6) ** 2 - 1)))

    angle = np.pi / 3 + np.radians(rng.uniform(-0.375, 0.375, rays))
    aside = np.radians(rng.uniform(-1.25, 1.25, rays))
    light = np.stack(
        [-np.sin(angle) * np.cos(aside), np.sin(aside), np.cos(angle) * np.cos(aside)]
    )
    u, turn = rng.random(rays), rng.uniform(0, 2 * np.pi, rays)
    tilt = np.arctan(alpha * np.sqrt(u / (1 - u)))
    facet = np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)]
    )
    cosine = (light * facet).sum(axis=0)
    out = 2 * cosine * facet - light
    ahead, side = (
        np.degrees(np.arctan2(out[0], out[2])) - 60,
        np.degrees(np.arcsin(np.clip(out[1], -1, 1))),
    )
    seen = (np.abs(ahead) < 2.2) & (np.abs(side) < 5.85) & (cosine > 0) & (out[2] > 0)
    weight = (
        fresnel(np.clip(cosine, 1e-3, 1), 1.5)
        * shadowing(light[2])
        * shadowing(out[2])
        * cosine
    )
    return (
        100
        * np.mean(np.where(seen, weight / (light[2] * facet[2]), 0))
        / fresnel(0.5, GLASS_INDEX)
    )


def test_finishes_have_the_gloss_of_paints_of_these_names():
    """Master Painters Institute: matte at most 5 units at 60 degrees, eggshell and satin 10 to 35, gloss 35 to 85."""
    assert gloss(FINISHES["matte"][1]) < 5.5
    assert 5 < gloss(FINISHES["satin"][2]) < 10
    assert 25 < gloss(FINISHES["satin"][1]) < 35
    assert 33 < gloss(FINISHES["glossy"][2]) < 40
    assert 78 < gloss(FINISHES["glossy"][1]) < 86


@pytest.fixture(scope="module")
def held_out(tmp_path_factory):
    """Statistics of the held-out scenes of docs/realism.md, with which no share, contrast or tolerance was chosen."""
    folder = tmp_path_factory.mktemp("held_out")
    (folder / "recipe.toml").write_text(
        f"seed = 1602\ncount = 12\nfamilies = {sorted(FAMILIES)}\nwidth = 700\nheight = 500\nspp = 16\n"
        "[sensor]\nfull_well = 42800\nread_noise = 4.6\ndark_current = 4.0\ndsnu = 2.0\nprnu = 0.0025\n"
        'mismatch = "typical"\n'
    )
    generate(read_recipe(folder / "recipe.toml"), folder / "data")
    return summarize([pair_statistics(pair) for pair in open_pairs([folder / "data"])])


OF_THE_RIG = {"width", "largest_disparity", "range"}
# Scenes have fewer edges, thin things and slanted surfaces than real ones.
OF_GEOMETRY = {"edges", "thin", "slant", "slant_high", "unknown"}
OF_LIGHT = {"dark", "bright", "plain_areas"}
COMPARED = sorted(set(STATISTICS) - OF_THE_RIG - OF_GEOMETRY - OF_LIGHT)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMPARED)
def test_medians_of_random_scenes_are_in_the_range_of_real_pairs(held_out, name):
    _, low, high = STATISTICS[name].real
    assert low <= held_out[name][0] <= high


OFFSET = pytest.param(
    "offset",
    marks=pytest.mark.xfail(
        strict=True,
        reason="-2.32; -2.23 would be near, and the 41 pairs of the frozen benchmark have -1.15",
    ),
)
"""Known not to be near in these twelve scenes: stray light, which the second camera alone has, makes it negative."""


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", [*[name for name in COMPARED if name != "offset"], OFFSET]
)
def test_medians_of_random_scenes_are_near_those_of_real_pairs(held_out, name):
    """Within a third of the real range."""
    middle, low, high = STATISTICS[name].real
    assert abs(held_out[name][0] - middle) <= (high - low) / 3


@pytest.mark.slow
def test_the_largest_disparity_of_random_scenes_is_that_of_real_pairs(held_out):
    """0.09 of the width, within two standard errors of the median of twelve scenes.

    Its logarithm is uniform over a factor of 9, with a standard deviation of ln(9) / sqrt(12). The standard error of a
    median is 1.25 times that of a mean.
    """
    error = 1.25 * np.log(9) / np.sqrt(12) / np.sqrt(12)
    assert abs(np.log(held_out["largest_disparity"][0] / 0.09)) < 2 * error
