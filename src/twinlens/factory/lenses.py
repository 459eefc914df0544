"""A lens as a table of a recipe, and where it focuses.

kind = "thin"                      # pinhole | thin | hole
aperture_mm = 8                    # or f_number = 4
focus = "middle"                   # metres, inf, or one of FOCUSES
shape = { kind = "polygon", blades = 6, rotation_deg = 15, roundness = 0.3 }   # one of SHAPES
film_mm = 50                       # of a bare hole
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from twinlens.camera import Annulus, Camera, Disk, Lens, MaskAperture, Pinhole, Polygon, ThinLens
from twinlens.camera.aperture import Aperture
from twinlens.camera.lens import BareAperture
from twinlens.camera.truth import Truth
from twinlens.errors import FileError, InputError
from twinlens.factory.draws import stream
from twinlens.factory.masks import read_mask
from twinlens.optics import middle_focus
from twinlens.scenes.scene import Scene
from twinlens.scenes.table import At, Parser, Table, choice, listed, number, show, text, whole

_LARGEST_ROW = 4096
_LEAST_SEEN = 0.005  # of the image: an object that is worth a focus


@dataclass(frozen=True)
class View:
    """What a lens is made for: the camera behind it, the scene before it, and a seed for what it picks to focus on."""

    scene: Scene
    camera: Camera
    truths: Sequence[Truth]
    seed: int = 0


Find = Callable[[str], Path]
"""The path of a file that a lens names."""


def lens_from_table(table: Mapping[str, Any], view: View | None, at: At, find: Find = Path) -> Lens:
    """The lens that `table` describes. Raises InputError naming the key that is unknown, missing or wrong.

    Without a `view` the table is merely checked: a focus that depends on the scene is taken as 1 m. Masks are read from
    where `find` says, and noted among the source's assets; FileError for one that cannot be read.
    """
    keys: Table[Any] = Table(at, table)
    kind = keys.take("kind", choice(*_KINDS))
    try:
        lens = _KINDS[kind](keys, view, partial(_shape, find=find))
    except FileError:
        raise
    except InputError as error:
        raise error if str(error).startswith(str(at.source.file)) else at.wrong(str(error)) from error
    keys.done()
    return lens


def _pinhole(keys: Table[Any], view: View | None, shaped: Parser[Aperture]) -> Lens:
    return Pinhole()


def _thin(keys: Table[Any], view: View | None, shaped: Parser[Aperture]) -> Lens:
    by_number = keys.has("f_number")
    if by_number == keys.has("aperture_mm"):
        raise keys.at.wrong("a thin lens needs either 'aperture_mm' or 'f_number'")
    size = keys.take("f_number" if by_number else "aperture_mm", number(above=0.0) if by_number else number(0.0))
    focus = _distance(keys.take("focus", _focus, "middle"), view, keys.at / "focus")
    shape = keys.take("shape", shaped, Disk())
    if not by_number:
        return ThinLens(1e-3 * size, focus, shape)
    return ThinLens.from_f_number(size, focus, view.camera.film_distance if view else 1e-3, shape)


def _hole(keys: Table[Any], view: View | None, shaped: Parser[Aperture]) -> Lens:
    diameter, film = keys.take("aperture_mm", number(0.0)), keys.take("film_mm", number(above=0.0))
    return BareAperture(1e-3 * diameter, 1e-3 * film, keys.take("shape", shaped, Disk()))


_KINDS: dict[str, Callable[[Table[Any], View | None, Parser[Aperture]], Lens]] = {
    "pinhole": _pinhole,
    "thin": _thin,
    "hole": _hole,
}


def _focus(at: At, value: Any) -> float | str:
    if isinstance(value, str):
        return choice(*FOCUSES)(at, value)
    if isinstance(value, float) and value == math.inf:
        return value
    return number(above=0.0)(at, value)


def _distance(focus: float | str, view: View | None, at: At) -> float:
    if not isinstance(focus, str):
        return focus
    if view is None:
        return 1.0
    distance = FOCUSES[focus](view)
    if not distance > 0 or not math.isfinite(distance):
        raise at.wrong(f"{show(focus)} finds nothing to focus on in scene {view.scene.name!r}; say metres")
    return distance


def _known_range(view: View) -> tuple[float, float]:
    """The depths that the scene says, or else those that its first view shows."""
    if view.scene.depth_range_known:
        return view.scene.depth_range
    depth = view.truths[0].depth[view.truths[0].hit]
    return (float(depth.min()), float(depth.max())) if depth.size else (math.inf, math.inf)


def _middle(view: View) -> float:
    """The middle of the disparities: the harmonic mean of nearest and farthest."""
    return middle_focus(*_known_range(view))


def _centre(view: View) -> float:
    depth = view.truths[0].depth
    return float(depth[depth.shape[0] // 2, depth.shape[1] // 2])


def _object(view: View) -> float:
    """The median depth of one of the objects that the first view shows well, each as likely as the next."""
    truth = view.truths[0]
    pixels = np.bincount(truth.object_id.ravel(), minlength=2)
    pixels[0] = 0
    seen = np.flatnonzero(pixels >= _LEAST_SEEN * truth.object_id.size)
    if not seen.size:
        return math.inf
    chosen = seen[stream(view.seed, "focus").integers(seen.size)]
    return float(np.median(truth.depth[truth.object_id == chosen]))


FOCUSES: dict[str, Callable[[View], float]] = {
    "near": lambda view: _known_range(view)[0],
    "middle": _middle,
    "far": lambda view: _known_range(view)[1],
    "centre": _centre,
    "object": _object,
}
"""Where a lens may focus, by name: by the scene's depths, on what the first view's centre shows, or on some object."""


def _shape(at: At, value: Any, find: Find) -> Aperture:
    keys: Table[Any] = Table(at, value)
    kind = keys.take("kind", choice(*SHAPES))
    shape = SHAPES[kind](keys, find)
    keys.done()
    return shape


def _polygon(keys: Table[Any], find: Find) -> Aperture:
    blades = keys.take("blades", whole(3, 1000))
    return Polygon(blades, keys.take("rotation_deg", number(), 0.0), keys.take("roundness", number(0.0, 1.0), 0.0))


def _mask(keys: Table[Any], find: Find) -> Aperture:
    """Of a grey picture, or of numbers in the recipe itself: rows from the top, 0 shut, 1 open."""
    if keys.has("file") == keys.has("cells"):
        raise keys.at.wrong("a mask needs either 'file' (a grey picture) or 'cells' (rows of numbers from 0 to 1)")
    if keys.has("cells"):
        rows = listed(listed(number(0.0, 1.0), 1, _LARGEST_ROW), 1, _LARGEST_ROW)
        return MaskAperture(keys.take("cells", rows))
    name = keys.take("file", text)
    if not (name and name.isprintable()):
        raise (keys.at / "file").wrong(f"must be the name of a picture beside the recipe, got {show(name)}")
    keys.at.source.assets.append(Path(name))
    try:
        return read_mask(find(name))
    except FileError as error:
        raise FileError(str((keys.at / "file").wrong(str(error)))) from error


SHAPES: dict[str, Callable[[Table[Any], Find], Aperture]] = {
    "disk": lambda keys, find: Disk(),
    "polygon": _polygon,
    "annulus": lambda keys, find: Annulus(keys.take("inner", number(0.0, 1.0))),
    "mask": _mask,
}
"""Apertures, by the kind of their table."""
