"""Images of many lenses from one set of light paths equal those of each lens by itself, and know their own error."""

import os
import subprocess
import sys
from pathlib import Path

import drjit
import numpy as np
import pytest
from optics_lights import HERE, chequered_room, sky, square_camera

import twinlens as tl
from twinlens.camera import BrownConrady, Polygon
from twinlens.errors import InputError
from twinlens.rendering.rings import plan_rings

LEFT = tl.Camera(24, 18, fx=26.0, fy=31.0, cx=10.2, cy=9.1)  # pixels of two widths, off-centre
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
SPP, REPEATS, BLOCK = 16, 12, 6


@pytest.fixture(scope="module")
def room():
    return chequered_room()


def repeated(take) -> np.ndarray:
    """Stacked results for seeds 0, 1, ..., float64."""
    return np.array([take(seed) for seed in range(REPEATS)], dtype=np.float64)


@pytest.fixture(scope="module")
def grids(room):
    """[seed, lens, camera, y, x, channel], and the grids' own standard errors [seed, lens, camera]."""
    made = [tl.render_lens_grid(room, RIG, list(LENSES.values()), spp=SPP, seed=seed) for seed in range(REPEATS)]
    return np.array([list(grid) for grid in made], dtype=np.float64), np.array([grid.standard_error for grid in made])


@pytest.fixture(scope="module")
def direct(room):
    """The same, each lens by itself."""
    return repeated(lambda seed: [tl.render(room, RIG, lens, spp=SPP, seed=100 + seed) for lens in LENSES.values()])


def blocks(images: np.ndarray) -> np.ndarray:
    """Grey means of blocks of pixels of stacked images (n, ..., H, W, 3)."""
    shade = images.mean(axis=-1)
    h, w = shade.shape[-2:]
    return shade.reshape(*shade.shape[:-2], h // BLOCK, BLOCK, w // BLOCK, BLOCK).mean(axis=(-3, -1))


def z_squared(a: np.ndarray, b: np.ndarray) -> float:
    """Welch's t^2 between block means of two stacks, over its expectation nu/(nu - 2): about 1 for the same light."""
    a, b = blocks(a), blocks(b)
    t2 = (a.mean(0) - b.mean(0)) ** 2 / (a.var(0, ddof=1) / len(a) + b.var(0, ddof=1) / len(b))
    nu = len(a) + len(b) - 2
    return float(t2.mean() * (nu - 2) / nu)


# Blocks of one image share samples, so fewer than all 24 of both eyes count: with 12 the mean of t^2 scatters by 0.45.
SAME, OTHER = 2.2, 4.0


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_every_lens_sees_what_it_sees_by_itself(grids, direct, index):
    assert z_squared(grids[0][:, index], direct[:, index]) < SAME


def test_the_comparison_notices_another_lens(grids, direct):
    names = list(LENSES)
    for a, b in (("wide near", "wide far"), ("wide far", "wide near"), ("pinhole", "wide far")):
        assert z_squared(grids[0][:, names.index(a)], direct[:, names.index(b)]) > OTHER
    assert z_squared(grids[0][:, 0, 0], direct[:, 0, 1]) > OTHER  # the left eye is not the right one


@pytest.mark.parametrize("index", range(len(LENSES)), ids=list(LENSES))
def test_the_standard_error_is_the_error(grids, direct, index):
    """Within 30% of the distance from a reference of all other seeds' images, with the reference's own error off."""
    images, stated = grids
    for camera in (0, 1):
        measured = np.sqrt(images[:, index, camera].var(axis=0, ddof=1).mean())
        assert np.sqrt((stated[:, index, camera] ** 2).mean()) == pytest.approx(measured, rel=0.3)


def test_the_error_is_about_that_of_the_direct_images(grids, direct):
    """At most 1.5 times their mean squared error, as a few seeds tell it: what `spp` promises."""
    ratio = grids[0].var(axis=0, ddof=1).mean(axis=(1, 2, 3, 4)) / direct.var(axis=0, ddof=1).mean(axis=(1, 2, 3, 4))
    assert ratio.max() < 1.5


def test_bytes_depend_on_the_seed_and_not_on_the_threads(room):
    lenses = [LENSES["wide near"], LENSES["narrow far"], LENSES["pinhole"]]

    def taken(seed):
        return np.array(list(tl.render_lens_grid(room, RIG, lenses, spp=4, seed=seed))).tobytes()

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
def test_any_count_of_any_sampler_is_taken(sampler, spp):
    """Samplers round counts up; an even light comes out even, whatever they take."""
    lenses = [tl.ThinLens(0.1, 1.0), tl.ThinLens(0.07, 3.0)]
    grid = tl.render_lens_grid(sky(0.25), RIG, lenses, spp=spp, sampler=sampler)
    assert np.array(list(grid)) == pytest.approx(0.25, rel=1e-5)
    assert np.isnan(grid.standard_error).all() if spp == 1 else (grid.standard_error < 1e-4).all()
    assert grid.rays >= 2 * spp * LEFT.width * LEFT.height


@pytest.mark.parametrize(
    ("camera", "lens"),
    [
        (LEFT.replace(distortion=BrownConrady(k1=-0.05)), tl.ThinLens(0.2, 2.0)),
        (LEFT, tl.ThinLens(0.2, 2.0, Polygon(5, rotation_deg=10))),
    ],
    ids=["distortion", "polygon"],
)
def test_what_cannot_share_paths_is_rendered_lens_by_lens(room, camera, lens):
    rig, lenses = tl.Rig([camera], [HERE]), [tl.ThinLens(0.2, 5.0), lens]
    grid = repeated(lambda seed: tl.render_lens_grid(room, rig, lenses, spp=SPP, seed=seed)[1])
    alone = repeated(lambda seed: tl.render(room, rig, lens, spp=SPP, seed=100 + seed))
    assert z_squared(grid, alone) < SAME
    one = tl.render_lens_grid(room, rig, lenses, spp=1, seed=0)
    assert np.isnan(one.standard_error).all()
    assert one.rays == 2 * camera.width * camera.height


SCALAR = """
import sys
import numpy as np
sys.path.insert(0, sys.argv[1])
import twinlens as tl
from optics_lights import chequered_room, square_camera
rig = tl.Rig.stereo(square_camera(18, 26.0), 0.1)
lenses = [tl.Pinhole(), tl.ThinLens(0.2, 2.0)]
grids = [tl.render_lens_grid(chequered_room(), rig, lenses, spp=16, seed=seed) for seed in range(12)]
assert np.isnan(grids[0].standard_error).all()
np.save(sys.argv[2], [list(grid) for grid in grids])
"""


def test_the_scalar_backend_renders_lens_by_lens(room, tmp_path):
    """In a process of its own; the same light as the direct images of this one."""
    file = tmp_path / "grid.npy"
    command = [sys.executable, "-c", SCALAR, str(Path(__file__).parent), str(file)]
    child = subprocess.run(
        command, env={**os.environ, "TWINLENS_BACKEND": "scalar"}, capture_output=True, text=True, timeout=300
    )
    assert child.returncode == 0, child.stderr
    scalar = np.load(file).astype(np.float64)
    rig = tl.Rig.stereo(square_camera(18, 26.0), 0.1)
    for i, lens in enumerate((tl.Pinhole(), tl.ThinLens(0.2, 2.0))):
        direct = repeated(lambda seed, lens=lens: tl.render(room, rig, lens, spp=16, seed=100 + seed))
        assert z_squared(scalar[:, i], direct) < SAME


@pytest.mark.parametrize("fall", [1.0, 1.25, 1.5])
def test_rings_are_as_many_as_radii_and_give_each_lens_its_error(fall):
    """Six apertures one stop apart, in units of one sample's variance, two passes a ring: that of 64 direct samples."""
    lenses = [tl.ThinLens(0.1 / 2 ** (0.5 * stop), focus) for stop in range(6) for focus in (1.0, 2.0, 3.0, 4.0)]
    rings = plan_rings(lenses, 64, fall)
    assert len(rings) == 6
    for lens in lenses:
        inside = [ring for ring in rings if ring.outer <= 0.5 * lens.aperture_diameter]
        shares = np.array([ring.area for ring in inside]) / (0.25 * lens.aperture_diameter**2)
        assert shares.sum() == pytest.approx(1.0)
        passes = np.array([ring.spp / 2 for ring in inside])
        variance = (shares**2 * passes**-fall / 2).sum()
        assert 0.85 * 64**-fall < variance <= 64**-fall * (1 + 1e-9)
        assert all(lens.vergence in ring.vergences for ring in inside)


def test_an_empty_list_of_lenses_is_refused(room):
    with pytest.raises(InputError, match="at least one lens"):
        tl.render_lens_grid(room, RIG, [])
