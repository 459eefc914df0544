"""The part of a recipe that every sample draws anew, with plain values in the place of its distributions."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.camera.intrinsics import MAX_SIDE
from twinlens.factory.lenses import lens_from_table
from twinlens.factory.sensors import exposure_from_table, jitter_from_table, sensor_from_table
from twinlens.geometry import Float
from twinlens.scenes import Scene, rig_from_table
from twinlens.scenes.table import At, Parser, Table, boolean, listed, number, whole
from twinlens.sensor import Exposure, Sensor

_PINHOLE = [{"kind": "pinhole"}]
_MOST_LENSES = 100
_MOST_SPP = 1_000_000
_ASPECTS, _LEAST_WIDTH = (0.2, 5.0), 16
"""What families of scenes are composed for: width over height, and pixels across."""
_STAND_IN = Scene("any", (), {}, np.eye(4), (1.0, 10.0))


@dataclass(frozen=True, eq=False)
class Settings:
    """How one sample is taken. Rig and lenses stay tables: they are read where the scene is known."""

    width: int
    height: int
    spp: int
    diffraction: bool
    sky_disparity: bool
    sensor: Sensor
    exposure: Exposure | None
    jitter: Float
    depth_range: tuple[float, float] | None
    object_count: int | None
    rig: Mapping[str, Any]
    lenses: list[Mapping[str, Any]]


_SIMPLE: dict[str, tuple[Parser[Any], Any]] = {
    "width": (whole(1, MAX_SIDE), 640),
    "height": (whole(1, MAX_SIDE), 480),
    "spp": (whole(1, _MOST_SPP), 64),
    "diffraction": (boolean, False),
    "sky_disparity": (boolean, False),
}
DRAWN = (*_SIMPLE, "scene", "rig", "lenses", "sensor", "exposure")
"""The keys of a recipe that are drawn for every sample."""


def read_settings(drawn: Mapping[str, Any], at: At) -> Settings:
    """The settings that a drawn table says, else their defaults. Raises InputError naming the place."""
    keys: Table[Any] = Table(at, drawn)
    return Settings(
        **{key: keys.take(key, parser, default) for key, (parser, default) in _SIMPLE.items()},
        sensor=keys.take("sensor", lambda at, value: sensor_from_table(value, at), Sensor()),
        exposure=keys.take("exposure", lambda at, value: exposure_from_table(value, at), None),
        rig=keys.take("rig", _table, {}),
        lenses=keys.take("lenses", _lenses, _PINHOLE),
        **keys.take("scene", _scene, _scene(at, {})),
    )


@dataclass(frozen=True)
class Asked:
    """What is to be judged of all draws together, or beside the recipe's families."""

    depth_range: tuple[float, float] | None
    diffraction: bool
    lens_has_width: bool


def check_settings(drawn: Mapping[str, Any], at: At, families: bool) -> Asked:
    """Raise InputError for what could not be a sample, whatever its scene is.

    `families` says whether scenes are made, and not read from files.
    """
    settings = read_settings(drawn, at)
    if families:
        _check_picture(settings, at)
    else:
        for key in ("depth_range", "object_count"):
            if key in drawn.get("scene", {}):
                raise (at / "scene" / key).wrong("belongs to 'families'; a scene from a file is as it is")
    rig_from_table(settings.rig, _STAND_IN, settings.width, settings.height, at / "rig")
    lenses = [
        lens_from_table(lens, None, at / "lenses" / k, lambda name: at.source.folder / name)
        for k, lens in enumerate(settings.lenses)
    ]
    return Asked(settings.depth_range, settings.diffraction, any(lens.aperture_diameter > 0 for lens in lenses))


def _check_picture(settings: Settings, at: At) -> None:
    """Families compose their scenes for the picture: it must be one that they can fill."""
    if settings.width < _LEAST_WIDTH:
        raise (at / "width").wrong(f"must be {_LEAST_WIDTH} or more for a family, got {settings.width}")
    aspect = settings.width / settings.height
    if not _ASPECTS[0] <= aspect <= _ASPECTS[1]:
        asked = f"{settings.width} x {settings.height}"
        raise (at / "width").wrong(f"must be 0.2 to 5 times the height for a family, got {asked}")


def _scene(at: At, value: Any) -> dict[str, Any]:
    keys: Table[Any] = Table(at, value)
    given = {
        "jitter": keys.take("jitter", lambda at, value: jitter_from_table(value, at), np.eye(4)),
        "depth_range": keys.take("depth_range", _depths, None),
        "object_count": keys.take("object_count", whole(1, 10_000), None),
    }
    keys.done()
    return given


def _depths(at: At, value: Any) -> tuple[float, float]:
    near, far = listed(number(above=0.0), 2, 2)(at, value)
    if not near < far:
        raise at.wrong(f"must be [near, far] with near < far, in metres, got [{near:g}, {far:g}]")
    return near, far


def _lenses(at: At, value: Any) -> list[Mapping[str, Any]]:
    if isinstance(value, Mapping):
        raise at.wrong("is a list of tables, one for each lens: write [[lenses]] above each, not [lenses]")
    tables: list[Mapping[str, Any]] = listed(_table, 1, _MOST_LENSES)(at, value)
    return tables


def _table(at: At, value: Any) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise at.wrong(f"must be a table of keys and values, got {value!r:.60}")
    return value
