"""Images of many lenses from one set of light paths equal those of each lens by itself, and know their own error."""

import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import t as student

import twinlens as tl
from tests.optics_rendered.optics_lights import (
    HERE,
    chequered_room,
    lamps,
    sky,
    square_camera,
)
from twinlens.camera import Annulus, BrownConrady, MaskAperture, Polygon
from twinlens.errors import InputError
from twinlens.rendering import backend, lens_grid, shared_paths
from twinlens.rendering.annuli import area_fraction, plan_annuli, split_vergences

backend()
import drjit  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

LEFT = tl.Camera(
    24, 18, fx=26.0, fy=31.0, cx=10.2, cy=9.1
)  # pixels of two widths, off-centre
RIG = tl.Rig.stereo(LEFT, 0.1, right=LEFT.replace(cx=13.7))  # doffs = 3.5
LENSES = {
    "pinhole": tl.Pinhole(),
    "wide near": tl.ThinLens(0.4, 1.9),
    "wide far": tl.ThinLens(0.4, 5.0),
    "narrow near": tl.ThinLens(0.2, 1.9),
    "narrow far": tl.ThinLens(0.2, 5.0),
    "infinity": tl.ThinLens(0.2, np.inf),
    "bare hole": tl.BareAperture(0.1, 4.0),
}
SPP, REPEATS, BLOCK = 16, 14, 6


@pytest.fixture(scope="module")
def room():
    return chequered_room()


def repeated(take) -> np.ndarray:
    """Stacked results for seeds 0, 1, ..., float64."""
    return np.array([take(seed) for seed in range(REPEATS)], dtype=np.float64)


@pytest.fixture(scope="module")
def grids(room):
    """[seed, lens, camera, y, x, channel], and the grids' own standard errors [seed, lens, camera]."""
    made = [
        tl.render_lens_grid(room, RIG, list(LENSES.values()), spp=SPP, seed=seed)
        for seed in range(REPEATS)
    ]
    return np.array([list(grid) for grid in made], dtype=np.float64), np.array(
        [grid.standard_error for grid in made]
    )


@pytest.fixture(scope="module")
def direct(room):
    """The same, each lens by itself."""
    return repeated(
        lambda seed: [
            tl.render(room, RIG, lens, spp=SPP, seed=100 + seed)
            for lens in LENSES.values()
        ]
    )


def blocks(images: np.ndarray) -> np.ndarray:
    """Grey means of blocks of pixels of stacked images (n, ..., H, W, 3): (n, blocks)."""
    shade = images.mean(axis=-1)
    h, w = shade.shape[-2:]
    cut = shade.reshape(*shade.shape[:-2], h // BLOCK, BLOCK, w // BLOCK, BLOCK).mean(
        axis=(-3, -1)
    )
    return cut.reshape(len(images), -1)


def differ(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether some block means of two stacks differ: Welch's |t| against Student's quantile, Bonferroni, level 0.1%.

    The bound holds however the blocks of an image depend on each other.
    """
    a, b = blocks(a), blocks(b)
    va, vb = a.var(0, ddof=1) / len(a), b.var(0, ddof=1) / len(b)
    spread = va + vb > 0  # black stays black in every seed
    va, vb, apart = va[spread], vb[spread], np.abs(a.mean(0) - b.mean(0))
    t = apart[spread] / np.sqrt(va + vb)
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return bool(
        (t > student.ppf(1 - 0.0005 / t.size, freedom)).any()
        or (apart[~spread] > 1e-6).any()
    )


def variance_ratio(of: np.ndarray, to: np.ndarray) -> tuple[float, float, float]:
    """The ratio of two mean squares over stacks of the same length, and its 99% limits by the jackknife of its log.

    `of`, `to`: stacks (n, ...) whose mean over all but the first axis are the squares' shares, by leaving one out.
    """
    n = len(of)
    logs = np.log(of / to)
    middle = logs.mean()
    half = student.ppf(0.995, n - 1) * np.sqrt(
        (n - 1) / n * ((logs - middle) ** 2).sum()
    )
    return (
        float(np.exp(middle)),
        float(np.exp(middle - half)),
        float(np.exp(middle + half)),
    )


def left_out(images: np.ndarray) -> np.ndarray:
    """Mean variance of a stack without its first image, without its second, ..."""
    return np.array(
        [
            np.delete(images, i, axis=0).var(axis=0, ddof=1).mean()
            for i in range(len(images))
        ]
    )


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_every_lens_equals_its_direct_image(grids, direct, index):
    assert not differ(grids[0][:, index], direct[:, index])


def test_the_comparison_detects_another_lens(grids, direct):
    names = list(LENSES)
    for a, b in (
        ("wide near", "wide far"),
        ("wide far", "wide near"),
        ("pinhole", "wide far"),
    ):
        assert differ(grids[0][:, names.index(a)], direct[:, names.index(b)])
    assert differ(
        grids[0][:, :1, 0], direct[:, :1, 1]
    )  # the left eye is not the right one


@pytest.fixture(scope="module")
def out_of_focus():
    """A lamp, a rig and two lenses, and the images through the wider one, rendered by itself."""
    scene, rig = (
        lamps([(0.0, 0.0, 2.5)], 0.05),
        tl.Rig([square_camera(24, 80.0)], [HERE]),
    )
    lenses = [tl.ThinLens(0.4, 1.0), tl.ThinLens(0.2, 1.0)]
    return (
        scene,
        rig,
        lenses,
        repeated(
            lambda seed: tl.render(scene, rig, lenses[0], spp=1024, seed=100 + seed)
        ),
    )


@pytest.mark.parametrize(
    ("factors", "same"),
    [
        ((1.0, 1.0), True),
        ((0.8, 3.2 / 3), False),
        pytest.param((1.0, 1.2), False, marks=pytest.mark.slow),
    ],
)
def test_weights_of_annuli_are_right_and_an_error_of_a_fifth_is_detected(
    monkeypatch, out_of_focus, factors, same
):
    """A lamp out of focus is an even disk of 19 pixels, of which the inner ring makes the inner half."""

    def askew(ring, radius):
        return area_fraction(ring, radius) * (
            factors[ring.inner > 0] if radius == 0.2 else 1.0
        )

    monkeypatch.setattr(lens_grid, "area_fraction", askew)
    scene, rig, lenses, alone = out_of_focus
    images = repeated(
        lambda seed: tl.render_lens_grid(scene, rig, lenses, spp=1024, seed=seed)[0]
    )
    assert differ(images, alone) != same


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_the_standard_error_bounds_the_error(grids, index):
    """The stated variance is that between seeds, or up to 1.5^2 times it, within its confidence limits."""
    images, stated = grids
    own = stated[:, index] ** 2
    estimated = np.array([np.delete(own, i, axis=0).mean() for i in range(REPEATS)])
    ratio, low, high = variance_ratio(estimated, left_out(images[:, index]))
    assert high >= 1.0, ratio
    assert low <= 1.5**2, ratio
    assert high / low < 3.5


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_the_error_is_about_that_of_the_direct_images(grids, direct, index):
    """What `spp` promises: not beyond their mean squared error, as confidently as the seeds tell it."""
    _, low, high = variance_ratio(
        left_out(grids[0][:, index]), left_out(direct[:, index])
    )
    assert low < 1.0
    assert high / low < 2.5


def test_bytes_depend_on_the_seed_and_not_on_the_threads(room):
    lenses = [LENSES["wide near"], LENSES["narrow far"], LENSES["pinhole"]]

    def taken(seed):
        return np.array(
            list(tl.render_lens_grid(room, RIG, lenses, spp=4, seed=seed))
        ).tobytes()

    usual, first = drjit.thread_count(), taken(5)
    try:
        for threads in (1, 3):
            drjit.set_thread_count(threads)
            assert taken(5) == first
    finally:
        drjit.set_thread_count(usual)
    assert taken(6) != first


@pytest.mark.parametrize(
    ("sampler", "spp"),
    [("multijitter", spp) for spp in (1, 2, 5, 64)]
    + [("independent", 1), ("stratified", 2), ("orthogonal", 5), ("ldsampler", 3)],
)
def test_every_sample_count_works_with_every_sampler(sampler, spp):
    """Samplers round counts up; uniform light stays uniform for every count."""
    lenses = [tl.ThinLens(0.1, 1.0), tl.ThinLens(0.07, 3.0)]
    grid = tl.render_lens_grid(sky(0.25), RIG, lenses, spp=spp, sampler=sampler)
    assert np.array(list(grid)) == pytest.approx(0.25, rel=1e-5)
    assert (
        np.isnan(grid.standard_error).all()
        if spp == 1
        else (grid.standard_error < 1e-4).all()
    )
    assert grid.rays >= 2 * spp * LEFT.width * LEFT.height


@pytest.mark.parametrize(
    ("camera", "lens"),
    [
        (LEFT.replace(distortion=BrownConrady(k1=-0.05)), tl.ThinLens(0.2, 2.0)),
        pytest.param(
            LEFT,
            tl.ThinLens(0.2, 2.0, Polygon(5, rotation_deg=10)),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["distortion", "polygon"],
)
def test_lenses_that_cannot_share_paths_are_rendered_separately(room, camera, lens):
    rig, lenses = tl.Rig([camera], [HERE]), [tl.ThinLens(0.2, 5.0), lens]
    grid = repeated(
        lambda seed: tl.render_lens_grid(room, rig, lenses, spp=SPP, seed=seed)[1]
    )
    alone = repeated(lambda seed: tl.render(room, rig, lens, spp=SPP, seed=100 + seed))
    assert not differ(grid, alone)
    one = tl.render_lens_grid(room, rig, lenses, spp=1, seed=0)
    assert np.isnan(one.standard_error).all()


@pytest.mark.parametrize("fall", [1.0, 1.1, 1.5])
def test_there_is_one_annulus_per_radius_with_enough_samples(fall):
    """Six apertures one stop apart, in units of one sample's variance: that of 64 direct samples."""
    lenses = [
        tl.ThinLens(0.1 / 2 ** (0.5 * stop), focus)
        for stop in range(6)
        for focus in (1.0, 2.0, 3.0, 4.0)
    ]
    rings = plan_annuli(lenses, 64)
    assert len(rings) == 6
    for lens in lenses:
        inside = [ring for ring in rings if ring.outer <= 0.5 * lens.aperture_diameter]
        shares = np.array([ring.outer**2 - ring.inner**2 for ring in inside]) / (
            0.25 * lens.aperture_diameter**2
        )
        assert shares.sum() == pytest.approx(1.0)
        variance = (
            shares**2 * np.array([float(ring.spp) for ring in inside]) ** -fall
        ).sum()
        assert variance <= 64**-fall * (1 + 1e-9)
        assert all(lens.vergence in ring.vergences for ring in inside)
    assert sum(ring.spp for ring in rings) < 4 * 64  # of 24 lenses


def test_an_empty_list_of_lenses_is_refused(room):
    with pytest.raises(InputError, match="at least one lens"):
        tl.render_lens_grid(room, RIG, [])


@pytest.mark.parametrize("radiance", [1e-12, 3.0, 1e8])
def test_light_of_any_strength_keeps_its_value(radiance):
    grid = tl.render_lens_grid(
        sky(radiance), RIG, [tl.ThinLens(0.1, 1.0), tl.ThinLens(0.07, 3.0)], spp=4
    )
    assert np.array(list(grid)) == pytest.approx(radiance, rel=1e-5)
    assert (grid.standard_error < 1e-5 * radiance).all()


@pytest.mark.parametrize("radiance", [np.nan, np.inf])
def test_non_finite_light_is_as_in_direct_images(monkeypatch, radiance):
    """Pixels whose rays meet such light are not finite; all others, and their errors, do not change."""
    lit = chequered_room()
    lenses = [LENSES["wide near"], LENSES["narrow far"]]
    clean = np.array(list(tl.render_lens_grid(lit, RIG, lenses, spp=4, seed=3)))
    sample = shared_paths.SharedPaths._radiance

    def spoilt(self, grid, *rest):
        colour = sample(self, grid, *rest)
        colour.x[(self.camera.width * 9 + 7) * grid[0] * grid[1]] = radiance
        return colour

    monkeypatch.setattr(shared_paths.SharedPaths, "_radiance", spoilt)
    grid = tl.render_lens_grid(lit, RIG, lenses, spp=4, seed=3)
    images = np.array(list(grid))
    bad = ~np.isfinite(images)
    assert 0 < bad.sum() < 20 * images.shape[0] * images.shape[1]
    assert (images[~bad] == clean[~bad]).all()
    assert np.isfinite(grid.standard_error).all()


@pytest.mark.slow
@pytest.mark.parametrize("spp", [1, 2])
def test_few_samples_have_the_right_mean(room, direct, spp):
    """Every pixel has samples of its own by construction: none is filled from others."""
    index = list(LENSES).index("wide far")
    lenses = list(LENSES.values())
    images = np.array(
        [
            tl.render_lens_grid(room, RIG, lenses, spp=spp, seed=seed)[index]
            for seed in range(24)
        ]
    )
    assert not differ(images.astype(np.float64), direct[:, index])


LISTS = {
    "one": [tl.ThinLens(0.4, 1.9)],
    "pinhole alone": [tl.Pinhole()],
    "infinity alone": [tl.ThinLens(0.2, np.inf)],
    "pinholes of two kinds": [tl.Pinhole(), tl.ThinLens(0.0, 2.0)],
    "equal apertures": [
        tl.ThinLens(0.2, 1.9),
        tl.ThinLens(0.2, 5.0),
        tl.BareAperture(0.2, 4.0),
    ],
    "the same twice": [
        tl.ThinLens(0.2, 1.9),
        tl.ThinLens(0.4, 1.9),
        tl.ThinLens(0.2, 1.9),
    ],
}


@pytest.mark.parametrize("name", LISTS)
def test_lists_of_every_kind(room, name):
    lenses, rig = LISTS[name], tl.Rig([LEFT], [HERE])
    grid = repeated(
        lambda seed: list(tl.render_lens_grid(room, rig, lenses, spp=8, seed=seed))
    )
    for i, lens in enumerate(lenses):
        assert not differ(
            grid[:, i],
            repeated(lambda seed, lens=lens: tl.render(room, rig, lens, 8, 100 + seed)),
        )
    if name == "the same twice":
        assert (grid[:, 0] == grid[:, 2]).all()


def test_other_apertures_do_not_stop_disks_from_sharing(room):
    rig, disks = (
        tl.Rig([LEFT], [HERE]),
        [tl.ThinLens(0.4, 1.9), tl.Pinhole(), tl.ThinLens(0.2, 5.0)],
    )
    shapes = [
        tl.ThinLens(0.3, 2.0, shape)
        for shape in (Polygon(5), Annulus(0.5), MaskAperture(np.eye(3)))
    ]
    both = tl.render_lens_grid(
        room,
        rig,
        [shapes[0], disks[0], shapes[1], disks[1], shapes[2], disks[2]],
        spp=8,
    )
    alone = tl.render_lens_grid(room, rig, disks, spp=8)
    assert [(both[2 * i + 1][0] == alone[i][0]).all() for i in range(3)] == [True] * 3
    assert both.rays == alone.rays + 3 * 8 * LEFT.width * LEFT.height
    assert (both.standard_error > 0).all()


def test_separate_lenses_have_a_standard_error(room):
    rig, lens = tl.Rig([LEFT], [HERE]), tl.ThinLens(0.3, 2.0, Polygon(5))
    grids = [
        tl.render_lens_grid(room, rig, [lens], spp=SPP, seed=seed)
        for seed in range(REPEATS)
    ]
    images = np.array([grid[0][0] for grid in grids], dtype=np.float64)
    own = np.array([grid.standard_error[0, 0] ** 2 for grid in grids])
    estimated = np.array([np.delete(own, i).mean() for i in range(REPEATS)])
    ratio, low, high = variance_ratio(estimated, left_out(images))
    assert high >= 1.0, ratio
    assert low <= 1.5**2, ratio
    assert high / low < 3.5


def test_a_bare_aperture_among_lenses_does_not_enlarge_the_film():
    """5 mm before a film 5 cm away shears by 45 pixels where the lenses shear by 2."""
    camera = tl.Camera.from_fov(640, 480, fov_x_deg=40)
    lenses = [
        tl.ThinLens(0.02 / 2 ** (0.5 * stop), z)
        for stop in range(6)
        for z in (1.2, 1.5, 2.0, 2.9)
    ]
    for ring in plan_annuli([*lenses, tl.BareAperture(0.005, 0.05)], 64):
        parts = split_vergences(ring, camera)
        assert sorted(k for part in parts for k in part.vergences) == sorted(
            ring.vergences
        )
        assert (
            sum(math.prod(part.film_size(camera)) for part in parts) <= 2.1 * 640 * 480
        )


def test_vergences_are_split_only_where_that_saves_film():
    camera = tl.Camera.from_fov(640, 480, fov_x_deg=40)
    for far in (0.4, 10.0, 1e3, 1e5):
        (ring,) = plan_annuli(
            [
                tl.ThinLens(0.02, 1.2),
                tl.ThinLens(0.02, 1.3),
                tl.ThinLens(0.02, 1 / far),
            ],
            4,
        )
        film = sum(
            math.prod(part.film_size(camera)) for part in split_vergences(ring, camera)
        )
        assert film <= 3 * 640 * 480  # one by one


PASSES = """
import resource, sys
sys.path.insert(0, sys.argv[1])
import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, sky
from twinlens.rendering import shared_paths
shared_paths.RAYS_PER_PASS = int(sys.argv[3])
rig = tl.Rig([tl.Camera.from_fov(384, 384, fov_x_deg=40)], [HERE])
grid = tl.render_lens_grid(sky(), rig, [tl.ThinLens(0.02, 2.0)], spp=int(sys.argv[2]))
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, grid.rays)
"""


@pytest.mark.slow
def test_memory_is_bounded_by_passes():
    """Four passes' worth of rays take what one pass takes, and more where they are traced at once."""

    def taken(spp, rays_a_pass):
        command = [
            sys.executable,
            "-c",
            PASSES,
            str(Path(__file__).parents[2]),
            str(spp),
            str(rays_a_pass),
        ]
        child = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert child.returncode == 0, child.stderr
        return [float(word) for word in child.stdout.split()]

    (one, rays), (four, more), (at_once, _) = (
        taken(48, 1 << 23),
        taken(192, 1 << 23),
        taken(192, 1 << 26),
    )
    assert rays < 1 << 23
    assert more == 4 * rays
    grown = at_once - one
    assert grown > 100  # megabytes
    assert four - one < 0.2 * grown
