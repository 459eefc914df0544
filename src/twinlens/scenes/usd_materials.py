"""Materials of USD files: UsdPreviewSurface, its textures and primvar readers, as `Material`s.

Other shaders (MDL, MaterialX) are named and shown white and diffuse. Source: the UsdPreviewSurface proposal, 2.6.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.scenes.assets import linear_from_srgb
from twinlens.scenes.gltf_materials import VERTEX_COLOR, decode_texels
from twinlens.scenes.materials import (
    Bitmap,
    Color,
    Material,
    VertexColor,
    wrap_along,
)
from twinlens.scenes.scene import free_name
from twinlens.scenes.usd_layers import UsdFiles

_CHANNELS = {
    "r": slice(0, 1),
    "g": slice(1, 2),
    "b": slice(2, 3),
    "a": slice(3, 4),
    "rgb": slice(0, 3),
}
_WRAPS = {"repeat": "repeat", "mirror": "mirror", "clamp": "clamp", "black": "clamp"}
_EXACT_WRAPS = ("repeat", "mirror", "clamp", "useMetadata")
_READERS = ("UsdPrimvarReader_float2", "UsdPrimvarReader_string")
_LONGEST_CHAIN = 32  # of UsdTransform2d, which may be connected in a circle
_ST = "st"  # the usual primvar of texture coordinates


class Surfaces:
    """The materials of a stage in the order of their use; `lost` names what is not rendered."""

    def __init__(self, files: UsdFiles) -> None:
        self.files = files
        self.names: list[str] = []
        self.materials: list[Material] = []
        self.lost: list[str] = []
        self._numbers: dict[Any, tuple[int, str]] = {}
        self._texels: dict[bytes, NDArray[Any]] = {}

    def of(self, bound: Any) -> tuple[int, str]:
        """The number of a material, and the primvar of its texture coordinates."""
        key = str(bound.GetPath())
        if key not in self._numbers:
            surface = bound.ComputeSurfaceSource()[0]
            kind = surface.GetIdAttr().Get() if surface else None
            name = bound.GetPrim().GetName()
            if kind != "UsdPreviewSurface":
                shader = kind or "no UsdPreviewSurface"
                self.lost.append(f"material {name!r}, {shader} (white and diffuse)")
                self._numbers[key] = self._add(name, Material(specular=0.0)), _ST
            else:
                reader = _Preview(self, surface)
                material = reader.material()
                self._numbers[key] = self._add(name, material), reader.primvar
        return self._numbers[key]

    def plain(self, color: Color | None, has_colors: bool) -> int:
        """The number of the material of a prim without one: white and diffuse, or of the primvar displayColor."""
        key = color, has_colors
        if key not in self._numbers:
            base = VERTEX_COLOR if has_colors else color or Color((1.0, 1.0, 1.0))
            material = Material(base_color=base, specular=0.0, two_sided=True)
            self._numbers[key] = self._add("default", material), _ST
        return self._numbers[key][0]

    def has_colors(self, number: int) -> bool:
        """Whether a material takes the colours of vertices."""
        return isinstance(self.materials[number].base_color, VertexColor)

    def has_textures(self, number: int) -> bool:
        """Whether a material has textures."""
        values = vars(self.materials[number]).values()
        return any(isinstance(value, Bitmap) for value in values)

    def _add(self, name: str, material: Material) -> int:
        self.names.append(free_name(name, dict.fromkeys(self.names)))
        self.materials.append(material)
        return len(self.materials) - 1

    def texels(self, asset: Any, layer: str) -> NDArray[Any]:
        """The stored values (H, W, 4) of a picture."""
        data = self.files.picture(asset, layer)
        if data not in self._texels:
            texels = decode_texels(data, asset.path)
            self.files.allow(texels.nbytes)
            self._texels[data] = texels
        return self._texels[data]


class _Preview:
    """Reads the inputs of one UsdPreviewSurface."""

    def __init__(self, surfaces: Surfaces, shader: Any) -> None:
        self._surfaces = surfaces
        self._shader = shader
        self._primvar: str | None = None

    @property
    def primvar(self) -> str:
        """The primvar of the texture coordinates: that of the first input that names one."""
        return self._primvar or _ST

    def material(self) -> Material:
        """The `Material`. Both sides are visible: `doubleSided` is a hint to leave faces out."""
        base_color = self.color("diffuseColor", 0.18)
        opacity = self.number("opacity", 1.0)
        cutoff = self.number("opacityThreshold", 0.0)
        self._name_lost()
        is_specular = self.number("useSpecularWorkflow", 0) != 0
        emission = self.color("emissiveColor", 0.0)
        is_dark = isinstance(emission, Color) and not any(emission.rgb)
        return Material(
            base_color=base_color,
            metallic=0.0 if is_specular else self.number("metallic", 0.0),
            roughness=self.number("roughness", 0.5),
            # An infinite index reflects the specular colour.
            ior=0.0 if is_specular else max(self.uniform("ior", 1.5), 1.0),
            specular_color=self.color("specularColor", 0.0) if is_specular else 1.0,
            coat=self.number("clearcoat", 0.0),
            coat_roughness=self.number("clearcoatRoughness", 0.01),
            normal=self.normals(),
            emission=None if is_dark else emission,
            opacity=opacity,
            alpha_cutoff=cutoff if isinstance(cutoff, float) and cutoff > 0 else None,
            two_sided=True,
        )

    def _name_lost(self) -> None:
        displacement = self.number("displacement", 0.0)
        if isinstance(displacement, Bitmap) or displacement:
            self._lost("displacement (left out)")

    def _lost(self, part: str) -> None:
        self._surfaces.lost.append(part)

    def uniform(self, name: str, default: float) -> float:
        """A number that has no texture here; the mean of one that has."""
        value = self.number(name, default)
        return float(value.pixels.mean()) if isinstance(value, Bitmap) else value

    def number(self, name: str, default: float) -> float | Bitmap:
        """A number in [0, 1], or one per texel."""
        stored, texture = self._input(name)
        if texture is not None:
            pixels, placed = texture
            return self._bitmap(np.clip(pixels[..., 0], 0, 1), placed)
        number = default if stored is None else float(stored)
        most = np.inf if name == "ior" else 1.0
        if not 0 <= number <= most:
            raise InputError(f"{self._where(name)} must be 0 to {most:g}, got {number}")
        return number

    def color(self, name: str, default: float) -> Color | Bitmap:
        """A linear colour, or one per texel."""
        stored, texture = self._input(name)
        if texture is not None:
            pixels, placed = texture
            colors = np.broadcast_to(pixels, (*pixels.shape[:2], 3))
            most = None if name == "emissiveColor" else 1
            return self._bitmap(np.clip(colors, 0, most), placed)
        values = [default] * 3 if stored is None else [float(v) for v in stored]
        limit = np.inf if name == "emissiveColor" else 1.0
        if not all(0 <= value <= limit for value in values):
            raise InputError(
                f"{self._where(name)} must be 0 to {limit:g}, got {values}"
            )
        r, g, b = values
        return Color((r, g, b))

    def normals(self) -> Bitmap | None:
        """The normal map, as (n + 1) / 2."""
        _, texture = self._input("normal")
        if texture is None:
            return None
        pixels, placed = texture
        length = np.linalg.norm(pixels, axis=-1, keepdims=True)
        unit = pixels / np.maximum(length, 1e-6)
        return self._bitmap((unit + 1) / 2, placed)

    def _where(self, name: str) -> str:
        return f"{self._shader.GetPath()}: {name}"

    def _bitmap(self, pixels: Any, placed: dict[str, Any]) -> Bitmap:
        return Bitmap(np.ascontiguousarray(pixels, dtype=np.float32), **placed)

    def _input(self, name: str) -> tuple[Any, tuple[Any, dict[str, Any]] | None]:
        """The value of an input, or else the texels (H, W, 1 or 3) of its texture and how they are placed."""
        from pxr import UsdShade

        attribute = _source(self._shader, name)
        if attribute is None:
            return None, None
        if not UsdShade.Output.IsOutput(attribute):
            return _stored(attribute), None
        shader = UsdShade.Shader(attribute.GetPrim())
        if shader.GetIdAttr().Get() != "UsdUVTexture":
            self._lost(f"{name} by {shader.GetIdAttr().Get()} (its default)")
            return None, None
        output = UsdShade.Output(attribute).GetBaseName()
        return self._texture(name, shader, str(output))

    def _texture(
        self, name: str, shader: Any, output: str
    ) -> tuple[Any, tuple[Any, dict[str, Any]] | None]:
        asset = _value(shader, "file")
        if asset is None or "<UDIM>" in asset.path:
            self._lost(
                f"{name} by {asset.path if asset else 'a texture without a file'} (its fallback)"
            )
            fallback = _value(shader, "fallback")
            if fallback is None:
                return None, None
            channels = list(fallback)[_CHANNELS.get(output, slice(0, 3))]
            return (channels if output == "rgb" else channels[0]), None
        stored = self._surfaces.texels(asset, _layer_of(_source(shader, "file")))
        most = float(np.iinfo(stored.dtype).max)
        values = stored / np.float32(most)
        if _is_srgb(shader, name, stored):
            values[..., :3] = linear_from_srgb(values[..., :3])
        is_normal = name == "normal"
        scale = _value(shader, "scale") or ((2, 2, 2, 1) if is_normal else (1, 1, 1, 1))
        bias = _value(shader, "bias") or (
            (-1, -1, -1, 0) if is_normal else (0, 0, 0, 0)
        )
        values = values * np.array(scale, np.float32) + np.array(bias, np.float32)
        chosen = values[..., _CHANNELS.get(output, slice(0, 3))]
        return None, (chosen, self._placed(shader))

    def _placed(self, shader: Any) -> dict[str, Any]:
        wraps = [str(_value(shader, name) or "repeat") for name in ("wrapS", "wrapT")]
        along = [_WRAPS.get(wrap, "repeat") for wrap in wraps]
        for wrap, used in dict(zip(wraps, along, strict=True)).items():
            if wrap not in _EXACT_WRAPS:
                self._lost(f"wrap mode {wrap} ({used})")
        matrix, primvar = self._coordinates(shader)
        if self._primvar is None:
            self._primvar = primvar
        elif primvar not in (None, self._primvar):
            self._lost(f"primvar {primvar!r} (the material uses {self._primvar!r})")
        to_uv = np.eye(4)
        to_uv[np.ix_([0, 1, 3], [0, 1, 3])] = matrix
        return {"wrap": wrap_along(*along), "to_uv": to_uv}

    def _coordinates(self, texture: Any) -> tuple[Float, str | None]:
        """The matrix (3, 3) from a primvar to the coordinates of a texture, and the primvar."""
        from pxr import UsdShade

        matrix = np.eye(3)
        attribute = _source(texture, "st")
        for _ in range(_LONGEST_CHAIN):
            if attribute is None:
                return matrix, None
            if not UsdShade.Output.IsOutput(attribute):
                self._lost("constant texture coordinates (those of the mesh)")
                return matrix, None
            shader = UsdShade.Shader(attribute.GetPrim())
            kind = shader.GetIdAttr().Get()
            if kind in _READERS:
                name = _value(shader, "varname")
                return matrix, str(name) if name else None
            if kind != "UsdTransform2d":
                self._lost(f"texture coordinates by {kind} (those of the mesh)")
                return matrix, None
            # The innermost transform comes first.
            matrix = matrix @ _transform(shader)
            attribute = _source(shader, "in")
        self._lost(f"more than {_LONGEST_CHAIN} chained UsdTransform2d")
        return matrix, None


def _source(shader: Any, name: str) -> Any:
    """The attribute that has the value of an input, of any prim, or the output that computes it; None without one."""
    from pxr import UsdShade

    connected = shader.GetInput(name)
    if not connected:
        return None
    attributes = UsdShade.Utils.GetValueProducingAttributes(connected)
    return attributes[0] if attributes else None


def _stored(attribute: Any) -> Any:
    """The value of an attribute at its earliest time; its default if it does not change."""
    from pxr import Usd

    return attribute.Get(Usd.TimeCode.EarliestTime())


def _value(shader: Any, name: str) -> Any:
    """The value of an input, which another prim may hold; None without one."""
    attribute = _source(shader, name)
    return None if attribute is None else _stored(attribute)


def _layer_of(attribute: Any) -> str:
    """The layer that names the file of a texture."""
    stack = attribute.GetPropertyStack()
    return str(stack[0].layer.identifier)


def _is_srgb(shader: Any, name: str, stored: NDArray[Any]) -> bool:
    """Whether the texels are sRGB: as the file says, or else 8 bits of a colour."""
    space = _value(shader, "sourceColorSpace")
    if space in ("sRGB", "raw"):
        return bool(space == "sRGB")
    return stored.dtype == np.uint8 and name in (
        "diffuseColor",
        "emissiveColor",
        "specularColor",
    )


def _transform(shader: Any) -> Float:
    """UsdTransform2d (3, 3): scale, then rotation counter-clockwise in degrees, then translation."""
    scale = _value(shader, "scale") or (1.0, 1.0)
    angle = np.radians(float(_value(shader, "rotation") or 0.0))
    shift = _value(shader, "translation") or (0.0, 0.0)
    c, s = np.cos(angle), np.sin(angle)
    turned = np.array([[c, -s, shift[0]], [s, c, shift[1]], [0, 0, 1]])
    return np.asarray(turned @ np.diag([scale[0], scale[1], 1.0]))
