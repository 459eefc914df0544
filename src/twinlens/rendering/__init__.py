"""Images and exact ground truth of a scene. The only room that imports mitsuba and drjit, and only when it is used."""

from twinlens.rendering.backends import (
    backend as backend,
    doctor as doctor,
    forget_kernels as forget_kernels,
    use_threads as use_threads,
)
from twinlens.rendering.denoising import denoiser_record as denoiser_record
from twinlens.rendering.ground_truth import (
    correspondence as correspondence,
    ground_truth as ground_truth,
    projection as projection,
)
from twinlens.rendering.images import MAX_SPP as MAX_SPP, NoisyImage as NoisyImage
from twinlens.rendering.lens_grid import (
    LensGrid as LensGrid,
    focal_stack as focal_stack,
    render_lens_grid as render_lens_grid,
)
from twinlens.rendering.light_field import render_light_field as render_light_field
from twinlens.rendering.object_truth import object_models as object_models
from twinlens.rendering.projectors import ProjectorWarning as ProjectorWarning
from twinlens.rendering.radiance import (
    render as render,
    render_measured as render_measured,
)
from twinlens.rendering.requests import (
    Progress as Progress,
    check_lit as check_lit,
    check_memory as check_memory,
    check_still as check_still,
    partial_progress as partial_progress,
)
from twinlens.rendering.samplers import (
    SAMPLERS as SAMPLERS,
    Sampler as Sampler,
    default_sampler as default_sampler,
)
from twinlens.rendering.shared_kernels import share_kernels as share_kernels
from twinlens.rendering.views import denoised_cameras as denoised_cameras
