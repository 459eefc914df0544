"""The light field of a lens as a rig of pinhole cameras on a grid over its aperture, and images refocused from it.

Through the point a of the aperture, a lens of vergence k sees what a pinhole camera at a sees whose principal point is
moved by fx k a: the point (X, Y, Z) is at u = fx (X - ax)/Z + cx + fx k ax. The disparity of two views b apart is
therefore fx b (1/Z - k), zero in the plane of focus.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import shift
from scipy.spatial import cKDTree

from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import Paraxial, require_paraxial
from twinlens.camera.rig import Rig
from twinlens.errors import InputError, check_int, format_value
from twinlens.geometry import Float, check_rigid, rigid

_POINTS = 512  # a side, of the aperture's points that are divided among views
_ROUNDING = 1e-9  # relative to the aperture
_ALIGNED = 1e-9
_FLOAT64 = 1e-15  # rounding of poses, relative to the distance from the origin
_TOLERANCE = 1e-6  # of the distance of neighbours; pixels


def light_field_rig(
    camera: Camera, lens: Paraxial, n: int, world_from_cam: ArrayLike | None = None
) -> Rig:
    """The n x n views of the light field that `lens` sees in front of `camera`, row by row from the top left.

    View (row, column) is a pinhole camera at ax = A (column - (n-1)/2) / n, ay = A (row - (n-1)/2) / n, in metres: the
    middle of a cell of `Grid(n)`. Corners of the grid are outside a round aperture, but their views exist. For odd n
    the middle view, number (n**2 - 1) / 2, is `camera` itself.

    Raises InputError for n outside 1 to 32, a lens without an aperture, and a camera with lens distortion, which
    depends on the pixel and not on the view's principal point.

    >>> from twinlens.camera import ThinLens
    >>> rig = light_field_rig(Camera.from_fov(64, 48, 60), ThinLens(0.09, 2.0), 9)
    >>> len(rig), round(rig.baseline(0, 1), 12)
    (81, 0.01)
    """
    if not isinstance(camera, Camera):
        raise InputError(f"camera must be a Camera, got {format_value(camera)}")
    require_paraxial(lens, "a light field")
    check_int("n", n, 1, 32)
    if lens.aperture_diameter == 0:
        raise InputError(
            "a light field needs a lens with an aperture; a pinhole has none"
        )
    if camera.distortion is not None:
        raise InputError("a light field needs a camera without lens distortion")
    pose = (
        np.eye(4)
        if world_from_cam is None
        else check_rigid(world_from_cam, "world_from_cam")
    )
    places = lens.aperture_diameter * (np.arange(n) - 0.5 * (n - 1)) / n
    cameras, poses = [], []
    for y, x in itertools.product(places, places):
        cx = camera.cx + camera.fx * lens.vergence * x
        cy = camera.cy + camera.fy * lens.vergence * y
        cameras.append(camera.replace(cx=cx, cy=cy))
        poses.append(pose @ rigid(np.eye(3), [x, y, 0.0]))
    return Rig(cameras, poses)


def light_field_grid(rig: Rig) -> tuple[int, float, float]:
    """Views per side, distance of neighbours in metres, and vergence in 1/m of the rig of a light field.

    Raises InputError for rigs other than those of `light_field_rig`.

    >>> from twinlens.camera import ThinLens
    >>> n, spacing, vergence = light_field_grid(light_field_rig(Camera.from_fov(64, 48, 60), ThinLens(0.09, 2.0), 9))
    >>> n, round(spacing, 12), round(vergence, 12)
    (9, 0.01, 0.5)
    """
    n, camera = math.isqrt(len(rig)), rig.cameras[0]
    if n > 1 and n**2 == len(rig):
        places, spacing = places_in_plane(rig), rig.baseline(0, 1)
        shifts = np.array(
            [(view.cx - camera.cx, view.cy - camera.cy) for view in rig.cameras]
        )
        # Neighbours are `spacing` apart and have principal points fx k spacing apart, in rows from the top left.
        vergence = float(shifts[1, 0]) / (camera.fx * spacing)
        index = np.arange(n**2)
        steps = spacing * np.stack([index % n, index // n], axis=-1)
        expected_shifts = steps * vergence * [camera.fx, camera.fy]
        on_grid = np.allclose(
            places - places[0], steps, rtol=0, atol=_TOLERANCE * spacing
        )
        if on_grid and np.allclose(shifts, expected_shifts, rtol=0, atol=_TOLERANCE):
            return n, spacing, vergence
    raise InputError(f"the {len(rig)} cameras are not the n x n views of a light field")


def refocus(
    images: Sequence[ArrayLike], rig: Rig, lens: Paraxial
) -> NDArray[np.float32]:
    """The image through `lens` from the views of a light field: shift and add.

    The lens stands in the middle of the views. Each point of its aperture sees what the nearest view sees, moved to the
    focus of the lens: a view's weight is the lens's light that falls nearest to it, so the aperture may be of any shape
    and smaller than the light field's. Images move by fractions of pixels with cubic splines; what they do not show is
    continued from their border. A pinhole gives the nearest view to the middle.

    Parameters
    ----------
    images : arrays (H, W, 3) or (H, W), linear
        One per camera of `rig`.
    rig : Rig
        Of `light_field_rig`, or any cameras in one plane with parallel axes and equal fx, fy and image sizes.

    Returns
    -------
    float32 (H, W, 3) or (H, W)
        As seen by a camera whose principal point is the mean of the views'.

    Raises
    ------
    InputError
        When images and rig do not fit each other, for other rigs, and for an aperture that is larger than the views.

    Source: Ng et al., Light field photography with a hand-held plenoptic camera, 2005; Isaksen et al., Dynamically
    reparameterized light fields, 2000.
    """
    require_paraxial(lens, "refocusing")
    if not isinstance(rig, Rig):
        raise InputError(
            f"rig must be a Rig, as of light_field_rig, got {format_value(rig)}"
        )
    places = places_in_plane(rig)
    stack = _checked_views(images, rig)
    principal = np.array([(camera.cx, camera.cy) for camera in rig.cameras])
    focal = np.array([rig.cameras[0].fx, rig.cameras[0].fy])
    # A view at a shows the plane of focus shifted by its own principal point and by f k a.
    shifts = principal.mean(axis=0) - principal + focal * lens.vergence * places
    total = np.zeros_like(stack[0])
    weights = _weights(places, lens)
    for image, weight, (du, dv) in zip(stack, weights, shifts, strict=True):
        if weight:
            total += weight * _shifted(image, du, dv)
    return total.astype(np.float32)


def _shifted(image: Float, du: float, dv: float) -> Float:
    """An image (H, W[, C]) moved right and down by fractions of pixels, by cubic splines."""
    unmoved = [0.0] * (image.ndim - 2)
    moved: Float = shift(image, (dv, du, *unmoved), order=3, mode="nearest")
    return moved


def _checked_views(images: Sequence[ArrayLike], rig: Rig) -> list[Float]:
    """The images as arrays. Raises InputError unless there is one for each camera, of its size."""
    first = rig.cameras[0]
    try:
        stack = [np.asarray(image, dtype=np.float64) for image in images]
    except (TypeError, ValueError) as error:
        raise InputError(
            f"refocus needs a list of images of numbers, got {format_value(images)}"
        ) from error
    shapes = sorted({image.shape for image in stack})
    if (
        len(stack) != len(rig)
        or len(shapes) > 1
        or shapes[0][:2] != (first.height, first.width)
    ):
        got = f"{len(stack)} of shapes {shapes}"
        raise InputError(
            f"refocus needs {len(rig)} images of {first.width}x{first.height} pixels, got {got}"
        )
    return stack


def places_in_plane(rig: Rig) -> Float:
    """The x and y (n, 2) of the cameras in their common plane, from their middle. Raises InputError for other rigs."""
    formats = {
        (camera.fx, camera.fy, camera.width, camera.height) for camera in rig.cameras
    }
    alike = len(formats) == 1
    poses = np.array([rig.b_from_a(i, 0) for i in range(len(rig))])
    centres = poses[:, :3, 3]
    places = centres - centres.mean(axis=0)
    extent = max(float(np.abs(places).max()), 1.0)
    coordinates = np.abs([pose[:3, 3] for pose in rig.world_from_cams])
    out_of_plane = float(np.abs(places[:, 2]).max())
    is_plane = out_of_plane <= _ALIGNED * extent + _FLOAT64 * float(coordinates.max())
    parallel = np.abs(poses[:, :3, :3] - np.eye(3)).max() <= _ALIGNED
    if not (alike and parallel and is_plane):
        raise InputError(
            "a light field needs cameras in one plane, with parallel axes and equal fx, fy and image sizes"
        )
    plane: Float = places[:, :2]
    return plane


def _weights(places: Float, lens: Paraxial) -> Float:
    """The fraction (n,) of the lens's light that is nearest to each view; they add up to 1."""
    # The weight of a view is the share of evenly spread points of the aperture that are nearer to it than to others.
    tree = cKDTree(places)
    u1, u2 = (np.mgrid[:_POINTS, :_POINTS].reshape(2, -1) + 0.5) / _POINTS
    unit_points = np.stack(lens.aperture.sample(u1, u2), axis=-1)
    points = 0.5 * lens.aperture_diameter * unit_points
    _, nearest = tree.query(points)
    # Beyond half the distance of neighbours, a point of the aperture is outside the cells of all views.
    pitch = tree.query(places, k=2)[0][:, 1].max() if len(places) > 1 else 0.0
    farthest = np.abs(points - places[nearest]).max()
    if farthest > (0.5 + _ROUNDING) * pitch and lens.aperture_diameter > 0:
        raise InputError(
            f"the aperture of {format_value(lens)} is larger than the light field's views reach"
        )
    return np.bincount(nearest, minlength=len(places)) / len(points)
