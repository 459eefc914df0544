"""Focal stacks: one view at many focus distances from one set of light paths, their sharpness, the image in focus."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import correlate1d, uniform_filter

from twinlens.camera import Rig, ThinLens
from twinlens.errors import InputError, check_int, format_value
from twinlens.geometry import Float
from twinlens.rendering.lens_grid import LensGrid, render_lens_grid
from twinlens.rendering.radiance import Progress
from twinlens.scenes import Scene


def focal_stack(
    scene: Scene,
    rig: Rig,
    lens: ThinLens,
    focus_distances: Sequence[float],
    spp: int = 64,
    seed: int = 0,
    *,
    denoise: bool = False,
    progress: Progress | None = None,
) -> LensGrid:
    """Render `scene` through `lens` focused at each of `focus_distances` (metres), as `render_lens_grid`.

    Returns images[i_focus][i_camera]. Changing the focus does not move the image: there is no focus breathing. Raises
    InputError unless `lens` is a ThinLens, and as `render_lens_grid`.
    """
    if not isinstance(lens, ThinLens):
        raise InputError(f"a focal stack needs a ThinLens, got {format_value(lens)}")
    lenses = [lens.replace(focus_distance=float(distance)) for distance in focus_distances]
    return render_lens_grid(scene, rig, lenses, spp, seed, denoise=denoise, progress=progress)


def sharpness(image: ArrayLike, window: int = 9) -> Float:
    """The sum-modified Laplacian |2I - I(x-1) - I(x+1)| + |2I - I(y-1) - I(y+1)|, float64 (H, W), without threshold.

    `image` is (H, W) or (H, W, 3), of which the channels are averaged first; the sum is over `window` x `window`
    pixels, an odd number. Images are reflected at their border. Raises InputError for another window.

    Source: Nayar and Nakagawa, Shape from focus, 1994.
    """
    check_int("window", window, 1)
    if window % 2 == 0:
        raise InputError(f"window must be odd, got {window}")
    pixels = np.asarray(image, dtype=np.float64)
    grey = pixels.mean(axis=-1) if pixels.ndim == 3 else pixels
    modified = sum(np.abs(correlate1d(grey, [-1.0, 2.0, -1.0], axis=axis)) for axis in (0, 1))
    total: Float = window**2 * uniform_filter(modified, window)
    return total


def all_in_focus(images: Sequence[ArrayLike], window: int = 9) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """The image of the sharpest pixels of one camera's focal stack, and the number (H, W) of each pixel's image."""
    stack = np.asarray(images, dtype=np.float32)
    sharpest = np.argmax([sharpness(image, window) for image in stack], axis=0)
    rows, columns = np.indices(sharpest.shape)
    return stack[sharpest, rows, columns], sharpest
