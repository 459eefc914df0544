"""A rig as a table of a scene file, of a recipe, or of a file of its own. docs/rigs.md shows every key."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.calibrations import read_rig, rig_table, warn_of_lengths
from twinlens.camera import (
    BrownConrady,
    Camera,
    Distortion,
    GrayCode,
    KannalaBrandt,
    Misalignment,
    PhaseShift,
    Projector,
    Rig,
    ThinLens,
    layouts,
    light_field_rig,
    misaligned,
)
from twinlens.camera.film import sensor_width_mm
from twinlens.camera.intrinsics import MAX_SIDE
from twinlens.camera.patterns import PHASE_PERIOD, named
from twinlens.camera.presets import CAMERAS, find_camera
from twinlens.camera.projector import MAX_FRAMES
from twinlens.camera.rig import check_seen
from twinlens.errors import FileError, InputError, check_known, counted, located
from twinlens.geometry import Float, rigid
from twinlens.optics import middle_focus
from twinlens.scenes.assets import decode_picture
from twinlens.scenes.placement import Matrix, Vector3, euler_rotation, view_pose
from twinlens.scenes.scene import Scene
from twinlens.schema import (
    Declared,
    Fraction,
    NonNegative,
    Number,
    Positive,
    StrictModel,
    number,
    one_of,
    read,
    reads,
    setting,
    table_of,
    tagged,
    variants,
    whole,
)
from twinlens.settings import Field, Setting

_MOST_CAMERAS = 1000
_CAMERAS = pydantic.Field(min_length=1, max_length=_MOST_CAMERAS)
FOV = Field(
    "fov_x_deg",
    float,
    False,
    Setting("Horizontal field of view.", "degrees", above=0, most=179),
)
SensorWidth = Annotated[
    Positive, pydantic.BeforeValidator(sensor_width_mm, Number | str)
]
"""A width in mm, or the name of a sensor format."""
RigLength: Any = number(0, 1e6, above=True)
"""Metres between cameras: at most as far as a recipe's `scene.jitter` moves them."""
_Focus = Annotated[float, setting(ThinLens, "focus_distance")]
_Elevation: Any = number(-89, 89)
_WAYPOINTS = pydantic.Field(min_length=2, max_length=_MOST_CAMERAS)
_UP = (0.0, 0.0, 1.0)
Count = Annotated[int, pydantic.Field(ge=1, le=_MOST_CAMERAS)]

OF_ONE_CAMERA = {
    "light_field": "a light field",
    "orbit": "an orbit",
    "hemisphere": "a hemisphere",
    "trajectory": "a trajectory",
}
"""Layouts whose views one camera takes, in words."""

_DISTORTIONS = (
    table_of(BrownConrady, model=(Literal["brown-conrady"], "brown-conrady")),
    table_of(KannalaBrandt, model=(Literal["kannala-brandt"], ...)),
)
DistortionTable = Annotated[
    Distortion, reads(tagged("Distortion", "model", _DISTORTIONS, BrownConrady.name))
]
CalibrationError: Any = table_of(Misalignment)
"""How far a camera is off its calibration."""


ALTERNATIVES = (
    {"fov_x_deg", "fx", "fy", "focal_length_mm"},
    {"pixel_pitch_um", "sensor_width_mm"},
)
"""Keys of which a table's own replace all those of the table below it."""


def _replaced_by(values: Mapping[str, Any]) -> set[str]:
    """The keys with alternatives that `values` replace in the table below."""
    replaced = [keys for keys in ALTERNATIVES if values.keys() & keys]
    return set[str]().union(*replaced)


class Intrinsics(StrictModel):
    """What a table may set of a camera. An image size of its own centres the camera's principal point.

    `focal_length_mm` is that of a lens focused at infinity: fx = fy = focal length / pixel pitch.
    """

    width: Annotated[int, setting(Camera, "width")] | None = None
    height: Annotated[int, setting(Camera, "height")] | None = None
    fov_x_deg: Annotated[float, Declared(FOV)] | None = None
    fx: Annotated[float, setting(Camera, "fx")] | None = None
    fy: Annotated[float, setting(Camera, "fy")] | None = None
    focal_length_mm: Positive | None = None
    cx: Annotated[float, setting(Camera, "cx")] | None = None
    cy: Annotated[float, setting(Camera, "cy")] | None = None
    pixel_pitch_um: Annotated[float, setting(Camera, "pixel_pitch_um")] | None = None
    sensor_width_mm: SensorWidth | None = None
    distortion: DistortionTable | None = None
    band: Annotated[str, setting(Camera, "band")] | None = None

    @pydantic.model_validator(mode="after")
    def _check_focal_length(self) -> "Intrinsics":
        keys = [
            key
            for key in ("fov_x_deg", "fx", "focal_length_mm")
            if getattr(self, key) is not None
        ]
        if len(keys) > 1:
            raise InputError(
                f"{keys[0]!r} and {keys[1]!r} both set the focal length; keep one"
            )
        if self.fy is not None and self.fx is None:
            raise InputError("'fy' needs 'fx'")
        if self.pixel_pitch_um is not None and self.sensor_width_mm is not None:
            raise InputError(
                "'pixel_pitch_um' and 'sensor_width_mm' both set the size of a pixel; keep one"
            )
        return self

    def given(self) -> dict[str, Any]:
        """The values that the table sets, by the names of `Camera` and of `Camera.from_fov`."""
        return {
            key: getattr(self, key)
            for key in Intrinsics.model_fields
            if key in self.model_fields_set
        }

    def over(self, shared: Mapping[str, Any]) -> dict[str, Any]:
        """This table's values, and `shared` ones where it has none."""
        values = self.given()
        replaced = _replaced_by(values)
        # Another size has another principal point, which is in the middle by default.
        if "width" in values:
            replaced.add("cx")
        if "height" in values:
            replaced.add("cy")
        kept = {key: value for key, value in shared.items() if key not in replaced}
        return kept | values

    def made(self, shared: Mapping[str, Any]) -> Camera:
        """The camera with this table's values, and `shared` ones where it has none."""
        values = self.over(shared)
        fov = values.pop("fov_x_deg", 90.0)
        if "sensor_width_mm" in values:
            values["pixel_pitch_um"] = (
                1e3 * values.pop("sensor_width_mm") / values["width"]
            )
        if "focal_length_mm" in values:
            if "pixel_pitch_um" not in values:
                raise InputError(
                    "focal_length_mm needs the size of a pixel: add 'pixel_pitch_um' or 'sensor_width_mm'"
                )
            values["fx"] = (
                1e3 * values.pop("focal_length_mm") / values["pixel_pitch_um"]
            )
        if "fx" in values:
            values.setdefault("fy", values["fx"])
        return Camera.from_fov(values["width"], values["height"], fov).replace(**values)


class CameraTable(Intrinsics):
    """A camera: `preset` names one of `twinlens.camera.presets`, and the other keys change it.

    A preset has the size of its whole sensor unless `width` is given, which bins the columns; `height` crops the rows.
    """

    preset: Annotated[str, one_of("camera", CAMERAS)] | None = None

    def over(self, shared: Mapping[str, Any]) -> dict[str, Any]:
        if self.preset is None:
            return super().over(shared)
        camera = find_camera(self.preset).resized(self.width, self.height)
        values = {
            field.name: getattr(camera, field.name)
            for field in dataclasses.fields(camera)
        }
        del values["fx"], values["fy"]
        values["focal_length_mm"] = 1e3 * camera.film_distance
        changes = super().given()
        for key in ("width", "height"):
            changes.pop(key, None)
        replaced = _replaced_by(changes)
        kept = {key: value for key, value in values.items() if key not in replaced}
        return kept | changes


class Viewed(Intrinsics):
    """Intrinsics with a pose in world coordinates: `position`, `look_at` and `up`."""

    position: Vector3 | None = None
    look_at: Vector3 | None = None
    up: Vector3 | None = None

    @pydantic.model_validator(mode="after")
    def _check_pose(self) -> "Viewed":
        keys = (
            *("position", "world_from_cam", "rig_from_cam"),
            *("translate", "euler_deg"),
        )
        present = [key for key in keys if getattr(self, key, None)]
        if len(present) > 1 and present != ["translate", "euler_deg"]:
            raise InputError(
                f"{present[0]!r} and {present[1]!r} both set the camera's pose; keep one"
            )
        if (self.position is None) != (self.look_at is None) or (
            self.position is None and self.up is not None
        ):
            raise InputError(
                "'position' and 'look_at' go together; give both or neither"
            )
        return self

    def pose(self, default: Float) -> Float:
        """world_from_cam (4, 4), `default` where the table has none."""
        if self.position is None or self.look_at is None:
            return default
        return view_pose(self.position, self.look_at, self.up)


class PosedIntrinsics(Viewed):
    """A camera with a pose of its own, also as `world_from_cam`.

    `rig_from_cam`, or `translate` and `euler_deg`, are relative to the rig's pose, in its axes: x right, y down,
    z forward.
    """

    world_from_cam: Matrix | None = None
    rig_from_cam: Matrix | None = None
    translate: Vector3 | None = None
    euler_deg: Vector3 | None = None

    def pose(self, default: Float) -> Float:
        if self.world_from_cam is not None:
            return np.array(self.world_from_cam, dtype=np.float64)
        if self.rig_from_cam is not None:
            return default @ np.array(self.rig_from_cam, dtype=np.float64)
        turn = euler_rotation(self.euler_deg or [0.0] * 3)
        return super().pose(default @ rigid(turn[:3, :3], self.translate or [0.0] * 3))


_SIZE: Any = whole(1, MAX_SIDE) | None
_SEED: Any = whole(0, 2**63 - 1) | None
_FRAME: Any = whole(0, MAX_SIDE) | None
_AXIS: Any = Literal["u", "v"] | None
_PATTERNS = {
    "white": {},
    "dots": {"density": Fraction | None, "size": _SIZE, "seed": _SEED, "tiles": _SIZE},
    "dot_grid": {"period": _SIZE, "size": _SIZE},
    "stripes": {"period": _SIZE, "axis": _AXIS},
    "checker": {"size": _SIZE},
    "speckle": {"grain": Positive | None, "seed": _SEED},
    "gray_code": {"frame": _FRAME, "axis": _AXIS},
    "phase_shift": {
        "frame": _FRAME,
        "period": Positive | None,
        "steps": _SIZE,
        "axis": _AXIS,
    },
    "picture": {"file": str},
}
PatternTable = Annotated[
    StrictModel,
    reads(tagged("Pattern", "type", variants(StrictModel, "type", _PATTERNS))),
]
"""A pattern of `twinlens.camera.patterns`, by its `type`, and its options; or a grey picture."""


class ProjectorTable(Intrinsics):
    """A projector. `translate` and `euler_deg` are its pose in the first camera's axes: x right, y down, z forward.

    Field of view and image size are by default those of the scene's cameras; a pattern of type "picture" has the size
    of the picture. `power` is in watts; `lux` is the illuminance of a white pattern on the axis, 1 m away, for the band
    "rgb". An aperture blurs the pattern away from `focus`, in metres.

    `sequence` has patterns that are shown one after another, in the frames of one sample: a code without `frame` stands
    for all of its images.
    """

    translate: Vector3 | None = None
    euler_deg: Vector3 | None = None
    pattern: PatternTable | None = None
    sequence: (
        Annotated[
            list[PatternTable], pydantic.Field(min_length=1, max_length=MAX_FRAMES)
        ]
        | None
    ) = None
    power: NonNegative | None = None
    lux: NonNegative | None = None
    band: Literal["nir", "rgb"] = "nir"
    filter: Literal["bilinear", "nearest"] = "bilinear"
    aperture_mm: NonNegative = 0.0
    focus: _Focus = math.inf

    def projector(self, shared: Mapping[str, Any]) -> Projector:
        """The projector, with the intrinsics in `shared` where the table has none."""
        if self.power is not None and self.lux is not None:
            raise InputError("'power' and 'lux' both set the light; keep one")
        if self.pattern is not None and self.sequence is not None:
            raise InputError("'pattern' and 'sequence' both set the patterns; keep one")
        shown = [self.pattern] if self.sequence is None else self.sequence
        tables = [_options(table) for table in shown]
        pictures = [_picture_of(table) for table in tables]
        for picture in pictures:
            if picture is not None:
                shared = {**shared, "height": len(picture), "width": len(picture[0])}
        intrinsics = self.made(shared).replace(band="rgb")
        parts = []
        for i, (table, picture) in enumerate(zip(tables, pictures, strict=True)):
            with located(f"sequence[{i}]") if self.sequence else nullcontext():
                is_whole = self.sequence is not None and "frame" not in table
                parts.append(_part(table, picture, intrinsics, is_whole))
        pose = rigid(
            euler_rotation(self.euler_deg or [0.0] * 3)[:3, :3],
            self.translate or [0.0] * 3,
        )
        power = 1.0 if self.power is None else self.power
        lens = 1e-3 * self.aperture_mm, self.focus
        made = Projector(
            pose, intrinsics, "white", power, self.band, self.filter, *lens
        )
        made = (
            made.with_sequence(parts) if self.sequence else made.with_pattern(parts[0])
        )
        return made if self.lux is None else made.with_lux(self.lux)


def _options(table: StrictModel | None) -> dict[str, Any]:
    """The type of a pattern and its options; that of no pattern is white."""
    if table is None:
        return {"type": "white"}
    return table.model_dump(exclude_none=True)


def _picture_of(table: Mapping[str, Any]) -> NDArray[np.float32] | None:
    """The picture of a pattern, or None for a pattern of another type."""
    if table["type"] != "picture":
        return None
    return _grey_picture(Path(table["file"]))


def _part(
    table: Mapping[str, Any],
    picture: NDArray[np.float32] | None,
    intrinsics: Camera,
    is_whole: bool,
) -> Any:
    """A pattern (H, W), or with `is_whole` the code whose images are all shown, where the type is a code."""
    if picture is not None:
        return picture
    size = intrinsics.width, intrinsics.height
    options = {key: value for key, value in table.items() if key != "type"}
    if is_whole and table["type"] == "gray_code":
        return GrayCode(*size, **options)
    if is_whole and table["type"] == "phase_shift":
        return PhaseShift(*size, **{"period": PHASE_PERIOD, **options})
    return named(table["type"], *size, **options)


def _grey_picture(path: Path) -> NDArray[np.float32]:
    """The values (H, W) of a picture as they are stored, 1 for white. Raises FileError."""
    pixels, _ = decode_picture(path)
    if not (pixels == pixels[..., :1]).all():
        raise FileError(
            f"{path}: is coloured; a projector's pattern is a grey picture, white where light is sent"
        )
    return pixels[..., 0]


Find = Callable[[str], Path]
"""The path of a file that a table names. Raises InputError."""


def with_files(
    table: Mapping[str, Any], find: Find, size: tuple[int, int] | None = None
) -> dict[str, Any]:
    """The table of a rig with what its files hold, which `find` finds by their names.

    A calibration `file` is replaced by its cameras; the pictures that are patterns of projectors, by their paths.

    size : (width, height) for a calibration without it. Raises InputError.
    """
    placed = _with_pictures(table, find)
    return _with_calibration(placed, find, size) if "file" in placed else placed


def _with_pictures(table: Mapping[str, Any], find: Find) -> dict[str, Any]:
    projectors = table.get("projectors")
    if not isinstance(projectors, list):
        return dict(table)
    with_paths = [
        _with_pictures_of(projector, f"projectors[{i}]", find)
        for i, projector in enumerate(projectors)
    ]
    return {**table, "projectors": with_paths}


def _with_pictures_of(projector: Any, key: str, find: Find) -> Any:
    """The table of a projector with the paths of the pictures of its pattern and its sequence."""
    if not isinstance(projector, Mapping):
        return projector
    changed = dict(projector)
    if "pattern" in projector:
        changed["pattern"] = _with_path(projector["pattern"], f"{key}.pattern", find)
    sequence = projector.get("sequence")
    if isinstance(sequence, list):
        changed["sequence"] = [
            _with_path(pattern, f"{key}.sequence[{i}]", find)
            for i, pattern in enumerate(sequence)
        ]
    return changed


def _with_path(pattern: Any, key: str, find: Find) -> Any:
    """The table of a pattern with the path of its picture."""
    match pattern:
        case {"type": "picture", "file": str(name)}:
            with located(f"{key}.file"):
                path = str(find(name))
            return {**pattern, "file": path}
    return pattern


def _with_calibration(
    table: Mapping[str, Any], find: Find, size: tuple[int, int] | None
) -> dict[str, Any]:
    """The table with the cameras of its calibration, and its other keys."""
    settings = read(
        CalibrationKeys,
        {key: table[key] for key in table if key in CalibrationKeys.model_fields},
        "file",
    )
    rest = {key: table[key] for key in table if key not in CalibrationKeys.model_fields}
    for key in rest:
        if key in _OF_CALIBRATION:
            raise InputError(
                f"{key!r} is in the calibration file; remove the key or 'file'"
            )
    with located("file"):
        paths = [find(name) for name in settings.names()]
    calibration = read_rig(
        *paths,
        length_unit=settings.length_unit,
        size=settings.size() or size,
        fisheye=settings.fisheye,
    )
    warn_of_lengths(calibration, settings.names())
    return {**rest, **rig_table(calibration.rig, settings.poses)}


def file_names(table: Mapping[str, Any]) -> list[str]:
    """The files that a rig's table names."""
    names: list[str] = []

    def find(name: str) -> Path:
        names.append(name)
        return Path(name)

    _with_pictures(table, find)
    file = table.get("file", [])
    calibration = [file] if isinstance(file, str) else file
    return names + [name for name in calibration if isinstance(name, str)]


_CalibrationFile: Any = (
    str | Annotated[list[str], pydantic.Field(min_length=1, max_length=2)]
)
_LengthUnit: Any = Literal["m", "cm", "mm"]
_Poses: Any = Literal["rig", "world"]


class CalibrationKeys(StrictModel):
    """The keys of a rig that is in the calibration file of another program.

    file : its name, or two names: intrinsics and extrinsics of OpenCV, left and right camera_info of ROS, cameras.txt
        and images.txt of COLMAP.
    width, height : of the images, for a file without them.
    length_unit : of the file's lengths.
    fisheye : whether an OpenCV file has the coefficients of `cv2.fisheye`.
    poses : "rig" puts the first camera at the rig's pose, "world" takes the file's world for the scene's.
    """

    layout: Literal["file"] = "file"
    file: _CalibrationFile
    width: Annotated[int, setting(Camera, "width")] | None = None
    height: Annotated[int, setting(Camera, "height")] | None = None
    length_unit: _LengthUnit = "m"
    fisheye: bool = False
    poses: _Poses = "rig"

    def names(self) -> list[str]:
        return [self.file] if isinstance(self.file, str) else list(self.file)

    def size(self) -> tuple[int, int] | None:
        """(width, height) of the images where the table states them. Raises InputError for one without the other."""
        if (self.width is None) != (self.height is None):
            raise InputError("'width' and 'height' of a calibration go together")
        if self.width is None or self.height is None:
            return None
        return self.width, self.height


_OF_CALIBRATION = {
    *("camera", "cameras", "baseline", "fov_x_deg", "fx", "fy"),
    *("focal_length_mm", "cx", "cy", "distortion"),
}
"""Keys of a rig that its calibration file sets."""


class RigBase(Viewed):
    """Keys of every layout: the pose, what all cameras share, what each of them changes, and calibration errors."""

    camera: CameraTable | None = None
    cameras: Annotated[list[Intrinsics], _CAMERAS] | None = None
    misalignment: CalibrationError | list[CalibrationError] | None = None
    projectors: (
        Annotated[list[ProjectorTable], pydantic.Field(max_length=_MOST_CAMERAS)] | None
    ) = None

    def rig(self, scene: Scene, width: int, height: int) -> Rig:
        of_scene = {"width": width, "height": height, "fov_x_deg": scene.fov_x_deg}
        shared: Mapping[str, Any] = of_scene
        if self.camera is not None:
            with located("camera"):
                shared = self.camera.over(shared)
            if self.camera.preset and (
                baseline := find_camera(self.camera.preset).baseline
            ):
                scene = replace(scene, baseline=baseline)
        shared = self.over(shared)
        placed = _placed(self, scene, self.pose(scene.world_from_left))
        count = len(placed)
        tables = self.cameras or [Intrinsics()] * count
        if len(tables) != count:
            raise InputError(
                f"cameras: this layout has {counted(count, 'camera')}, got {counted(len(tables), 'table')}"
            )
        cameras = [
            _shifted(table.made(shared), one)
            for table, one in zip(tables, placed.cameras, strict=True)
        ]
        projectors = []
        for i, projector in enumerate(self.projectors or []):
            with located(f"projectors[{i}]"):
                projectors.append(projector.projector(of_scene))
        rig = Rig(cameras, placed.world_from_cams, projectors=projectors)
        check_seen(rig)
        if self.misalignment is None:
            return rig
        errors = self.misalignment
        if not isinstance(errors, list):
            if count < 2:
                raise InputError(
                    "misalignment: a table is for the second camera, and this rig has one; give a list"
                )
            errors = [errors if i == 1 else Misalignment() for i in range(count)]
        with located("misalignment"):
            return misaligned(rig, errors)


def _shifted(camera: Camera, placed: Camera) -> Camera:
    """`camera` with its principal point moved as that of a camera of `_placed`."""
    if placed.cx == placed.cy == 0:
        return camera
    if camera.distortion is not None:
        raise InputError("a light field needs a camera without lens distortion")
    dx, dy = placed.cx / placed.fx, placed.cy / placed.fy
    return camera.replace(cx=camera.cx + camera.fx * dx, cy=camera.cy + camera.fy * dy)


def _placed(table: Any, scene: Scene, pose: Float) -> Rig:
    """A camera at each place of a table's layout, `pose` being world_from_rig; see `twinlens.camera.layouts`."""
    camera, step = Camera.from_fov(1, 1, 90.0), scene.baseline
    match table.layout:
        case "parallel":
            return layouts.line(camera, 2, table.baseline or step, pose)
        case "vertical":
            spacing = table.baseline or step
            return layouts.grid(camera, 2, 1, spacing, spacing, pose)
        case "line":
            return layouts.line(camera, table.count, table.spacing or step, pose)
        case "grid":
            return _grid(table, camera, step, pose)
        case "cameras":
            poses = [place.pose(pose) for place in table.cameras]
            return Rig([camera] * len(poses), poses)
        case "trajectory":
            path = table.count, table.waypoints, table.distance
            return layouts.trajectory(camera, *path, pose)
    length = _length_of_layout(table, scene)
    if table.layout in ("orbit", "hemisphere"):
        return _around(table, camera, length, pose)
    if table.layout == "light_field":
        lens = ThinLens(1e-3 * table.aperture_mm, length)
        return light_field_rig(camera, lens, table.n, pose)
    if table.layout == "arc":
        return layouts.arc(camera, table.count, length, table.angle_deg, pose)
    baseline = table.baseline or step
    # The scene's pose is that of a left camera; the layout's is half a baseline to its right.
    middle = pose @ rigid(np.eye(3), [0.5 * baseline, 0.0, 0.0])
    return layouts.toed_in(camera, baseline, length, middle)


def _around(table: Any, camera: Camera, radius: float, pose: Float) -> Rig:
    """Cameras around an axis, by default the world's z axis."""
    axis = table.axis or _UP
    if table.layout == "orbit":
        sweep = table.angle_deg or 360.0, table.elevation_deg
        return layouts.orbit(camera, table.count, radius, *sweep, pose, axis)
    lowest = {} if table.elevation_deg is None else {"elevation_deg": table.elevation_deg}  # fmt: skip
    return layouts.hemisphere(
        camera, table.count, radius, **lowest, world_from_first=pose, up=axis
    )


def _grid(table: Any, camera: Camera, step: float, pose: Float) -> Rig:
    """A grid of cameras; the spacing down is that across by default, and both the scene's baseline."""
    if (count := table.rows * table.columns) > _MOST_CAMERAS:
        raise InputError(
            f"rows and columns make {count} cameras; at most {_MOST_CAMERAS} are allowed"
        )
    across = table.spacing_x or step
    down = table.spacing_y or across
    return layouts.grid(camera, table.rows, table.columns, across, down, pose)


def _length_of_layout(table: Any, scene: Scene) -> float:
    """The distance on which a layout converges or focuses: that of the table, or the middle of the scene's depths.

    Layouts around a point have the distance of `look_at` where the table has one.
    """
    key = {"toed_in": "distance", "light_field": "focus"}.get(table.layout, "radius")
    length: float | None = getattr(table, key)
    if length:
        return length
    if table.layout in ("orbit", "hemisphere") and table.position is not None:
        return float(np.linalg.norm(np.subtract(table.look_at, table.position)))
    if not scene.depth_range_known:
        raise InputError(
            f"missing key {key!r}; the scene has no depth range to derive it from"
        )
    return middle_focus(*scene.depth_range)


_KEYS: dict[str, dict[str, Any]] = {
    "parallel": {"baseline": RigLength | None},
    "toed_in": {"baseline": RigLength | None, "distance": RigLength | None},
    "vertical": {"baseline": RigLength | None},
    "line": {"count": Count, "spacing": RigLength | None},
    "grid": {
        "rows": Count,
        "columns": Count,
        "spacing_x": RigLength | None,
        "spacing_y": RigLength | None,
    },
    "arc": {
        "count": Count,
        "radius": RigLength | None,
        "angle_deg": number(0, 360, above=True),
    },
    "orbit": {
        "count": Count,
        "radius": RigLength | None,
        "angle_deg": number(0, 360, above=True) | None,
        "elevation_deg": _Elevation | None,
        "axis": Vector3 | None,
    },
    "hemisphere": {
        "count": Count,
        "radius": RigLength | None,
        "elevation_deg": _Elevation | None,
        "axis": Vector3 | None,
    },
    "trajectory": {
        "count": Count,
        "waypoints": Annotated[list[Vector3], _WAYPOINTS],
        "distance": RigLength | None,
    },
    "light_field": {
        "n": Annotated[int, pydantic.Field(ge=1, le=31)],
        "aperture_mm": Positive,
        "focus": _Focus | None,
    },
    "cameras": {"cameras": Annotated[list[PosedIntrinsics], _CAMERAS]},
    "file": {
        "file": _CalibrationFile,
        "length_unit": _LengthUnit | None,
        "fisheye": bool | None,
        "poses": _Poses | None,
    },
}
_RIGS = variants(RigBase, "layout", _KEYS, "parallel")
RigTable = Annotated[RigBase, reads(tagged("Rig", "layout", _RIGS, "parallel"))]
"""The table that `rig_from_table` reads."""

_RIG: pydantic.TypeAdapter[RigBase] = pydantic.TypeAdapter(RigTable)
_ALL_KEYS = {name for rig in _RIGS for name in rig.model_fields}
"""Of the tables of all layouts: a misspelt `file` is near to a key that only one of them has."""


def with_values(table: Mapping[str, Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """A rig's table with `values` in place of its own, and of those of its `cameras`.

    A `camera` replaces all intrinsics and, with a preset of a pair, the baseline.
    """
    replaced = set(values).union(
        *(keys for keys in ALTERNATIVES if keys & values.keys())
    )
    if "camera" in values:
        replaced |= Intrinsics.model_fields.keys()
        preset = CAMERAS.get(
            values["camera"].get("preset")
        )  # an unknown one is an error where the table is read
        if preset and preset.baseline:
            replaced.add("baseline")

    def kept(part: Any) -> Any:
        if isinstance(part, Mapping):
            return {key: part[key] for key in part if key not in replaced}
        return part

    rest: dict[str, Any] = kept(table)
    if isinstance(rest.get("cameras"), list):
        rest["cameras"] = [kept(camera) for camera in rest["cameras"]]
    return {**rest, **values}


def rig_from_table(
    table: Mapping[str, Any],
    scene: Scene,
    width: int,
    height: int,
    file: str | Path = "rig",
    key: str = "",
) -> Rig:
    """The rig that `table` describes, at the viewpoint of the scene unless the table has one.

    `table` has plain values as TOML has them; docs/rigs.md shows the keys. Files that it names are below the current
    folder. The scene's pose, field of view and baseline are the defaults; `width` and `height` in pixels are for
    cameras whose tables have none. With `misalignment`, the rig's `calibrated` is the one without the calibration
    errors.

    Raises InputError that names `file`, the key below the dotted path `key`, and what is allowed.
    """
    with located(f"{file}: {key}" if key else str(file)):
        for name in table:
            check_known("key", name, _ALL_KEYS)
        table = with_files(table, Path)
    checked = read(_RIG, table, file, key)
    with located(f"{file}: {key}" if key else str(file)):
        return checked.rig(scene, width, height)
