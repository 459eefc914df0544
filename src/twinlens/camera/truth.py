"""What one camera sees, exactly: the arrays of the ground truth and what follows from them without a scene.

Plain data between the rooms: `rendering` makes it, `dataset` writes it, `scoring` reads it. Never imports a renderer.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MATERIAL_KINDS = ("none", "diffuse", "glossy", "mirror", "transmissive")
"""What `Truth.material_kind` counts: its value is the index in this tuple; 0 where nothing was hit
(or an instance in a raw Mitsuba file, which does not tell)."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of one view, cast along the chief ray of each pixel's centre, never averaged. Arrays (H, W[, 3]).

    depth : float64, metres along the optical axis; +inf where nothing was hit.
    position : float64 (H, W, 3), world coordinates in metres; +inf where nothing was hit.
    disparity : float32, pixels, u_left - u_right towards the partner view; +inf where unknown, or where the pair is not
        rectified (then `position` projects into the partner).
    visible : bool, whether the point is seen by the partner view: inside its image and nothing in between.
    normal : float32 (H, W, 3), geometric unit normal in world coordinates, turned towards the camera; 0 where no hit.
    shading_normal : float32 (H, W, 3), the interpolated one that shading uses, turned likewise.
    object_id : int32, 0 where nothing was hit, else 1 + index into `object_names`.
    material_id : int32, 0 where nothing was hit, else 1 + index into `material_names`.
    material_kind : uint8, index into MATERIAL_KINDS.
    """

    depth: NDArray[np.float64]
    position: NDArray[np.float64]
    disparity: NDArray[np.float32]
    visible: NDArray[np.bool_]
    normal: NDArray[np.float32]
    shading_normal: NDArray[np.float32]
    object_id: NDArray[np.int32]
    material_id: NDArray[np.int32]
    material_kind: NDArray[np.uint8]
    object_names: tuple[str, ...]
    material_names: tuple[str, ...]

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Where the chief ray hits something, bool (H, W)."""
        hit: NDArray[np.bool_] = self.object_id > 0
        return hit

    def mask_nonocc(self) -> NDArray[np.uint8]:
        """Middlebury's mask, uint8 (H, W): 255 visible in both views, 128 occluded or out of frame, 0 unknown."""
        known = self.hit | np.isfinite(self.disparity)
        return np.where(self.visible & known, 255, np.where(known, 128, 0)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Where each pixel of one camera (the source) lies in the image of another (the target). Arrays (H, W[, 2]).

    pixels : float64 (H, W, 2), (u', v') in the target's image, its distortion included, also where the point is outside
        or occluded there; +inf where unknown: nothing was hit, or the point lies behind the target or beyond what its
        lens can form.
    visible : bool, whether the target sees the point: inside its image and nothing in between.
    disparity : float32, pixels, u_left - u_right where the two are a rectified pair in either order; +inf elsewhere.
    """

    pixels: NDArray[np.float64]
    visible: NDArray[np.bool_]
    disparity: NDArray[np.float32]
