"""The tables of a glTF 2.0 header that describe materials and textures. Source: glTF 2.0, chapter 5, and Khronos's
extensions.
"""

# ruff: noqa: N815 (keys are spelt as in glTF)

import math
from typing import Annotated, Literal

import numpy as np
import pydantic

from twinlens.geometry import Float
from twinlens.schema import Fraction, NonNegative, exactly


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
        other = self.extensions.KHR_texture_transform.texCoord
        return self.texCoord if other is None else other


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


EXTENSIONS = {*_Extensions.model_fields, *_InfoExtensions.model_fields}
"""The extensions that are read."""


class Image(Lenient):
    """Where a picture is: a file or data URI, or a part of a buffer."""

    uri: str | None = None
    bufferView: _Index | None = None


class Sampler(Lenient):
    """How a texture is repeated and filtered."""

    wrapS: int = 10497
    wrapT: int = 10497
    magFilter: int | None = None


class Texture(Lenient):
    """A picture and its sampler."""

    source: _Index | None = None
    sampler: _Index | None = None


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

    @property
    def has_normal_maps(self) -> bool:
        """Whether the surface or its clear coat has a normal map."""
        return (
            self.normalTexture
            or self.extensions.KHR_materials_clearcoat.clearcoatNormalTexture
        ) is not None
