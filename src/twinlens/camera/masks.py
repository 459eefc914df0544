"""Masks as text, in COCO's compressed run-length code.

The pixels are taken column by column. The lengths of the runs of 0, 1, 0, ... are written, from the fourth on minus the
length two runs before, in groups of five bits, the lowest first. A character is the group plus 48, with bit 5 set if
another one follows. The last group's highest bit is the sign.

Source: pycocotools 2.0, `mask.encode`.
"""

import numpy as np
from numpy.typing import NDArray

from twinlens.errors import InputError

_GROUP, _SIGN, _MORE, _ZERO = 5, 0x10, 0x20, 48
_MOST_BITS = 60  # of a count


def encode_mask(mask: NDArray[np.bool_]) -> str:
    """The code of a mask (H, W), which pycocotools reads as ``{"size": [H, W], "counts": code}``.

    >>> encode_mask(np.eye(3, dtype=bool))
    '013000'
    """
    columns = np.flatnonzero(mask.any(axis=0))
    first, last = (columns[0], columns[-1] + 1) if len(columns) else (0, 0)
    flat = np.concatenate([[False], mask[:, first:last].ravel(order="F"), [False]])
    changes = np.flatnonzero(flat[1:] != flat[:-1]) + first * len(mask)
    counts = np.diff(np.concatenate([[0], changes[changes < mask.size], [mask.size]]))
    counts[3:] -= counts[1:-2].copy()
    text = bytearray()
    for count in counts.tolist():
        more = True
        while more:
            group, count = count & 0x1F, count >> _GROUP
            more = count != (-1 if group & _SIGN else 0)
            text.append((group | _MORE if more else group) + _ZERO)
    return text.decode()


def decode_mask(text: str, height: int, width: int) -> NDArray[np.bool_]:
    """The mask (H, W) of a code. Raises InputError for a code of another size.

    >>> decode_mask("013000", 3, 3).astype(int).tolist()
    [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    """
    counts: list[int] = []
    value = shift = 0
    for character in text.encode("ascii", "replace"):
        group = character - _ZERO
        value |= (group & 0x1F) << shift
        shift += _GROUP
        if not group & _MORE:
            value -= (group & _SIGN) << (shift - _GROUP + 1)
            counts.append(value + (counts[-2] if len(counts) > 2 else 0))
            value = shift = 0
        elif shift > _MOST_BITS:
            break
    if shift or min(counts, default=0) < 0 or sum(counts) != height * width:
        raise InputError(
            f"the run-length code of a mask does not have {width} x {height} pixels"
        )
    runs = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    return runs.reshape((height, width), order="F")
