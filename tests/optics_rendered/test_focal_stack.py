"""Focal stacks: they are the lens grid's images, and the sharpness of a plane peaks where the lens is focused on it."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

import twinlens as tl
from tests.optics_rendered.optics_lights import HERE, chequered_room
from twinlens.errors import InputError

CAMERA = tl.Camera(64, 48, 70.0, 70.0, 31.5, 23.5)
RIG = tl.Rig([CAMERA], [HERE])


def test_sharpness_is_the_sum_modified_laplacian():
    image = np.random.default_rng(0).uniform(size=(12, 10))
    measured = tl.sharpness(image, 3)
    expected = 0.0
    for v in range(4, 7):
        for u in range(3, 6):
            x = image[v, u - 1] + image[v, u + 1]
            y = image[v - 1, u] + image[v + 1, u]
            expected += abs(2 * image[v, u] - x) + abs(2 * image[v, u] - y)
    assert measured[5, 4] == pytest.approx(expected)
    np.testing.assert_allclose(
        tl.sharpness(np.stack([image] * 3, axis=-1), 3), measured
    )
    with pytest.raises(InputError, match="odd"):
        tl.sharpness(image, 4)


def test_sharpness_of_a_wall_peaks_at_its_focus():
    """The wall of the room is at 5 m; pixels whose windows and blur reach a nearer object are left out."""
    focuses = [2.0, 3.0, 5.0, 9.0, 20.0]
    scene = chequered_room()
    lens = tl.ThinLens(0.2, 1.0)
    stack = [images[0] for images in tl.focal_stack(scene, RIG, lens, focuses, 64, 1)]
    lenses = [lens.replace(focus_distance=focus) for focus in focuses]
    grid = tl.render_lens_grid(scene, RIG, lenses, spp=64, seed=1)
    np.testing.assert_array_equal(stack, [images[0] for images in grid])
    is_wall = np.isclose(tl.ground_truth(scene, RIG)[0].depth, 5.0)
    wall = binary_erosion(is_wall, iterations=10, border_value=1)
    assert wall.sum() > 200
    means = [tl.sharpness(image)[wall].mean() for image in stack]
    assert int(np.argmax(means)) == 2
    sharp, index = tl.all_in_focus(stack)
    assert sharp.shape == stack[0].shape
    assert (index[wall] == 2).mean() > 0.7
    pinhole = tl.render(scene, RIG, spp=64, seed=2)[0]
    of_sharp, of_near, of_far = (
        np.mean((image - pinhole)[wall] ** 2) for image in (sharp, stack[0], stack[4])
    )
    assert of_sharp < 0.5 * min(of_near, of_far)


STACKS = [[1.0, np.nan], [0.0], [None], ["near"], 1.0, []]
APART = [np.zeros((4, 4)), np.zeros((5, 4))]
IMAGES = [[], None, "near", APART, np.zeros((2, 4, 4, 2)), [np.full((4, 4), np.nan)]]


@pytest.mark.parametrize("distances", STACKS)
def test_a_stack_needs_distances(distances):
    with pytest.raises(InputError, match=r"focus_distance|at least one lens"):
        tl.focal_stack(chequered_room(), RIG, tl.ThinLens(0.2, 1.0), distances)


def test_a_stack_needs_a_lens():
    with pytest.raises(InputError, match="needs a ThinLens"):
        tl.focal_stack(chequered_room(), RIG, tl.Pinhole(), [1.0])


@pytest.mark.parametrize("images", IMAGES)
def test_what_is_no_stack_is_refused(images):
    with pytest.raises(InputError, match="one or more images"):
        tl.all_in_focus(images)
