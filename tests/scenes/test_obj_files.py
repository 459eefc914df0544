"""OBJ and .mtl files as other programs write them. The right values are those of the format's specification."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from twinlens.errors import FileError
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.materials import Bitmap, Color
from twinlens.scenes.model_files import MaterialWarning, read_model

CORNERS = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"
HALF = Color((0.5, 0.5, 0.5))


def read(folder, obj, **libraries):
    """The model of an OBJ file; `libraries` are the contents of NAME.mtl files."""
    folder.mkdir(exist_ok=True)
    (folder / "m.obj").write_bytes(obj.encode())
    for name, content in libraries.items():
        (folder / f"{name}.mtl").write_bytes(content.encode())
    return read_model(folder / "m.obj", SceneContext(folder))


def material(model):
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
def test_white_space_does_not_change_a_material(tmp_path, obj, mtl):
    assert material(read(tmp_path, obj, m=mtl)).base_color == HALF


@pytest.mark.parametrize("name", ["Material__#25", "old oak", "naïve", "0"])
def test_names_of_materials_may_have_signs_and_spaces(tmp_path, name):
    obj = f"mtllib m.mtl\n{CORNERS}usemtl {name}\nf 1 2 3\n"
    model = read(tmp_path, obj, m=f"newmtl {name}\nKd 0.5 0.5 0.5\n")
    assert list(model.materials) == [f"m.obj:{name}"]
    assert material(model).base_color == HALF


def test_names_in_latin_1_stay_different(tmp_path):
    """As German exporters of Windows write them."""
    faces = "usemtl grün\nf 1 2 3\nusemtl grän\nf 1 3 2\n"
    (tmp_path / "m.obj").write_bytes(
        f"mtllib m.mtl\n{CORNERS}{faces}".encode("latin-1")
    )
    colours = "newmtl grün\nKd 0 .5 0\nnewmtl grän\nKd .5 0 0\n"
    (tmp_path / "m.mtl").write_bytes(colours.encode("latin-1"))
    model = read_model(tmp_path / "m.obj", SceneContext(tmp_path))
    assert sorted(model.materials) == ["m.obj:grän", "m.obj:grün"]
    assert model.materials["m.obj:grün"].base_color == Color((0.0, 0.5, 0.0))


@pytest.mark.parametrize(
    "libraries",
    ["mtllib a.mtl b.mtl", "mtllib a.mtl\nmtllib b.mtl", "mtllib A parts.mtl b.MTL"],
)
def test_several_libraries_may_be_named(tmp_path, libraries):
    obj = f"{libraries}\n{CORNERS}usemtl grey\nf 1 2 3\nusemtl red\nf 3 2 1\n"
    red, grey = "newmtl red\nKd 1 0 0\n", "newmtl grey\nKd .5\n"
    (tmp_path / "b.MTL").write_text(grey)
    model = read(tmp_path, obj, **{"a": red, "b": grey, "A parts": red})
    colors = {name: made.base_color for name, made in model.materials.items()}
    assert colors == {"m.obj:grey": HALF, "m.obj:red": Color((1.0, 0.0, 0.0))}


def test_folders_may_be_separated_as_in_windows(tmp_path):
    """In the names of the library and of its picture."""
    (tmp_path / "parts" / "pictures").mkdir(parents=True)
    picture = tmp_path / "parts" / "pictures" / "grey.png"
    Image.fromarray(np.full((2, 2, 3), 188, np.uint8)).save(picture)
    library = "newmtl grey\nmap_Kd pictures\\grey.png\n"
    (tmp_path / "parts" / "m.mtl").write_text(library)
    corners = f"{CORNERS}vt 0 0\nvt 1 0\nvt 0 1\n"
    obj = f"mtllib parts\\m.mtl\n{corners}usemtl grey\nf 1/1 2/2 3/3\n"
    made = material(read(tmp_path, obj)).base_color
    # sRGB 188 is half of the light of 255, within its rounding.
    assert np.abs(made.pixels - 0.5).max() < 0.005


@pytest.mark.parametrize("library", ["", "mtllib m.mtl\n"])
def test_faces_without_a_material_are_white_and_diffuse(tmp_path, library):
    model = read(tmp_path, f"{library}{CORNERS}f 1 2 3\n", m="newmtl unused\nKd 0 0 0")
    made = material(model)
    assert made.base_color == Color((1.0, 1.0, 1.0))
    assert (made.metallic, made.specular) == (0.0, 0.0)


def test_faces_before_the_first_usemtl_have_the_default_alone(tmp_path):
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
def test_errors_name_the_key_of_the_file(tmp_path, line, message):
    obj = f"mtllib m.mtl\n{CORNERS}usemtl m\nf 1 2 3\n"
    with pytest.raises(FileError, match=rf"m\.obj: material 'm': {message}"):
        read(tmp_path, obj, m=f"newmtl m\n{line}\n")


def test_a_material_without_a_library_is_an_error(tmp_path):
    with pytest.raises(
        FileError, match=r"m\.obj: names no \.mtl file with its material 'wood'"
    ):
        read(tmp_path, f"{CORNERS}usemtl wood\nf 1 2 3\n")


def test_a_scene_takes_an_obj_without_materials(tmp_path, read_scene):
    (tmp_path / "m.obj").write_text(f"{CORNERS}f 1 2 3\n")
    scene = read_scene("[objects.own]\nfile = 'm.obj'\n")
    assert "m.obj:default" in scene.materials


CARD = f"mtllib m.mtl\n{CORNERS}vt 0 0\nvt 1 0\nvt 0 1\nusemtl leaf\nf 1/1 2/2 3/3\n"
GREY = np.array([[0, 51, 102], [153, 204, 255]], np.uint8)


def png(texels):
    stream = BytesIO()
    Image.fromarray(texels).save(stream, format="PNG")
    return stream.getvalue()


COLORED = np.stack([GREY, 255 - GREY, GREY], axis=-1)
PICTURES = {
    "grey.png": png(GREY),
    "colored.png": png(COLORED),
    "alpha.png": png(np.dstack([COLORED, GREY])),
    "a leaf.png": png(np.stack([GREY] * 3, axis=-1)),
}
WHOLE = GREY / 255
LUMINANCE = COLORED / 255 @ [0.2126, 0.7152, 0.0722]


@pytest.mark.parametrize(
    ("mtl", "opacity"),
    [
        ("map_d grey.png", WHOLE),
        ("map_D a leaf.png", WHOLE),
        ("d 0.5\nmap_d grey.png", 0.5 * WHOLE),
        ("Tr 0.25\nmap_d grey.png", 0.75 * WHOLE),
        ("map_d alpha.png", WHOLE),
        ("map_d colored.png", LUMINANCE),
        ("map_Kd alpha.png", 1.0),
        ("map_Kd alpha.png\nd 0.5", 0.5),
        ("map_Kd colored.png\nmap_d alpha.png", WHOLE),
        ("d 0.25", 0.25),
    ],
)
def test_opacity_is_the_factor_times_its_own_map(tmp_path, mtl, opacity):
    """A map's alpha where it has some, else its luminance; the alpha of `map_Kd` has no meaning in the format."""
    for name, data in PICTURES.items():
        (tmp_path / name).write_bytes(data)
    made = material(read(tmp_path, CARD, m=f"newmtl leaf\n{mtl}\n"))
    values = made.opacity.pixels if isinstance(made.opacity, Bitmap) else made.opacity
    np.testing.assert_allclose(values, opacity, atol=1e-6)
    assert made.alpha_cutoff is None


OPTIONS = [
    "-s 2 2 1",
    "-o 0.5",
    "-o .1 0 0 -s 1 1",
    "-bm 0.5",
    "-clamp on",
    "-mm 0 1",
    "-mm 0",
    "-imfchan r",
    "-blendu off -blendv off -texres 512",
    "-type sphere -boost 2 -cc on -t 1 1 1",
]


@pytest.mark.parametrize("options", OPTIONS)
@pytest.mark.parametrize("name", ["a leaf.png", "leaf.png", "a\\leaf.png"])
def test_options_of_a_map_are_no_part_of_its_name(tmp_path, options, name):
    """There is a leaf.png beside, which was taken for "a leaf.png"."""
    (tmp_path / "a").mkdir()
    for i, path in enumerate(("leaf.png", "a leaf.png", "a/leaf.png")):
        (tmp_path / path).write_bytes(png(np.full((2, 2), 51 * i, np.uint8)))
    right = {"leaf.png": 0, "a leaf.png": 51, "a\\leaf.png": 102}
    with pytest.warns(MaterialWarning, match="not rendered: options of map_d"):
        made = material(
            read(tmp_path, CARD, m=f"newmtl leaf\nmap_d {options} {name}\n")
        )
    np.testing.assert_allclose(made.opacity.pixels, right[name] / 255, atol=1e-6)
