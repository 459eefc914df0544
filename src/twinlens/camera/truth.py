"""Ground truth as arrays. `rendering` computes it, `dataset` stores it, `scoring` reads it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.camera.masks import decode_mask
from twinlens.errors import InputError
from twinlens.geometry import Float, check_rigid

MATERIAL_KINDS = ("none", "diffuse", "glossy", "mirror", "transmissive")
"""Names of the values of `Truth.material_kind`, by index; 0 where nothing was hit, and for instances in a Mitsuba
file, whose material is unknown."""


@dataclass(frozen=True, eq=False)
class ObjectTruth:
    """An object in one view, with the parts that other objects hide. It covers the pixels whose chief rays hit it.

    Pixels outside the image count too, unless the object reaches behind the camera, or farther than the image's width
    to the left or right of the image or its height above or below it. Of such an object, only those in the image count.
    Boxes of pixels are (u, v, width, height): the first pixel, and the number of pixels; all 0 if there are none.

    object_id : 1 + index into `Truth.object_names`.
    model : identifies the object's triangles in its own axes, in metres: equal for copies of one shape.
    cam_from_object : (4, 4), the rigid pose. The object's own axes are those of its scene file, without scale.
    extent : (2, 3), the smallest and the largest coordinates of the model, metres.
    corners_px : (8, 2), pixels of the corners of `extent`, x slowest and z fastest; +inf for a corner without an image.
    silhouette : the mask of the image (H, W), also where it is hidden, in COCO's run-length code: `Truth.silhouette`.
    pixel_count, box : of the whole object.
    visible_pixel_count, visible_box : of the visible part.
    """

    object_id: int
    model: str
    cam_from_object: Float
    extent: Float
    corners_px: Float
    silhouette: str
    pixel_count: int
    box: tuple[int, ...]
    visible_pixel_count: int
    visible_box: tuple[int, ...]

    def __post_init__(self) -> None:
        checked: dict[str, Float | tuple[int, ...]] = {
            "cam_from_object": check_rigid(self.cam_from_object, "cam_from_object"),
            "extent": _of_shape("extent", self.extent, (2, 3)),
            "corners_px": _of_shape("corners_px", self.corners_px, (8, 2)),
        }
        for name in ("box", "visible_box"):
            _of_shape(name, getattr(self, name), (4,))
            checked[name] = tuple(getattr(self, name))
        for name, value in checked.items():
            object.__setattr__(self, name, value)
        counts_fit = 0 <= self.visible_pixel_count <= self.pixel_count
        if not counts_fit or self.pixel_count == 0:
            counts = f"{self.visible_pixel_count} of {self.pixel_count}"
            raise InputError(
                f"an object must have 1 or more pixels, of which 0 to all are visible, got {counts}"
            )

    @property
    def visible_fraction(self) -> float:
        """Visible pixels over all pixels of the object, 0 to 1."""
        return self.visible_pixel_count / self.pixel_count


def _of_shape(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Float:
    """The values in float64. Raises InputError if they have another shape."""
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise InputError(f"{name} must have the shape {shape}, got {array.shape}")
    return array


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
    objects : the objects in the image, by rising object_id, also where they are hidden. Instances in a Mitsuba file,
        whose shape is unknown, are left out; so are all in samples written before twinlens 0.2.
    projections : for each projector of the rig, its pixels and whether it lights the point.
    extra : further channels by name, (H, W) or (H, W, 3). `dataset.channels.CHANNELS` declares those that files hold.
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
    objects: tuple[ObjectTruth, ...] = ()
    projections: tuple["Projection", ...] = ()
    extra: Mapping[str, NDArray[Any]] = field(default_factory=dict)

    @property
    def hit(self) -> NDArray[np.bool_]:
        """Where the chief ray hits something, bool (H, W)."""
        return np.asarray(self.object_id > 0)

    def object_name(self, truth: ObjectTruth) -> str:
        """The name of the object in its scene."""
        return self.object_names[truth.object_id - 1]

    def silhouette(self, truth: ObjectTruth) -> NDArray[np.bool_]:
        """Where the object is in the image, also where it is hidden, bool (H, W)."""
        return decode_mask(truth.silhouette, *self.object_id.shape)

    def mask_nonocc(self) -> NDArray[np.uint8]:
        """Middlebury's mask, uint8 (H, W): 255 visible in both views, 128 occluded or out of frame, 0 unknown."""
        mask = np.zeros(self.visible.shape, dtype=np.uint8)
        is_known = self.hit | np.isfinite(self.disparity)
        mask[is_known] = 128
        mask[is_known & self.visible] = 255
        return mask


@dataclass(frozen=True, eq=False)
class Correspondence:
    """The pixel in one camera (the target) of each pixel of another (the source). Arrays (H, W[, 2 or 3]).

    pixels : float64 (H, W, 2), (u', v') in the target's image, distorted, also where the point is outside the image or
        occluded; +inf where nothing was hit, or the point is behind the target or beyond its distortion's range.
    visible : bool, whether the target sees the point: inside its image and not occluded.
    disparity : float32, pixels, u_left - u_right where the two are a rectified pair in either order; +inf elsewhere.
    target_disparity : float32, the disparity of the same surface points at the target's time.
    scene_flow : float64 (H, W, 3), metres: how the surface point moves from the source's time to the target's, in the
        axes of the source camera at its time. 0 where surfaces are still, however cameras move; +inf where nothing was
        hit.
    """

    pixels: NDArray[np.float64]
    visible: NDArray[np.bool_]
    disparity: NDArray[np.float32]
    target_disparity: NDArray[np.float32]
    scene_flow: NDArray[np.float64]

    @property
    def flow(self) -> NDArray[np.float64]:
        """Optical flow (H, W, 2), pixels: `pixels` minus the source's own pixel (u, v); +inf where `pixels` is."""
        height, width = self.visible.shape
        own_pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), axis=-1)
        return np.asarray(self.pixels - own_pixels)


@dataclass(frozen=True, eq=False)
class Projection:
    """The pixel of a projector that lights the point which each pixel of a camera sees. Arrays (H, W[, 2]).

    pixels : float64 (H, W, 2), (u_p, v_p), distorted, also where the point is in shadow or outside the pattern; +inf
        where nothing was hit, or the point is behind the projector or beyond its distortion's range.
    lit : bool, whether light of the projector reaches the point directly, on the side that the camera sees.
    """

    pixels: NDArray[np.float64]
    lit: NDArray[np.bool_]
