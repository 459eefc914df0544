"""`focal-length`: a longer lens sees less and measures it better: z^2/(f B) again, along f."""

from twinlens.studies.model import Figure, Finding, Measured, Setup, Study
from twinlens.studies.range_error import (
    COLUMNS,
    PLANES,
    SCENES,
    TOLERANCE,
    exponent,
    law_residual,
    measure_pairs,
    square_law,
)
from twinlens.studies.table import Table

PLANE_FIELDS = (80.0, 50.0, 28.0)
"""Horizontal fields of view, degrees."""
FACTORS = (1.0, 0.8, 0.6, 0.4)
"""Of the field of view that a bundled scene was composed for."""
BASELINE = 0.12


def measure(setup: Setup) -> Measured:
    """Planes at every depth for each focal length, then every scene with narrower and narrower views."""
    planes = [(BASELINE, fov_x_deg) for fov_x_deg in PLANE_FIELDS]
    rows = measure_pairs(setup, planes, lambda scene, factor: (scene.baseline, factor * scene.fov_x_deg), FACTORS)
    return Measured(rows, notes={"plane_fields_deg": PLANE_FIELDS, "factors": FACTORS, "baseline_m": BASELINE})


def conclude(table: Table) -> list[Finding]:
    """The law of depth error, along z and f."""
    planes = table.where(part=PLANES)
    return [
        *square_law(table, [str(method) for method in table.values("method")]),
        law_residual(table),
        exponent(planes, "fx_px", "depth_error_mm", -1.0, TOLERANCE, "Depth error falls as f^p, p = {}"),
    ]


STUDY: Study = Study(
    name="focal-length",
    question="If disparity errors do not depend on distance, what depth does a longer focal length buy?",
    columns=COLUMNS,
    measure=measure,
    conclude=conclude,
    figures=(
        Figure(
            "depth-error", "Depth error of planes and z²/(f B)", "z_m", "depth_error_mm", by="method", panel="fx_px",
            log_x=True, log_y=True, where={"part": PLANES}, residual_of="predicted_mm", also=("predicted_mm",),
        ),
        Figure(
            "wrong", "Wrong pixels against the focal length", "fx_px", "totbad2", by="method", panel="scene",
            where={"part": SCENES},
        ),
    ),
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1, 2), spp=16),
)  # fmt: skip
