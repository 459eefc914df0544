"""A depth map with its camera and image, from matched or true disparities: the input of every reconstruction."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera import Camera, Rig, Truth
from twinlens.camera.film import rgb8
from twinlens.errors import InputError
from twinlens.geometry import Float, check_rigid, depth_from_disparity


@dataclass(frozen=True, eq=False)
class DepthView:
    """A depth map and its image.

    camera : Camera, with any distortion. world_from_cam : (4, 4).
    depth : float64 (H, W), metres along the axis, > 0; +inf where unknown.
    image : uint8 (H, W, 3), or None.

    Raises InputError when an array does not fit the camera, or a depth is NaN or not positive.
    """

    camera: Camera
    world_from_cam: Float
    depth: Float
    image: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "world_from_cam", check_rigid(self.world_from_cam, "world_from_cam"))
        depth = np.asarray(self.depth, dtype=np.float64)
        size = self.camera.height, self.camera.width
        if depth.shape != size or (self.image is not None and self.image.shape != (*size, 3)):
            image = None if self.image is None else self.image.shape
            raise InputError(f"a view of {size} pixels needs depth (H, W), image (H, W, 3); got {depth.shape}, {image}")
        if not (depth > 0).all():
            raise InputError("depths must be positive, or +inf where unknown; got NaN or values <= 0")
        object.__setattr__(self, "depth", depth)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where the depth is known, bool (H, W)."""
        return np.isfinite(self.depth)

    @property
    def rig(self) -> Rig:
        """The camera as a rig of one."""
        return Rig([self.camera], [self.world_from_cam])

    def positions(self) -> Float:
        """World coordinates (H, W, 3) of every pixel, metres; +inf where unknown."""
        depth = np.where(self.known, self.depth, 1.0)
        points = self.rig.unproject(0, self.camera.pixel_grid(), depth)
        return np.where(self.known[..., None], points, np.inf)


def view_of_truth(truth: Truth, rig: Rig, index: int, image: NDArray[Any] | None = None) -> DepthView:
    """The true depths of camera `index`, with its image, uint8 or uint16 (H, W[, 3])."""
    return DepthView(
        rig.cameras[index], rig.world_from_cams[index], truth.depth, None if image is None else rgb8(image)
    )


def view_of_disparity(
    disparity: ArrayLike, rig: Rig, left: int = 0, right: int = 1, image: NDArray[Any] | None = None
) -> DepthView:
    """Depths z = fx B / (d + doffs) of the left view of a rectified pair, from its disparity map (H, W), +inf unknown.

    A disparity of -doffs or less, at or beyond infinity, gives an unknown depth. Raises InputError unless the pair is
    rectified, and for NaN or -inf.
    """
    values = np.asarray(disparity, dtype=np.float64)
    if not rig.is_rectified(left, right):
        raise InputError(f"cameras {left} and {right} are not a rectified pair in this order: rectify them first")
    if np.isnan(values).any() or np.isneginf(values).any():
        raise InputError("unknown disparities must be +inf, got NaN or -inf")
    doffs = rig.doffs(left, right)
    finite = np.where(values + doffs > 0, values, np.inf)
    depth = depth_from_disparity(finite, rig.cameras[left].fx, rig.baseline(left, right), doffs)
    return DepthView(rig.cameras[left], rig.world_from_cams[left], depth, None if image is None else rgb8(image))
