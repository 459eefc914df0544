"""The ground truth of a view as an EXR file with named channels.

Depth and position are stored as float32: half a unit in the last place is 6e-8 of the value, 0.1 micrometres at 2 m.
"""

import json
from typing import Any

import numpy as np
import pydantic
from numpy.typing import NDArray

from twinlens import optics
from twinlens.camera import Camera, Lens
from twinlens.camera.truth import Truth
from twinlens.dataset.codecs.exr import encode_exr, read_exr
from twinlens.dataset.storage import Where
from twinlens.errors import FileError

VECTORS = ("position", "normal", "shading_normal")
"""(H, W, 3) arrays of a Truth, each stored as the channels ``<name>.X``, ``<name>.Y`` and ``<name>.Z``."""

SCALARS = (
    "depth",
    "blur_circle_px",
    "visible",
    "object_id",
    "material_id",
    "material_kind",
)
"""(H, W) channels; the last four are unsigned integers."""

PROJECTIONS = ("projector_pixels", "lit")
"""(P, H, W, 2) and (P, H, W) arrays of P projectors; each has the channels ``projector<i>.u``, ``.v`` and ``.lit``."""

_NAMES = ("object_names", "material_names")
_TEXTS = pydantic.TypeAdapter(tuple[str, ...])
_DTYPES: dict[str, Any] = {
    "visible": bool,
    "object_id": np.int32,
    "material_id": np.int32,
    "material_kind": np.uint8,
}


def blur_circle_px(
    depth: NDArray[Any], camera: Camera, lens: Lens
) -> NDArray[np.float32]:
    """Signed diameter of the blur circle at `depth`, pixels, float32 (H, W); positive before the plane of focus."""
    blur = optics.circle_of_confusion_px(
        depth, lens.aperture_diameter, camera.fx, lens.vergence
    )
    return blur.astype(np.float32)


def encode_truth(truth: Truth, camera: Camera, lens: Lens) -> bytes:
    """The EXR file of a view's truth; `lens` determines the blur circles. docs/format.md lists the channels."""
    channels: dict[str, NDArray[Any]] = {
        name: getattr(truth, name) for name in SCALARS if name != "blur_circle_px"
    }
    channels["blur_circle_px"] = blur_circle_px(truth.depth, camera, lens)
    for name in VECTORS:
        channels |= {
            f"{name}.{axis}": getattr(truth, name)[..., i]
            for i, axis in enumerate("XYZ")
        }
    for i, each in enumerate(truth.projections):
        u, v = np.moveaxis(each.pixels.astype(np.float32), -1, 0)
        channels |= {
            f"projector{i}.u": u,
            f"projector{i}.v": v,
            f"projector{i}.lit": each.lit,
        }
    return encode_exr(
        channels, {name: json.dumps(getattr(truth, name)) for name in _NAMES}
    )


def read_truth(path: Where) -> dict[str, Any]:
    """Read a truth file: arrays (H, W) and (H, W, 3) and two tuples of names, named as the fields of `Truth`.

    float32 depth, blur_circle_px, position, normal, shading_normal; bool visible; int32 object_id, material_id; uint8
    material_kind. Of P projectors, float32 projector_pixels (P, H, W, 2) and bool lit (P, H, W). Raises FileError.
    """
    exr = read_exr(path)
    channels = exr.channels
    required = [*SCALARS, *(f"{name}.{axis}" for name in VECTORS for axis in "XYZ")]
    projectors = sorted(
        {name.partition(".")[0] for name in channels if name.startswith("projector")}
    )
    lights = [f"projector{i}" for i in range(len(projectors))]
    required += [f"{name}.{part}" for name in lights for part in ("u", "v", "lit")]
    if missing := [name for name in required if name not in channels]:
        raise FileError(
            f"{path}: has no channel {missing[0]!r}; a truth file has {', '.join(required)}"
        )
    result: dict[str, Any] = {
        name: channels[name].astype(_DTYPES.get(name, channels[name].dtype))
        for name in SCALARS
    }
    result |= {
        name: np.stack([channels[f"{name}.{axis}"] for axis in "XYZ"], axis=-1)
        for name in VECTORS
    }
    empty = np.empty((0, *result["depth"].shape), np.float32)
    positions = [
        np.stack([channels[f"{name}.u"], channels[f"{name}.v"]], axis=-1)
        for name in lights
    ]
    result["projector_pixels"] = (
        np.stack(positions) if lights else np.stack([empty, empty], axis=-1)
    )
    result["lit"] = (
        np.stack([channels[f"{name}.lit"] > 0 for name in lights])
        if lights
        else empty > 0
    )
    try:
        return result | {
            name: _TEXTS.validate_json(exr.text.get(name, "[]"), strict=True)
            for name in _NAMES
        }
    except ValueError:
        raise FileError(
            f"{path}: the names of objects or materials are damaged"
        ) from None
