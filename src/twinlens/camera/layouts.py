"""Camera layouts: the toed-in pair, the line, the grid and the arc around an object; the paths of one camera that moves
around an object or through a scene; and a depth camera.

Each but the depth camera takes one `Camera` for all places, or a sequence with one for each, and one pose in the world.
"""

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from twinlens.camera.intrinsics import Camera, check_size
from twinlens.camera.patterns import dots
from twinlens.camera.presets import CAMERAS
from twinlens.camera.projector import Projector
from twinlens.camera.rig import Rig
from twinlens.errors import (
    InputError,
    check_int,
    check_number,
    counted,
    format_value,
)
from twinlens.geometry import (
    Float,
    check_rigid,
    float_array,
    look_at,
    rigid,
    skew,
)
from twinlens.optics import check_length

Cameras = Camera | Sequence[Camera]

_GOLDEN_ANGLE = math.pi * (3.0 - math.sqrt(5.0))
_ALONG_AXIS = 1e-6  # the sine of the angle below which a direction is that of the axis
_SPLINE_STEPS = 256  # between two waypoints, to measure the length of the curve


def line(
    cameras: Cameras,
    count: int,
    spacing: float,
    world_from_first: ArrayLike | None = None,
) -> Rig:
    """`count` parallel cameras, `spacing` metres apart along the first one's x axis, left to right.

    Any two of them with the same camera, the left one first, are a rectified pair.

    >>> line(Camera.from_fov(64, 48, 60), 3, 0.1).baseline(0, 2)
    0.2
    """
    return grid(cameras, 1, count, spacing, spacing, world_from_first)


def grid(
    cameras: Cameras,
    rows: int,
    columns: int,
    spacing_x: float,
    spacing_y: float,
    world_from_first: ArrayLike | None = None,
) -> Rig:
    """``rows * columns`` parallel cameras, row by row from the first at the top left; spacings in metres.

    Camera (row, column) is at (column spacing_x, row spacing_y, 0) of the first one's frame: x right, y down.
    """
    check_int("rows", rows, 1)
    check_int("columns", columns, 1)
    check_length("spacing_x", spacing_x)
    check_length("spacing_y", spacing_y)
    places = []
    for i, j in itertools.product(range(rows), range(columns)):
        places.append(rigid(np.eye(3), [j * spacing_x, i * spacing_y, 0.0]))
    return _placed(cameras, places, world_from_first)


def arc(
    cameras: Cameras,
    count: int,
    radius: float,
    angle_deg: float,
    world_from_middle: ArrayLike | None = None,
) -> Rig:
    """`count` cameras on an arc, left to right, all looking at the point `radius` metres in front of the arc's middle.

    `angle_deg` is the angle of the arc at that point, above 0 and up to 360; at 360 the cameras form a closed ring.
    `world_from_middle` is the pose of a camera in the middle of the arc; its y axis is the arc's axis.
    """
    check_int("count", count, 1)
    check_length("radius", radius)
    check_number(
        "angle_deg", angle_deg, "above 0 and at most 360 degrees", above=0, most=360
    )
    steps = count if angle_deg == 360 else max(count - 1, 1)
    angles = math.radians(angle_deg) / steps * (np.arange(count) - 0.5 * (count - 1))
    places = [
        rigid(_about_y(-a), [radius * math.sin(a), 0.0, radius * (1.0 - math.cos(a))])
        for a in map(float, angles)
    ]
    return _placed(cameras, places, world_from_middle)


def toed_in(
    cameras: Cameras,
    baseline: float,
    distance: float,
    world_from_middle: ArrayLike | None = None,
) -> Rig:
    """Two cameras `baseline` metres apart whose axes intersect `distance` metres in front of their middle.

    Each is rotated inwards by atan(baseline / (2 distance)). The pose is that of the middle, looking straight ahead.
    """
    check_length("baseline", baseline)
    check_length("distance", distance)
    turn = math.atan2(0.5 * baseline, distance)
    places = [
        rigid(_about_y(side * turn), [-side * 0.5 * baseline, 0.0, 0.0])
        for side in (1, -1)
    ]
    return _placed(cameras, places, world_from_middle)


def orbit(
    cameras: Cameras,
    count: int,
    radius: float,
    angle_deg: float = 360.0,
    elevation_deg: float | None = None,
    world_from_first: ArrayLike | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> Rig:
    """`count` cameras around the axis `up`, to the right of each other, that keep the point `radius` metres ahead.

    world_from_first : the pose of the first camera; the others are turned about the axis through the point ahead.
    angle_deg : the angle between the first and the last camera, above 0 and up to 360; at 360 they form a closed ring.
    elevation_deg : the angle of the cameras above the point, -89 to 89 degrees; they are then upright. By default they
        keep the elevation and the roll of the first one.

    A first camera that looks along the axis, and has no elevation, turns in place. Raises InputError for values out of
    range.

    >>> around = orbit(Camera.from_fov(64, 48, 60), 4, 2.0, world_from_first=look_at([2, 0, 0], [0, 0, 0]))
    >>> [pose[:3, 3].round(9).tolist() for pose in around.world_from_cams[:2]]
    [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]
    """
    check_int("count", count, 1)
    check_number(
        "angle_deg", angle_deg, "above 0 and at most 360 degrees", above=0, most=360
    )
    axes = _Around(_pose(world_from_first), radius, up)
    first = axes.pose
    if elevation_deg is not None:
        first = axes.view_from(0.0, _elevation("elevation_deg", elevation_deg))
    steps = count if angle_deg == 360 else max(count - 1, 1)
    angles = math.radians(angle_deg) / steps * np.arange(count)
    return _placed(cameras, [axes.turn(angle) @ first for angle in angles], None)


def hemisphere(
    cameras: Cameras,
    count: int,
    radius: float,
    elevation_deg: float = 10.0,
    world_from_first: ArrayLike | None = None,
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> Rig:
    """`count` upright cameras, spread evenly over a sphere around the point `radius` metres ahead of the pose.

    They are `elevation_deg` degrees above the point or more, and each stands for an equal area of the sphere: a spiral
    of golden angles, whose sines of the elevation are equally spaced, from the lowest, at the side of the pose, to the
    highest. Source: Gonzalez, Measurement of areas on a sphere using Fibonacci and latitude-longitude lattices, 2010.

    Raises InputError for values out of range.
    """
    check_int("count", count, 1)
    lowest = math.sin(_elevation("elevation_deg", elevation_deg))
    axes = _Around(_pose(world_from_first), radius, up)
    sines = lowest + (1.0 - lowest) * (np.arange(count) + 0.5) / count
    angles = np.arange(count) * _GOLDEN_ANGLE
    places = [
        axes.view_from(angle, elevation)
        for angle, elevation in zip(angles, np.arcsin(sines), strict=True)
    ]
    return _placed(cameras, places, None)


def trajectory(
    cameras: Cameras,
    count: int,
    waypoints: ArrayLike,
    distance: float | None = None,
    world_from_start: ArrayLike | None = None,
) -> Rig:
    """`count` cameras at equal distances along a smooth curve through `waypoints`, from the first to the last.

    waypoints : (N, 3), two or more, in the axes of the pose, metres: x right, y down, z forward. The curve is the
        natural cubic spline over the lengths of the straight lines between them.
    distance : all cameras look at the point so many metres ahead of the pose, upright in its axes; by default they keep
        its direction.

    Raises InputError for waypoints that coincide or are at that point, and for values out of range.

    >>> ahead = trajectory(Camera.from_fov(64, 48, 60), 3, [[0, 0, 0], [0, 0, 1]])
    >>> [pose[:3, 3].tolist() for pose in ahead.world_from_cams]
    [[0.0, 0.0, 0.0], [0.0, 0.0, 0.5], [0.0, 0.0, 1.0]]
    """
    check_int("count", count, 1)
    eyes = _along_spline(_checked_waypoints(waypoints), count)
    if distance is None:
        return _placed(cameras, [rigid(np.eye(3), eye) for eye in eyes], world_from_start)  # fmt: skip
    check_length("distance", distance)
    ahead = (0.0, 0.0, distance)
    # In the axes of the pose, up is -y.
    places = [look_at(eye, ahead, up=(0.0, -1.0, 0.0)) for eye in eyes]
    return _placed(cameras, places, world_from_start)


def depth_camera(
    width: int = 848,
    height: int = 480,
    world_from_left: ArrayLike | None = None,
    power: float = 0.36,
) -> Rig:
    """The near infrared pair of an active stereo camera, Intel's RealSense D435, with its projector of dots.

    `width` and `height` are those of the images, in pixels, and `power` is what the projector emits, in watts. Left and
    right camera are the preset "realsense-d435", 50 mm apart. The projector lights 86 x 57 degrees with 5000 dots.
    That it is in the middle, that a dot is 3 mrad wide and that dots are independent of each other is assumed.

    Sources: the preset; FRAMOS, D435e Manual V1.0, 3.3: 86 x 57 degrees, 360 mW on average; Intel, Projectors for D400
    Series Depth Cameras, revision 1.0: about 5000 dots.

    >>> rig = depth_camera()
    >>> rig.baseline(), round(rig.projectors[0].emitted_power, 6)
    (0.05, 0.36)
    """
    check_size(width, height)
    check_number(
        "power", power, "a number of watts > 0, at most 1e7", above=0, most=1e7
    )
    preset = CAMERAS["realsense-d435"]
    camera = preset.resized(width).replace(
        height=height, cy=0.5 * (height - 1), band="nir"
    )
    baseline = preset.baseline or 0.0
    columns, rows = 1280, 720
    fx, fy = (
        0.5 * n / math.tan(math.radians(0.5 * angle))
        for n, angle in ((columns, 86.0), (rows, 57.0))
    )
    light = Camera(columns, rows, fx, fy, 0.5 * (columns - 1), 0.5 * (rows - 1))
    pattern = dots(columns, rows, density=5000 / (columns * rows / 4), size=2)
    middle = rigid(np.eye(3), [0.5 * baseline, 0.0, 0.0])
    projector = Projector(
        middle, light, pattern, power / float(pattern.mean(dtype=np.float64))
    )
    return Rig.stereo(camera, baseline, world_from_left).with_projectors([projector])


class _Around:
    """Cameras around an axis through the point ahead of a pose; its `side` is the horizontal direction to the pose."""

    def __init__(self, pose: Float, radius: float, up: ArrayLike) -> None:
        check_length("radius", radius)
        axis = float_array("up", up)
        length = np.linalg.norm(axis) if axis.shape == (3,) else np.nan
        if not (np.isfinite(length) and length > 0):
            raise InputError(
                f"up must be a direction of 3 numbers, got {format_value(up)}"
            )
        self.pose, self._radius = pose, radius
        self._up = axis / length
        self._centre = pose[:3, 3] + radius * pose[:3, 2]
        self._side = self._horizontal(-pose[:3, 2])
        if np.linalg.norm(self._side) < _ALONG_AXIS:
            # Seen from above, the lower border of the image is the side of the camera; from below, the upper one.
            self._side = self._horizontal(
                np.sign(-pose[:3, 2] @ self._up) * pose[:3, 1]
            )
        self._side /= np.linalg.norm(self._side)

    def _horizontal(self, direction: Float) -> Float:
        """The part of a direction across the axis."""
        return np.asarray(direction - (direction @ self._up) * self._up)

    def turn(self, angle: float) -> Float:
        """The rotation (4, 4) about the axis, by radians, counter-clockwise seen against it."""
        c, s = math.cos(angle), math.sin(angle)
        # Rodrigues' formula: R = c I + s [u]x + (1 - c) u u^T.
        rotation = c * np.eye(3) + s * skew(self._up)
        rotation += (1.0 - c) * np.outer(self._up, self._up)
        return rigid(rotation, self._centre - rotation @ self._centre)

    def view_from(self, angle: float, elevation: float) -> Float:
        """The pose of an upright camera, `angle` radians around the axis and `elevation` above the point."""
        direction = math.cos(elevation) * self._side + math.sin(elevation) * self._up
        eye = self._centre + self._radius * direction
        return np.asarray(self.turn(angle) @ look_at(eye, self._centre, up=self._up))


def _pose(pose: ArrayLike | None) -> Float:
    return np.eye(4) if pose is None else check_rigid(pose, "the pose of a layout")


def _elevation(name: str, degrees: float) -> float:
    """An elevation in radians. Raises InputError at and near the poles, where upright has no meaning."""
    check_number(name, degrees, "between -89 and 89 degrees", least=-89, most=89)
    return math.radians(degrees)


def _checked_waypoints(waypoints: ArrayLike) -> Float:
    points = float_array("waypoints", waypoints)
    if points.ndim != 2 or points.shape[1:] != (3,) or len(points) < 2:
        raise InputError(
            f"waypoints must be two points or more of 3 numbers, got shape {points.shape}"
        )
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    if not (np.isfinite(points).all() and (steps > 0).all()):
        raise InputError("waypoints must be finite, and each must differ from the next")
    return points


def _along_spline(points: Float, count: int) -> Float:
    """`count` points (count, 3) at equal distances along the natural cubic spline through `points`."""
    from scipy.interpolate import CubicSpline  # 0.2 s to import

    chords = np.linalg.norm(np.diff(points, axis=0), axis=1)
    knots = np.concatenate([[0.0], np.cumsum(chords)])
    if len(points) == 2:
        return np.linspace(points[0], points[1], count)
    curve = CubicSpline(knots, points, bc_type="natural")
    # The length along the curve, measured in short straight steps, and its inverse.
    fine = np.linspace(0.0, knots[-1], _SPLINE_STEPS * len(chords) + 1)
    steps = np.linalg.norm(np.diff(curve(fine), axis=0), axis=1)
    lengths = np.concatenate([[0.0], np.cumsum(steps)])
    wanted = np.linspace(0.0, lengths[-1], count)
    return np.asarray(curve(np.interp(wanted, lengths, fine)))


def _about_y(angle: float) -> Float:
    """The rotation about y that moves z towards x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _placed(
    cameras: Cameras, places: Sequence[Float], world_from_layout: ArrayLike | None
) -> Rig:
    pose = _pose(world_from_layout)
    chosen = [cameras] * len(places) if isinstance(cameras, Camera) else list(cameras)
    if len(chosen) != len(places):
        count = len(places)
        raise InputError(
            f"this layout has {counted(count, 'place')}: give one camera for all, or {count}, got {len(chosen)}"
        )
    return Rig(chosen, [pose @ place for place in places])
