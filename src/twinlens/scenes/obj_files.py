"""Wavefront OBJ files with their .mtl files, as parts and materials of glTF.

trimesh decodes the geometry. Of .mtl files it reads `Kd`, `Ka`, `Ks`, `Ns` and `map_Kd` alone: neither opacity,
emission, index and roughness nor other maps. So the materials are read here, as tables of glTF. Source: the format's
specification, and its keys Pr, Pm for roughness.
"""

import math
import posixpath
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.errors import FileError, InputError, format_value
from twinlens.scenes.assets import (
    LARGEST_MESH_FILE,
    check_face_count,
    check_faces,
    no_triangles,
    obj_lines,
    obj_not_used,
    read_limited,
    text_lines,
)
from twinlens.scenes.gltf import Part
from twinlens.scenes.gltf_materials import (
    MtlMaterial,
    PbrMaterial,
    SampledImage,
    Textures,
)
from twinlens.schema import read

_COLORS = {"kd": ("Kd", 1.0), "ks": ("Ks", math.inf), "ke": ("Ke", math.inf)}
"""Keys as they are compared, as they are written, and the largest value."""
_NUMBERS = {
    "ns": ("Ns", math.inf),
    "ni": ("Ni", math.inf),
    "d": ("d", 1.0),
    "tr": ("Tr", 1.0),
    "pr": ("Pr", 1.0),
    "pm": ("Pm", 1.0),
}
_MAPS = {"map_kd": "base", "map_ke": "emissive", "map_d": "opacity", "norm": "normal"}
_IGNORED = {"newmtl", "ka", "illum", "map_ka", "sharpness"}
_MAP_OPTIONS = {
    **dict.fromkeys(("-o", "-s", "-t"), 3),
    "-mm": 2,
    **dict.fromkeys(("-blendu", "-blendv", "-bm", "-boost", "-cc", "-clamp"), 1),
    **dict.fromkeys(("-imfchan", "-texres", "-type"), 1),
}
"""Options before the name of a map, and the most values of each."""
_ILLUM = {"0", "1", "2"}  # with and without highlights; others are glass and mirrors
_USE = "usemtl "
_BETWEEN_LIBRARIES = re.compile(r"(?<=\.mtl) ", re.IGNORECASE)  # names may have spaces
Table = dict[str, list[str]]
"""The keys of one material, in lower case, with the words that follow them."""
_DEFAULT: Table = {"ks": ["0"]}
"""The material of faces before the first `usemtl`: white and diffuse."""


def open_obj(
    path: Path, open_file: Callable[[str], bytes]
) -> tuple[list[Part], list[PbrMaterial], Textures]:
    """The parts of an OBJ file, one for each of its materials. trimesh reads a list of their names as its .mtl file."""
    import trimesh

    lines, materials, pictures, lost = obj_materials(path, open_file)
    number = {material.name: i for i, material in enumerate(materials)}
    names = list(dict.fromkeys(_arguments(lines, "usemtl")))
    if missing := [name for name in names if name not in number]:
        raise FileError(f"{path}: its .mtl file has no material {missing[0]!r}")
    # Only numbers of materials reach trimesh, as the names in an .mtl file that is called "names".
    aliases = {name: f"material-{number[name]}" for name in names}
    text, listed = _with_aliases(lines, aliases)
    loaded = trimesh.load_scene(
        BytesIO(text.encode()),
        file_type="obj",
        resolver={"names": listed.encode()},
        process=False,
    )
    number_of_alias = {alias: number[name] for name, alias in aliases.items()}
    # Faces before the first `usemtl` have the format's default material, which is then the last of the list.
    parts = _parts_of(path, loaded, number_of_alias, len(materials))
    if any(part.material == len(materials) for part in parts):
        table = read(MtlMaterial, _as_gltf("default", _DEFAULT, {}), str(path))
        materials = [*materials, table]
    check_face_count(path, sum(len(part.mesh.faces) for part in parts))
    if not parts:
        raise no_triangles(path, obj_not_used(lines))
    # trimesh's order is that of a set.
    parts.sort(key=lambda part: part.material or 0)
    textures = Textures(
        [SampledImage(source=i) for i in range(len(pictures))],
        [],
        lambda i: open_file(pictures[i]),
        [*obj_not_used(lines), *lost],
    )
    return parts, materials, textures


def _parts_of(
    path: Path, loaded: Any, number_of_alias: dict[str, int], default: int
) -> list[Part]:
    """The meshes that have faces, with the numbers of their materials."""
    parts = []
    for mesh in loaded.geometry.values():
        check_faces(path, mesh)
        if len(getattr(mesh, "faces", ())):
            alias = str(getattr(getattr(mesh.visual, "material", None), "name", ""))
            material = number_of_alias.get(alias, default)
            parts.append(Part(mesh, np.eye(4), material, False, None))
    return parts


def _with_aliases(lines: list[str], aliases: dict[str, str]) -> tuple[str, str]:
    """An OBJ file whose materials have aliases, and an .mtl file "names" that lists these."""
    geometry = ["mtllib names"]
    for line in lines:
        if line.startswith(_USE):
            name = line.removeprefix(_USE).strip()
            geometry.append(f"usemtl {aliases[name]}")
        elif not line.startswith("mtllib"):
            geometry.append(line)
    listed = [f"newmtl {alias}\nKd 1 1 1" for alias in aliases.values()]
    return "\n".join(geometry), "\n".join(listed)


def obj_materials(
    path: Path, open_file: Callable[[str], bytes]
) -> tuple[list[str], list[PbrMaterial], list[str], list[str]]:
    """The lines of an OBJ file, its materials, the names of their pictures, and what is not rendered."""
    data = read_limited(path, LARGEST_MESH_FILE)
    lines = obj_lines(path, data)
    libraries: list[str] = []
    for names in _arguments(lines, "mtllib"):
        libraries += _BETWEEN_LIBRARIES.split(names.replace("\\", "/"))
    used = _arguments(lines, "usemtl")
    if used and not libraries:
        raise FileError(
            f"{path}: names no .mtl file with its material {used[0]!r}; give the object a 'material'"
        )
    return lines, *read_mtl({name: open_file(name) for name in libraries})


def _arguments(lines: list[str], keyword: str) -> list[str]:
    """What follows a keyword at the start of lines, where anything does."""
    prefix = f"{keyword} "
    texts = [line.removeprefix(prefix) for line in lines if line.startswith(prefix)]
    return [text.strip() for text in texts if text.strip()]


def read_mtl(
    files: Mapping[str, bytes],
) -> tuple[list[PbrMaterial], list[str], list[str]]:
    """The materials of .mtl files (name, content), the names of their pictures, and the keys that are not rendered.

    Pictures are named relative to the folder of their .mtl file; the names returned start with that folder. Without
    `Pr`, the roughness is that of Phong's exponent `Ns`: alpha^2 = 2 / (Ns + 2). Raises InputError.
    """
    tables, folders = _tables(files)
    pictures: list[str] = []
    lost: set[str] = set()
    materials: list[PbrMaterial] = []
    for name, table in tables.items():
        infos = {}
        for key, slot in _MAPS.items():
            if key not in table:
                continue
            picture, options = _picture_name(table[key])
            if options:
                lost.add(f"options of {key}")
            infos[slot] = {"index": len(pictures)}
            pictures.append(posixpath.join(folders[name], picture))
        keys = _as_gltf(name, table, infos)
        materials.append(read(MtlMaterial, keys, f"material {name}"))
    return materials, pictures, sorted(lost.union(_not_rendered(tables)))


def _tables(files: Mapping[str, bytes]) -> tuple[dict[str, Table], dict[str, str]]:
    """The materials of all files by name, and the folder of the file that each was in."""
    tables: dict[str, Table] = {}
    folders: dict[str, str] = {}
    for file, data in files.items():
        table: Table = {}
        for line in text_lines(data):
            key, *values = line.split() or [""]
            if key.lower() == "newmtl":
                name = " ".join(values)
                table = tables.setdefault(name, {})
                folders[name] = posixpath.dirname(file)
            elif values:
                table[key.lower()] = values
    return tables, folders


def _picture_name(words: list[str]) -> tuple[str, bool]:
    """The file of a map, whose name may have spaces, and whether options precede it.

    Programs of Windows separate folders by backslashes.
    """
    rest = words
    while len(rest) > 1 and rest[0] in _MAP_OPTIONS:
        most = _MAP_OPTIONS[rest[0]]
        values = rest[1:-1][:most]
        # Of up to three numbers, the last may be left out; another option has one word.
        count = len(values) if most == 1 else _leading_numbers(values)
        rest = rest[1 + count :]
    return " ".join(rest).replace("\\", "/"), rest is not words


def _leading_numbers(words: list[str]) -> int:
    """How many words are numbers, before the first that is none."""
    for count, word in enumerate(words):
        try:
            float(word)
        except ValueError:
            return count
    return len(words)


def _not_rendered(tables: Mapping[str, Table]) -> Iterator[str]:
    """What the tables have that is not rendered."""
    for table in tables.values():
        yield from table.keys() - {*_COLORS, *_NUMBERS, *_MAPS, *_IGNORED}
        if len(set(table.get("ks", [])[:3])) > 1:
            yield "the colour of Ks"
        if table.get("illum", ["2"])[0] not in _ILLUM:
            yield f"illum {table['illum'][0]}"


def _numbers(
    words: list[str], where: str, key: str, most: float, counts: Sequence[int]
) -> list[float]:
    """The numbers of a key, each 0 to `most`. Raises InputError that names the key of the file."""
    try:
        numbers = [float(word) for word in words]
    except ValueError:
        numbers = []
    limit = f"0 to {most:g}" if math.isfinite(most) else "0 or more"
    if len(numbers) not in counts or not all(0 <= v <= most for v in numbers):
        form = " or ".join({1: "one number", 3: "three numbers"}[n] for n in counts)
        raise InputError(
            f"{where}: {key} must be {form}, {limit}, got {format_value(' '.join(words))}"
        )
    return numbers


def _colors(name: str, table: dict[str, list[str]]) -> dict[str, list[float]]:
    """The colours of a material by their keys, three numbers each."""
    colors = {}
    for key, (label, most) in _COLORS.items():
        if key in table:
            # A single number is a grey; a fourth, which some programs write, has no meaning.
            words = table[key][:3]
            values = _numbers(words, f"material {name!r}", label, most, (1, 3))
            colors[key] = values if len(values) == 3 else values * 3
    return colors


def _parameters(name: str, table: dict[str, list[str]]) -> dict[str, float]:
    """The numbers of a material by their keys."""
    numbers = {}
    for key, (label, most) in _NUMBERS.items():
        if key in table:
            # Options such as -halo precede the value.
            words = table[key][-1:]
            # Some exporters write negative exponents for rough surfaces.
            if key == "ns" and words[0].startswith("-"):
                words = ["0"]
            numbers[key] = _numbers(words, f"material {name!r}", label, most, (1,))[0]
    return numbers


def _as_gltf(
    name: str, table: dict[str, list[str]], infos: dict[str, dict[str, int]]
) -> dict[str, object]:
    colors, numbers = _colors(name, table), _parameters(name, table)
    exponent = numbers.get("ns", 0.0)
    rough = numbers.get("pr", math.sqrt(math.sqrt(2 / (exponent + 2))))
    opacity = numbers.get("d", 1 - numbers.get("tr", 0.0))
    surface = {
        "baseColorFactor": [*colors.get("kd", [1.0, 1.0, 1.0]), opacity],
        "roughnessFactor": rough,
        "metallicFactor": numbers.get("pm", 0.0),
        **({"baseColorTexture": infos["base"]} if "base" in infos else {}),
    }
    matte = "ks" in colors and not any(colors["ks"]) and "pr" not in numbers
    glow = colors.get("ke", [0.0] * 3)
    strength = max(1.0, *glow)
    extensions: dict[str, object] = {
        "KHR_materials_emissive_strength": {"emissiveStrength": strength}
    }
    if "ni" in numbers:
        extensions["KHR_materials_ior"] = {"ior": max(numbers["ni"], 1.0)}
    if matte:
        extensions["KHR_materials_specular"] = {"specularFactor": 0.0}
    return {
        "name": name,
        "pbrMetallicRoughness": surface,
        "emissiveFactor": [value / strength for value in glow],
        **({"emissiveTexture": infos["emissive"]} if "emissive" in infos else {}),
        **({"normalTexture": infos["normal"]} if "normal" in infos else {}),
        **({"opacityTexture": infos["opacity"]} if "opacity" in infos else {}),
        "alphaMode": "BLEND" if opacity < 1 or "opacity" in infos else "OPAQUE",
        "doubleSided": True,
        "extensions": extensions,
    }
