"""Materials of glTF 2.0: the tables of a header that describe them, and the `Material` of each.

trimesh reads materials too, but without samplers, texture transforms, the second set of texture coordinates and the
extensions of Khronos, and without limits on the pictures that a file may contain. So the tables are read here. Source:
glTF 2.0, chapter 5, and Khronos's extensions.
"""

# ruff: noqa: N815 (keys are spelt as in glTF)

import math
import struct
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Annotated, Any, Literal

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens.errors import InputError, import_extra
from twinlens.geometry import Float
from twinlens.pictures import kind_of_picture, opened, stored_values
from twinlens.scenes.assets import check_picture_size, linear_from_srgb
from twinlens.scenes.materials import (
    Bitmap,
    Color,
    Material,
    VertexColor,
    wrap_along,
)
from twinlens.schema import Fraction, NonNegative, exactly

Stored = NDArray[np.uint8] | NDArray[np.uint16]

VERTEX_COLOR = VertexColor("color")
"""The colours of vertices that a file has."""

_NEAREST, _CLAMP, _MIRROR = 9728, 33071, 33648
_WRAPS = {_CLAMP: "clamp", _MIRROR: "mirror"}
_RGBA_CHANNELS = {1: [0, 0, 0, 1], 2: [0, 0, 0, 1], 3: [0, 1, 2, 3], 4: [0, 1, 2, 3]}
"""Where RGBA are in the channels of a picture and one of full opacity after them."""
_KTX2 = b"\xabKTX 20\xbb\r\n\x1a\n"
_KTX2_SIZE = struct.Struct("<20x2I")
"""Width and height in the header. Source: KTX file format specification 2.0, section 3."""
_SMOOTHEST = 0.03  # roughness below which a pane is taken as clear


class Lenient(pydantic.BaseModel):
    """A table of a file that others write: unknown keys are allowed, NaN and infinity are not."""

    model_config = pydantic.ConfigDict(
        extra="allow", frozen=True, strict=True, allow_inf_nan=False
    )


_Factor = Annotated[list[Fraction], exactly(3, Fraction)]
_Index = Annotated[int, pydantic.Field(ge=0)]
_Pair = Annotated[list[float], exactly(2, float)]


class Transform(Lenient):
    """KHR_texture_transform."""

    offset: _Pair = pydantic.Field(default=[0.0, 0.0])
    rotation: float = 0.0
    scale: _Pair = pydantic.Field(default=[1.0, 1.0])
    texCoord: int | None = None

    def matrix(self) -> Float:
        """to_uv (3, 3) with v up. glTF's v points down: scale, counter-clockwise rotation as seen, offset."""
        c, s = math.cos(self.rotation), math.sin(self.rotation)
        turned = np.array([[c, s, self.offset[0]], [-s, c, self.offset[1]], [0, 0, 1]])
        flip = np.array([[1.0, 0, 0], [0, -1, 1], [0, 0, 1]])
        return np.asarray(flip @ turned @ np.diag([*self.scale, 1.0]) @ flip)


class _InfoExtensions(Lenient):
    KHR_texture_transform: Transform = Transform()


class TextureInfo(Lenient):
    """A reference to a texture; `scale` is that of a normal map."""

    index: _Index
    texCoord: _Index = 0
    scale: float = 1.0
    extensions: _InfoExtensions = _InfoExtensions()

    @property
    def coordinate_set(self) -> int:
        replaced = self.extensions.KHR_texture_transform.texCoord
        return self.texCoord if replaced is None else replaced


class _Roughness(Lenient):
    baseColorFactor: Annotated[list[Fraction], exactly(4, Fraction)] = pydantic.Field(
        default=[1.0] * 4
    )
    baseColorTexture: TextureInfo | None = None
    metallicFactor: Fraction = 1.0
    roughnessFactor: Fraction = 1.0
    metallicRoughnessTexture: TextureInfo | None = None


class _Transmission(Lenient):
    transmissionFactor: Fraction = 0.0
    transmissionTexture: TextureInfo | None = None


class _Ior(Lenient):
    ior: NonNegative = 1.5


class _Specular(Lenient):
    specularFactor: Fraction = 1.0
    specularTexture: TextureInfo | None = None
    specularColorFactor: Annotated[list[NonNegative], exactly(3, NonNegative)] = (
        pydantic.Field(default=[1.0] * 3)
    )
    specularColorTexture: TextureInfo | None = None


class _Clearcoat(Lenient):
    clearcoatFactor: Fraction = 0.0
    clearcoatTexture: TextureInfo | None = None
    clearcoatRoughnessFactor: Fraction = 0.0
    clearcoatRoughnessTexture: TextureInfo | None = None
    clearcoatNormalTexture: TextureInfo | None = None


class _Strength(Lenient):
    emissiveStrength: NonNegative = 1.0


class _Volume(Lenient):
    thicknessFactor: NonNegative = 0.0
    attenuationDistance: NonNegative | None = None


class _Extensions(Lenient):
    KHR_materials_transmission: _Transmission = _Transmission()
    KHR_materials_ior: _Ior = _Ior()
    KHR_materials_specular: _Specular = _Specular()
    KHR_materials_clearcoat: _Clearcoat = _Clearcoat()
    KHR_materials_emissive_strength: _Strength = _Strength()
    KHR_materials_volume: _Volume = _Volume()


class _Source(Lenient):
    source: _Index


class _SourceExtensions(Lenient):
    EXT_texture_webp: _Source | None = None
    KHR_texture_basisu: _Source | None = None


EXTENSIONS = {
    *_Extensions.model_fields,
    *_InfoExtensions.model_fields,
    *_SourceExtensions.model_fields,
}
"""The extensions of materials and textures that are read."""


class Image(Lenient):
    """Where a picture is: a file or data URI, or a part of a buffer."""

    uri: str | None = None
    bufferView: _Index | None = None


class Sampler(Lenient):
    """How a texture is repeated and filtered."""

    wrapS: int = 10497
    wrapT: int = 10497
    magFilter: int | None = None


class SampledImage(Lenient):
    """A picture and its sampler."""

    source: _Index | None = None
    sampler: _Index | None = None
    extensions: _SourceExtensions = _SourceExtensions()

    @property
    def image(self) -> int | None:
        """The number of its picture.

        That of EXT_texture_webp goes before the one for programs without, and this one before a KTX2 picture, which is
        stored with loss.
        """
        if (webp := self.extensions.EXT_texture_webp) is not None:
            return webp.source
        basis = self.extensions.KHR_texture_basisu
        return basis.source if self.source is None and basis else self.source


class PbrMaterial(Lenient):
    """A material of glTF 2.0."""

    name: str = ""
    pbrMetallicRoughness: _Roughness = _Roughness()
    normalTexture: TextureInfo | None = None
    emissiveTexture: TextureInfo | None = None
    emissiveFactor: _Factor = pydantic.Field(default=[0.0] * 3)
    alphaMode: Literal["OPAQUE", "MASK", "BLEND"] = "OPAQUE"
    alphaCutoff: NonNegative = 0.5
    doubleSided: bool = False
    extensions: _Extensions = _Extensions()

    @property
    def _infos(self) -> list[TextureInfo]:
        rough = self.pbrMetallicRoughness
        infos = (
            rough.baseColorTexture,
            rough.metallicRoughnessTexture,
            self.normalTexture,
            self.emissiveTexture,
        )
        return [info for info in infos if info is not None]

    @property
    def coordinate_set(self) -> int:
        """The set of texture coordinates of the first of its textures."""
        return self._infos[0].coordinate_set if self._infos else 0

    @property
    def has_textures(self) -> bool:
        """Whether it has textures, besides those of extensions."""
        return bool(self._infos)


class MtlMaterial(PbrMaterial):
    """A material of an .mtl file: its opacity has a texture of its own, and is not the alpha of the base colour."""

    opacityTexture: TextureInfo | None = None

    @property
    def _infos(self) -> list[TextureInfo]:
        infos = super()._infos
        return infos if self.opacityTexture is None else [*infos, self.opacityTexture]


@dataclass(eq=False)
class Textures:
    """The textures of a file. `picture` gives the encoded bytes of an image; `lost` collects what is not rendered."""

    textures: list[SampledImage]
    samplers: list[Sampler]
    picture: Callable[[int], bytes]
    lost: list[str] = field(default_factory=list)
    _decoded: dict[int, Stored] = field(default_factory=dict)

    def read(
        self,
        info: TextureInfo | None,
        coordinate_set: int,
        channels: slice | int,
        srgb: bool = False,
    ) -> Bitmap | None:
        """Some channels of a texture, in [0, 1]; None if there is nothing to render.

        With `srgb`, the first three channels are made linear.
        """
        if info is None:
            return None
        texture = self.textures[info.index]
        if texture.image is None:
            self.lost.append(f"textures[{info.index}], without a readable picture")
            return None
        if info.coordinate_set != coordinate_set:
            self.lost.append(
                f"TEXCOORD_{info.coordinate_set} of textures[{info.index}] (TEXCOORD_{coordinate_set})"
            )
        stored = self._stored(texture.image)[..., channels]
        most = np.iinfo(stored.dtype).max
        pixels = np.divide(stored, most, dtype=np.float32)
        if srgb:
            linear = linear_from_srgb(np.linspace(0, 1, most + 1))
            for channel in range(3):
                # One by one: NumPy converts indices to 8 bytes each.
                pixels[..., channel] = linear[stored[..., channel]]
        return self._placed(pixels, texture, info)

    def read_opacity(self, info: TextureInfo | None) -> Bitmap | None:
        """The opacity that a texture of its own gives: its alpha where it has some, else its luminance (BT.709)."""
        alpha = self.read(info, 0, 3)
        if alpha is None or (alpha.pixels < 1).any():
            return alpha
        colors = self.read(info, 0, slice(0, 3))
        assert colors is not None
        luminance = colors.pixels @ np.array([0.2126, 0.7152, 0.0722], np.float32)
        return replace(colors, pixels=luminance)

    def _stored(self, image: int) -> Stored:
        """The texels of an image; all images of a file together have a limit."""
        if image not in self._decoded:
            name = f"images[{image}]"
            self._decoded[image] = decode_texels(self.picture(image), name)
            total = sum(texels[..., 0].size for texels in self._decoded.values())
            check_picture_size(f"images[{image}]", 1, total)
        return self._decoded[image]

    def _placed(
        self, pixels: NDArray[np.float32], texture: SampledImage, info: TextureInfo
    ) -> Bitmap:
        sampler = Sampler()
        if texture.sampler is not None:
            sampler = self.samplers[texture.sampler]
        along = [_WRAPS.get(mode, "repeat") for mode in (sampler.wrapS, sampler.wrapT)]
        to_uv = np.eye(4)
        matrix = info.extensions.KHR_texture_transform.matrix()
        to_uv[np.ix_([0, 1, 3], [0, 1, 3])] = matrix
        return Bitmap(
            pixels,
            filter="nearest" if sampler.magFilter == _NEAREST else "bilinear",
            wrap=wrap_along(*along),
            to_uv=to_uv,
        )


def decode_texels(data: bytes, name: str) -> Stored:
    """The stored values (H, W, 4) of a picture, whatever its suffix. Raises InputError."""
    if data.startswith(_KTX2):
        return _decode_basis(data, name)
    kind = kind_of_picture(data)
    if kind is None:
        raise InputError(
            f"{name} must be a .png, .jpg, .bmp, .tga, .tif, .webp or .ktx2 picture"
        )
    with opened(data, kind) as image:
        check_picture_size(name, image.width, image.height)
        values = stored_values(image, data, "RGBA")
    if values.dtype == np.float32:
        raise InputError(f"{name} has floats; save it with 8 or 16 bits")
    if values.dtype == np.uint8:
        return np.asarray(values, np.uint8)
    full = np.full_like(values[..., :1], 65535)
    channels = _RGBA_CHANNELS[values.shape[2]]
    return np.concatenate([values, full], axis=2)[..., channels]


def _decode_basis(data: bytes, name: str) -> NDArray[np.uint8]:
    """The largest level (H, W, 4) of a KTX2 picture of Basis Universal, ETC1S or UASTC. Raises InputError.

    Raises MissingExtraError without opengl_basisu.
    """
    basis = import_extra("opengl_basisu", "gltf")
    if len(data) < _KTX2_SIZE.size:
        raise InputError(f"{name} ends within its header")
    check_picture_size(name, *_KTX2_SIZE.unpack_from(data))
    try:
        return np.asarray(basis.open(data).transcode(basis.Target.RGBA8).data)
    except basis.BasisuError as error:
        raise InputError(f"{name}: {error}") from None


def material_of(
    table: PbrMaterial, textures: Textures, colored: bool = False
) -> Material:
    """The `Material` of a table; with `colored`, its base colour and opacity are factors of those of vertices.

    What cannot be rendered is added to `textures.lost`.
    """
    textures.lost += sorted(table.extensions.model_extra or {})
    material = _Reader(table, textures, colored).material()
    textures.lost += _limits(material, table)
    return material


@dataclass(frozen=True, eq=False)
class _Reader:
    table: PbrMaterial
    textures: Textures
    colored: bool

    def material(self) -> Material:
        table, extensions = self.table, self.table.extensions
        specular = extensions.KHR_materials_specular
        coat = extensions.KHR_materials_clearcoat
        transmission = extensions.KHR_materials_transmission
        surface = table.pbrMetallicRoughness
        rough_and_metal = surface.metallicRoughnessTexture
        base_color, opacity = self.base()
        return Material(
            base_color=base_color,
            opacity=opacity,
            alpha_cutoff=table.alphaCutoff if table.alphaMode == "MASK" else None,
            metallic=self.number(rough_and_metal, surface.metallicFactor, 2),
            roughness=self.number(rough_and_metal, surface.roughnessFactor, 1),
            ior=extensions.KHR_materials_ior.ior,
            specular=self.number(specular.specularTexture, specular.specularFactor, 3),
            specular_color=self.color(
                specular.specularColorTexture, specular.specularColorFactor
            ),
            transmission=self.number(
                transmission.transmissionTexture, transmission.transmissionFactor, 0
            ),
            thin_walled=extensions.KHR_materials_volume.thicknessFactor == 0,
            coat=self.number(coat.clearcoatTexture, coat.clearcoatFactor, 0),
            coat_roughness=self.number(
                coat.clearcoatRoughnessTexture, coat.clearcoatRoughnessFactor, 1
            ),
            normal=self.normals(table.normalTexture),
            coat_normal=self.normals(coat.clearcoatNormalTexture),
            emission=self.emission(),
            two_sided=table.doubleSided,
        )

    def read(
        self, info: TextureInfo | None, channels: slice | int, srgb: bool = False
    ) -> Bitmap | None:
        return self.textures.read(info, self.table.coordinate_set, channels, srgb)

    def number(
        self, info: TextureInfo | None, factor: float, channel: int
    ) -> float | Bitmap:
        """`factor`, or `factor` times a channel of a texture."""
        return _times(factor, self.read(info, channel))

    def color(self, info: TextureInfo | None, factor: list[float]) -> Color | Bitmap:
        """`factor` (3,), or `factor` times a texture."""
        texture = self.read(info, slice(0, 3), srgb=True)
        if texture is None:
            r, g, b = factor
            return Color((r, g, b))
        return replace(texture, pixels=np.array(factor, np.float32) * texture.pixels)

    def base(self) -> tuple[Any, Any]:
        """The base colour and the opacity."""
        color, opacity = self.plain_base()
        if not self.colored:
            return color, opacity
        of_vertices = replace(VERTEX_COLOR, factor=color)
        if self.table.alphaMode == "OPAQUE":
            return of_vertices, 1.0
        return of_vertices, replace(VERTEX_COLOR, factor=opacity)

    def plain_base(self) -> tuple[Any, Any]:
        """The base colour and the opacity without those of vertices."""
        surface = self.table.pbrMetallicRoughness
        *factor, alpha = surface.baseColorFactor
        color = self.color(surface.baseColorTexture, factor)
        if self.table.alphaMode == "OPAQUE":
            return color, 1.0
        if isinstance(self.table, MtlMaterial):
            texture = self.textures.read_opacity(self.table.opacityTexture)
            return color, _times(alpha, texture)
        return color, self.number(surface.baseColorTexture, alpha, 3)

    def normals(self, info: TextureInfo | None) -> Bitmap | None:
        """A normal map, scaled and of unit length. glTF's green axis points to the top of the picture."""
        texture = self.read(info, slice(0, 3))
        if info is None or texture is None:
            return None
        scale = np.array([info.scale, info.scale, 1], dtype=np.float32)
        normals = (2 * texture.pixels - 1) * scale
        length = np.linalg.norm(normals, axis=-1, keepdims=True)
        normals /= np.maximum(length, 1e-6)
        pixels = np.asarray((normals + 1) / 2, dtype=np.float32)
        return replace(texture, pixels=pixels)

    def emission(self) -> Color | Bitmap | None:
        strength = self.table.extensions.KHR_materials_emissive_strength
        color = np.array(self.table.emissiveFactor, dtype=np.float32)
        factor = np.float32(strength.emissiveStrength) * color
        if not factor.any():
            return None
        return self.color(self.table.emissiveTexture, factor.astype(float).tolist())


def _times(factor: float, texture: Bitmap | None) -> float | Bitmap:
    """`factor`, times a texture if there is one."""
    if texture is None:
        return factor
    return replace(texture, pixels=np.float32(factor) * texture.pixels)


def _limits(material: Material, table: PbrMaterial) -> list[str]:
    """What `twinlens.rendering.materials` does not show of a material."""
    base = material.base_color
    mixed = (
        base.factor if isinstance(base, VertexColor) else base,
        material.metallic,
        material.coat,
        material.specular,
        material.specular_color,
        material.transmission,
    )
    pictures = [value for value in mixed if isinstance(value, Bitmap)]
    lost = []
    if not all(picture.lies_like(pictures[0]) for picture in pictures):
        lost.append("textures of one material placed in different ways")
    transmission = material.transmission
    passes_light = isinstance(transmission, Bitmap) or transmission > 0
    if not passes_light:
        return lost
    if table.extensions.KHR_materials_volume.attenuationDistance is not None:
        lost.append("the absorption of KHR_materials_volume")
    if not material.thin_walled and isinstance(material.roughness, Bitmap):
        lost.append("the roughness texture of glass")
    if material.thin_walled and table.pbrMetallicRoughness.roughnessFactor > _SMOOTHEST:
        lost.append("the roughness of thin glass")
    return lost
