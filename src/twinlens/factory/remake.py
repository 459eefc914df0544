"""Making a sample again from its record."""

from collections.abc import Mapping
from dataclasses import fields, replace
from types import NoneType
from typing import Any

from twinlens.dataset import Sample
from twinlens.dataset.record import lens_from_plain, rig_from_plain
from twinlens.errors import InputError, unknown
from twinlens.factory.sample import make_sample
from twinlens.factory.sources import file_digests
from twinlens.rendering import Progress
from twinlens.scenes import Scene, load_scene
from twinlens.sensor import Exposure, Mismatch, Sensor

ORIGIN = ("spec", "rejections", "sources_sha256", "rectified_from")
"""Keys of a record that `make_sample` does not write: the recipe's draw, or another sample."""


def remake(record: Mapping[str, Any], scene: Scene | None = None, *, progress: Progress | None = None) -> Sample:
    """Make the sample again whose sample.json is `record` (`StoredSample.record`).

    Its files are the same to the byte if backend and versions are those in the record. A bundled scene is found by its
    name; any other must be given as `scene`, as `load_scene` reads it.

    Raises
    ------
    InputError
        The scene differs from the record's, or is neither bundled nor given; the images were warped from others; or
        `make_sample` did not write the record.
    """
    made = _part(record, "record", Mapping)
    if isinstance(made.get("rectified_from"), Mapping) and made["rectified_from"].get("pictures") == "maps":
        raise InputError("its images were warped from another sample's; rectify that sample again")
    scene = scene_of(record, scene)
    sample = make_sample(
        scene,
        rig_from_plain(record.get("rig")),
        [lens_from_plain(shot.get("lens")) for shot in _part(record, "shots", list)],
        spp=_part(made, "spp", int),
        seed=_part(made, "seed", int),
        sensor=sensor_from_record(_part(made, "sensor", Mapping)),
        exposure=None if made.get("exposure") is None else _built(Exposure, made["exposure"]),
        diffraction=_part(made, "diffraction", bool),
        sky_disparity=_part(made, "sky_disparity", bool),
        keep_radiance=_part(made, "keep_radiance", bool),
        progress=progress,
    )
    ndisp = _part(_part(made, "spec", Mapping), "ndisp", (int, NoneType)) if "spec" in made else None
    return replace(sample, ndisp=ndisp, record={**sample.record, **{key: made[key] for key in ORIGIN if key in made}})


def sensor_from_record(record: Mapping[str, Any]) -> Sensor:
    """The sensor from ``dataclasses.asdict(sensor)`` or its JSON. Raises InputError."""
    mismatch: Mismatch = _built(Mismatch, record.get("mismatch") or {})
    sensor: Sensor = _built(Sensor, {**record, "mismatch": mismatch})
    return sensor


def _built(kind: type[Any], record: Any) -> Any:
    """A `kind` with the record's fields. Raises InputError for an unknown field."""
    if not isinstance(record, Mapping):
        raise InputError(f"the record of the {kind.__name__.lower()} must be an object")
    known = [field.name for field in fields(kind)]
    for name in record:
        if name not in known:
            raise unknown(f"field of {kind.__name__}", str(name), known)
    return kind(**record)


def scene_of(record: Mapping[str, Any], given: Scene | None = None) -> Scene:
    """The scene of a sample's record: the one given, or the bundled one of its name; of the very same files.

    Raises InputError as `remake` does.
    """
    made = _part(record, "record", Mapping)
    name = _part(made, "scene", str)
    try:
        scene = given or load_scene(name)
    except InputError as error:
        raise InputError(f"scene {name!r} is not bundled; give it, as load_scene reads it from its file") from error
    if (scene.name, file_digests(scene)) != (name, made.get("scene_files")):
        raise InputError(f"scene {scene.name!r} is not the one that the record names: its files have changed")
    return scene


def _part(record: Mapping[str, Any], name: str, kind: Any) -> Any:
    value = record.get(name)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise InputError(f"the record does not say {name!r}: it is not one that make_sample wrote")
    return value
