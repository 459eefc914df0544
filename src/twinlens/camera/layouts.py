"""Camera layouts: the toed-in pair, the line, the grid and the arc around an object; and a depth camera.

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
from twinlens.errors import InputError, check_int, check_number, counted
from twinlens.geometry import Float, check_rigid, rigid
from twinlens.optics import check_length

Cameras = Camera | Sequence[Camera]


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


def _about_y(angle: float) -> Float:
    """The rotation about y that moves z towards x."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _placed(
    cameras: Cameras, places: Sequence[Float], world_from_layout: ArrayLike | None
) -> Rig:
    pose = (
        np.eye(4)
        if world_from_layout is None
        else check_rigid(world_from_layout, "the pose of a layout")
    )
    chosen = [cameras] * len(places) if isinstance(cameras, Camera) else list(cameras)
    if len(chosen) != len(places):
        count = len(places)
        raise InputError(
            f"this layout has {counted(count, 'place')}: give one camera for all, or {count}, got {len(chosen)}"
        )
    return Rig(chosen, [pose @ place for place in places])
