"""USD files: meshes, poses and materials. Bounds and areas are those of OpenUSD, trimesh and shapely."""

import subprocess
import sys
import warnings
import zipfile

import numpy as np
import pytest
import trimesh
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, UsdUtils, Vt
from shapely import Polygon

from tests.scenes.gltf_files import png
from twinlens.errors import InputError, MissingExtraError
from twinlens.scenes import usd_process
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.gltf_materials import VERTEX_COLOR
from twinlens.scenes.materials import Bitmap, Color
from twinlens.scenes.model_files import MaterialWarning, named_files, read_model

C_PLATE = [(0, 0), (3, 0), (3, 1), (1, 1), (1, 2), (3, 2), (3, 3), (0, 3)]


def open_here(path, context, with_materials=True):
    """`usd_process.open_usd` without the process, which takes two seconds to start."""
    request = usd_process.Request(path, context.folder, with_materials)
    return usd_process._unpacked(usd_process.answer_to(request), context)


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """Tests of the process undo it."""
    monkeypatch.setattr("twinlens.scenes.model_files.open_usd", open_here)
    return monkeypatch


def read(path, **options):
    return read_model(path, SceneContext(path.parent), **options)


def stage_at(path, metres=1.0, up="Z"):
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, metres)
    UsdGeom.SetStageUpAxis(stage, up)
    return stage


def add_mesh(stage, name, points, faces, **values):
    mesh = UsdGeom.Mesh.Define(stage, name)
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in points])
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([index for face in faces for index in face])
    mesh.CreateSubdivisionSchemeAttr("none")
    for key, value in values.items():
        getattr(mesh, f"Create{key}Attr")(value)
    return mesh


def add_square(stage, name="/square", **values):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    return add_mesh(stage, name, points, [[0, 1, 2, 3]], **values)


def add_primvar(mesh, name, kind, values, interpolation, indices=None):
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
    primvar.Set(values)
    if indices is not None:
        primvar.SetIndices(Vt.IntArray(indices))


def preview(stage, name, **inputs):
    """A material whose inputs are values, or (shader, output)."""
    material = UsdShade.Material.Define(stage, name)
    shader = UsdShade.Shader.Define(stage, f"{name}/surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    for key, value in inputs.items():
        if isinstance(value, tuple) and isinstance(value[0], UsdShade.Shader):
            source, output, kind = value
            target = shader.CreateInput(key, kind)
            target.ConnectToSource(source.CreateOutput(output, kind))
        elif isinstance(value, tuple):
            shader.CreateInput(key, Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(*value))
        else:
            shader.CreateInput(key, Sdf.ValueTypeNames.Float).Set(value)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")
    return material


def bind(prim, material):
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(material)


def area(mesh):
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return cross.sum(axis=0) / 2


@pytest.mark.parametrize("suffix", ["usda", "usdc", "usd"])
@pytest.mark.parametrize(
    "outline",
    [C_PLATE, [(0, 0), (4, 0), (4, 3), (2, 1), (0, 3)], [(0, 0), (2, 0), (3, 2), (1, 4), (-1, 2)]],
)  # fmt: skip
def test_polygons_cover_their_own_area(tmp_path, suffix, outline):
    path = tmp_path / f"m.{suffix}"
    stage = stage_at(path)
    face = list(range(len(outline)))
    points = [(x, y, 0) for x, y in outline]
    add_mesh(stage, "/right", points, [face])
    add_mesh(stage, "/left", points, [face[::-1]], Orientation="leftHanded")
    add_mesh(stage, "/hole", points, [face], HoleIndices=[0])
    stage.Save()
    np.testing.assert_allclose(area(read(path).mesh), [0, 0, 2 * Polygon(outline).area])


@pytest.mark.parametrize(("metres", "up"), [(0.01, "Y"), (1.0, "Z"), (0.001, "Z")])
def test_poses_and_units(tmp_path, read_scene, metres, up):
    """The bounds that OpenUSD computes, in metres, with z up."""
    path = tmp_path / "m.usda"
    stage = stage_at(path, metres, up)
    top = UsdGeom.Xform.Define(stage, "/top")
    top.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    top.AddRotateXYZOp().Set(Gf.Vec3f(20, 30, 40))
    part = UsdGeom.Xform.Define(stage, "/top/part")
    part.AddScaleOp().Set(Gf.Vec3f(2, 0.5, -1))
    add_square(stage, "/top/part/square")
    UsdGeom.Cube.Define(stage, "/cube").CreateSizeAttr(0.5)
    stage.Save()
    bounds = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default"])
    corners = [
        np.array(
            bounds.ComputeWorldBound(stage.GetPrimAtPath(name))
            .ComputeAlignedRange()
            .GetCorner(i)
        )
        for name in ("/top", "/cube")
        for i in range(8)
    ]
    expected = np.array(corners) * metres
    mesh = read_scene("[objects.own]\nfile = 'm.usda'\n").objects[-1].shape
    if up == "Y":
        expected = expected[:, [0, 2, 1]] * [1, -1, 1]
    made = [mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)]
    np.testing.assert_allclose(
        made, [expected.min(axis=0), expected.max(axis=0)], rtol=1e-6
    )


def test_the_unit_of_a_file_that_names_none_is_a_centimetre(tmp_path):
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    assert np.ptp(read(tmp_path / "m.usda").mesh.vertices) == pytest.approx(0.02)


@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
@pytest.mark.parametrize(
    ("kind", "volume"),
    [("Cylinder", 0.024), ("Cone", 0.008), ("Capsule", 0.024 + 4 / 3 * 0.008)],
)  # fmt: skip
def test_round_shapes(tmp_path, axis, kind, volume):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    shape = getattr(UsdGeom, kind).Define(stage, "/shape")
    shape.CreateRadiusAttr(0.2)
    shape.CreateHeightAttr(0.6)
    shape.CreateAxisAttr(axis)
    shape.CreateExtentAttr(
        UsdGeom.Boundable.ComputeExtentFromPlugins(shape, Usd.TimeCode.Default())
    )
    stage.Save()
    mesh = read(path).mesh
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces)
    assert solid.volume == pytest.approx(np.pi * volume, rel=0.005)
    np.testing.assert_allclose(solid.bounds, shape.GetExtentAttr().Get(), atol=1e-6)


def test_values_of_corners_faces_and_vertices(tmp_path):
    """Two triangles that share an edge: (u, v) of corners by index, a normal of each face."""
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 1)]
    mesh = add_mesh(stage, "/m", points, [[0, 1, 2], [0, 2, 3]])
    uv = [(0, 0), (0.5, 0), (0.5, 1), (1, 1)]
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    add_primvar(mesh, "st", kind, uv, "faceVarying", [0, 1, 2, 0, 2, 3])
    normals = [(0, 0, 1), (-0.6, 0, 0.8)]
    add_primvar(mesh, "normals", Sdf.ValueTypeNames.Normal3fArray, normals, "uniform")
    stage.Save()
    model = read(path).mesh
    np.testing.assert_allclose(
        model.uv[model.faces].reshape(-1, 2), np.array(uv)[[0, 1, 2, 0, 2, 3]]
    )
    np.testing.assert_allclose(model.normals[model.faces[:, 0]], normals, atol=1e-6)
    assert len(model.vertices) == 6


def test_purposes_visibility_and_instances(tmp_path):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    for name, purpose in (("a", "guide"), ("b", "proxy"), ("c", "render")):
        add_square(stage, f"/{name}").CreatePurposeAttr(purpose)
    hidden = UsdGeom.Xform.Define(stage, "/hidden")
    hidden.CreateVisibilityAttr("invisible")
    add_square(stage, "/hidden/square")
    stage.CreateClassPrim("/prototype")
    add_square(stage, "/prototype/square")
    for i in range(3):
        copy = UsdGeom.Xform.Define(stage, f"/copy{i}")
        copy.AddTranslateOp().Set(Gf.Vec3d(0, 0, i + 1))
        copy.GetPrim().GetReferences().AddInternalReference("/prototype")
        copy.GetPrim().SetInstanceable(True)
    stage.Save()
    mesh = read(path).mesh
    heights = mesh.vertices[mesh.faces[::2, 0], 2]
    assert sorted(heights) == [0, 1, 2, 3]


def textured(stage, name, file="t.png", **inputs):
    shader = UsdShade.Shader.Define(stage, name)
    shader.CreateIdAttr("UsdUVTexture")
    shader.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(file)
    for key, value in inputs.items():
        kind = (
            Sdf.ValueTypeNames.Float4
            if key in ("scale", "bias")
            else Sdf.ValueTypeNames.Token
        )
        shader.CreateInput(key, kind).Set(value)
    return shader


def test_materials_of_the_mesh_and_of_subsets(tmp_path):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    points = [(x, y, 0) for y in range(2) for x in range(4)]
    mesh = add_mesh(stage, "/m", points, [[i, i + 1, i + 5, i + 4] for i in range(3)])
    red = preview(
        stage, "/red", diffuseColor=(0.8, 0.1, 0.0), metallic=1.0, roughness=0.3
    )
    glow = preview(stage, "/glow", emissiveColor=(2.0, 1.0, 0.0), opacity=0.5, ior=1.3)
    bind(mesh, red)
    binding = UsdShade.MaterialBindingAPI(mesh.GetPrim())
    subset = binding.CreateMaterialBindSubset("part", [1], UsdGeom.Tokens.face)
    bind(subset, glow)
    stage.Save()
    model = read(path)
    assert list(model.materials) == ["m.usda:glow", "m.usda:red"]
    lit, metal = model.materials.values()
    assert metal.base_color.rgb == pytest.approx((0.8, 0.1, 0.0))
    assert (metal.metallic, metal.roughness) == (1.0, pytest.approx(0.3))
    assert lit.emission == Color((2.0, 1.0, 0.0))
    assert (lit.opacity, lit.ior) == (0.5, pytest.approx(1.3))
    middle = model.mesh.vertices[model.mesh.faces].mean(axis=1)[:, 0]
    assert (model.mesh.surface == np.where((middle > 1) & (middle < 2), 0, 1)).all()


def add_textured_square(stage, **more):
    """A square with a colour from t.png and a roughness from the green channel of r.png, through a primvar `map1`."""
    mesh = add_square(stage)
    uv = [(0, 0), (1, 0), (1, 1), (0, 1)]
    add_primvar(mesh, "map1", Sdf.ValueTypeNames.TexCoord2fArray, uv, "vertex")
    color = textured(stage, "/m/color", wrapS="clamp", wrapT="clamp", **more)
    reader = UsdShade.Shader.Define(stage, "/m/reader")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("map1")
    place = UsdShade.Shader.Define(stage, "/m/place")
    place.CreateIdAttr("UsdTransform2d")
    pair = Sdf.ValueTypeNames.Float2
    place.CreateInput("scale", pair).Set(Gf.Vec2f(2, 3))
    place.CreateInput("translation", pair).Set(Gf.Vec2f(0.25, 0.5))
    place.CreateInput("rotation", Sdf.ValueTypeNames.Float).Set(90.0)
    place.CreateInput("in", pair).ConnectToSource(reader.CreateOutput("result", pair))
    color.CreateInput("st", pair).ConnectToSource(place.CreateOutput("result", pair))
    rough = textured(
        stage,
        "/m/rough",
        "r.png",
        sourceColorSpace="raw",
        scale=Gf.Vec4f(0.5),
        bias=Gf.Vec4f(0.25),
    )
    of_color, of_number = Sdf.ValueTypeNames.Color3f, Sdf.ValueTypeNames.Float
    material = preview(
        stage,
        "/m",
        diffuseColor=(color, "rgb", of_color),
        roughness=(rough, "g", of_number),
        opacity=(color, "a", of_number),
    )
    bind(mesh, material)


RGBA = np.array([[[0.5, 1, 0, 1], [0, 0, 0, 0.0]]])


@pytest.mark.parametrize("space", ["sRGB", "raw", None])
def test_textures(tmp_path, space):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    (tmp_path / "t.png").write_bytes(png(RGBA))
    (tmp_path / "r.png").write_bytes(png(np.array([[[1, 0.2, 1]], [[0, 1, 0]]])))
    add_textured_square(stage, **({"sourceColorSpace": space} if space else {}))
    stage.Save()
    [material] = read(path).materials.values()
    color = material.base_color
    half = 128 / 255 if space == "raw" else ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(color.pixels[0, 0], [half, 1, 0], atol=1e-6)
    np.testing.assert_allclose(material.roughness.pixels, [[0.35], [0.75]], atol=1e-6)
    np.testing.assert_allclose(material.opacity.pixels, [[1, 0]])
    assert color.wrap == "clamp"
    # (1, 0) is scaled to (2, 0), turned to (0, 2) and moved to (0.25, 2.5).
    np.testing.assert_allclose(
        color.to_uv @ [1, 0, 0, 1], [0.25, 2.5, 0, 1], atol=1e-12
    )
    assert {file.name for file in named_files(path, SceneContext(tmp_path))} >= {
        "t.png",
        "r.png",
    }


def linked(stage, name, kind, source=None, **inputs):
    """A shader whose input `in` is the result of another one."""
    shader = UsdShade.Shader.Define(stage, name)
    shader.CreateIdAttr(kind)
    pair = Sdf.ValueTypeNames.Float2
    for key, value in inputs.items():
        kinds = {
            "varname": Sdf.ValueTypeNames.String,
            "rotation": Sdf.ValueTypeNames.Float,
        }
        shader.CreateInput(key, kinds.get(key, pair)).Set(value)
    if source is not None:
        shader.CreateInput("in", pair).ConnectToSource(
            source.CreateOutput("result", pair)
        )
    return shader


def place(texture, source):
    pair = Sdf.ValueTypeNames.Float2
    texture.CreateInput("st", pair).ConnectToSource(source.CreateOutput("result", pair))


def with_texture(stage, tmp_path, *primvars, **inputs):
    """A square with the primvars, and a texture of its material's colour."""
    (tmp_path / "t.png").write_bytes(png(RGBA))
    mesh = add_square(stage)
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    for number, name in enumerate(primvars):
        uv = [(number, 0), (1, 0), (1, 1), (0, 1)]
        add_primvar(mesh, name, kind, uv, "vertex")
    texture = textured(stage, "/m/color", **inputs)
    color = texture, "rgb", Sdf.ValueTypeNames.Color3f
    bind(mesh, preview(stage, "/m", diffuseColor=color))
    return texture


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([{"scale": (2, 3)}], (2, 3)),
        # (1, 1) is scaled to (2, 3), then moved.
        ([{"scale": (2, 3)}, {"translation": (5, 7)}], (7, 10)),
        # (1, 1) is moved to (6, 8), then scaled.
        ([{"translation": (5, 7)}, {"scale": (2, 3)}], (12, 24)),
        # (1, 1) is moved to (6, 8), turned to (-8, 6), then scaled.
        ([{"translation": (5, 7)}, {"rotation": 90.0}, {"scale": (2, 3)}], (-16, 18)),
    ],
)
def test_chained_transforms(tmp_path, steps, expected):
    """The steps are those from the primvar to the texture."""
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    texture = with_texture(stage, tmp_path, "map1")
    shader = linked(stage, "/m/reader", "UsdPrimvarReader_float2", varname="map1")
    for number, step in enumerate(steps):
        values = {
            key: value if key == "rotation" else Gf.Vec2f(*value)
            for key, value in step.items()
        }
        shader = linked(stage, f"/m/step{number}", "UsdTransform2d", shader, **values)
    place(texture, shader)
    stage.Save()
    [material] = read(path).materials.values()
    uv = material.base_color.to_uv @ [1, 1, 0, 1]
    np.testing.assert_allclose(uv, [*expected, 0, 1], atol=1e-6)


def add_copies(stage, prototypes, of_prototype, **values):
    """A PointInstancer /copies."""
    made = UsdGeom.PointInstancer.Define(stage, "/copies")
    made.CreatePrototypesRel().SetTargets([Sdf.Path(name) for name in prototypes])
    made.CreateProtoIndicesAttr(of_prototype)
    for name, value in values.items():
        made.GetPrim().GetAttribute(name).Set(value)
    return made


def centres_and_areas(path):
    mesh = read(path).mesh
    corners = mesh.vertices[mesh.faces]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), np.linalg.norm(cross, axis=1) / 2


@pytest.mark.parametrize("place", ["/copies/square", "/Library/square"])
def test_points_of_an_instancer_are_copies(tmp_path, place):
    """In centimetres, below a moved instancer; the prototype has a pose of its own."""
    path = tmp_path / "m.usda"
    stage = stage_at(path, metres=0.01)
    made = add_copies(
        stage, [place], [0, 0, 0],
        positions=[(0, 0, 0), (100, 0, 0), (0, 200, 0)],
        scales=[(1, 1, 1), (2, 2, 2), (1, 1, 1)],
        invisibleIds=Vt.Int64Array([2]),
    )  # fmt: skip
    made.AddTranslateOp().Set(Gf.Vec3d(0, 0, 300))
    square = add_square(stage, place)
    square.AddTranslateOp().Set(Gf.Vec3d(10, 0, 0))
    if place.startswith("/Library"):
        stage.GetPrimAtPath("/Library").SetSpecifier(Sdf.SpecifierOver)
    stage.Save()
    centres, areas = centres_and_areas(path)
    np.testing.assert_allclose(areas.sum(), 1e-4 * (1 + 4), rtol=1e-5)
    # The middle of the square is at (10.5, 0.5, 0) of a point; the third point is invisible.
    expected = [[0.105, 0.005, 3.0], [1.21, 0.01, 3.0]]
    halves = centres.reshape(2, -1, 3).mean(axis=1)
    np.testing.assert_allclose(halves, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("values", "reason"),
    [
        ({"of_prototype": [0, 1]}, "protoIndices has a prototype that is missing"),
        ({"of_prototype": [-1, 0]}, "protoIndices has a prototype that is missing"),
        ({"of_prototype": [0]}, "positions do not fit protoIndices"),
        ({"positions": [(0, 0, 0), (float("nan"), 0, 0)]}, "no finite pose"),
    ],
)
def test_bad_instancers_are_refused_in_one_line(tmp_path, values, reason):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    good = {"of_prototype": [0, 0], "positions": [(0, 0, 0), (1, 0, 0)]}
    add_copies(stage, ["/copies/square"], **good | values)
    add_square(stage, "/copies/square")
    stage.Save()
    with pytest.raises(InputError, match=reason) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_a_texture_may_be_wrapped_differently_along_s_and_t(tmp_path):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    with_texture(stage, tmp_path, "st", wrapS="mirror", wrapT="repeat")
    stage.Save()
    [material] = read(path).materials.values()
    assert material.base_color.wrap == ("mirror", "repeat")


def ignored_coordinates(stage, tmp_path, case):
    wrap = {case: case for case in ("black", "repeat", "useMetadata")}.get(
        case, "repeat"
    )
    primvars = ["map1", "map2"] if case == "primvar" else ["st"]
    texture = with_texture(stage, tmp_path, *primvars, wrapS=wrap, wrapT=wrap)
    if case == "constant":
        texture.CreateInput("st", Sdf.ValueTypeNames.Float2).Set(Gf.Vec2f(0.5, 0.5))
    elif case == "other":
        place(texture, linked(stage, "/m/other", "ND_noise2d"))
    elif case == "circle":
        shader = linked(stage, "/m/a", "UsdTransform2d")
        place(texture, linked(stage, "/m/a", "UsdTransform2d", shader))
    elif case == "primvar":
        rough = textured(stage, "/m/rough")
        for number, shader in enumerate((texture, rough)):
            name = primvars[number]
            place(
                shader,
                linked(stage, f"/m/{name}", "UsdPrimvarReader_float2", varname=name),
            )
        number = Sdf.ValueTypeNames.Float
        surface = UsdShade.Shader(stage.GetPrimAtPath("/m/surface"))
        surface.CreateInput("opacity", number).ConnectToSource(
            rough.CreateOutput("g", number)
        )


@pytest.mark.parametrize(
    ("case", "part"),
    [
        ("repeat", None),
        ("useMetadata", None),
        ("black", "wrap mode black (clamp)"),
        ("constant", "constant texture coordinates (those of the mesh)"),
        ("other", "texture coordinates by ND_noise2d (those of the mesh)"),
        ("circle", "more than 32 chained UsdTransform2d"),
        ("primvar", "primvar 'map2' (the material uses 'map1')"),
    ],
)  # fmt: skip
def test_ignored_texture_coordinates_are_named(tmp_path, case, part):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    ignored_coordinates(stage, tmp_path, case)
    stage.Save()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        model = read(path)
    messages = [f"{path}: not used: {part}"] if part else []
    assert [str(warning.message) for warning in caught] == messages
    # (u, v) of `map2` would begin at u = 1.
    assert model.mesh.uv[:, 0].min() == 0


def test_materials_are_those_of_the_earliest_time(tmp_path):
    """Values that change have no default; those of an input without samples are its default."""
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    texture = with_texture(stage, tmp_path, "st")
    (tmp_path / "late.png").write_bytes(png(np.zeros((1, 1, 3))))
    file = texture.GetInput("file").GetAttr()
    file.Clear()
    transform = linked(stage, "/m/place", "UsdTransform2d")
    shift = transform.CreateInput("translation", Sdf.ValueTypeNames.Float2)
    place(texture, transform)
    surface = UsdShade.Shader(stage.GetPrimAtPath("/m/surface"))
    rough = surface.CreateInput("roughness", Sdf.ValueTypeNames.Float)
    metal = surface.CreateInput("metallic", Sdf.ValueTypeNames.Float)
    metal.Set(0.75)
    for time, name, value in ((8, "late.png", 0.9), (3, "t.png", 0.125)):
        file.Set(name, time)
        shift.Set(Gf.Vec2f(value, 0), time)
        rough.Set(value, time)
    stage.Save()
    [material] = read(path).materials.values()
    assert (material.roughness, material.metallic) == (0.125, 0.75)
    assert material.base_color.pixels.shape == (1, 2, 3)
    assert material.base_color.to_uv[0, 3] == 0.125


def test_a_package_has_its_own_pictures(tmp_path, here):
    """Read in the process of its own."""
    here.undo()
    folder = tmp_path / "parts"
    folder.mkdir()
    stage = stage_at(folder / "m.usda")
    (folder / "t.png").write_bytes(png(RGBA))
    (folder / "r.png").write_bytes(png(np.ones((1, 1, 3))))
    add_textured_square(stage)
    stage.Save()
    package = tmp_path / "m.usdz"
    assert UsdUtils.CreateNewUsdzPackage(str(folder / "m.usda"), str(package))
    for file in folder.iterdir():
        file.unlink()
    [material] = read(package).materials.values()
    assert isinstance(material.base_color, Bitmap)
    np.testing.assert_allclose(area(read(package).mesh), [0, 0, 1])


@pytest.mark.parametrize(
    "interpolation", ["constant", "vertex", "uniform", "faceVarying"]
)
def test_display_colors(tmp_path, interpolation):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    mesh = add_square(stage)
    count = {"constant": 1, "uniform": 1, "vertex": 4, "faceVarying": 4}[interpolation]
    colors = np.linspace(0.1, 0.9, 3 * count).reshape(count, 3)
    kind = Sdf.ValueTypeNames.Color3fArray
    add_primvar(
        mesh,
        "displayColor",
        kind,
        Vt.Vec3fArray.FromNumpy(np.float32(colors)),
        interpolation,
    )
    stage.Save()
    model = read(path)
    [material] = model.materials.values()
    if count == 1:
        assert material.base_color.rgb == pytest.approx(tuple(colors[0]))
        return
    assert material.base_color == VERTEX_COLOR
    stored = model.mesh.attributes[VERTEX_COLOR.attribute]
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for vertex, color in zip(model.mesh.vertices, stored, strict=True):
        number = np.flatnonzero((corners == vertex[:2]).all(axis=1))[0]
        np.testing.assert_allclose(color[:3], colors[number], atol=1e-6)


def add_instancer(stage, name):
    """Copies of a square and of a cube, its prototypes, which are its children or grandchildren."""
    instancer = UsdGeom.PointInstancer.Define(stage, name)
    add_square(stage, f"{name}/square")
    UsdGeom.Xform.Define(stage, f"{name}/prototypes")
    UsdGeom.Cube.Define(stage, f"{name}/prototypes/cube")
    children = [f"{name}/square", f"{name}/prototypes/cube"]
    instancer.CreatePrototypesRel().SetTargets(children)
    instancer.CreateProtoIndicesAttr([0, 1, 1])
    instancer.CreatePositionsAttr([Gf.Vec3f(float(x), 0, 0) for x in (5, 6, 7)])


def test_prototypes_of_an_instancer_have_no_place(tmp_path):
    """Squares before and after instancers, one of them in a group of its own; copies are at x = 5, 6 and 7."""
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    add_square(stage, "/a")
    add_instancer(stage, "/b")
    UsdGeom.Xform.Define(stage, "/c").AddTranslateOp().Set(Gf.Vec3d(0, 0, 9))
    add_instancer(stage, "/c/instancer")
    add_square(stage, "/c/square")
    stage.Save()
    mesh = read(path).mesh
    assert len(mesh.faces) == 2 * (2 + 2 + 2 * 12)
    corners = mesh.vertices[mesh.faces].mean(axis=1)
    of_group = corners[:, 2] > 4
    for group, height in ((~of_group, 0), (of_group, 9)):
        x, _, z = corners[group].T
        alone = x < 1
        assert alone.sum() == 2
        assert np.ptp(z[alone]) == 0
        assert x[~alone].max() == pytest.approx(8, abs=1e-6)
        assert z[~alone].mean() == pytest.approx(height, abs=1e-6)


def test_an_instancer_below_another_is_named(tmp_path):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    add_square(stage)
    add_copies(stage, ["/copies/inner"], [0], positions=[(0, 0, 0)])
    add_instancer(stage, "/copies/inner")
    stage.Save()
    with pytest.warns(MaterialWarning, match="a PointInstancer below another"):
        assert len(read(path).mesh.faces) == 2


def test_what_is_not_rendered_is_named(tmp_path):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    square = add_square(stage, SubdivisionScheme="catmullClark")
    material = UsdShade.Material.Define(stage, "/mdl")
    bind(square, material)
    for kind in ("BasisCurves", "Points", "Camera"):
        getattr(UsdGeom, kind).Define(stage, f"/{kind}")
    stage.DefinePrim("/light", "SphereLight")
    stage.DefinePrim("/joint", "PhysicsRevoluteJoint")
    stage.Save()
    with pytest.warns(MaterialWarning) as caught:
        model = read(path)
    assert len(model.mesh.faces) == 2
    [warning] = caught
    message = str(warning.message)
    assert message.startswith(f"{path}: not used: ")
    for part in (
        "subdivision (the control mesh)",
        "BasisCurves (left out)",
        "Points (left out)",
        "cameras (those of the scene)",
        "lights (those of the scene)",
        "PhysicsRevoluteJoint (left out)",
        "material 'mdl', no UsdPreviewSurface (white and diffuse)",
    ):
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
    ("change", "message"),
    [
        (
            {"FaceVertexCounts": [5]},
            "/square: faceVertexCounts do not fit faceVertexIndices",
        ),
        (
            {"FaceVertexIndices": [0, 1, 2, 9]},
            "/square: a face refers to a point that does not exist",
        ),
        (
            {"Points": [Gf.Vec3f(float("nan"), 0, 0)] * 4},
            "/square: points are not finite",
        ),
        ({"HoleIndices": [0]}, "has no triangles"),
    ],
)
def test_wrong_meshes_are_errors_of_one_line(tmp_path, change, message):
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    mesh = add_square(stage)
    for key, value in change.items():
        getattr(mesh, f"Create{key}Attr")(value)
    stage.Save()
    with pytest.raises(InputError, match=rf"m\.usda: {message}"):
        read(path)


def test_triangles_are_counted_before_they_are_made(tmp_path, here):
    """A polygon of 7 corners is 5 triangles."""
    path = tmp_path / "m.usda"
    stage = stage_at(path)
    points = [(np.cos(a), np.sin(a), 0) for a in range(7)]
    add_mesh(stage, "/a", points, [list(range(7))])
    stage.Save()
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


def test_a_file_that_usd_core_never_finishes_is_an_error(tmp_path, here):
    here.undo()
    here.setattr("twinlens.scenes.usd_process.SECONDS", 0.01)
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    with pytest.raises(
        InputError, match=r"m\.usda: reading takes more than 0 s; is it damaged\?"
    ):
        read(tmp_path / "m.usda")


def test_a_file_that_usd_core_does_not_survive_is_an_error(tmp_path, here):
    here.undo()
    crash = "import os; os.abort()"
    run = subprocess.run
    here.setattr(
        "twinlens.scenes.usd_process.subprocess.run",
        lambda words, **options: run([words[0], "-c", crash], **options),
    )
    (tmp_path / "m.usda").write_text('#usda 1.0\ndef Cube "c" {}\n')
    with pytest.raises(
        InputError,
        match=r"m\.usda: its reader was killed by SIGABRT; is the file damaged\?",
    ):
        read(tmp_path / "m.usda")
