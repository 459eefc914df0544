"""A rig as a table of a scene file, a recipe or a file of its own: a layout by name, its measures, what is inside each
camera, and errors of calibration left in on purpose. docs/rigs.md shows every key.

    layout = "toed_in"          # one of LAYOUTS; "parallel" unless said
    baseline = 0.2              # the scene's unless said
    distance = 2.0
    fov_x_deg = 50              # or fx, fy, cx, cy in pixels; the scene's unless said
    distortion = { model = "brown-conrady", k1 = -0.1 }
    cameras = [{}, { fx = 710, fy = 705 }]             # what differs, a table a camera
    misalignment = { vertical_px = 1.5, roll_deg = 0.2 }   # of the second camera, or a list with one a camera
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.camera import BrownConrady, Camera, Distortion, KannalaBrandt, Misalignment, Rig, layouts, misaligned
from twinlens.camera.intrinsics import MAX_SIDE
from twinlens.errors import InputError
from twinlens.geometry import Float, rigid
from twinlens.optics import middle_focus
from twinlens.scenes.placement import camera_pose, rotation
from twinlens.scenes.scene import Scene
from twinlens.scenes.table import At, Parser, Source, Table, choice, listed, number, vector, whole

Keys = Table[Any]
Place = Callable[[Sequence[Camera], Float], Rig]
"""Cameras and the layout's pose in the world -> the rig."""

_MOST = 1000


def rig_from_table(table: Mapping[str, Any], scene: Scene, width: int, height: int, at: At | None = None) -> Rig:
    """The rig that `table` describes, where `scene` was composed to be seen from.

    Parameters
    ----------
    table : mapping
        Plain values as TOML has them; `LAYOUTS` names the layouts, and this module's first lines show the keys.
    scene : Scene
        Gives the pose, the field of view and the baseline that the table leaves out.
    width, height : int
        Size of the images, pixels, of every camera whose table says no `width` and `height` of its own.
    at : At
        Where the table stands, for messages; the file and key that a mistake is reported with.

    Returns
    -------
    Rig. With `misalignment` it is the misaligned rig, and its `calibrated` is the rig without the error.

    Raises InputError naming the key that is unknown, missing or wrong, and what would be right.
    """
    keys: Keys = Table(at or At(Source(Path("rig"))), table)
    entries = keys.take("cameras", listed(lambda at, value: Table[Any](at, value), 1, _MOST), None)
    layout = keys.take("layout", choice(*LAYOUTS), "parallel")
    count, place = LAYOUTS[layout](keys, scene, entries)
    if entries is not None and len(entries) != count:
        raise (keys.at / "cameras").wrong(f"layout {layout!r} here has {count} cameras, got {len(entries)} tables")
    pose = camera_pose(keys) if keys.has("position") else scene.world_from_left
    shared = {"width": width, "height": height, "fov_x_deg": scene.fov_x_deg} | _inside(keys)
    errors = keys.take("misalignment", _misalignments(count), None)
    keys.done()
    cameras = [_camera(entry, shared) for entry in entries or [keys] * count]
    for entry in entries or ():
        entry.done()
    rig: Rig = _told(keys.at, lambda: place(cameras, pose))
    return rig if errors is None else misaligned(rig, errors)


def _parallel(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    baseline = _metres(keys, "baseline", scene.baseline)
    return 2, lambda cameras, pose: layouts.line(cameras, 2, baseline, pose)


def _vertical(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    baseline = _metres(keys, "baseline", scene.baseline)
    return 2, lambda cameras, pose: layouts.grid(cameras, 2, 1, baseline, baseline, pose)


def _toed_in(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    """The scene's pose is that of a left camera: the middle stands half a baseline to its right."""
    baseline = _metres(keys, "baseline", scene.baseline)
    distance = _metres(keys, "distance", _middle(scene))
    to_middle = rigid(np.eye(3), [0.5 * baseline, 0.0, 0.0])
    return 2, lambda cameras, pose: layouts.toed_in(cameras, baseline, distance, pose @ to_middle)


def _line(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    count = keys.take("count", whole(1, _MOST))
    spacing = _metres(keys, "spacing", scene.baseline)
    return count, lambda cameras, pose: layouts.line(cameras, count, spacing, pose)


def _grid(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    rows, columns = (keys.take(key, whole(1, _MOST)) for key in ("rows", "columns"))
    if rows * columns > _MOST:
        raise keys.at.wrong(f"rows and columns make {rows * columns} cameras; at most {_MOST}")
    across = _metres(keys, "spacing_x", scene.baseline)
    down = _metres(keys, "spacing_y", across)
    return rows * columns, lambda cameras, pose: layouts.grid(cameras, rows, columns, across, down, pose)


def _arc(keys: Keys, scene: Scene, _: Any) -> tuple[int, Place]:
    count = keys.take("count", whole(1, _MOST))
    radius = _metres(keys, "radius", _middle(scene))
    angle = keys.take("angle_deg", number(high=360.0, above=0.0))
    return count, lambda cameras, pose: layouts.arc(cameras, count, radius, angle, pose)


def _each(keys: Keys, scene: Scene, entries: list[Keys] | None) -> tuple[int, Place]:
    if entries is None:
        raise keys.at.wrong("layout 'cameras' needs the key 'cameras': a list with one table a camera")
    poses = [_own_pose(entry) for entry in entries]
    return len(poses), lambda cameras, pose: Rig(cameras, [own(pose) for own in poses])


LAYOUTS: dict[str, Callable[[Keys, Scene, list[Keys] | None], tuple[int, Place]]] = {
    "parallel": _parallel,
    "toed_in": _toed_in,
    "vertical": _vertical,
    "line": _line,
    "grid": _grid,
    "arc": _arc,
    "cameras": _each,
}
"""Every way to place cameras, by name; see `twinlens.camera.layouts`."""


def _own_pose(entry: Keys) -> Callable[[Float], Float]:
    """World coordinates (`position`, `look_at`, `up`, or the 4x4 `world_from_cam`), or a step and a turn from the rig's
    pose in its axes (`translate`, `euler_deg`; x right, y down, z forward)."""
    ways = {"position": ("look_at",), "world_from_cam": (), "translate": ("euler_deg",), "euler_deg": ("translate",)}
    given = [key for key in ways if entry.has(key)]
    for other in given[1:]:
        if other not in ways[given[0]]:
            raise entry.at.wrong(f"{given[0]!r} and {other!r} both place the camera; keep one")
    if "position" in given:
        fixed = camera_pose(entry)
        return lambda pose: fixed
    if "world_from_cam" in given:
        matrix = np.array(entry.take("world_from_cam", listed(vector(4), 4, 4)))
        return lambda pose: matrix
    step = entry.take("translate", vector(3), np.zeros(3))
    x, y, z = map(rotation, np.eye(3), entry.take("euler_deg", vector(3), np.zeros(3)))
    return lambda pose: pose @ rigid((z @ y @ x)[:3, :3], step)


_INSIDE: dict[str, Parser[Any]] = {
    "width": whole(1, MAX_SIDE),
    "height": whole(1, MAX_SIDE),
    "fov_x_deg": number(high=179.0, above=0.0),
    "fx": number(above=0.0),
    "fy": number(above=0.0),
    "cx": number(),
    "cy": number(),
    "pixel_pitch_um": number(above=0.0),
    "distortion": lambda at, value: _distortion(at, value),
}
"""What a table may say of a camera's inside."""


def _inside(keys: Keys) -> dict[str, Any]:
    given = {key: keys.take(key, parser) for key, parser in _INSIDE.items() if keys.has(key)}
    if "fov_x_deg" in given and "fx" in given:
        raise keys.at.wrong("'fov_x_deg' and 'fx' both say the focal length; keep one")
    if "fy" in given and "fx" not in given:
        raise keys.at.wrong("'fy' needs 'fx' beside it")
    return given


def _camera(entry: Keys, shared: Mapping[str, Any]) -> Camera:
    """One camera: what its own table says, then what all share. A size of its own centres its principal point."""
    own = _inside(entry)
    unsaid = {"fx", "fy", "fov_x_deg"} if own.keys() & {"fx", "fov_x_deg"} else set()
    unsaid |= {"fov_x_deg"} if "fx" in shared else set()
    unsaid |= {"cx"} if "width" in own else set()
    unsaid |= {"cy"} if "height" in own else set()
    values = {key: value for key, value in shared.items() if key not in unsaid} | own
    fov = values.pop("fov_x_deg", None)

    def build() -> Camera:
        centred = Camera.from_fov(values["width"], values["height"], 90.0 if fov is None else fov)
        if "fx" in values:
            values.setdefault("fy", values["fx"])
        return centred.replace(**values)

    camera: Camera = _told(entry.at, build)
    return camera


_MODELS: dict[str, tuple[type[BrownConrady] | type[KannalaBrandt], tuple[str, ...]]] = {
    BrownConrady.name: (BrownConrady, ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    KannalaBrandt.name: (KannalaBrandt, ("k1", "k2", "k3", "k4")),
}


def _distortion(at: At, value: Any) -> Distortion:
    keys: Keys = Table(at, value)
    model, names = _MODELS[keys.take("model", choice(*_MODELS), BrownConrady.name)]
    coefficients = {name: keys.take(name, number(), 0.0) for name in names}
    keys.done()
    return model(**coefficients)


def _misalignments(count: int) -> Parser[Sequence[Misalignment]]:
    def parse(at: At, value: Any) -> Sequence[Misalignment]:
        if isinstance(value, list):
            return listed(_misalignment, count, count)(at, value)
        if count < 2:
            raise at.wrong("a table is the second camera's, and this rig has one: give a list")
        return [_misalignment(at, value) if i == 1 else Misalignment() for i in range(count)]

    return parse


def _misalignment(at: At, value: Any) -> Misalignment:
    keys: Keys = Table(at, value)
    names = ("vertical_px", "pitch_deg", "yaw_deg", "roll_deg")
    error = Misalignment(**{name: keys.take(name, number(), 0.0) for name in names})
    keys.done()
    return error


def _metres(keys: Keys, key: str, default: float | None) -> float:
    parser = number(above=0.0)
    value = keys.take(key, parser) if default is None else keys.take(key, parser, default)
    return float(value)


def _middle(scene: Scene) -> float | None:
    """The depth in the middle of the scene's disparities, metres; None where the scene does not say its depths."""
    return middle_focus(*scene.depth_range) if scene.depth_range_known else None


def _told(at: At, make: Callable[[], Any]) -> Any:
    """What `make` answers; what it refuses is told with its place."""
    try:
        return make()
    except InputError as error:
        raise at.wrong(str(error)) from error
