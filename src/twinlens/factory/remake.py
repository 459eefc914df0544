"""A stored sample rendered again from its record."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import Field, create_model

from twinlens.dataset import Sample
from twinlens.dataset.lens_labels import LABEL
from twinlens.dataset.record import LENS, RIG, FileModel, read
from twinlens.errors import InputError, format_value, located
from twinlens.factory.objects import with_objects
from twinlens.factory.produce import family_scene, under_sky
from twinlens.factory.sample import Shoot, make_sample
from twinlens.factory.settings import (
    ExposureTable,
    RecipeSettings,
    SceneTable,
    SensorTable,
)
from twinlens.factory.sources import Sources, file_digests
from twinlens.rendering import Progress
from twinlens.scenes import Scene, load_scene
from twinlens.schema import declared
from twinlens.settings import fields_of

ORIGIN = ("spec", "rejections", "sources_sha256", "rectified_from")
"""Keys of a record that state where a sample comes from; `make_sample` does not write them."""


def remake(
    record: Mapping[str, Any],
    scene: Scene | None = None,
    *,
    folder: str | Path = ".",
    progress: Progress | None = None,
) -> Sample:
    """Render the sample again whose sample.json is `record` (`StoredSample.record`).

    Its files are the same to the byte if backend and versions are those in the record. A bundled scene is found by its
    name, and a scene of a family is made again; any other must be given as `scene`, as `load_scene` reads it. The sky
    and the objects of the sample's recipe are added to it.

    folder : of the recipe, whose sky and objects have files relative to it.

    Raises InputError if the scene differs from the record's, or is neither bundled nor given; if the images were warped
    from others; or if `make_sample` did not write the record.
    """
    if not isinstance(record, Mapping):
        raise InputError(
            f"record must be a sample's, such as Dataset('out')[0].record, got {format_value(record)}"
        )
    settings = read(_Record, record, _FILE).record
    if (settings.rectified_from or {}).get("pictures") == "maps":
        raise InputError(
            "its images were warped from another sample's; rectify that sample again"
        )
    scene = scene_of(record, scene, folder)
    if settings.sky != (scene.sky.record if scene.sky else None):
        raise InputError(
            "the sample was lit by another sky than the scene's; its file has changed"
        )
    written = record["record"]  # plain values, which are written as they were read
    sample = make_sample(
        scene,
        read(RIG, record.get("rig"), _FILE, "rig"),
        [read(LENS, shot.get("lens"), _FILE, "lens") for shot in record["shots"]],
        Shoot.from_record(written),
        labels=_labels(record["shots"]),
        progress=progress,
    )
    origin = {key: written[key] for key in ORIGIN if key in written}
    return replace(
        sample,
        ndisp=None if settings.spec is None else settings.spec.ndisp,
        record={**sample.record, **origin},
    )


def _labels(shots: Sequence[Mapping[str, Any]]) -> list[str]:
    """The recorded labels of the lenses; empty in samples of versions without them."""
    records = [shot.get("record") or {} for shot in shots]
    labels = [str(record[LABEL]) for record in records if LABEL in record]
    return labels if len(labels) == len(shots) else []


class _Spec(FileModel):
    """What `remake` reads of a SampleSpec."""

    seed: int = 0
    kind: str = "scene"
    scene: str = ""
    drawn: dict[str, Any] = Field(default_factory=dict)
    ndisp: int | None = None


class _MadeWith(FileModel):
    """What `make_sample` records beside its `Shoot`."""

    scene: str
    scene_files: dict[str, str]
    sky: dict[str, Any] | None = None
    ambient: float = 1.0
    denoise: dict[str, Any] | None = None
    sensor: SensorTable
    exposure: ExposureTable | None = None
    spec: _Spec | None = None
    rectified_from: dict[str, Any] | None = None


ADDED = ("noise", "sampler", "dual_pixel", "keep_models")
"""Settings that the first versions did not write."""


def _recorded_keys() -> dict[str, Any]:
    """The types of the settings in a record that have a plain value there."""
    keys = {}
    for name, field in fields_of(Shoot).items():
        if field.is_plain and name != "denoise":
            written = field if name in ADDED else replace(field, default=...)
            keys[name] = declared(written)
    return keys


_Settings: Any = create_model("_Settings", __base__=_MadeWith, **_recorded_keys())


class _Record(FileModel):
    """The keys of a sample.json that `remake` reads."""

    record: _Settings
    shots: list[dict[str, Any]]


_FILE = Path("sample.json")


def _found_scene(settings: Any, sources: Sources | None) -> Scene:
    """The scene that a record names: of a family, of the recipe's `sources`, or bundled. Raises InputError."""
    spec = settings.spec
    if spec is not None and spec.kind == "family":
        drawn = read(RecipeSettings, spec.drawn, _FILE, "record.spec.drawn")
        return family_scene(spec.scene, spec.seed, drawn, sources or Sources())
    if spec is not None and sources is not None and spec.scene in sources.scenes:
        return sources.scene(spec.scene)
    try:
        return load_scene(settings.scene)
    except InputError as error:
        raise InputError(
            f"scene {settings.scene!r} is not bundled; load it with load_scene and pass it"
        ) from error


def scene_of(
    record: Mapping[str, Any],
    given_scene: Scene | None = None,
    folder: str | Path = ".",
    lit: bool = True,
    sources: Sources | None = None,
) -> Scene:
    """The scene of a sample's record: the given one, the bundled one of that name, or that of a family, made again.

    Its files must be unchanged.

    The objects of the recipe in `folder` are added to it, and if `lit` its sky, unless the given scene has one.
    `sources` are the files of that recipe: its scenes, and what its families draw from.

    Raises InputError as `remake` does.
    """
    settings = read(_Record, record, _FILE).record
    scene = given_scene or _found_scene(settings, sources)
    if lit and settings.sky is not None and scene.sky is None:
        table = {key: value for key, value in settings.sky.items() if key != "sha256"}
        with located(f"{_FILE}: record.sky"):
            scene = under_sky(scene, table, Path(folder))
    scene = replace(scene, ambient=settings.ambient)
    if settings.spec is not None and "scene" in settings.spec.drawn:
        objects = read(
            SceneTable, settings.spec.drawn["scene"], _FILE, "record.spec.drawn.scene"
        ).objects
        rig = read(RIG, record.get("rig"), _FILE, "rig").nominal
        scene = with_objects(
            scene, objects, rig, settings.spec.seed, Path(folder), _FILE
        )
    if (scene.name, file_digests(scene)) != (settings.scene, settings.scene_files):
        raise InputError(
            f"scene {scene.name!r} is not the one that the record names: its files have changed"
        )
    return scene
