"""Formulas of lenses and light, as functions of numbers and arrays: `thin_lens` (exported here) and `diffraction`."""

from twinlens.optics.thin_lens import (
    AIRY_FIRST_ZERO,
    LONGEST,
    SHORTEST,
    check_diameter,
    check_focus,
    check_length,
    circle_of_confusion_px,
    depth_of_field,
    focal_length,
    hyperfocal_distance,
    in_focus,
    middle_focus,
    vergence,
)

__all__ = [
    "AIRY_FIRST_ZERO",
    "LONGEST",
    "SHORTEST",
    "check_diameter",
    "check_focus",
    "check_length",
    "circle_of_confusion_px",
    "depth_of_field",
    "focal_length",
    "hyperfocal_distance",
    "in_focus",
    "middle_focus",
    "vergence",
]
