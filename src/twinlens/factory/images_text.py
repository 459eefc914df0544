"""The settings on which images depend most, in one line, which `render` and `generate` print first.

The defaults of the two differ: `render` takes images of equal cameras, to study one effect at a time, and `generate` of
two cameras that differ as real ones do, to train and to rank matchers.
"""

from collections.abc import Mapping
from typing import Any

from twinlens.factory.draws import KINDS
from twinlens.factory.settings import RecipeSettings, only_one_camera
from twinlens.sensor.mismatch import mismatch_table

_DEFAULT_SENSOR, _DRAWN, _SET = "machine_vision", "drawn", "as set"


def images_text(sensor: str, mismatch: str, spp: str, denoise: str) -> str:
    """Sensor, differences of the cameras, samples per pixel and denoising.

    >>> images_text("phone", "none", "12", "true")
    'images: sensor phone, equal cameras (mismatch none), 12 samples per pixel, denoised'
    """
    cameras = "equal cameras" if mismatch == "none" else "cameras that differ"
    noise = {"true": "denoised", "false": "not denoised"}.get(
        denoise, f"denoising {denoise}"
    )
    return f"images: sensor {sensor}, {cameras} (mismatch {mismatch}), {spp} samples per pixel, {noise}"


def images_of_recipe(written: Mapping[str, Any]) -> str:
    """`images_text` of a recipe as its file has it.

    >>> images_of_recipe({"spp": 16, "sensor": {"read_noise": {"uniform": [1, 3]}, "mismatch": "consumer"}})
    'images: sensor machine_vision, cameras that differ (mismatch consumer), 16 samples per pixel, denoised'
    """
    sensor = written.get("sensor", {})
    spp, denoise = (
        _stated(written.get(name, RecipeSettings.model_fields[name].default))
        for name in ("spp", "denoise")
    )
    if not isinstance(sensor, Mapping) or _is_distribution(sensor):
        return images_text(_DRAWN, _DRAWN, spp, denoise)
    preset = _stated(sensor.get("preset", _DEFAULT_SENSOR))
    mismatch = "none" if _has_one_camera(written.get("rig")) else _mismatch_of(sensor)
    return images_text(preset, mismatch, spp, denoise)


def _has_one_camera(rig: Any) -> bool:
    """Whether a recipe's rig says that its views are of one camera, which has no mismatch."""
    table = rig if isinstance(rig, Mapping) else {}
    cameras = table.get("cameras")
    count = len(cameras) if isinstance(cameras, list) else table.get("count")
    number = count if isinstance(count, int) else 2
    return bool(only_one_camera(number, table.get("layout")))


def _mismatch_of(sensor: Mapping[str, Any]) -> str:
    """The level of the mismatch; of several cameras, those that differ."""
    table = mismatch_table(sensor)
    tables = table if isinstance(table, list) else [table]
    levels = [_level(of_camera) for of_camera in tables]
    return ", ".join(dict.fromkeys(levels))


def _level(table: Any) -> str:
    if not isinstance(table, Mapping) or _is_distribution(table):
        return _DRAWN
    return _stated(table["level"]) if "level" in table else _SET


def _is_distribution(value: Mapping[str, Any]) -> bool:
    return not set(KINDS).isdisjoint(value)


def _stated(value: Any) -> str:
    """A value as text, that of a distribution as "drawn"."""
    if isinstance(value, Mapping):
        return _DRAWN
    return str(value).lower() if isinstance(value, bool) else str(value)
