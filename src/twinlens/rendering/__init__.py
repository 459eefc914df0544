"""Photographs and exact truth of a scene. The only room that imports mitsuba and drjit, and only when it is used."""

from twinlens.rendering.backends import Backend, backend, doctor, forget_kernels, steady_memory, use_threads
from twinlens.rendering.builtin import check_possible
from twinlens.rendering.ground_truth import correspondence, ground_truth
from twinlens.rendering.lens_grid import LensGrid, render_lens_grid
from twinlens.rendering.radiance import SAMPLERS, render

__all__ = [
    "SAMPLERS",
    "Backend",
    "LensGrid",
    "backend",
    "check_possible",
    "correspondence",
    "doctor",
    "forget_kernels",
    "ground_truth",
    "render",
    "render_lens_grid",
    "steady_memory",
    "use_threads",
]
