"""The exact truth of one view as an EXR of named channels, and back.

Depth and position are kept as float32: half a unit in the last place is 6e-8 of the value, 0.1 micrometres at 2 m.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens import optics
from twinlens.camera import Camera, Lens
from twinlens.camera.truth import Truth
from twinlens.dataset.codecs.exr import encode_exr, read_exr
from twinlens.dataset.storage import Where
from twinlens.errors import FileError

VECTORS = ("position", "normal", "shading_normal")
"""Truth's (H, W, 3) arrays: each is three channels, ``<name>.X`` ``<name>.Y`` ``<name>.Z``."""

SCALARS = ("depth", "blur_circle_px", "visible", "object_id", "material_id", "material_kind")
"""The channels of one number a pixel; the last four are unsigned integers."""


def blur_circle_px(depth: NDArray[Any], camera: Camera, lens: Lens) -> NDArray[np.float32]:
    """Signed diameter of the blur circle, pixels, float32 (H, W), of what stands at `depth`: positive before focus."""
    blur = optics.circle_of_confusion_px(depth, lens.aperture_diameter, camera.fx, lens.vergence)
    return blur.astype(np.float32)


def encode_truth(truth: Truth, camera: Camera, lens: Lens) -> bytes:
    """The EXR of a view's truth; `lens` is the one its blur circles are of. See docs/format.md for the channels."""
    channels: dict[str, NDArray[Any]] = {
        "depth": truth.depth,
        "blur_circle_px": blur_circle_px(truth.depth, camera, lens),
        "visible": truth.visible,
        "object_id": truth.object_id,
        "material_id": truth.material_id,
        "material_kind": truth.material_kind,
    }
    for name in VECTORS:
        vector = getattr(truth, name)
        channels |= {f"{name}.{axis}": vector[..., i] for i, axis in enumerate("XYZ")}
    names = {"object_names": truth.object_names, "material_names": truth.material_names}
    return encode_exr(channels, {name: json.dumps(entries) for name, entries in names.items()})


def read_truth(path: Where) -> dict[str, Any]:
    """What a truth EXR holds, under the names of `Truth`: arrays (H, W) and (H, W, 3), and the two tuples of names.

    float32 depth, blur_circle_px, position, normal, shading_normal; bool visible; int32 object_id, material_id; uint8
    material_kind. Raises FileError.
    """
    exr = read_exr(path)
    found = _stacked(exr.channels, str(path))
    kinds: dict[str, type] = {"object_id": np.int32, "material_id": np.int32, "material_kind": np.uint8}
    result: dict[str, Any] = {key: plane.astype(kinds.get(key, plane.dtype)) for key, plane in found.items()}
    result["visible"] = found["visible"] != 0
    for name in ("object_names", "material_names"):
        result[name] = _names(exr.text.get(name, "[]"), str(path))
    return result


def truth_from_arrays(arrays: Mapping[str, Any], disparity: NDArray[np.float32]) -> Truth:
    """The Truth of `read_truth`'s answer and the view's disparity map."""
    fields = {name: arrays[name] for name in (*VECTORS, *SCALARS, "object_names", "material_names")}
    del fields["blur_circle_px"]
    wide = {name: fields[name].astype(np.float64) for name in ("depth", "position")}
    return Truth(**(fields | wide), disparity=disparity)


def _stacked(channels: Mapping[str, NDArray[Any]], path: str) -> dict[str, NDArray[Any]]:
    needed = [*SCALARS, *(f"{name}.{axis}" for name in VECTORS for axis in "XYZ")]
    missing = [name for name in needed if name not in channels]
    if missing:
        raise FileError(f"{path}: has no channel {missing[0]!r}; a truth file holds {', '.join(needed)}")
    vectors = {name: np.stack([channels[f"{name}.{axis}"] for axis in "XYZ"], axis=-1) for name in VECTORS}
    return {name: channels[name] for name in SCALARS} | vectors


def _names(text: str, path: str) -> tuple[str, ...]:
    try:
        names = json.loads(text)
    except (ValueError, RecursionError):
        names = None
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise FileError(f"{path}: its lists of names are damaged")
    return tuple(names)
