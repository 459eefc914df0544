"""Scene files become a `Scene`: by the name of a bundled scene, or the path of a scene.toml or a Mitsuba .xml."""

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

import pydantic

from twinlens.calibrations.trajectories import read_trajectory
from twinlens.errors import FileError, InputError, file_hint, located, unknown
from twinlens.geometry.motion import Keyframe, Motion
from twinlens.scenes.assets import Asset, SceneContext, find_asset, read_limited
from twinlens.scenes.materials import Plugin
from twinlens.scenes.objects import Object
from twinlens.scenes.placement import Length, Vector3, view_pose
from twinlens.scenes.plugins import SURROUNDING_LIGHTS, Integrator, Light, MaterialTable
from twinlens.scenes.rigs import RigLength, RigTable, rig_from_table, with_files
from twinlens.scenes.scene import WHOLE_PATHS, Scene
from twinlens.scenes.texture_tables import Texture
from twinlens.scenes.xml_file import read_scene_xml
from twinlens.schema import NEAR_FAR, StrictModel, exactly, read, table_of

_SCENE_FILE = "scene.toml"
_ANY_SIZE = (
    64,
    48,
)  # pixels; a rig is built once with images of this size to check its table


class ViewTable(StrictModel):
    """[camera] of a scene file: the default left camera, and the range of depths that it sees."""

    position: Vector3
    look_at: Vector3
    up: Vector3 = pydantic.Field([0.0, 0.0, 1.0])
    fov_x_deg: Annotated[
        float, pydantic.Field(ge=1, le=170), pydantic.AfterValidator(float)
    ] = 50.0
    baseline: RigLength = 0.1
    depth_range: Annotated[list[Length], exactly(2, Length), NEAR_FAR]

    @pydantic.model_validator(mode="after")
    def _check_pose(self) -> "ViewTable":
        view_pose(self.position, self.look_at, self.up)
        return self


def _motion(keyframes: Any = (), trajectory: Path | None = None, **keys: Any) -> Motion:
    path = None if trajectory is None else read_trajectory(trajectory)
    return Motion(keyframes=tuple(keyframes), trajectory=path, **keys)


_KEYFRAMES: Any = list[table_of(Keyframe)]  # type: ignore[misc]  # made at run time
MotionTable: Any = table_of(
    Motion, _motion, keyframes=(_KEYFRAMES, []), trajectory=(Asset | None, None)
)
"""An entry of [[motion]]; its `trajectory` is a TUM file below the scene's folder."""


def _with_files_of_rig(table: Any, info: Any) -> Any:
    if not isinstance(table, Mapping):
        return table
    return with_files(table, lambda name: find_asset(name, info.context))


def _register_textures(textures: dict[str, Any], info: Any) -> dict[str, Any]:
    info.context.textures.update(textures)
    return textures


class SceneFile(StrictModel):
    """The keys of a scene.toml. Textures come first: the fields after it refer to them by name."""

    description: str = ""
    textures: Annotated[
        dict[str, Texture], pydantic.AfterValidator(_register_textures)
    ] = pydantic.Field({})
    materials: dict[str, MaterialTable] = pydantic.Field({})
    objects: dict[str, Object]
    camera: ViewTable
    lights: dict[str, Light] = pydantic.Field({})
    integrator: Integrator = pydantic.Field({**WHOLE_PATHS})
    rig: Annotated[RigTable, pydantic.BeforeValidator(_with_files_of_rig)] | None = None
    motion: list[MotionTable] = pydantic.Field([])

    @pydantic.model_validator(mode="after")
    def _check_scene(self) -> "SceneFile":
        if (
            sum(light["type"] in SURROUNDING_LIGHTS for light in self.lights.values())
            > 1
        ):
            raise InputError(
                f"lights: at most one of {', '.join(SURROUNDING_LIGHTS)} is allowed"
            )
        return self


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file. Raises FileError, for a syntax error with its line."""
    data = read_limited(path, 16 << 20)
    try:
        return tomllib.loads(data.decode("utf-8-sig"))
    except tomllib.TOMLDecodeError as error:
        message = str(error).replace(
            "at end of document", f"at end of document, line {len(data.splitlines())}"
        )
        message = message.replace(
            "Cannot overwrite a value", "the key is defined twice"
        )
        raise FileError(f"{path}: not valid TOML: {message}") from error
    except (
        ValueError,
        RecursionError,
    ) as error:  # not UTF-8, an integer of thousands of digits, nested too deep
        raise FileError(f"{path}: not valid TOML: {error}") from error


def read_scene_toml(path: Path, name: str) -> Scene:
    """The scene of a scene.toml file. Raises InputError with file, key, and what is allowed."""
    data = read_toml(path)
    context = SceneContext(path.parent)
    file = read(SceneFile, data, path, context=context)
    camera = file.camera
    with located(str(path)):
        scene = Scene(
            name=name,
            objects=tuple(
                replace(item, name=key) for key, item in file.objects.items()
            ),
            materials={**file.materials, **context.materials},
            lights=file.lights,
            integrator=_with_defaults(file.integrator),
            world_from_left=view_pose(camera.position, camera.look_at, camera.up),
            fov_x_deg=camera.fov_x_deg,
            baseline=camera.baseline,
            depth_range=(camera.depth_range[0], camera.depth_range[1]),
            description=file.description,
            files=(path, *dict.fromkeys(context.files)),
            motion=tuple(file.motion),
        )
    if file.rig is None:
        return scene
    pictures = SceneContext(path.parent)
    scene = scene_with_rig(scene, path, data["rig"], "rig", pictures)
    return replace(scene, files=(*scene.files, *dict.fromkeys(pictures.files)))


def scene_with_rig(
    scene: Scene,
    path: Path,
    table: Mapping[str, Any] | None = None,
    key: str = "",
    context: SceneContext | None = None,
) -> Scene:
    """`scene` with the rig of a .toml file, or of its `table` at `key`. Raises InputError with file and key.

    Pictures that are patterns of projectors are below the file's folder, and noted in `context`.
    """
    table = read_toml(path) if table is None else table
    assets = context or SceneContext(path.parent)
    with located(f"{path}: {key}" if key else str(path)):
        table = with_files(table, lambda name: find_asset(name, assets))
    rig_from_table(table, scene, *_ANY_SIZE, path, key)
    return replace(scene, rig=table)


def bundled_folder() -> Path:
    """The folder of the bundled scenes: inside the installed package, or next to src/ in a checkout."""
    package = Path(__file__).parents[1]
    installed = package / "bundled_scenes"
    return installed if installed.is_dir() else package.parents[1] / "scenes"


def bundled_scenes() -> list[str]:
    """The names of the bundled scenes, sorted."""
    return sorted(
        path.parent.name for path in bundled_folder().glob(f"*/{_SCENE_FILE}")
    )


def bundled_headings() -> list[dict[str, Any]]:
    """The name, depth_range, baseline and description of each bundled scene, sorted by name.

    Textures and objects, which take a second per scene, are not read.
    """
    headings = []
    for name in bundled_scenes():
        path = bundled_folder() / name / _SCENE_FILE
        data = read_toml(path)
        view = read(ViewTable, data["camera"], path, "camera")
        heading = {
            "name": name,
            "depth_range": tuple(view.depth_range),
            "baseline": view.baseline,
        }
        headings.append(heading | {"description": data["description"]})
    return headings


_read_bundled = lru_cache(maxsize=2)(read_scene_toml)


def _with_defaults(integrator: Plugin) -> Plugin:
    """The integrator with its parameters that decide on the light of images, which records then have."""
    return {**WHOLE_PATHS, **integrator} if integrator["type"] == "path" else integrator


def load_scene(name_or_path: str | Path) -> Scene:
    """The scene of a bundled name, of a scene.toml or its folder, or of a Mitsuba .xml; InputError for a mistake.

    The textures of the two bundled scenes that were loaded last stay in memory, for drawing them takes a second.
    """
    path, bundled = Path(name_or_path), bundled_scenes()
    if str(name_or_path) in bundled:
        return replace(
            _read_bundled(
                bundled_folder() / name_or_path / _SCENE_FILE, str(name_or_path)
            )
        )
    if path.is_dir():
        path = path / _SCENE_FILE
        if not path.is_file():
            remedy = f"name a scene file, or one of {', '.join(bundled)}"
            raise FileError(f"{path.parent}: the folder has no {_SCENE_FILE}; {remedy}")
    if path.suffix in (".toml", ".xml"):
        if not path.is_file():
            raise FileError(f"{path}: no such scene file{file_hint(path)}")
        name = path.resolve().parent.name if path.name == _SCENE_FILE else path.stem
        if path.suffix == ".xml":
            return read_scene_xml(path)
        return read_scene_toml(path, name)
    if path.is_file():
        raise InputError(
            f"{path}: a scene is a .toml or a Mitsuba .xml file, got {path.suffix!r}"
        )
    raise unknown("scene", str(name_or_path), bundled)
