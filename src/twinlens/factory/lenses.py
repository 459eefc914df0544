"""A lens as a table of a recipe, and the distance it is focused at.

kind = "thin"                      # pinhole | thin | hole
aperture_mm = 8                    # or f_number = 4
focus = "middle"                   # metres, inf, or one of FOCUSES
shape = { kind = "polygon", blades = 6, rotation_deg = 15, roundness = 0.3 }   # disk | polygon | annulus | mask
film_mm = 50                       # of a bare hole
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator

from twinlens.camera import Annulus, Camera, Disk, Lens, MaskAperture, Pinhole, Polygon, ThinLens
from twinlens.camera.aperture import Aperture
from twinlens.camera.lens import BareAperture
from twinlens.camera.truth import Truth
from twinlens.dataset import read_image
from twinlens.errors import FileError, InputError, format_value
from twinlens.optics import middle_focus
from twinlens.scenes.scene import Scene
from twinlens.schema import Fraction, NonNegative, Number, Positive, StrictModel
from twinlens.seeds import generator

_LEAST_SEEN = 0.005  # of the image: an object that is large enough to focus on

Rows = Annotated[
    list[Annotated[list[Fraction], Field(min_length=1, max_length=4096)]], Field(min_length=1, max_length=4096)
]
Find = Callable[[str], Path]
"""The path of a file that a lens names."""


@dataclass(frozen=True)
class View:
    """What a lens is made for: the camera behind it, the scene in front, and a seed for choosing what to focus on."""

    scene: Scene
    camera: Camera
    truths: Sequence[Truth]
    seed: int = 0


class DiskTable(StrictModel):
    """A disk."""

    kind: Literal["disk"] = "disk"

    def aperture(self, find: Find) -> Aperture:
        return Disk()


class PolygonTable(StrictModel):
    """The opening of a diaphragm."""

    kind: Literal["polygon"]
    blades: int = Field(ge=3, le=1000)
    rotation_deg: Number = 0.0
    roundness: Fraction = 0.0

    def aperture(self, find: Find) -> Aperture:
        return Polygon(self.blades, self.rotation_deg, self.roundness)


class AnnulusTable(StrictModel):
    """A ring."""

    kind: Literal["annulus"]
    inner: Fraction

    def aperture(self, find: Find) -> Aperture:
        return Annulus(self.inner)


class MaskTable(StrictModel):
    """A grey picture, or its numbers: rows from the top, 0 closed, 1 open."""

    kind: Literal["mask"]
    file: str | None = None
    cells: Rows | None = None

    @model_validator(mode="after")
    def _check(self) -> "MaskTable":
        if (self.file is None) == (self.cells is None):
            raise InputError("a mask needs exactly one of 'file' (a grey image) and 'cells' (rows of numbers, 0 to 1)")
        if self.file is not None and not (self.file and self.file.isprintable()):
            raise InputError(f"file must be the name of a picture next to the recipe, got {format_value(self.file)}")
        return self

    def aperture(self, find: Find) -> Aperture:
        return MaskAperture(self.cells or []) if self.file is None else read_mask(find(self.file))


ShapeTable = Annotated[DiskTable | PolygonTable | AnnulusTable | MaskTable, Field(discriminator="kind")]
Focus = Annotated[float, Field(gt=0, allow_inf_nan=True)] | Literal["near", "middle", "far", "centre", "object"]


class PinholeTable(StrictModel):
    """A pinhole."""

    kind: Literal["pinhole"] = "pinhole"

    def lens(self, view: View | None, find: Find = Path) -> Lens:
        return Pinhole()


class ThinTable(StrictModel):
    """A thin lens by its aperture or its f-number."""

    kind: Literal["thin"]
    aperture_mm: NonNegative | None = None
    f_number: Positive | None = None
    focus: Focus = "middle"
    shape: ShapeTable = DiskTable()

    @model_validator(mode="after")
    def _check(self) -> "ThinTable":
        if (self.aperture_mm is None) == (self.f_number is None):
            raise InputError("a thin lens needs exactly one of 'aperture_mm' and 'f_number'")
        return self

    def lens(self, view: View | None, find: Find = Path) -> Lens:
        """The lens. Without a view, a focus that depends on the scene is 1 m: enough to check the table."""
        focus, film = self.focus, view.camera.film_distance if view else 1e-3
        if isinstance(focus, str):
            focus = FOCUSES[focus](view) if view else 1.0
            if view and not 0 < focus < math.inf:
                raise InputError(
                    f"focus {self.focus!r} finds nothing to focus on in scene {view.scene.name!r}; give metres instead"
                )
        shape = self.shape.aperture(find)
        if self.f_number is not None:
            return ThinLens.from_f_number(self.f_number, focus, film, shape)
        return ThinLens(1e-3 * (self.aperture_mm or 0.0), focus, shape)


class HoleTable(StrictModel):
    """A bare hole, without a lens."""

    kind: Literal["hole"]
    aperture_mm: NonNegative
    film_mm: Positive
    shape: ShapeTable = DiskTable()

    def lens(self, view: View | None, find: Find = Path) -> Lens:
        return BareAperture(1e-3 * self.aperture_mm, 1e-3 * self.film_mm, self.shape.aperture(find))


LensTable = Annotated[PinholeTable | ThinTable | HoleTable, Field(discriminator="kind")]


def read_mask(path: Path) -> MaskAperture:
    """The aperture that a grey picture shows: white is open, black is closed, row 0 the top. Raises FileError."""
    mask = read_image(path)
    if mask.ndim == 3:
        if not (mask == mask[..., :1]).all():
            raise FileError(f"{path}: is coloured; an aperture mask is a grey picture, white where light passes")
        mask = mask[..., 0]
    try:
        return MaskAperture(np.ascontiguousarray(mask))
    except InputError as error:
        raise FileError(f"{path}: {error}") from error


def _known_range(view: View) -> tuple[float, float]:
    """The scene's depth range, or that of the first view."""
    if view.scene.depth_range_known:
        return view.scene.depth_range
    depth = view.truths[0].depth[view.truths[0].hit]
    return (float(depth.min()), float(depth.max())) if depth.size else (math.inf, math.inf)


def _object(view: View) -> float:
    """The median depth of a random object that covers enough of the first view."""
    truth = view.truths[0]
    pixels = np.bincount(truth.object_id.ravel(), minlength=2)
    pixels[0] = 0
    seen = np.flatnonzero(pixels >= _LEAST_SEEN * truth.object_id.size)
    if not seen.size:
        return math.inf
    chosen = seen[generator(view.seed, "focus").integers(seen.size)]
    return float(np.median(truth.depth[truth.object_id == chosen]))


FOCUSES: dict[str, Callable[[View], float]] = {
    "near": lambda view: _known_range(view)[0],
    "middle": lambda view: middle_focus(*_known_range(view)),
    "far": lambda view: _known_range(view)[1],
    "centre": lambda view: float(view.truths[0].depth[tuple(side // 2 for side in view.truths[0].depth.shape)]),
    "object": _object,
}
"""Focus distances by name: of the scene's depth range, of the first view's central pixel, or of some object in it."""
