"""A depth map and the camera that it belongs to: what every reconstruction starts from, matched or true."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens import geometry
from twinlens.camera import Camera, Rig
from twinlens.camera.truth import Truth
from twinlens.errors import InputError
from twinlens.geometry import Float


@dataclass(frozen=True, eq=False)
class DepthView:
    """Depths as one camera has them, and what it photographed.

    camera : Camera, of any distortion. world_from_cam : (4, 4).
    depth : float64 (H, W), metres along the axis, > 0; +inf where unknown.
    image : uint8 (H, W, 3), or None.

    Raises InputError when an array does not fit the camera, or a depth is NaN or not positive.
    """

    camera: Camera
    world_from_cam: Float
    depth: Float
    image: NDArray[np.uint8] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "world_from_cam", geometry.check_rigid(self.world_from_cam, "world_from_cam"))
        depth = np.asarray(self.depth, dtype=np.float64)
        size = self.camera.height, self.camera.width
        if depth.shape != size or (self.image is not None and self.image.shape != (*size, 3)):
            image = None if self.image is None else self.image.shape
            raise InputError(f"a view of {size} pixels needs depth (H, W), image (H, W, 3); got {depth.shape}, {image}")
        if not (depth > 0).all():
            raise InputError("depths must be positive, +inf where unknown; NaN and values <= 0 are refused")
        object.__setattr__(self, "depth", depth)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Where there is a depth, bool (H, W)."""
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
    """Camera `index`'s true depths."""
    return DepthView(rig.cameras[index], rig.world_from_cams[index], truth.depth, _eight_bits(image))


def view_of_disparity(
    disparity: ArrayLike, rig: Rig, left: int = 0, right: int = 1, image: NDArray[Any] | None = None
) -> DepthView:
    """The left view's depths z = fx B / (d + doffs) of a rectified pair's left disparity map (H, W), +inf unknown.

    A disparity of -doffs or less is at infinity or beyond: unknown. Raises InputError where the pair is not rectified,
    or the map holds NaN or -inf.
    """
    values = np.asarray(disparity, dtype=np.float64)
    if not rig.is_rectified(left, right):
        raise InputError(f"cameras {left} and {right} are no rectified pair in this order: rectify them first")
    if np.isnan(values).any() or np.isneginf(values).any():
        raise InputError("a disparity map holds +inf where unknown; NaN and -inf are refused")
    doffs = rig.doffs(left, right)
    ahead = np.where(values + doffs > 0, values, np.inf)
    depth = geometry.depth_from_disparity(ahead, rig.cameras[left].fx, rig.baseline(left, right), doffs)
    return DepthView(rig.cameras[left], rig.world_from_cams[left], depth, _eight_bits(image))


def _eight_bits(image: NDArray[Any] | None) -> NDArray[np.uint8] | None:
    if image is None:
        return None
    eight = (image >> 8).astype(np.uint8) if image.dtype == np.uint16 else image.astype(np.uint8)
    return np.repeat(eight[..., None], 3, axis=2) if eight.ndim == 2 else eight
