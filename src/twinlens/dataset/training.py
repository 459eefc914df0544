"""Samples for training: crops and flips that keep the ground truth exact, and batches.

A sample is a dict of the quantities of docs/loading.md, or a `StoredSample`. Functions return new dicts, whose arrays
are contiguous copies: torch rejects negative strides, and a view would keep the whole image in memory.
"""

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.channels import CHANNELS
from twinlens.dataset.stored import Quantity, parse_quantity
from twinlens.dataset.visibility import HIDDEN, VISIBLE
from twinlens.errors import InputError, check_int, format_value

_OF_THE_PAIR = ("name", "baseline", "doffs", "ndisp")
_MIRROR = np.diag([-1.0, 1.0, 1.0, 1.0])


def crop(
    sample: Mapping[str, Any], x: int, y: int, width: int, height: int
) -> dict[str, Any]:
    """A window of both views of a sample; pixel (x, y) becomes (0, 0).

    Disparity, doffs, depth and poses do not change. The principal points of K0 and K1 move by (-x, -y), and pixels
    whose match is outside the window are occluded in mask0_nonocc and not visible in visible0, for which disp0 is
    needed; likewise of view 1. Raises InputError for numbers that are not whole, if the window leaves the image, for
    views other than 0 and 1, for an unknown quantity, and where a disparity is missing.
    """
    for side, number in (("x", x), ("y", y), ("width", width), ("height", height)):
        check_int(side, number)
    cropped = {}
    for name, value in _items(sample).items():
        quantity = _of_pair(name).kind
        if quantity == "K":
            cropped[name] = value - [[0, 0, x], [0, 0, y], [0, 0, 0]]
        elif quantity not in CHANNELS:
            cropped[name] = value
        else:
            axis = _row_axis(quantity)
            rows, columns = value.shape[axis : axis + 2]
            is_inside = min(x, y) >= 0 and x + width <= columns and y + height <= rows
            if min(width, height) < 1 or not is_inside:
                window = f"{width} x {height} pixels at ({x}, {y})"
                raise InputError(
                    f"a crop of {window} is not inside {name} of {columns} x {rows} pixels"
                )
            window_of = (slice(None),) * axis
            window_of += (slice(y, y + height), slice(x, x + width))
            cropped[name] = value[window_of].copy()
    for view in (0, 1):
        _hide_unmatched(cropped, view)
    return cropped


def stereo_flip(sample: Mapping[str, Any]) -> dict[str, Any]:
    """The sample of the mirrored scene: both views are mirrored left to right and exchanged.

    disp0 is the mirrored disp1, so all quantities of a view must be present for views 0 and 1. Disparities stay
    positive; doffs and baseline do not change. Of view 0, K has cx = W - 1 - cx1, with the width W of the view. The
    world is mirrored at its plane x = 0, so that poses stay rotations: x changes its sign in positions and normals.
    Raises InputError if a quantity of the other view is missing, or one of another view or unknown is present, and for
    projector_pixels, whose mirror image needs the width of the pattern.
    """
    flipped = {}
    sample = _items(sample)
    for name, value in sample.items():
        parsed = _of_pair(name)
        quantity, view = parsed.kind, parsed.view
        if quantity in _OF_THE_PAIR:
            flipped[name] = value
            continue
        partner = _of_view(name, view, 1 - view)
        if partner not in sample:
            raise InputError(
                f"a flip of {name} needs {partner} too, which becomes {name}; select both"
            )
        flipped[name] = _mirrored(sample, partner, quantity, 1 - view)
    return flipped


def collate(samples: Iterable[Mapping[str, Any]]) -> dict[str, Any]:
    """Samples as one batch: a dict of arrays with the samples along the first axis.

    Arrays and numbers are stacked and keep their dtype, other values become lists. It needs no torch; as the
    `collate_fn` of a DataLoader, ``torch.utils.data.default_convert(collate(samples))`` makes tensors of the arrays.
    Raises InputError if there is no sample, or if samples differ in their quantities, shapes or dtypes.

    >>> batch = collate([{"name": "a", "disp0": np.float32([[1, 2]])}, {"name": "b", "disp0": np.float32([[3, 4]])}])
    >>> batch["name"], batch["disp0"].shape, batch["disp0"].dtype
    (['a', 'b'], (2, 1, 2), dtype('float32'))
    """
    if isinstance(samples, (Mapping, str)) or not isinstance(samples, Iterable):
        raise InputError(
            f"a batch is made of a list of samples, got {format_value(samples)}"
        )
    rows = [_items(sample) for sample in samples]
    if not rows:
        raise InputError("a batch needs one sample or more")
    for i, row in enumerate(rows):
        if different := rows[0].keys() ^ row.keys():
            raise InputError(
                f"samples 0 and {i} of a batch differ: only one has {', '.join(sorted(different))}"
            )
    names = [
        repr(row["name"]) if "name" in row else str(i) for i, row in enumerate(rows)
    ]
    batch = {}
    for quantity in rows[0]:
        values = [row[quantity] for row in rows]
        batch[quantity] = _stacked(quantity, values, names)
    return batch


def _items(sample: Any) -> dict[str, Any]:
    """The quantities of a sample. Raises InputError for what is no sample."""
    if not isinstance(sample, Mapping):
        raise InputError(
            f"a sample is a dict of quantities, as Dataset.select gives, got {format_value(sample)}"
        )
    return dict(sample)


def _stacked(
    name: str, values: list[Any], samples: list[str]
) -> NDArray[Any] | list[Any]:
    if not all(
        isinstance(value, (np.ndarray, np.generic, int, float)) for value in values
    ):
        return values
    arrays = [np.asarray(value) for value in values]
    first = arrays[0]
    for array, sample in zip(arrays, samples, strict=True):
        if (array.shape, array.dtype) != (first.shape, first.dtype):
            raise InputError(
                f"{name} is {first.dtype} {first.shape} in sample {samples[0]} and {array.dtype} {array.shape} in "
                f"sample {sample} of one batch; crop or convert them"
            )
    return np.stack(arrays)


def _row_axis(quantity: str) -> int:
    """The axis of the rows of an array; arrays of projectors have another one before it."""
    return 1 if CHANNELS[quantity].per_projector else 0


def _of_pair(name: str) -> Quantity:
    """The quantity of that name, which must be of one of the two views of a pair. Raises InputError."""
    quantity = parse_quantity(name)
    if quantity.view > 1:
        raise InputError(f"a crop or flip is of a pair, views 0 and 1, not of {name}")
    return quantity


def _of_view(name: str, view: int, partner: int) -> str:
    """The name of a quantity of another view: im0 for im1, mask0_nonocc for mask1_nonocc."""
    head, _, tail = name.rpartition(str(view))
    return f"{head}{partner}{tail}"


def _hide_unmatched(sample: dict[str, Any], view: int) -> None:
    """Mark the pixels of a view whose match is outside the partner image, as `Camera.contains` defines it."""
    disparity_name, mask_name, visible_name = (
        CHANNELS[name].quantity(view) for name in ("disp", "mask_nonocc", "visible")
    )
    masks = [name for name in (mask_name, visible_name) if name in sample]
    if not masks:
        return
    if disparity_name not in sample:
        raise InputError(
            f"a crop of {masks[0]} needs {disparity_name}, since pixels lose their match; select it too"
        )
    disparity = sample[disparity_name]
    width = disparity.shape[1]
    match = np.arange(width) + (disparity if view else -disparity)
    outside = ~((match >= -0.5) & (match < width - 0.5))
    if mask_name in sample:
        mask = sample[mask_name]
        mask[outside & (mask == VISIBLE)] = HIDDEN
    if visible_name in sample:
        sample[visible_name][outside] = False


def _mirrored(
    sample: Mapping[str, Any], name: str, quantity: str, view: int
) -> NDArray[Any]:
    value = sample[name]
    if quantity == "world_from_cam":
        return np.asarray(_MIRROR @ value @ _MIRROR)
    if quantity == "K":
        mirrored = value.copy()
        mirrored[0, 2] = _width(sample, view) - 1 - value[0, 2]
        return np.asarray(mirrored)
    if quantity == "projector_pixels":
        raise InputError(
            f"a flip cannot mirror {name}, which needs the width of the pattern; leave it out"
        )
    image = np.flip(value, _row_axis(quantity) + 1).copy()
    if CHANNELS[quantity].is_vector:
        x = image[..., 0]
        np.negative(x, out=x, where=np.isfinite(x))  # unknown positions stay +inf
    return np.asarray(image)


def _width(sample: Mapping[str, Any], view: int) -> int:
    """Width of a view in pixels, from any of its images."""
    for name, value in sample.items():
        quantity = parse_quantity(name)
        if quantity.view == view and quantity.channel is not None:
            return int(value.shape[_row_axis(quantity.kind) + 1])
    raise InputError(
        f"a flip of K{view} needs the width of its view; select im{view} too"
    )
