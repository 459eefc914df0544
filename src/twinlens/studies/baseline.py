"""`baseline`: a wider base measures depth better, and hides more from the other eye.

The law of stereo, z^2/(f B) metres of depth for a pixel of disparity: Gallup, Frahm, Mordohai and Pollefeys, Variable
Baseline/Resolution Stereo, CVPR 2008, equation 3.
"""

from twinlens.studies.bootstrap import log_slope, over_scenes
from twinlens.studies.model import Figure, Finding, Measured, Setup, Study, is_above
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

PLANE_BASELINES = (0.06, 0.12, 0.24)
FACTORS = (0.25, 0.5, 1.0, 1.5)
"""Of the base that a bundled scene was composed for."""
FOV_X_DEG = 50.0


def measure(setup: Setup) -> Measured:
    """Planes at every depth for each base, then every scene with a part or a multiple of its own base."""
    planes = [(base, FOV_X_DEG) for base in PLANE_BASELINES]
    rows = measure_pairs(setup, planes, lambda scene, factor: (factor * scene.baseline, scene.fov_x_deg), FACTORS)
    return Measured(rows, notes={"plane_baselines_m": PLANE_BASELINES, "factors": FACTORS})


def conclude(table: Table) -> list[Finding]:
    """The law of depth error, along z and B; occlusion in proportion to the base."""
    planes = table.where(part=PLANES)
    return [
        *square_law(table, [str(method) for method in table.values("method")]),
        law_residual(table),
        exponent(planes, "baseline_mm", "depth_error_mm", -1.0, TOLERANCE, "Depth error falls as B^p, p = {}"),
        _occlusion(table.where(part=SCENES)),
    ]


def _occlusion(rows: Table) -> Finding:
    """In proportion to B where every edge hides by itself; less where gaps are narrower than what would be hidden."""
    growth = over_scenes(rows, log_slope("baseline_mm", "occluded"))
    text = "What the other eye cannot see grows with the base as B^p, in proportion at most, p = {}"
    return Finding(text, growth, is_above(growth) and growth.value <= 1 + TOLERANCE)


STUDY: Study = Study(
    name="baseline",
    question="If disparity errors do not depend on distance, what depth does a wider base buy, and what does it hide?",
    columns=COLUMNS,
    measure=measure,
    conclude=conclude,
    figures=(
        Figure(
            "depth-error", "Depth error of planes and z²/(f B)", "z_m", "depth_error_mm", by="method",
            panel="baseline_mm", log_x=True, log_y=True, where={"part": PLANES},
            residual_of="predicted_mm", also=("predicted_mm",),
        ),
        Figure(
            "occlusion", "Hidden from the other eye, of the left pixels inside its picture", "baseline_mm", "occluded",
            by="scene", where={"part": SCENES},
        ),
        Figure(
            "wrong", "Wrong pixels against the base", "baseline_mm", "totbad2", by="method", panel="scene",
            where={"part": SCENES},
        ),
    ),
    defaults=Setup(("staircase", "tabletop", "cards"), ("sad", "zncc", "census", "sgm"), (0, 1, 2), spp=16),
)  # fmt: skip
