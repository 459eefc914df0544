"""Ground truth as arrays. `rendering` computes it, `dataset` stores it, `scoring` reads it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MATERIAL_KINDS = ("none", "diffuse", "glossy", "mirror", "transmissive")
"""Names of the values of `Truth.material_kind`, by index; 0 where nothing was hit, and for instances in a Mitsuba
file, whose material is unknown."""


@dataclass(frozen=True, eq=False)
class Truth:
    """Ground truth of one view, along the chief ray through each pixel's centre, not averaged. Arrays (H, W[, 3]).

    depth : float64, metres along the optical axis; +inf where nothing was hit.
    position : float64 (H, W, 3), world coordinates in metres; +inf where nothing was hit.
    disparity : float32, pixels, u_left - u_right towards the partner view; +inf where unknown or not rectified.
    visible : bool, whether the partner view sees the point: inside its image and not occluded.
    normal : float32 (H, W, 3), geometric unit normal in world coordinates, towards the camera; 0 where nothing was hit.
    shading_normal : float32 (H, W, 3), the interpolated normal used for shading, oriented in the same way.
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
        return np.asarray(self.object_id > 0)

    def mask_nonocc(self) -> NDArray[np.uint8]:
        """Middlebury's mask, uint8 (H, W): 255 visible in both views, 128 occluded or out of frame, 0 unknown."""
        known = self.hit | np.isfinite(self.disparity)
        return np.where(self.visible & known, 255, np.where(known, 128, 0)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The pixel in one camera (the target) of each pixel of another (the source). Arrays (H, W[, 2]).

    pixels : float64 (H, W, 2), (u', v') in the target's image, distorted, also where the point is outside the image or
        occluded; +inf where nothing was hit, or the point is behind the target or beyond its distortion's range.
    visible : bool, whether the target sees the point: inside its image and not occluded.
    disparity : float32, pixels, u_left - u_right where the two are a rectified pair in either order; +inf elsewhere.
    """

    pixels: NDArray[np.float64]
    visible: NDArray[np.bool_]
    disparity: NDArray[np.float32]
