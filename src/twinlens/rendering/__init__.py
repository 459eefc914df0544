"""Images and exact ground truth of a scene. The only room that imports mitsuba and drjit, and only when it is used."""

from twinlens.rendering.backends import backend, configure_malloc, doctor, forget_kernels, use_threads
from twinlens.rendering.denoising import denoiser_record
from twinlens.rendering.ground_truth import correspondence, ground_truth
from twinlens.rendering.lens_grid import LensGrid, render_lens_grid
from twinlens.rendering.noise import MAX_SPP, NoisyImage, render_measured
from twinlens.rendering.radiance import SAMPLERS, Progress, partial_progress, render
from twinlens.rendering.sensors import check_lens_supported
from twinlens.rendering.shared_kernels import share_kernels

__all__ = [
    "MAX_SPP",
    "SAMPLERS",
    "LensGrid",
    "NoisyImage",
    "Progress",
    "backend",
    "check_lens_supported",
    "configure_malloc",
    "correspondence",
    "denoiser_record",
    "doctor",
    "forget_kernels",
    "ground_truth",
    "partial_progress",
    "render",
    "render_lens_grid",
    "render_measured",
    "share_kernels",
    "use_threads",
]
