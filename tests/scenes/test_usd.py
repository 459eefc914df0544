"""USD files: meshes, poses and materials. Bounds and areas are those of OpenUSD, trimesh and shapely."""

import itertools
import math
import os
import signal
import subprocess
import sys
import threading
import warnings
import zipfile

import numpy as np
import pytest
import trimesh
from pxr import Gf, Usd, UsdGeom, UsdUtils
from shapely import Polygon

from tests.scenes.gltf_files import png
from tests.scenes.usd_files import (
    SQUARE,
    TEXTURED,
    instancer,
    material,
    mesh,
    moved,
    prim,
    read_in_a_fork,
    shader,
    square,
    texture,
    textured_square,
    usda,
    write_pictures,
)
from twinlens.errors import InputError, MissingExtraError, TwinlensError
from twinlens.scenes import usd_process
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.gltf_materials import VERTEX_COLOR
from twinlens.scenes.materials import Bitmap, Color
from twinlens.scenes.model_files import MaterialWarning, named_files, read_model

C_PLATE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)]
ARROW = [(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)]
PENTAGON = [(0, 0), (2, 0), (3, 2), (1, 4), (-1, 2)]


def open_here(path, context, with_materials=True):
    """`usd_process.open_usd` without the process, which takes two seconds to start."""
    request = usd_process.Request(path, context.folder, with_materials)
    return usd_process._unpacked(
        usd_process.answer_to(request, allow=lambda size: None), context
    )


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """Tests of the process undo it."""
    monkeypatch.setattr("twinlens.scenes.model_files.open_usd", open_here)
    return monkeypatch


@pytest.fixture
def write(tmp_path):
    """Writes m.usda of some prims and returns its path."""
    return lambda prims, **options: usda(tmp_path / "m.usda", prims, **options)


def read(path, **options):
    return read_model(path, SceneContext(path.parent), **options)


def material_of(path):
    """The only material of a file."""
    [only] = read(path).materials.values()
    return only


def areas(model):
    """The area of each triangle times its normal (N, 3)."""
    corners = model.vertices[model.faces]
    edges = corners[:, 1:] - corners[:, :1]
    return np.cross(edges[:, 0], edges[:, 1]) / 2


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
@pytest.mark.parametrize("outline", [C_PLATE, ARROW, PENTAGON])
def test_polygons_cover_their_own_area(tmp_path, write, suffix, outline):
    points = [(x, y, 0) for x, y in outline]
    face = list(range(len(outline)))
    prims = mesh("right", points, [face])
    prims += mesh(
        "left", points, [face[::-1]], 'uniform token orientation = "leftHanded"'
    )
    prims += mesh("hole", points, [face], "int[] holeIndices = [0]")
    path = tmp_path / f"other.{suffix}"
    Usd.Stage.Open(str(write(prims))).Export(str(path))
    area = areas(read(path).mesh).sum(axis=0)
    np.testing.assert_allclose(area, [0, 0, 2 * Polygon(outline).area])


TREE = f"""
def Xform "top" {{
  double3 xformOp:translate = (1, 2, 3)
  float3 xformOp:rotateXYZ = (20, 30, 40)
  uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
  def Xform "part" {{
    float3 xformOp:scale = (2, 0.5, -1)
    uniform token[] xformOpOrder = ["xformOp:scale"]
    {SQUARE}
  }}
}}
def Cube "cube" {{
  double size = 0.5
}}
"""


@pytest.mark.parametrize(("metres", "up"), [(0.01, "Y"), (1.0, "Z"), (0.001, "Z")])
def test_poses_and_units(write, read_scene, metres, up):
    """The bounds that OpenUSD computes, in metres, with z up."""
    stage = Usd.Stage.Open(str(write(TREE, metres=metres, up=up)))
    bounds = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
    box = Gf.Range3d()
    for name in ("/top", "/cube"):
        bound = bounds.ComputeWorldBound(stage.GetPrimAtPath(name))
        box.UnionWith(bound.ComputeAlignedRange())
    expected = np.array([box.min, box.max]) * metres
    if up == "Y":
        expected = np.sort(expected[:, [0, 2, 1]] * [1, -1, 1], axis=0)
    vertices = read_scene("[objects.own]\nfile = 'm.usda'\n").objects[-1].shape.vertices
    made = [vertices.min(axis=0), vertices.max(axis=0)]
    np.testing.assert_allclose(made, expected, rtol=1e-6)


def test_the_unit_of_a_file_that_names_none_is_a_centimetre(tmp_path):
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    assert np.ptp(read(tmp_path / "m.usda").mesh.vertices) == pytest.approx(0.02)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize(
    ("kind", "volume"),
    [("Cylinder", 0.024), ("Cone", 0.008), ("Capsule", 0.024 + 4 / 3 * 0.008)],
)  # fmt: skip
def test_round_shapes(write, axis, kind, volume):
    size = f'double radius = 0.2\ndouble height = 0.6\nuniform token axis = "{axis}"'
    path = write(prim(kind, "shape", size))
    made = read(path).mesh
    solid = trimesh.Trimesh(made.vertices, made.faces)
    assert solid.volume == pytest.approx(np.pi * volume, rel=0.005)
    stage = Usd.Stage.Open(str(path))
    shape = UsdGeom.Boundable(stage.GetPrimAtPath("/shape"))
    extent = UsdGeom.Boundable.ComputeExtentFromPlugins(shape, Usd.TimeCode.Default())
    np.testing.assert_allclose(solid.bounds, extent, atol=1e-6)


def test_values_of_corners_faces_and_vertices(write):
    """Two triangles that share an edge: (u, v) of corners by index, a normal of each face."""
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)]
    values = """
      texCoord2f[] primvars:st = [(0, 0), (0.5, 0), (0.5, 1), (1, 1)] (interpolation = "faceVarying")
      int[] primvars:st:indices = [0, 1, 2, 0, 2, 3]
      normal3f[] primvars:normals = [(0, 0, 1), (-0.6, 0, 0.8)] (interpolation = "uniform")
    """
    model = read(write(mesh("m", points, [[0, 1, 2], [0, 2, 3]], values))).mesh
    uv = [[(0, 0), (0.5, 0), (0.5, 1)], [(0, 0), (0.5, 1), (1, 1)]]
    np.testing.assert_allclose(model.uv[model.faces], uv)
    normals = model.normals[model.faces[:, 0]]
    np.testing.assert_allclose(normals, [(0, 0, 1), (-0.6, 0, 0.8)], atol=1e-6)
    assert len(model.vertices) == 6


def test_purposes_visibility_and_instances(write):
    prims = "".join(
        square(purpose, f'uniform token purpose = "{purpose}"')
        for purpose in ("guide", "proxy", "render")
    )
    prims += prim("Xform", "hidden", f'token visibility = "invisible"\n{SQUARE}')
    prims += f'class "prototype" {{\n{SQUARE}\n}}\n'
    for height in (1, 2, 3):
        instance = "instanceable = true\nprepend references = </prototype>"
        prims += prim("Xform", f"copy{height}", moved(0, 0, height), instance)
    model = read(write(prims)).mesh
    heights = model.vertices[model.faces[::2, 0], 2]
    assert sorted(heights) == [0, 1, 2, 3]


def test_materials_of_the_mesh_and_of_subsets(write):
    points = [(x, y, 0) for y in range(2) for x in range(4)]
    faces = [[i, i + 1, i + 5, i + 4] for i in range(3)]
    parts = """
      rel material:binding = </red>
      def GeomSubset "part" (prepend apiSchemas = ["MaterialBindingAPI"]) {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [1]
        rel material:binding = </glow>
      }
    """
    red = "color3f inputs:diffuseColor = (0.8, 0.1, 0)\nfloat inputs:metallic = 1\nfloat inputs:roughness = 0.3"
    glow = "color3f inputs:emissiveColor = (2, 1, 0)\nfloat inputs:opacity = 0.5\nfloat inputs:ior = 1.3"
    prims = mesh("m", points, faces, parts)
    model = read(write(prims + material("red", red) + material("glow", glow)))
    assert list(model.materials) == ["m.usda:glow", "m.usda:red"]
    lit, metal = model.materials.values()
    assert metal.base_color.rgb == pytest.approx((0.8, 0.1, 0.0))
    assert (metal.metallic, metal.roughness) == (1.0, pytest.approx(0.3))
    assert lit.emission == Color((2.0, 1.0, 0.0))
    assert (lit.opacity, lit.ior) == (0.5, pytest.approx(1.3))
    middle = model.mesh.vertices[model.mesh.faces].mean(axis=1)[:, 0]
    is_part = (middle > 1) & (middle < 2)
    np.testing.assert_array_equal(model.mesh.surface, np.where(is_part, 0, 1))


@pytest.mark.parametrize("space", ["sRGB", "raw", None])
def test_textures(tmp_path, write, space):
    write_pictures(tmp_path)
    stated = f'token inputs:sourceColorSpace = "{space}"' if space else ""
    path = write(TEXTURED.replace("SPACE", stated))
    made = material_of(path)
    color = made.base_color
    half = 128 / 255 if space == "raw" else ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(color.pixels[0, 0], [half, 1, 0], atol=1e-6)
    np.testing.assert_allclose(made.roughness.pixels, [[0.35], [0.75]], atol=1e-6)
    np.testing.assert_allclose(made.opacity.pixels, [[1, 0]])
    assert color.wrap == "clamp"
    # (1, 0) is scaled to (2, 0), turned to (0, 2) and moved to (0.25, 2.5).
    place = color.to_uv @ [1, 0, 0, 1]
    np.testing.assert_allclose(place, [0.25, 2.5, 0, 1], atol=1e-12)
    names = {file.name for file in named_files(path, SceneContext(tmp_path))}
    assert names >= {"t.png", "r.png"}


SCALE, SHIFT = "float2 inputs:scale = (2, 3)", "float2 inputs:translation = (5, 7)"
TURN = "float inputs:rotation = 90"


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([SCALE], (2, 3)),
        # (1, 1) is scaled to (2, 3), then moved.
        ([SCALE, SHIFT], (7, 10)),
        # (1, 1) is moved to (6, 8), then scaled.
        ([SHIFT, SCALE], (12, 24)),
        # (1, 1) is moved to (6, 8), turned to (-8, 6), then scaled.
        ([SHIFT, TURN, SCALE], (-16, 18)),
    ],
)
def test_chained_transforms(tmp_path, write, steps, expected):
    """The steps are those from the primvar to the texture."""
    write_pictures(tmp_path)
    varname = 'string inputs:varname = "map1"'
    shaders, source = shader("reader", "UsdPrimvarReader_float2", varname), "reader"
    for number, step in enumerate(steps):
        name = f"step{number}"
        shaders += shader(name, "UsdTransform2d", step, source)
        source = name
    path = write(textured_square(texture(source=source), shaders, ["map1"]))
    uv = material_of(path).base_color.to_uv @ [1, 1, 0, 1]
    np.testing.assert_allclose(uv, [*expected, 0, 1], atol=1e-6)


@pytest.mark.parametrize("place", ["copies", "Library"])
def test_points_of_an_instancer_are_copies(write, place):
    """In centimetres, below a moved instancer; the prototype has a pose of its own."""
    prototype = square("square", moved(10, 0, 0))
    points = """
      int[] protoIndices = [0, 0, 0]
      point3f[] positions = [(0, 0, 0), (100, 0, 0), (0, 200, 0)]
      float3[] scales = [(1, 1, 1), (2, 2, 2), (1, 1, 1)]
      int64[] invisibleIds = [2]
    """
    inside = prototype if place == "copies" else ""
    prims = instancer("copies", [f"/{place}/square"], points + moved(0, 0, 300), inside)
    if place == "Library":
        prims += f'over "Library" {{\n{prototype}\n}}\n'
    model = read(write(prims, metres=0.01)).mesh
    area = np.linalg.norm(areas(model), axis=1).sum()
    np.testing.assert_allclose(area, 1e-4 * (1 + 4), rtol=1e-5)
    # The middle of the square is at (10.5, 0.5, 0) of a point; the third point is invisible.
    expected = [[0.105, 0.005, 3.0], [1.21, 0.01, 3.0]]
    centres = model.vertices[model.faces].mean(axis=1)
    halves = centres.reshape(2, -1, 3).mean(axis=1)
    np.testing.assert_allclose(halves, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("indices", "last", "reason"),
    [
        ([0, 1], "1", "protoIndices has a prototype that is missing"),
        ([-1, 0], "1", "protoIndices has a prototype that is missing"),
        ([0], "1", "positions do not fit protoIndices"),
        ([0, 0], "nan", "no finite pose"),
    ],
)
def test_bad_instancers_are_refused_in_one_line(write, indices, last, reason):
    points = f"""
      int[] protoIndices = {indices}
      point3f[] positions = [(0, 0, 0), ({last}, 0, 0)]
    """
    path = write(instancer("copies", ["/copies/square"], points, SQUARE))
    with pytest.raises(InputError, match=reason) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_texture_may_be_wrapped_differently_along_s_and_t(tmp_path, write):
    write_pictures(tmp_path)
    path = write(textured_square(texture(wrap_s="mirror", wrap_t="repeat")))
    assert material_of(path).base_color.wrap == ("mirror", "repeat")


BLACK, REPEAT, METADATA = (
    textured_square(texture(wrap_s=mode, wrap_t=mode))
    for mode in ("black", "repeat", "useMetadata")
)
CONSTANT = textured_square(texture("float2 inputs:st = (0.5, 0.5)"))
NOISE = textured_square(texture(source="other"), shader("other", "ND_noise2d"))
CIRCLE = textured_square(texture(source="a"), shader("a", "UsdTransform2d", source="a"))
TWO_PRIMVARS = textured_square(
    texture(source="map1"),
    shader("map1", "UsdPrimvarReader_float2", 'string inputs:varname = "map1"')
    + shader("map2", "UsdPrimvarReader_float2", 'string inputs:varname = "map2"')
    + texture(name="rough", source="map2"),
    ["map1", "map2"],
    "float inputs:opacity.connect = </m/rough.outputs:g>",
)


@pytest.mark.parametrize(
    ("prims", "part"),
    [
        (REPEAT, None),
        (METADATA, None),
        (BLACK, "wrap mode black (clamp)"),
        (CONSTANT, "constant texture coordinates (those of the mesh)"),
        (NOISE, "texture coordinates by ND_noise2d (those of the mesh)"),
        (CIRCLE, "more than 32 chained UsdTransform2d"),
        (TWO_PRIMVARS, "primvar 'map2' (the material uses 'map1')"),
    ],
)  # fmt: skip
def test_ignored_texture_coordinates_are_named(tmp_path, write, prims, part):
    write_pictures(tmp_path)
    path = write(prims)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read(path)
    messages = [f"{path}: not used: {part}"] if part else []
    assert [str(warning.message) for warning in caught] == messages
    # (u, v) of `map2` would begin at u = 1.
    assert model.mesh.uv[:, 0].min() == 0


def test_materials_are_those_of_the_earliest_time(tmp_path, write):
    """Values that change have no default; those of an input without samples are its default."""
    write_pictures(tmp_path)
    (tmp_path / "late.png").write_bytes(png(np.zeros((1, 1, 3))))
    shift = (
        "float2 inputs:translation.timeSamples = { 3: (0.125, 0.125), 8: (0.9, 0.9) }"
    )
    number = "float inputs:metallic = 0.75\nfloat inputs:roughness.timeSamples = { 3: 0.125, 8: 0.9 }"
    files = texture(
        "asset inputs:file.timeSamples = { 3: @t.png@, 8: @late.png@ }",
        file=None,
        source="place",
    )
    prims = textured_square(
        files, shader("place", "UsdTransform2d", shift), values=number
    )
    made = material_of(write(prims))
    assert (made.roughness, made.metallic) == (0.125, 0.75)
    assert made.base_color.pixels.shape == (1, 2, 3)
    assert made.base_color.to_uv[0, 3] == 0.125


def test_a_package_has_its_own_pictures(tmp_path, here):
    """Read in the process of its own."""
    here.undo()
    folder = tmp_path / "parts"
    folder.mkdir()
    write_pictures(folder)
    path = usda(folder / "m.usda", TEXTURED.replace("SPACE", ""))
    package = tmp_path / "m.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(path), str(package))
    for file in folder.iterdir():
        file.unlink()
    model = read(package)
    [made] = model.materials.values()
    assert isinstance(made.base_color, Bitmap)
    np.testing.assert_allclose(areas(model.mesh).sum(axis=0), [0, 0, 1])


@pytest.mark.parametrize(
    ("interpolation", "count"),
    [("constant", 1), ("vertex", 4), ("uniform", 1), ("faceVarying", 4)],
)
def test_display_colors(write, interpolation, count):
    colors = np.linspace(0.1, 0.9, 3 * count).reshape(count, 3)
    texts = [tuple(color) for color in colors.tolist()]
    model = read(
        write(
            square(
                "square",
                f'color3f[] primvars:displayColor = {texts} (interpolation = "{interpolation}")',
            )
        )
    )
    [made] = model.materials.values()
    if count == 1:
        assert made.base_color.rgb == pytest.approx(tuple(colors[0]))
        return
    assert made.base_color == VERTEX_COLOR
    stored = model.mesh.attributes[VERTEX_COLOR.attribute]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for vertex, color in zip(model.mesh.vertices, stored, strict=True):
        number = np.flatnonzero((corners == vertex[:2]).all(axis=1))[0]
        np.testing.assert_allclose(color[:3], colors[number], atol=1e-6)


def test_display_opacity_is_named(write):
    path = write(square("square", "float[] primvars:displayOpacity = [0.5]"))
    with pytest.warns(MaterialWarning, match=r"not used: displayOpacity \(opaque\)$"):
        read(path)


COPIES = """
  int[] protoIndices = [0, 1, 1]
  point3f[] positions = [(5, 0, 0), (6, 0, 0), (7, 0, 0)]
"""
PROTOTYPES = (
    SQUARE
    + 'def Xform "prototypes" {\n  def Cube "cube" {\n    double size = 2\n  }\n}'
)


def squares_and_cubes(path):
    """An instancer of a square, its child, and of a cube, its grandchild; copies are at x = 5, 6 and 7."""
    name = path.rpartition("/")[2]
    targets = [f"{path}/square", f"{path}/prototypes/cube"]
    return instancer(name, targets, COPIES, PROTOTYPES)


def test_prototypes_of_an_instancer_have_no_place(write):
    """Squares before and after instancers, one of them in a group of its own."""
    group = moved(0, 0, 9) + squares_and_cubes("/c/instancer") + SQUARE
    path = write(SQUARE + squares_and_cubes("/b") + prim("Xform", "c", group))
    model = read(path).mesh
    assert len(model.faces) == 2 * (2 + 2 + 2 * 12)
    centres = model.vertices[model.faces].mean(axis=1)
    of_group = centres[:, 2] > 4
    for group, height in ((~of_group, 0), (of_group, 9)):
        x, _, z = centres[group].T
        alone = x < 1
        assert alone.sum() == 2
        assert np.ptp(z[alone]) == 0
        assert x[~alone].max() == pytest.approx(8, abs=1e-6)
        assert z[~alone].mean() == pytest.approx(height, abs=1e-6)


def test_an_instancer_below_another_is_named(write):
    points = "int[] protoIndices = [0]\npoint3f[] positions = [(0, 0, 0)]"
    inner = squares_and_cubes("/copies/inner")
    path = write(SQUARE + instancer("copies", ["/copies/inner"], points, inner))
    with pytest.warns(MaterialWarning, match="a PointInstancer below another"):
        assert len(read(path).mesh.faces) == 2


NOT_RENDERED = {
    "BasisCurves": "BasisCurves (left out)",
    "Points": "Points (left out)",
    "Camera": "cameras (those of the scene)",
    "SphereLight": "lights (those of the scene)",
    "PhysicsRevoluteJoint": "PhysicsRevoluteJoint (left out)",
    "Material": "material 'Material', no UsdPreviewSurface (white and diffuse)",
}


@pytest.mark.parametrize(
    ("prims", "message"),
    [
        ('def Plane "ground" {}\n', r"has no triangles; it has Plane \(left out\)$"),
        ('def BasisCurves "hair" {}\n', r"has no triangles; it has BasisCurves \(left out\)$"),
        ('def Camera "c" {}\ndef Xform "x" {}\n', r"has no triangles; it has cameras \(those of the scene\)$"),
        ('def Xform "x" {}\n', "has no triangles$"),
    ],
)  # fmt: skip
def test_a_file_without_triangles_names_what_it_has(write, prims, message):
    with pytest.raises(InputError, match=rf"m\.usda: {message}"):
        read(write(prims))


def test_what_is_not_rendered_is_named(write):
    smooth = square("square", "rel material:binding = </Material>")
    prims = smooth.replace('"none"', '"catmullClark"')
    prims += "".join(prim(kind, kind, "") for kind in NOT_RENDERED)
    path = write(prims)
    with pytest.warns(MaterialWarning) as caught:
        assert len(read(path).mesh.faces) == 2
    [warning] = caught
    message = str(warning.message)
    assert message.startswith(f"{path}: not used: ")
    for part in ("subdivision (the control mesh)", *NOT_RENDERED.values()):
        assert part in message


HEAD = '#usda 1.0\n(\n  subLayers = [@{}@]\n)\ndef Cube "c" {{}}\n'
CLIPS = "clips = { dictionary default = { asset[] assetPaths = [@../secret.usda@] } }"
VARIANT = """#usda 1.0
def "a" (
  prepend variantSets = "v"
  variants = {{ string v = "x" }}
) {{
  variantSet "v" = {{
    "x" ({}) {{
      {}
    }}
  }}
}}
"""
NESTED = """
def Cube "c" (prepend variantSets = "w"
  variants = {{ string w = "y" }}) {{
  variantSet "w" = {{
    "y" ({}) {{ }}
  }}
}}
"""
OUTSIDE = {
    "absolute": HEAD.format("/etc/hostname.usda"),
    "above": HEAD.format("../secret.usda"),
    "web": HEAD.format("https://a.b/c.usda"),
    "reference": '#usda 1.0\ndef "a" (references = @../secret.usda@) {}\n',
    "payload": '#usda 1.0\ndef "a" (payload = @../secret.usda@</c>) {}\n',
    "link": HEAD.format("link.usda"),
    "nested": HEAD.format("below/inner.usda"),
    "clips": f'#usda 1.0\ndef "a" ({CLIPS}) {{}}\n',
    "clips of a variant": VARIANT.format(CLIPS, ""),
    "clips of a prim in a variant": VARIANT.format("", f'def Cube "c" ({CLIPS}) {{}}'),
    "clips of a nested variant": VARIANT.format("", NESTED.format(CLIPS)),
    "clips of a class": f'#usda 1.0\nclass "a" ({CLIPS}) {{}}\n',
    "clips of an over": f'#usda 1.0\nover "a" ({CLIPS}) {{}}\n',
    "reference of a variant": VARIANT.format("references = @../secret.usda@", ""),
    "payload of a nested variant": VARIANT.format(
        "", NESTED.format("payload = @../secret.usda@")
    ),
    "expression": """#usda 1.0
(
  expressionVariables = { string X = "../secret.usda" }
)
def "a" (references = @`"${X}"`@) {}
""",
}


@pytest.mark.parametrize("name", OUTSIDE)
def test_layers_outside_the_folder_are_refused(tmp_path, name):
    folder = tmp_path / "scene"
    (folder / "below").mkdir(parents=True)
    secret = tmp_path / "secret.usda"
    secret.write_text('#usda 1.0\ndef Cube "c" {}\n')
    (folder / "link.usda").symlink_to(secret)
    (folder / "below" / "inner.usda").write_text(HEAD.format("../../secret.usda"))
    path = folder / "m.usda"
    path.write_text(OUTSIDE[name])
    reasons = "leads outside|must be a file name|web addresses|value clips|no file"
    with pytest.raises(InputError, match=reasons) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_layers_below_the_folder_are_read(tmp_path):
    (tmp_path / "below").mkdir()
    (tmp_path / "below" / "inner.usda").write_text(HEAD.format("../other.usda"))
    (tmp_path / "other.usda").write_text(
        '#usda 1.0\n(metersPerUnit = 1)\ndef Sphere "s" {}\n'
    )
    (tmp_path / "m.usda").write_text(HEAD.format("below/inner.usda"))
    read(tmp_path / "m.usda")
    names = {
        file.name for file in named_files(tmp_path / "m.usda", SceneContext(tmp_path))
    }
    assert names == {"inner.usda", "other.usda"}


@pytest.mark.parametrize(
    ("good", "bad", "message"),
    [
        ("Counts = [4]", "Counts = [5]", "/square: faceVertexCounts do not fit faceVertexIndices"),
        ("[0, 1, 2, 3]", "[0, 1, 2, 9]", "/square: a face refers to a point that does not exist"),
        ("[(0, 0, 0)", "[(nan, 0, 0)", "/square: points are not finite"),
        ("point3f[]", "int[] holeIndices = [0]\npoint3f[]", "has no triangles"),
    ],
)  # fmt: skip
def test_wrong_meshes_are_errors_of_one_line(write, good, bad, message):
    path = write(SQUARE.replace(good, bad))
    with pytest.raises(InputError, match=rf"m\.usda: {message}"):
        read(path)


def test_triangles_are_counted_before_they_are_made(write, here):
    """A polygon of 7 corners is 5 triangles."""
    points = [(math.cos(a), math.sin(a), 0) for a in range(7)]
    path = write(mesh("a", points, [list(range(7))]))
    here.setattr("twinlens.scenes.assets.MOST_FACES", 4)
    here.setattr(
        "twinlens.scenes.usd.triangulated", lambda *_: pytest.fail("were made")
    )
    with pytest.raises(InputError, match="5 triangles are more than 4"):
        read(path)


def test_a_file_of_another_kind_is_an_error(tmp_path):
    for name in ("m.usda", "m.usdc", "m.usdz", "m.usd"):
        (tmp_path / name).write_bytes(b"PK\3\4 no such file")
        with pytest.raises(InputError, match=rf"{name}: "), warnings.catch_warnings():
            read(tmp_path / name)
    with zipfile.ZipFile(tmp_path / "m.usdz", "w") as archive:
        archive.writestr("a.txt", "no layer")
    with pytest.raises(InputError, match=r"m\.usdz: "):
        read(tmp_path / "m.usdz")


def test_without_usd_core_the_extra_is_named(tmp_path, here):
    here.undo()
    here.setitem(sys.modules, "pxr", None)
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    with pytest.raises(
        MissingExtraError, match=r"m\.usda: .*pip install 'twinlens\[usd\]'"
    ):
        read(tmp_path / "m.usda")


@pytest.mark.parametrize(
    "module", ["pxr", pytest.param("contextlib", marks=pytest.mark.slow)]
)
def test_modules_in_the_current_folder_are_not_run(tmp_path, here, module):
    """As in a terminal, where the current folder is not among the paths of modules."""
    here.undo()
    here.chdir(tmp_path)
    here.setattr(sys, "path", [path for path in sys.path if path])
    (tmp_path / f"{module}.py").write_text("open('was_run', 'w').close()\n")
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    assert len(read(tmp_path / "m.usda").mesh.faces) == 12
    assert not (tmp_path / "was_run").exists()


def compute_forever(*_):
    """As usd-core does it: without a return to Python, which would handle signals."""
    sum(itertools.repeat(0))


def wait_forever(*_):
    lock = threading.Lock()
    for _ in range(2):
        lock.acquire()


def allocate_forever(*_):
    blocks = []
    while True:
        blocks.append(bytearray(1 << 28))


def crash(*_):
    os.kill(os.getpid(), signal.SIGSEGV)


TOO_LONG = "reading takes more than 0 s and 4 s per MiB; is the file damaged"


@pytest.mark.parametrize(
    ("reads", "wait", "reason"),
    [
        (compute_forever, 60, TOO_LONG),
        (wait_forever, 1, TOO_LONG),
        (allocate_forever, 60, r"cannot be read as a \.usda mesh \(MemoryError\)"),
        (crash, 60, "its reader was killed by SIGSEGV; is the file damaged"),
        (lambda *_: os.abort(), 60, "its reader was killed by SIGABRT; is the file"),
    ],
)
def test_readers_that_do_not_end_well_are_errors(write, here, reads, wait, reason):
    def read_stage(path, find, allow, with_materials):
        allow(10)
        reads()

    here.setattr(usd_process, "read_stage", read_stage)
    here.setattr(usd_process, "_SECONDS", 0)
    here.setattr(usd_process, "_BUSY", wait)
    with pytest.raises(TwinlensError, match=rf"m\.usda: {reason}"):
        read_in_a_fork(write(SQUARE))


def test_the_process_of_a_reader_limits_itself(write, here):
    here.undo()
    program = """
from itertools import repeat
from twinlens.scenes import usd_process
usd_process._SECONDS = 0
usd_process.read_stage = lambda path, find, allow, _: (allow(10), sum(repeat(0)))
usd_process._main()
"""
    run = subprocess.run
    here.setattr(
        "twinlens.scenes.usd_process.subprocess.run",
        lambda words, **options: run([words[0], "-c", program], **options),
    )
    with pytest.raises(InputError, match=r"m\.usda: reading takes more than 20 s"):
        read(write(SQUARE))


def test_limits_grow_with_layers_and_decoded_pictures(tmp_path, write):
    write_pictures(tmp_path)
    below = usda(tmp_path / "below.usda", prim("Cube", "cube", ""))
    path = write(TEXTURED.replace("SPACE", ""))
    text = path.read_text().replace("(\n", "(\n  subLayers = [@below.usda@]\n", 1)
    path.write_text(text)
    sizes = []
    request = usd_process.Request(path, tmp_path, True)
    assert usd_process.answer_to(request, sizes.append).error is None
    layers = [path.stat().st_size, below.stat().st_size]
    texels = [2 * 4, 2 * 4]
    assert sizes == layers + texels
