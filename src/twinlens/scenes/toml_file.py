"""A scene.toml becomes a `Scene`: camera, materials, lights, objects, and every mistake named by file and key."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twinlens.errors import FileError
from twinlens.scenes.objects import scene_object
from twinlens.scenes.paint import read_textures
from twinlens.scenes.placement import camera_pose
from twinlens.scenes.plugins import bsdf, emitter, integrator
from twinlens.scenes.rigs import rig_from_table
from twinlens.scenes.scene import Scene
from twinlens.scenes.table import At, Source, Table, listed, number, text

_LARGEST_FILE = 16 << 20
_ANY_SIZE = 64, 48  # pixels, of images that a rig is tried with when its scene is read


def read_toml(path: Path) -> dict[str, Any]:
    """The tables of a TOML file, with a byte order mark or without; FileError says the line where its syntax fails."""
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise FileError(f"{path}: a scene file is text of at most {_LARGEST_FILE >> 20} MiB")
        written = path.read_text(encoding="utf-8-sig")
        return tomllib.loads(written)
    except tomllib.TOMLDecodeError as error:
        last = f"at end of document, line {len(written.splitlines())}"
        raise FileError(f"{path}: not valid TOML: {str(error).replace('at end of document', last)}") from error
    except UnicodeDecodeError as error:
        raise FileError(f"{path}: not UTF-8 text ({error.reason} at byte {error.start})") from error
    except ValueError as error:  # a number of thousands of digits
        raise FileError(f"{path}: not valid TOML: {error}") from error
    except RecursionError as error:
        raise FileError(f"{path}: nested too deep") from error
    except OSError as error:
        raise FileError(f"{path}: cannot be read ({error.strerror})") from error


def read_scene_toml(path: Path, name: str) -> Scene:
    """The scene of a scene.toml file. Raises InputError naming file, key, and what would be right."""
    data = read_toml(path)
    bare = At(Source(path))
    textures = read_textures(bare / "textures", data.pop("textures", {}))
    at = At(Source(path, textures))
    table: Table[Any] = Table(at, data)
    table.need("materials", "objects", "camera")
    description = table.take("description", text, "")
    materials = table.take("materials", _named(lambda at, name, value: bsdf(at, value)))
    lights = table.take("lights", _named(lambda at, name, value: emitter(at, value)), {})
    objects = table.take("objects", _named(scene_object))
    light_path = table.take("integrator", integrator, {"type": "path", "max_depth": 6})
    camera = table.take("camera", _camera)
    rig = table.take("rig", lambda at, value: value, None)
    table.has("textures")
    table.done()
    for thing in objects.values():
        if thing.material not in materials:
            raise (at / "objects" / thing.name / "material").unknown("material", thing.material, materials)
    if not lights and not any(thing.emitter for thing in objects.values()):
        raise at.wrong("nothing shines: add a light under [lights], or an emitter to an object")
    if sum(light["type"] in ("constant", "envmap", "sunsky") for light in lights.values()) > 1:
        raise (at / "lights").wrong("only one of constant, envmap and sunsky may surround a scene")
    scene = Scene(
        name=name,
        objects=tuple(objects.values()),
        materials=materials,
        lights=lights,
        integrator=light_path,
        description=description,
        files=(path, *dict.fromkeys(at.source.assets)),
        rig=rig,
        **camera,
    )
    if rig is not None:
        rig_from_table(rig, scene, *_ANY_SIZE, at / "rig")
    return scene


@dataclass(frozen=True)
class Heading:
    """What tells a scene from others at a glance; depth range and baseline in metres, as those of `Scene`."""

    name: str
    depth_range: tuple[float, float]
    baseline: float
    description: str


def read_heading(path: Path, name: str) -> Heading:
    """The heading of a scene.toml file: no texture is drawn and no object built, which takes a second a scene.

    Raises InputError as `read_scene_toml`, of what it reads.
    """
    table: Table[Any] = Table(At(Source(path)), read_toml(path))
    table.need("camera")
    camera = table.take("camera", _camera)
    return Heading(name, camera["depth_range"], camera["baseline"], table.take("description", text, ""))


def scene_with_rig(scene: Scene, path: Path) -> Scene:
    """`scene` with the rig of a .toml file (`scenes.rigs`) in place of its own. Raises InputError: file and key."""
    table = read_toml(path)
    rig_from_table(table, scene, *_ANY_SIZE, At(Source(path)))
    return replace(scene, rig=table)


def _named(read: Any) -> Any:
    """A table whose every entry is read by read(at, name, value)."""

    def parse(at: At, value: Any) -> dict[str, Any]:
        entries = Table[Any](at, value).rest()
        return {name: read(at / name, name, entry) for name, entry in entries.items()}

    return parse


def _camera(at: At, value: Any) -> dict[str, Any]:
    table: Table[Any] = Table(at, value)
    near, far = table.take("depth_range", listed(number(above=0.0), 2, 2))
    if not near < far:
        raise (at / "depth_range").wrong(f"must be [near, far] with near < far, in metres, got [{near:g}, {far:g}]")
    camera = {
        "world_from_left": camera_pose(table),
        "fov_x_deg": table.take("fov_x_deg", number(1.0, 170.0), 50.0),
        "baseline": table.take("baseline", number(above=0.0), 0.1),
        "depth_range": (near, far),
    }
    table.done()
    return camera
