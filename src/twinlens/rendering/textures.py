"""Textures that Mitsuba lacks: a mix by colours of vertices, and pictures wrapped differently along u and v.

They are plugins by the names `vertex_mix` and `wrapped`, for trees that `rendering.build` loads. Importing this module
sets up the backend.
"""

import functools
from typing import Any

from twinlens.rendering.backends import mitsuba

mi = mitsuba()
import drjit as dr  # noqa: E402, Dr.Jit reads DRJIT_LIBLLVM_PATH when it is imported


class VertexMix(mi.Texture):  # type: ignore[misc, name-defined]
    """low + share (high - low), each a texture: linear in a `share` that the vertices of a mesh have.

    Colours of vertices times a texture are the mix of black and the texture.
    """

    def __init__(self, properties: Any) -> None:
        super().__init__(properties)
        self._low, self._high, self._share = (
            properties.get_unbounded_texture(key) for key in ("low", "high", "share")
        )

    def eval(self, si: Any, active: Any = True) -> Any:
        return self._mixed("eval", si, active)

    def eval_1(self, si: Any, active: Any = True) -> Any:
        return self._mixed("eval_1", si, active)

    def eval_3(self, si: Any, active: Any = True) -> Any:
        return self._mixed("eval_3", si, active)

    def _mixed(self, method: str, si: Any, active: Any) -> Any:
        low, high, share = (
            getattr(texture, method)(si, active)
            for texture in (self._low, self._high, self._share)
        )
        return low + share * (high - low)

    def mean(self) -> Any:
        return 0.5 * (self._low.mean() + self._high.mean())

    def to_string(self) -> str:
        return f"VertexMix[{self._low}, {self._high}, {self._share}]"


class Wrapped(mi.Texture):  # type: ignore[misc, name-defined]
    """A picture that is repeated, mirrored or clamped along u, and otherwise along v.

    texture : repeats, and covers [0, 1]^2. Coordinates that do not repeat are moved to its texels: within half a texel
        of an edge a clamped or mirrored picture is as its last texel.
    It counts as uniform in Mitsuba: then a lamp with it is sampled by its area, which any coordinates allow.
    u_row, v_row : of the matrix from the (u, v, 1) of a surface to those of the picture.
    """

    def __init__(self, properties: Any) -> None:
        super().__init__(properties)
        self._texture = properties.get_texture("texture")
        self._rows = properties["u_row"], properties["v_row"]
        self._wraps = properties["wrap_u"], properties["wrap_v"]

    def eval(self, si: Any, active: Any = True) -> Any:
        return self._texture.eval(self._inside(si), active)

    def eval_1(self, si: Any, active: Any = True) -> Any:
        return self._texture.eval_1(self._inside(si), active)

    def eval_3(self, si: Any, active: Any = True) -> Any:
        return self._texture.eval_3(self._inside(si), active)

    def _inside(self, si: Any) -> Any:
        """The interactions with coordinates inside the picture, for axes that do not repeat."""
        u, v = si.uv
        uv = [row[0] * u + row[1] * v + row[2] for row in self._rows]
        sizes = self._texture.resolution()
        inside = [
            _inside(coordinate, wrap, size)
            for coordinate, wrap, size in zip(uv, self._wraps, sizes, strict=True)
        ]
        moved = mi.SurfaceInteraction3f(si)
        moved.uv = mi.Point2f(*inside)
        return moved

    def mean(self) -> Any:
        return self._texture.mean()

    def to_string(self) -> str:
        return f"Wrapped[{self._wraps}, {self._texture}]"


def _inside(coordinate: Any, wrap: str, size: int) -> Any:
    """A texture coordinate that a picture of `size` texels may be read at in place of one outside."""
    if wrap == "repeat":
        return coordinate
    if wrap == "mirror":
        # Periods of 2, of which the second half runs backwards.
        phase = coordinate - 2 * dr.floor(coordinate / 2)
        coordinate = dr.minimum(phase, 2 - phase)
    edge = 0.5 / size
    return dr.clip(coordinate, edge, 1 - edge)


@functools.cache
def register_textures() -> None:
    """Let Mitsuba load these textures by their names."""
    mi.register_texture("vertex_mix", VertexMix)
    mi.register_texture("wrapped", Wrapped)
