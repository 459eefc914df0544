"""Lenses in a few words: as the maker of a sample wrote them, or else by aperture and focus distance."""

from collections.abc import Mapping, Sequence
from typing import Any

from twinlens.camera import RecipeLens

LABEL = "label"
"""Key of the record of a shot: the lens as its maker wrote it."""
_LONGEST = 100


def label_of_table(table: Mapping[str, Any]) -> str:
    """A lens of a recipe in the syntax of `twinlens render --lens` where there is one, with the shape of its opening.

    >>> label_of_table({"kind": "thin", "f_number": 1.4})
    'f/1.4'
    >>> label_of_table({"kind": "thin", "aperture_mm": 12, "focus": "near", "shape": {"kind": "polygon", "blades": 6}})
    'thin:12@near polygon:6'
    >>> label_of_table({"kind": "fisheye", "bend": 0.5})
    'fisheye:bend=0.5'
    """
    values = {key: _text(value) for key, value in table.items() if _is_scalar(value)}
    kind = values.pop("kind", "pinhole")
    shape = table.get("shape", table.get("aperture"))
    opening = f" {_shape(shape)}" if isinstance(shape, Mapping) else ""
    focus = f"@{values['focus']}" if "focus" in values else ""
    if kind == "thin" and "f_number" in values:
        return f"f/{values['f_number']}{focus}{opening}"
    if kind == "thin" and "aperture_mm" in values:
        return f"thin:{values['aperture_mm']}{focus}{opening}"
    if kind == "hole" and {"aperture_mm", "film_mm"} <= values.keys():
        return f"hole:{values['aperture_mm']}@{values['film_mm']}{opening}"
    fields = ",".join(f"{key}={value}" for key, value in values.items())
    return f"{kind}:{fields}{opening}" if fields else f"{kind}{opening}"


def _is_scalar(value: Any) -> bool:
    return isinstance(value, (str, int, float))


def _text(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _shape(shape: Mapping[str, Any]) -> str:
    """The shape of an opening, such as polygon:6 and mask:codes/mura.png."""
    parts = [_text(value) for value in shape.values() if _is_scalar(value)]
    return ":".join(parts)


def label_of_lens(lens: RecipeLens) -> str:
    """A lens by its aperture and focus distance."""
    diameter = lens.aperture_diameter
    focus = getattr(lens, "focus_distance", None)
    if not diameter:
        return "pinhole"
    if focus is None:
        return f"hole {1e3 * diameter:.3g} mm"
    return f"lens {1e3 * diameter:.3g} mm at {focus:.3g} m"


def written_label(record: Mapping[str, Any], lens: int) -> str:
    """How the maker of a sample wrote lens number `lens`, from sample.json; empty where that is not recorded."""
    taken = _at(record.get("shots"), lens).get("record")
    label = taken.get(LABEL) if isinstance(taken, Mapping) else None
    if label is None:
        table: Any = record
        for key in ("record", "spec", "drawn"):
            table = table.get(key) if isinstance(table, Mapping) else None
        tables = table.get("lenses") if isinstance(table, Mapping) else None
        entry = _at(tables, lens)
        label = label_of_table(entry) if entry else None
    is_usable = isinstance(label, str) and label.isprintable()
    return label[:_LONGEST] if is_usable and label is not None else ""


def _at(tables: Any, index: int) -> Mapping[str, Any]:
    """Entry number `index` of a list of tables; empty where there is none."""
    has_entry = isinstance(tables, Sequence) and index < len(tables)
    entry = tables[index] if has_entry else None
    return entry if isinstance(entry, Mapping) else {}
