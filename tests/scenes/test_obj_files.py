"""OBJ and .mtl files as other programs write them. The right values are those of the format's specification."""

from pathlib import Path

import pytest

from tests.scenes.scene_text import Read
from twinlens.errors import FileError
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.materials import Color, Material
from twinlens.scenes.model_files import Model, read_model

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
HALF = Color((0.5, 0.5, 0.5))


def read(folder: Path, obj: str, **libraries: str) -> Model:
    """The model of an OBJ file; `libraries` are the contents of NAME.mtl files."""
    folder.mkdir(exist_ok=True)
    (folder / "m.obj").write_bytes(obj.encode())
    for name, content in libraries.items():
        (folder / f"{name}.mtl").write_bytes(content.encode())
    return read_model(folder / "m.obj", SceneContext(folder))


def material(model: Model) -> Material:
    [made] = model.materials.values()
    return made


@pytest.mark.parametrize(
    "obj",
    [
        f"mtllib m.mtl\n{CORNERS}usemtl grey\nf 1 2 3\n",
        f"mtllib m.mtl\n{CORNERS}usemtl\tgrey\nf\t1\t2  3\n",
        f"  mtllib m.mtl\n{CORNERS}\tusemtl  grey\n    f 1 2 3\n",
        f"mtllib m.mtl\r\n{CORNERS}usemtl grey  # the only one\r\nf 1 2 3 # a face\r\n",
        f"mtllib m.mtl\n{CORNERS}usemtl grey\nf 1 \\\n2 3\n",
        f"\ufeffmtllib m.mtl\n{CORNERS}usemtl grey\nf 1 2 3",
    ],
)
@pytest.mark.parametrize(
    "mtl",
    [
        "newmtl grey\nKd 0.5 0.5 0.5\n",
        "\tnewmtl\tgrey\r\n\tKd\t.5\r\n",
        "newmtl grey\n  kd .5 .5 .5 1\n  d -halo 1.0\n",
    ],
)
def test_white_space_does_not_change_a_material(
    tmp_path: Path, obj: str, mtl: str
) -> None:
    assert material(read(tmp_path, obj, m=mtl)).base_color == HALF


@pytest.mark.parametrize("name", ["Material__#25", "old oak", "naïve", "0"])
def test_names_of_materials_may_have_signs_and_spaces(
    tmp_path: Path, name: str
) -> None:
    obj = f"mtllib m.mtl\n{CORNERS}usemtl {name}\nf 1 2 3\n"
    model = read(tmp_path, obj, m=f"newmtl {name}\nKd 0.5 0.5 0.5\n")
    assert list(model.materials) == [f"m.obj:{name}"]
    assert material(model).base_color == HALF


@pytest.mark.parametrize(
    "libraries",
    ["mtllib a.mtl b.mtl", "mtllib a.mtl\nmtllib b.mtl", "mtllib A parts.mtl b.MTL"],
)
def test_several_libraries_may_be_named(tmp_path: Path, libraries: str) -> None:
    obj = f"{libraries}\n{CORNERS}usemtl grey\nf 1 2 3\nusemtl red\nf 3 2 1\n"
    red, grey = "newmtl red\nKd 1 0 0\n", "newmtl grey\nKd .5\n"
    (tmp_path / "b.MTL").write_text(grey)
    model = read(tmp_path, obj, **{"a": red, "b": grey, "A parts": red})
    colors = {name: made.base_color for name, made in model.materials.items()}
    assert colors == {"m.obj:grey": HALF, "m.obj:red": Color((1.0, 0.0, 0.0))}


@pytest.mark.parametrize("library", ["", "mtllib m.mtl\n"])
def test_faces_without_a_material_are_white_and_diffuse(
    tmp_path: Path, library: str
) -> None:
    model = read(tmp_path, f"{library}{CORNERS}f 1 2 3\n", m="newmtl unused\nKd 0 0 0")
    made = material(model)
    assert made.base_color == Color((1.0, 1.0, 1.0))
    assert (made.metallic, made.specular) == (0.0, 0.0)


def test_faces_before_the_first_usemtl_have_the_default_alone(tmp_path: Path) -> None:
    obj = f"mtllib m.mtl\n{CORNERS}f 3 2 1\nusemtl grey\nf 1 2 3\n"
    model = read(tmp_path, obj, m="newmtl grey\nKd .5")
    assert list(model.materials) == ["m.obj:grey", "m.obj:default"]
    assert model.mesh.surface is not None
    assert sorted(model.mesh.surface.tolist()) == [0, 1]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("Kd 1.5 0 0", "Kd must be one number or three numbers, 0 to 1, got '1.5 0 0'"),
        ("Kd 0.5 0.5", "Kd must be one number or three numbers, 0 to 1, got '0.5 0.5'"),
        ("Kd spectral red.rfl", "Kd must be .* got 'spectral red.rfl'"),
        ("Ke -1 0 0", "Ke must be one number or three numbers, 0 or more, got"),
        ("Pr nan", "Pr must be one number, 0 to 1, got 'nan'"),
        ("d 2", "d must be one number, 0 to 1, got '2'"),
    ],
)
def test_errors_name_the_key_of_the_file(
    tmp_path: Path, line: str, message: str
) -> None:
    obj = f"mtllib m.mtl\n{CORNERS}usemtl m\nf 1 2 3\n"
    with pytest.raises(FileError, match=rf"m\.obj: material 'm': {message}"):
        read(tmp_path, obj, m=f"newmtl m\n{line}\n")


def test_a_material_without_a_library_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(
        FileError, match=r"m\.obj: names no \.mtl file with its material 'wood'"
    ):
        read(tmp_path, f"{CORNERS}usemtl wood\nf 1 2 3\n")


def test_a_scene_takes_an_obj_without_materials(
    tmp_path: Path, read_scene: Read
) -> None:
    (tmp_path / "m.obj").write_text(f"{CORNERS}f 1 2 3\n")
    scene = read_scene("[objects.own]\nfile = 'm.obj'\n")
    assert "m.obj:default" in scene.materials
