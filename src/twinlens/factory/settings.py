"""The keys of a recipe that are drawn for every sample, after their distributions have been replaced by values.

docs/recipes.md shows the tables of lenses, apertures, sensors and mismatches.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PlainValidator,
    Strict,
    TypeAdapter,
    model_validator,
)

from twinlens.calibrations import read_rig, rig_table, warn_of_lengths
from twinlens.camera import (
    RecipeLens,
    Rig,
)
from twinlens.camera.intrinsics import MAX_SIDE
from twinlens.camera.presets import CAMERAS, find_camera
from twinlens.errors import FileError, InputError, located
from twinlens.factory.lenses import Find, Lenses, View, make_lens
from twinlens.factory.objects import Objects
from twinlens.factory.sample import Shoot
from twinlens.families import FAMILIES, check_view
from twinlens.geometry import Float, rigid
from twinlens.scenes import Scene, read_toml, rig_from_table
from twinlens.scenes.placement import rotation
from twinlens.scenes.rigs import (
    ALTERNATIVES,
    OF_ONE_CAMERA,
    CameraTable,
    Intrinsics,
    with_files,
    with_values,
)
from twinlens.schema import (
    NEAR_FAR,
    NonNegative,
    Number,
    Positive,
    StrictModel,
    read,
    setting,
    table_of,
)
from twinlens.seeds import derived_seed
from twinlens.sensor import (
    DEFAULT_MISMATCH,
    LEVELS,
    PRESETS,
    Exposure,
    Mismatch,
    Sensor,
    level_table,
    mismatch_table,
)

Step = Annotated[Number, Field(ge=-1e6, le=1e6)]
Degrees = Annotated[Number, Field(ge=-360, le=360)]


class JitterTable(StrictModel):
    """Displacement of the rig from the scene's viewpoint: metres along its axes, then degrees about x, y, z."""

    right: Step = 0.0
    down: Step = 0.0
    forward: Step = 0.0
    pitch_deg: Degrees = 0.0
    yaw_deg: Degrees = 0.0
    roll_deg: Degrees = 0.0

    def pose(self) -> Float:
        """4x4, multiplied from the right: ``world_from_left @ pose``."""
        x, y, z = map(
            rotation, np.eye(3), (self.pitch_deg, self.yaw_deg, self.roll_deg)
        )
        return rigid((y @ x @ z)[:3, :3], [self.right, self.down, self.forward])


class SceneTable(StrictModel):
    """Where the rig is, the recipe's own objects, the factor of the scene's own light, and, for families only, the
    depths and the number of objects."""

    ambient: Annotated[NonNegative, Field(le=1e9)] = 1.0
    jitter: JitterTable = JitterTable()
    depth_range: (
        Annotated[tuple[Positive, Positive], Strict(strict=False), NEAR_FAR] | None
    ) = None
    object_count: Annotated[int, Field(ge=0, le=10_000)] | None = None
    objects: Objects = Field(default_factory=dict)


class SkyTable(StrictModel):
    """A picture that lights the scene in place of its own lights. Without `lamps`, objects that emit light are dark."""

    file: Annotated[
        str,
        Field(
            min_length=1,
            description="an .exr, .hdr or .png file next to the recipe, or a folder",
        ),
    ]
    turn_deg: Degrees = 0.0
    scale: Annotated[Positive, Field(ge=1e-9, le=1e9)] = 1.0
    visible: bool = True
    lamps: bool = True
    nir: Literal["daylight", "tungsten", "led"] | NonNegative | None = None


Seed = Annotated[int, Field(ge=0)]
_PRESET = "machine_vision"
ExposureTable: Any = table_of(Exposure)


def _mismatch(
    level: str = "none", seed: int | None = None, **fields: float
) -> Mismatch:
    if level == "none" and seed is not None:
        raise InputError("seed needs a level that is drawn, such as typical")
    return Mismatch.draw(level, seed or 0, **fields)


MismatchTable: Any = table_of(
    Mismatch, make=_mismatch, level=(Literal[LEVELS], "none"), seed=(Seed | None, None)
)
"""The fields of `Mismatch`, of which those not given are drawn at a level."""
_level = BeforeValidator(level_table, str | MismatchTable)
MismatchTables: Any = (
    Annotated[MismatchTable, _level]
    | Annotated[list[Annotated[MismatchTable, _level]], AfterValidator(tuple)]
)
"""A level or a table for all cameras after the first, or a list with one for each."""


def sensor_table(cls: type[Sensor] = Sensor) -> Any:
    """The type of a table with a preset, and every field of a class of sensors under its own name, as a sensor."""
    keys: dict[str, Any] = {
        "make": lambda preset=_PRESET, **changes: cls.preset(preset, **changes),
        "preset": (Literal[tuple(PRESETS)], _PRESET),
        "mismatch": (MismatchTables, DEFAULT_MISMATCH),
    }
    nir = table_of(cls, **keys, title=f"Nir{cls.__name__}Table", nir=(type(None), None))
    return table_of(cls, **keys, nir=(nir | None, None))


SensorTable: Any = sensor_table()


class RigFile(StrictModel):
    """The part of a recipe that describes the cameras, as `twinlens plan` writes it."""

    width: int | None = Field(None, ge=1, le=MAX_SIDE)
    height: int | None = Field(None, ge=1, le=MAX_SIDE)
    rig: dict[str, Any]
    lenses: Lenses | None = None


def read_rig_file(
    paths: Sequence[Path], size: tuple[int, int] | None = None
) -> tuple[dict[str, Any], str, list[Any]]:
    """The rig's table in a .toml file, its key in the file, and the tables of lenses.

    The file is a rig's table, or has its keys in `[rig]`, beside `width`, `height` and `[[lenses]]`. Files of other
    kinds are calibrations (`calibrations.read_rig`), without lenses. `size` is (width, height) for calibrations without
    it, also where a table names them.
    """
    if not any(path.suffix == ".toml" for path in paths):
        calibration = read_rig(*paths, size=size)
        warn_of_lengths(calibration, [str(path) for path in paths])
        return rig_table(calibration.rig), "", []
    if len(paths) > 1:
        raise FileError(f"{paths[1]}: a rig in a .toml file has no second file")
    path = paths[0]
    table = read_toml(path)
    stated = dict(zip(("width", "height"), size or (), strict=False))
    if not isinstance(table.get("rig"), Mapping):
        return (stated if "file" in table else {}) | table, "", []
    part = read(RigFile, table, path)
    image_size = {
        key: getattr(part, key)
        for key in ("width", "height")
        if getattr(part, key) is not None
    }
    if "file" in part.rig:
        image_size = stated | image_size
    return image_size | part.rig, "rig", part.lenses or []


def _check_camera(table: Any) -> Any:
    checked = _CAMERA.validate_python(table)
    if checked.width or checked.height:
        raise InputError(
            "'width' and 'height' of a recipe are not in [camera]; write them above the first table"
        )
    return table


_CAMERA: TypeAdapter[CameraTable] = TypeAdapter(CameraTable)
RecipeCamera = Annotated[
    dict[str, Any], PlainValidator(_check_camera, json_schema_input_type=CameraTable)
]


ANY_SCENE = Scene("any", (), {}, np.eye(4), (1.0, 10.0))
"""For checks of a rig where the scene is not known."""


class RecipeSettings(StrictModel):
    """How one sample is taken. The rig stays a table: it is read where the scene is known."""

    width: int = Field(704, ge=1, le=MAX_SIDE)
    height: int = Field(528, ge=1, le=MAX_SIDE)
    spp: Annotated[int, setting(Shoot, "spp")] = 8
    denoise: Annotated[bool, setting(Shoot, "denoise")] = True
    noise: Annotated[float, setting(Shoot, "noise")] | None = None
    diffraction: Annotated[bool, setting(Shoot, "diffraction")] = False
    dual_pixel: Annotated[bool, setting(Shoot, "dual_pixel")] = False
    sky_disparity: Annotated[bool, setting(Shoot, "sky_disparity")] = False
    scene: SceneTable = SceneTable()
    sky: SkyTable | None = None
    camera: RecipeCamera | None = None
    rig: dict[str, Any] = Field(default_factory=dict)
    lenses: Lenses = Field([{"kind": "pinhole"}], validate_default=True)
    sensor: SensorTable = Field(default_factory=Sensor)
    exposure: ExposureTable | None = None

    @model_validator(mode="before")
    @classmethod
    def _take_size_of_camera(cls, data: Any) -> Any:
        """Without a size, images have that of the preset in `camera`."""
        camera = data.get("camera") if isinstance(data, Mapping) else None
        preset = camera.get("preset") if isinstance(camera, Mapping) else None
        width = data.get("width") if preset is not None else None
        if not (isinstance(preset, str) and preset in CAMERAS) or not (
            width is None or type(width) is int
        ):
            return data
        preset_width, preset_height = CAMERAS[preset].size(width)
        return {"width": preset_width, "height": preset_height} | data

    @model_validator(mode="after")
    def _check_camera_and_rig(self) -> "RecipeSettings":
        if preset := (self.camera or {}).get("preset"):
            find_camera(preset).resized(self.width, self.height)
        with_alternatives = set[str]().union(*ALTERNATIVES)
        groups = [
            *ALTERNATIVES,
            *({key} for key in Intrinsics.model_fields if key not in with_alternatives),
        ]
        for keys in groups:
            camera = [key for key in self.camera or {} if key in keys]
            rig = [key for key in self.rig if key in keys]
            if camera and rig:
                raise InputError(
                    f"camera.{camera[0]} and rig.{rig[0]} exclude each other; keep one"
                )
        return self

    def shoot(self, seed: int, sensor: Sensor, keep: Sequence[str] = ()) -> Shoot:
        """How the sample is taken. `keep` are the optional outputs of the recipe."""
        return Shoot(
            seed=seed,
            spp=self.spp,
            denoise=self.denoise,
            noise=self.noise,
            sensor=sensor,
            exposure=self.exposure,
            diffraction=self.diffraction,
            dual_pixel=self.dual_pixel,
            sky_disparity=self.sky_disparity,
            keep_radiance="radiance" in keep,
            keep_models="models" in keep,
        )

    def rig_of(
        self, scene: Scene, scene_rig: Mapping[str, Any] | None, file: Path, find: Find
    ) -> Rig:
        """The rig in `scene`: that of the recipe, or `own`, the table of the scene, with the camera of the recipe."""
        with located(f"{file}: rig"):
            recipe_rig = with_files(self.rig, find)
        table = recipe_rig or scene_rig or {}
        if self.camera is not None:
            camera = {**self.camera, "width": self.width, "height": self.height}
            table = (
                {**recipe_rig, "camera": camera}
                if recipe_rig
                else with_values(table, {"camera": camera})
            )
        return rig_from_table(table, scene, self.width, self.height, file, "rig")


def sensor_for(
    rig: Rig,
    drawn: Mapping[str, Any],
    seed: int,
    scene_rig: Mapping[str, Any] | None = None,
    file: Path = Path(),
) -> Sensor:
    """The sensor of a drawn table for a rig; a level of mismatch is drawn for each camera after the first.

    Where there is `only_one_camera`, the default is no mismatch, and another one raises InputError.
    own : the table of the scene's rig.
    """
    table = drawn.get("sensor", {})
    mismatch = mismatch_table(table)
    if problem := only_one_camera(
        len(rig), (drawn.get("rig") or scene_rig or {}).get("layout")
    ):
        if "mismatch" in table and mismatch != {"level": "none"}:
            raise InputError(f"{file}: sensor.mismatch: {problem}")
        mismatch = {"level": "none"}
    table = {**table, "mismatch": mismatches_for(mismatch, len(rig), seed)}
    sensor: Sensor = read(SensorTable, table, file, "sensor")
    with located(str(file)):
        sensor.check_mismatches(rig)
    return sensor


def only_one_camera(count: int, layout: str | None) -> str:
    """Why a rig of `count` cameras has no mismatch; empty if it may have one."""
    remedy = "leave the mismatch out"
    if layout in OF_ONE_CAMERA:
        return (
            f"the views of {OF_ONE_CAMERA[layout]} are of one camera and do not differ; "
            f"{remedy}"
        )
    if count == 1:
        return (
            f"the rig has one camera, and only those after the first differ; {remedy}"
        )
    return ""


def mismatches_for(table: Any, cameras: int, seed: int) -> Any:
    """A mismatch's table, or a list of them, with seeds. A level is drawn for each camera after the first."""
    if isinstance(table, list):
        return [
            _seeded(mismatch, camera, seed)
            for camera, mismatch in enumerate(table, start=1)
        ]
    if cameras < 3 or table.get("level", "none") == "none":
        return _seeded(table, 1, seed)
    return [_seeded(table, camera, seed) for camera in range(1, cameras)]


def _seeded(table: Mapping[str, Any], camera: int, seed: int) -> Mapping[str, Any]:
    """The table with the seed of a camera, if it has a level. That of the second camera is `seed`, or the table's."""
    if table.get("level", "none") == "none":
        return table
    seed = table.get("seed", seed)
    return {
        **table,
        "seed": seed if camera == 1 else derived_seed(seed, "camera", camera),
    }


def check_settings(
    drawn: Mapping[str, Any], file: Path, families: Sequence[str]
) -> tuple[RecipeSettings, list[RecipeLens]]:
    """The settings and lenses of a drawn table, or InputError where no scene (of these families) could be its sample.

    Focus distances that depend on the scene are 1 m.
    """
    settings = read(RecipeSettings, dict(drawn), file)
    with located(str(file)):
        settings.shoot(0, settings.sensor)
    for name in families:
        with located(str(file)):
            depths = settings.scene.depth_range
            check_view(
                name,
                settings.width / settings.height,
                settings.width,
                depths,
                "scene.depth_range",
            )
            if settings.scene.object_count == 0 and not FAMILIES[name].may_be_empty:
                raise InputError(
                    f"scene.object_count must be >= 1 in {name} scenes, got 0"
                )
    family_keys = settings.scene.model_fields_set & {"depth_range", "object_count"}
    if family_keys and not families:
        raise InputError(
            f"{file}: scene.{min(family_keys)}: can be used with 'families' only"
        )
    rig = settings.rig_of(ANY_SCENE, None, file, lambda name: file.parent / name)
    if settings.rig:
        sensor_for(rig, drawn, 0, file=file)
    return settings, make_lenses(settings, None, file, lambda name: file.parent / name)


def make_lenses(
    settings: RecipeSettings, view: View | None, file: Path, find: Find
) -> list[RecipeLens]:
    """The lenses of a sample; without a view they are only checked."""
    lenses = []
    for k, table in enumerate(settings.lenses):
        with located(f"{file}: lenses[{k}]"):
            lenses.append(make_lens(table, view, find))
    return lenses
