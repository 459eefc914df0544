"""Focal stacks: views at many focus distances from one set of light paths."""

from collections.abc import Sequence

import numpy as np

from twinlens.camera import Rig, ThinLens
from twinlens.errors import InputError, format_value
from twinlens.optics import check_focus
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
    if np.ndim(focus_distances) != 1:
        raise InputError(
            f"focus_distances must be a list of metres, got {format_value(focus_distances)}"
        )
    for distance in focus_distances:
        check_focus(distance)
    lenses = [
        lens.replace(focus_distance=float(distance)) for distance in focus_distances
    ]
    return render_lens_grid(
        scene, rig, lenses, spp, seed, denoise=denoise, progress=progress
    )
