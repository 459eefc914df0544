"""The keys of a recipe that are drawn for every sample, after their distributions have been replaced by values."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, Strict, create_model

from twinlens.camera import Lens
from twinlens.camera.intrinsics import MAX_SIDE
from twinlens.errors import InputError, located
from twinlens.factory.lenses import Find, LensTable, PinholeTable, View
from twinlens.geometry import Float, rigid
from twinlens.scenes import Scene, rig_from_table
from twinlens.scenes.placement import rotation
from twinlens.schema import Number, Positive, StrictModel, exactly, read
from twinlens.sensor import PRESETS, Mismatch, Sensor

_PRESET = "machine_vision"
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
        x, y, z = map(rotation, np.eye(3), (self.pitch_deg, self.yaw_deg, self.roll_deg))
        return rigid((y @ x @ z)[:3, :3], [self.right, self.down, self.forward])


def _near_far(depths: tuple[float, float]) -> tuple[float, float]:
    if not depths[0] < depths[1]:
        raise InputError(f"must be [near, far] with near < far, in metres, got {list(depths)}")
    return depths


class SceneTable(StrictModel):
    """Where the rig is, and, for families only, the depths and the number of objects."""

    jitter: JitterTable = JitterTable()
    depth_range: Annotated[tuple[Positive, Positive], Strict(strict=False), AfterValidator(_near_far)] | None = None
    object_count: Annotated[int, Field(ge=1, le=10_000)] | None = None


class ExposureTable(StrictModel):
    """A fixed exposure: time in seconds, gain as a factor."""

    time: Positive
    gain: Positive = 1.0


def _keys_of(kind: type[Any]) -> dict[str, Any]:
    """The fields of a dataclass of constants, as fields of a model. TOML has lists where Python has tuples."""
    triple = Annotated[list[Number], exactly(3, Number), AfterValidator(tuple)]
    keys: dict[str, Any] = {}
    for field in fields(kind):
        if isinstance(field.default, tuple):
            keys[field.name] = (triple, list(field.default))
        elif field.name != "mismatch":
            keys[field.name] = (Number if isinstance(field.default, float) else type(field.default), field.default)
    return keys


MismatchTable: Any = create_model("MismatchTable", __base__=StrictModel, **_keys_of(Mismatch))


class _SensorTable(StrictModel):
    preset: Literal[tuple(PRESETS)] = _PRESET  # type: ignore[valid-type]
    mismatch: MismatchTable = MismatchTable()

    def sensor(self) -> Sensor:
        """The preset with the given fields replaced. Raises InputError for a value out of range."""
        given = {name: getattr(self, name) for name in self.model_fields_set - {"preset", "mismatch"}}
        return Sensor.preset(self.preset, mismatch=Mismatch(**self.mismatch.model_dump()), **given)


SensorTable: Any = create_model("SensorTable", __base__=_SensorTable, **_keys_of(Sensor))
"""A preset, and every field of `Sensor` under its own name."""


def _as_list(value: Any) -> Any:
    if isinstance(value, Mapping):
        raise InputError("must be a list of tables: write [[lenses]] above each lens, not [lenses]")
    return value


Lenses = Annotated[list[LensTable], Field(min_length=1, max_length=100), BeforeValidator(_as_list)]


class Settings(StrictModel):
    """How one sample is taken. The rig stays a table: it is read where the scene is known."""

    width: int = Field(640, ge=1, le=MAX_SIDE)
    height: int = Field(480, ge=1, le=MAX_SIDE)
    spp: int = Field(64, ge=1, le=1_000_000)
    diffraction: bool = False
    sky_disparity: bool = False
    scene: SceneTable = SceneTable()
    rig: dict[str, Any] = Field(default_factory=dict)
    lenses: Lenses = Field([PinholeTable()])
    sensor: SensorTable = SensorTable()
    exposure: ExposureTable | None = None


_ASPECTS, _LEAST_WIDTH = (0.2, 5.0), 16
"""Image shapes that families compose scenes for: width over height, and pixels across."""
_STAND_IN = Scene("any", (), {}, np.eye(4), (1.0, 10.0))


def check_settings(drawn: Mapping[str, Any], file: Path, families: Sequence[str]) -> tuple[Settings, list[Lens]]:
    """The settings and lenses of a drawn table, or InputError where no scene (of these families) could be its sample.

    Focus distances that depend on the scene are 1 m.
    """
    settings = read(Settings, dict(drawn), file)
    if families:
        _check_families(settings, file, families)
    elif given := settings.scene.model_fields_set & {"depth_range", "object_count"}:
        raise InputError(f"{file}: scene.{min(given)}: can be used with 'families' only")
    rig_from_table(settings.rig, _STAND_IN, settings.width, settings.height, file, "rig")
    make_sensor(settings, file)
    return settings, make_lenses(settings, None, file, lambda name: file.parent / name)


def make_sensor(settings: Settings, file: Path) -> Sensor:
    """The sensor of a sample."""
    with located(str(file)):  # the message names the sensor's field
        sensor: Sensor = settings.sensor.sensor()
    return sensor


def make_lenses(settings: Settings, view: View | None, file: Path, find: Find) -> list[Lens]:
    """The lenses of a sample; without a view they are only checked."""
    lenses = []
    for k, table in enumerate(settings.lenses):
        with located(f"{file}: lenses[{k}]"):
            lenses.append(table.lens(view, find))
    return lenses


def _check_families(settings: Settings, file: Path, families: Sequence[str]) -> None:
    from twinlens.families import FAMILIES

    width, height = settings.width, settings.height
    if width < _LEAST_WIDTH:
        raise InputError(f"{file}: width: must be >= {_LEAST_WIDTH} for families, got {width}")
    if not _ASPECTS[0] <= width / height <= _ASPECTS[1]:
        raise InputError(f"{file}: width: must be 0.2 to 5 times the height for families, got {width} x {height}")
    for name in families if settings.scene.depth_range else ():
        near, far = settings.scene.depth_range or (0.0, 0.0)
        least = FAMILIES[name].least_ratio
        if not far >= least * near:
            raise InputError(
                f"{file}: scene.depth_range: a {name} scene needs far >= {least:g} near, got [{near:g}, {far:g}]"
            )
