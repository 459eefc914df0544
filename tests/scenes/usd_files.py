"""Texts of USD files for tests, and a reader of them."""

import faulthandler
import os
import traceback

import numpy as np

from tests.scenes.gltf_files import png
from twinlens.errors import TwinlensError
from twinlens.scenes import usd_process

RGBA = np.array([[[0.5, 1, 0, 1], [0, 0, 0, 0.0]]])
BINDING = 'prepend apiSchemas = ["MaterialBindingAPI"]'


def usda(path, prims, metres=1.0, up="Z"):
    """Write a .usda file of prims and return its path."""
    path.write_text(
        f'#usda 1.0\n(\n  metersPerUnit = {metres}\n  upAxis = "{up}"\n)\n{prims}'
    )
    return path


def write_pictures(folder):
    """t.png, an opaque and a transparent pixel, and r.png, whose green channel is 0.2 and 1."""
    (folder / "t.png").write_bytes(png(RGBA))
    (folder / "r.png").write_bytes(png(np.array([[[1, 0.2, 1]], [[0, 1, 0]]])))


def prim(kind, name, content, metadata=""):
    return f'def {kind} "{name}" (\n{metadata}\n) {{\n{content}\n}}\n'


def moved(*shift):
    """The pose of a prim."""
    order = 'uniform token[] xformOpOrder = ["xformOp:translate"]'
    return f"double3 xformOp:translate = {shift}\n{order}\n"


def mesh(name, points, faces, values=""):
    content = f"""
      uniform token subdivisionScheme = "none"
      point3f[] points = {points}
      int[] faceVertexCounts = {[len(face) for face in faces]}
      int[] faceVertexIndices = {[index for face in faces for index in face]}
      {values}
    """
    return prim("Mesh", name, content, BINDING)


def square(name, values=""):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    return mesh(name, points, [[0, 1, 2, 3]], values)


SQUARE = square("square")


def instancer(name, prototypes, points, inside=""):
    targets = ", ".join(f"<{path}>" for path in prototypes)
    content = f"rel prototypes = [{targets}]\n{points}\n{inside}"
    return prim("PointInstancer", name, content)


def material(name, inputs, shaders=""):
    """A material with inputs of its UsdPreviewSurface, and other shaders."""
    surface = f"""
      uniform token info:id = "UsdPreviewSurface"
      {inputs}
      token outputs:surface
    """
    output = f"token outputs:surface.connect = </{name}/surface.outputs:surface>\n"
    return prim("Material", name, output + prim("Shader", "surface", surface) + shaders)


def shader(name, kind, inputs="", source=None):
    """A shader of the material `m`, whose input `in` is the result of another one."""
    link = f"float2 inputs:in.connect = </m/{source}.outputs:result>" if source else ""
    content = f"""
      uniform token info:id = "{kind}"
      {inputs}
      {link}
      float2 outputs:result
    """
    return prim("Shader", name, content)


def texture(
    inputs="", *, name="color", file="t.png", source=None, wrap_s=None, wrap_t=None
):
    """A UsdUVTexture of the material `m`, whose coordinates are the result of a shader."""
    values = {
        "asset inputs:file =": f"@{file}@" if file else None,
        "token inputs:wrapS =": f'"{wrap_s}"' if wrap_s else None,
        "token inputs:wrapT =": f'"{wrap_t}"' if wrap_t else None,
        "float2 inputs:st.connect =": f"</m/{source}.outputs:result>" if source else None,
    }  # fmt: skip
    lines = [f"{key} {value}" for key, value in values.items() if value is not None]
    outputs = "float3 outputs:rgb\nfloat outputs:g\nfloat outputs:a"
    return shader(name, "UsdUVTexture", "\n".join([inputs, *lines, outputs]))


def textured_square(color, shaders="", primvars=("st",), values=""):
    """A square with coordinates by name, and a material whose colour is the texture `color`."""
    coordinates = "".join(
        f'texCoord2f[] primvars:{name} = [({number}, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")\n'
        for number, name in enumerate(primvars)
    )
    bound = square("square", coordinates + "rel material:binding = </m>")
    link = "color3f inputs:diffuseColor.connect = </m/color.outputs:rgb>\n"
    return bound + material("m", link + values, color + shaders)


ROUGHNESS = """
  token inputs:sourceColorSpace = "raw"
  float4 inputs:scale = (0.5, 0.5, 0.5, 0.5)
  float4 inputs:bias = (0.25, 0.25, 0.25, 0.25)
"""
TEXTURED = textured_square(
    texture("SPACE", source="place", wrap_s="clamp", wrap_t="clamp"),
    shader("reader", "UsdPrimvarReader_float2", 'string inputs:varname = "map1"')
    + shader(
        "place",
        "UsdTransform2d",
        "float2 inputs:scale = (2, 3)\nfloat2 inputs:translation = (0.25, 0.5)\nfloat inputs:rotation = 90",
        "reader",
    )
    + texture(
        ROUGHNESS,
        name="rough",
        file="r.png",
    ),
    ["map1"],
    "float inputs:roughness.connect = </m/rough.outputs:g>\nfloat inputs:opacity.connect = </m/color.outputs:a>",
)
"""A square with a colour from t.png, through a transform and the primvar `map1`, and a roughness from the green channel
of r.png. SPACE stands for more inputs of the colour."""


def read_in_a_fork(path):
    """Read a file as its own process does, with the limits and the end of that of users, in a hundredth of the time."""
    receiver, sender = os.pipe()
    child = os.fork()
    if not child:
        faulthandler.disable()
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        try:
            request = usd_process.Request(path, path.parent, True)
            allow = usd_process.Limits().allow
            refusal = usd_process.answer_to(request, allow).error
            os.write(sender, str(refusal or "").encode())
        except BaseException:
            os.write(sender, traceback.format_exc().encode())
        os._exit(0)
    os.close(sender)
    with os.fdopen(receiver) as pipe:
        message = pipe.read()
    _, ended = os.waitpid(child, 0)
    usd_process.check_status(path, os.waitstatus_to_exitcode(ended))
    if message:
        raise TwinlensError(message)
