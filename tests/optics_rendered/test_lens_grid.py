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
from twinlens.rendering import backend, lens_grid, shared_paths
from twinlens.rendering.annuli import area_fraction, plan_annuli

backend()
import drjit  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported

LEFT = tl.Camera(24, 18, fx=26.0, fy=31.0, cx=10.2, cy=9.1)
"""Pixels of two widths, off-centre."""

RIG = tl.Rig.stereo(LEFT, 0.1, right=LEFT.replace(cx=13.7))  # doffs = 3.5
ALONE = tl.Rig([LEFT], [HERE])
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
    lenses = list(LENSES.values())
    made = [
        tl.render_lens_grid(room, RIG, lenses, spp=SPP, seed=seed)
        for seed in range(REPEATS)
    ]
    images = np.array([list(grid) for grid in made], dtype=np.float64)
    return images, np.array([grid.standard_error for grid in made])


@pytest.fixture(scope="module")
def direct(room):
    """The same, each lens by itself."""

    def images(seed):
        return [tl.render(room, RIG, lens, SPP, 100 + seed) for lens in LENSES.values()]

    return repeated(images)


def blocks(images: np.ndarray) -> np.ndarray:
    """Grey means of blocks of pixels of stacked images (n, ..., H, W, 3): (n, blocks)."""
    shade = images.mean(axis=-1)
    h, w = shade.shape[-2:]
    cut = shade.reshape(*shade.shape[:-2], h // BLOCK, BLOCK, w // BLOCK, BLOCK)
    return cut.mean(axis=(-3, -1)).reshape(len(images), -1)


def differ(a: np.ndarray, b: np.ndarray) -> bool:
    """Whether some block means of two stacks differ: Welch's |t| against Student's quantile, Bonferroni, level 0.1%.

    The bound holds however the blocks of an image depend on each other.
    """
    a, b = blocks(a), blocks(b)
    va = a.var(0, ddof=1) / len(a)
    vb = b.var(0, ddof=1) / len(b)
    apart = np.abs(a.mean(0) - b.mean(0))
    varies = va + vb > 0  # black stays black in every seed
    if (apart[~varies] > 1e-6).any():
        return True
    va, vb = va[varies], vb[varies]
    t = apart[varies] / np.sqrt(va + vb)
    freedom = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return bool((t > student.ppf(1 - 0.0005 / t.size, freedom)).any())


def variance_ratio(of: np.ndarray, to: np.ndarray) -> tuple[float, float]:
    """The 99% limits of the ratio of two mean squares over stacks of the same length, by the jackknife of its log.

    `of`, `to`: the mean squares with each member of the stacks left out once.
    """
    n = len(of)
    logs = np.log(of / to)
    middle = logs.mean()
    deviation = np.sqrt((n - 1) / n * ((logs - middle) ** 2).sum())
    half = student.ppf(0.995, n - 1) * deviation
    return math.exp(middle - half), math.exp(middle + half)


def left_out(images: np.ndarray) -> np.ndarray:
    """Mean variance of a stack without its first image, without its second, ..."""
    stacks = (np.delete(images, i, axis=0) for i in range(len(images)))
    return np.array([stack.var(axis=0, ddof=1).mean() for stack in stacks])


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_every_lens_equals_its_direct_image(grids, direct, index):
    """Its error is about that of the direct image, which is what `spp` promises."""
    of_grid = grids[0][:, index]
    alone = direct[:, index]
    assert not differ(of_grid, alone)
    low, high = variance_ratio(left_out(of_grid), left_out(alone))
    assert low < 1.0
    assert high / low < 2.5


def test_the_comparison_detects_another_lens_and_the_other_camera(grids, direct):
    images = grids[0]
    names = list(LENSES)
    for a, b in (("wide near", "wide far"), ("pinhole", "wide far")):
        assert differ(images[:, names.index(a)], direct[:, names.index(b)])
    assert differ(images[:, :1, 0], direct[:, :1, 1])


@pytest.fixture(scope="module")
def out_of_focus():
    """A lamp, a rig and two lenses, and the images through the wider one, rendered by itself."""
    scene = lamps([(0.0, 0.0, 2.5)], 0.05)
    rig = tl.Rig([square_camera(24, 80.0)], [HERE])
    lenses = [tl.ThinLens(0.4, 1.0), tl.ThinLens(0.2, 1.0)]

    def images(seed):
        return tl.render(scene, rig, lenses[0], spp=256, seed=100 + seed)

    return scene, rig, lenses, repeated(images)


@pytest.mark.parametrize(
    ("factors", "same"), [((1.0, 1.0), True), ((0.8, 3.2 / 3), False)]
)
def test_weights_of_annuli_are_right_and_an_error_of_a_fifth_is_detected(
    monkeypatch, out_of_focus, factors, same
):
    """A lamp out of focus is an even disk of 19 pixels, of which the inner ring makes the inner half."""

    def askew(ring, radius):
        factor = factors[ring.inner > 0] if radius == 0.2 else 1.0
        return area_fraction(ring, radius) * factor

    monkeypatch.setattr(lens_grid, "area_fraction", askew)
    scene, rig, lenses, alone = out_of_focus

    def images(seed):
        return tl.render_lens_grid(scene, rig, lenses, spp=256, seed=seed)[0]

    assert differ(repeated(images), alone) != same


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_the_standard_error_bounds_the_error(grids, index):
    """The stated variance is that between seeds, or up to 1.5^2 times it, within its confidence limits."""
    images, stated = grids
    variances = stated[:, index] ** 2
    estimated = [np.delete(variances, i, axis=0).mean() for i in range(REPEATS)]
    low, high = variance_ratio(np.array(estimated), left_out(images[:, index]))
    assert high >= 1.0
    assert low <= 1.5**2
    assert high / low < 3.5


def test_bytes_depend_on_the_seed_and_not_on_the_threads(room):
    lenses = [LENSES["wide near"], LENSES["narrow far"], LENSES["pinhole"]]

    def taken(seed):
        grid = tl.render_lens_grid(room, RIG, lenses, spp=4, seed=seed)
        return np.array(list(grid)).tobytes()

    usual = drjit.thread_count()
    first = taken(5)
    try:
        for threads in (1, 3):
            drjit.set_thread_count(threads)
            assert taken(5) == first
    finally:
        drjit.set_thread_count(usual)
    assert taken(6) != first


@pytest.mark.parametrize(
    ("sampler", "spp", "radiance"),
    [
        ("multijitter", 1, 0.25),
        ("multijitter", 2, 1e-12),
        ("multijitter", 64, 1e8),
        ("independent", 1, 3.0),
        ("stratified", 2, 3.0),
        ("orthogonal", 5, 3.0),
        ("ldsampler", 3, 3.0),
    ],
)
def test_uniform_light_keeps_its_value(sampler, spp, radiance):
    """For every sampler, although some round counts up, and for light of any strength."""
    lenses = [tl.ThinLens(0.1, 1.0), tl.ThinLens(0.07, 3.0)]
    grid = tl.render_lens_grid(sky(radiance), RIG, lenses, spp=spp, sampler=sampler)
    assert np.array(list(grid)) == pytest.approx(radiance, rel=1e-5)
    assert grid.rays >= 2 * spp * LEFT.width * LEFT.height
    if spp == 1:
        assert np.isnan(grid.standard_error).all()
    else:
        assert (grid.standard_error < 1e-4 * radiance).all()


POLYGON = tl.ThinLens(0.2, 2.0, Polygon(5, rotation_deg=10))


@pytest.mark.parametrize(
    ("camera", "lens"),
    [
        (LEFT.replace(distortion=BrownConrady(k1=-0.05)), tl.ThinLens(0.2, 2.0)),
        pytest.param(LEFT, POLYGON, marks=pytest.mark.slow),
    ],
    ids=["distortion", "polygon"],
)
def test_lenses_that_cannot_share_paths_are_rendered_separately(room, camera, lens):
    rig = tl.Rig([camera], [HERE])
    lenses = [tl.ThinLens(0.2, 5.0), lens]

    def of_grid(seed):
        return tl.render_lens_grid(room, rig, lenses, spp=SPP, seed=seed)[1]

    def alone(seed):
        return tl.render(room, rig, lens, spp=SPP, seed=100 + seed)

    assert not differ(repeated(of_grid), repeated(alone))
    one = tl.render_lens_grid(room, rig, lenses, spp=1, seed=0)
    assert np.isnan(one.standard_error).all()


@pytest.mark.parametrize("fall", [1.0, 1.5])
def test_there_is_one_annulus_per_radius_with_enough_samples(fall):
    """Six apertures one stop apart, in units of one sample's variance: that of 64 direct samples."""
    diameters = [0.1 / 2 ** (0.5 * stop) for stop in range(6)]
    lenses = [tl.ThinLens(d, focus) for d in diameters for focus in (1.0, 2.0, 3.0)]
    rings = plan_annuli(lenses, 64)
    assert len(rings) == 6
    for lens in lenses:
        radius = 0.5 * lens.aperture_diameter
        inside = [ring for ring in rings if ring.outer <= radius]
        areas = np.array([ring.outer**2 - ring.inner**2 for ring in inside])
        shares = areas / radius**2
        assert shares.sum() == pytest.approx(1.0)
        samples = np.array([float(ring.spp) for ring in inside])
        variance = (shares**2 * samples**-fall).sum()
        assert variance <= 64**-fall * (1 + 1e-9)
        assert all(lens.vergence in ring.vergences for ring in inside)
    assert sum(ring.spp for ring in rings) < 4 * 64  # of 18 lenses


@pytest.mark.parametrize("radiance", [np.nan, np.inf])
def test_non_finite_light_is_as_in_direct_images(monkeypatch, room, radiance):
    """Pixels whose rays meet such light are not finite; all others, and their errors, do not change."""
    lenses = [LENSES["wide near"], LENSES["narrow far"]]

    def rendered():
        return tl.render_lens_grid(room, RIG, lenses, spp=4, seed=3)

    clean = np.array(list(rendered()))
    sample = shared_paths.SharedPaths._radiance

    def spoilt(self, grid, *rest):
        colour = sample(self, grid, *rest)
        colour.x[(self.camera.width * 9 + 7) * grid[0] * grid[1]] = radiance
        return colour

    monkeypatch.setattr(shared_paths.SharedPaths, "_radiance", spoilt)
    grid = rendered()
    images = np.array(list(grid))
    bad = ~np.isfinite(images)
    assert 0 < bad.sum() < 20 * images.shape[0] * images.shape[1]
    assert (images[~bad] == clean[~bad]).all()
    assert np.isfinite(grid.standard_error).all()


WIDE = LENSES["wide near"]
NARROW = LENSES["narrow near"]
LISTS = {
    "one": [WIDE],
    "pinhole alone": [tl.Pinhole()],
    "infinity alone": [LENSES["infinity"]],
    "pinholes of two kinds": [tl.Pinhole(), tl.ThinLens(0.0, 2.0)],
    "equal apertures": [NARROW, LENSES["narrow far"], tl.BareAperture(0.2, 4.0)],
    "the same twice": [NARROW, WIDE, NARROW],
}


@pytest.mark.parametrize("name", LISTS)
def test_lists_of_every_kind(room, name):
    lenses = LISTS[name]

    def of_grid(seed):
        return list(tl.render_lens_grid(room, ALONE, lenses, spp=8, seed=seed))

    def alone(seed):
        return [tl.render(room, ALONE, lens, 8, 100 + seed) for lens in lenses]

    images = repeated(of_grid)
    expected = repeated(alone)
    for index in range(len(lenses)):
        assert not differ(images[:, index], expected[:, index])
    if name == "the same twice":
        assert (images[:, 0] == images[:, 2]).all()


def test_other_apertures_do_not_stop_disks_from_sharing(room):
    disks = [WIDE, tl.Pinhole(), LENSES["narrow far"]]
    apertures = Polygon(5), Annulus(0.5), MaskAperture(np.eye(3))
    mixed = []
    for disk, aperture in zip(disks, apertures, strict=True):
        mixed += [tl.ThinLens(0.3, 2.0, aperture), disk]
    both = tl.render_lens_grid(room, ALONE, mixed, spp=8)
    alone = tl.render_lens_grid(room, ALONE, disks, spp=8)
    for index in range(3):
        assert (both[2 * index + 1][0] == alone[index][0]).all()
    assert both.rays == alone.rays + 3 * 8 * LEFT.width * LEFT.height
    assert (both.standard_error > 0).all()


PASSES = """
import re, sys
from pathlib import Path
sys.path.insert(0, sys.argv[1])
import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, sky
from twinlens.rendering import shared_paths
shared_paths.PATHS_PER_PASS = int(sys.argv[3])
rig = tl.Rig([tl.Camera.from_fov(384, 384, fov_x_deg=40)], [HERE])
grid = tl.render_lens_grid(sky(), rig, [tl.ThinLens(0.02, 2.0)], spp=int(sys.argv[2]))
peak = re.search(r"VmHWM:\\s+(\\d+) kB", Path("/proc/self/status").read_text())
print(int(peak[1]) / 1024, grid.rays)
"""


@pytest.mark.slow
def test_memory_is_bounded_by_passes():
    """Four passes' worth of rays take what one pass takes, and more where they are traced at once.

    Linux' peak of the process itself: that of `resource.getrusage` is at least that of the process which started it.
    """

    def taken(spp, rays_a_pass):
        arguments = [str(Path(__file__).parents[2]), str(spp), str(rays_a_pass)]
        command = [sys.executable, "-c", PASSES, *arguments]
        child = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert child.returncode == 0, child.stderr
        return [float(word) for word in child.stdout.split()]

    one, rays = taken(48, 1 << 23)
    four, more = taken(192, 1 << 23)
    at_once, _ = taken(192, 1 << 26)
    assert rays < 1 << 23
    assert more == 4 * rays
    grown = at_once - one
    assert grown > 100  # megabytes
    assert four - one < 0.2 * grown
