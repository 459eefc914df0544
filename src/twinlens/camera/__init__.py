"""Cameras, lenses and rigs of several cameras: immutable data and the geometry that follows from it. No rendering.

`multiview` (epipolar geometry, triangulation) and `rectification` work on a `Rig`; `film` on images.
"""

from twinlens.camera.aperture import (
    Annulus as Annulus,
    Aperture as Aperture,
    Disk as Disk,
    MaskAperture as MaskAperture,
    Polygon as Polygon,
)
from twinlens.camera.distortion import (
    BrownConrady as BrownConrady,
    Distortion as Distortion,
    KannalaBrandt as KannalaBrandt,
)
from twinlens.camera.film import film_image as film_image
from twinlens.camera.intrinsics import (
    Camera as Camera,
    undistort_maps as undistort_maps,
)
from twinlens.camera.lens import (
    ApertureLens as ApertureLens,
    BareAperture as BareAperture,
    Lens as Lens,
    Paraxial as Paraxial,
    Pinhole as Pinhole,
    RecipeLens as RecipeLens,
    ThinLens as ThinLens,
    chief_rays as chief_rays,
    film_distance as film_distance,
)
from twinlens.camera.light_field import (
    light_field_grid as light_field_grid,
    light_field_rig as light_field_rig,
    refocus as refocus,
)
from twinlens.camera.parts import (
    Dual as Dual,
    Grid as Grid,
    Masks as Masks,
    Quad as Quad,
    dual_pixel_disparity as dual_pixel_disparity,
)
from twinlens.camera.projector import Projector as Projector
from twinlens.camera.rig import (
    ALIGNED as ALIGNED,
    Misalignment as Misalignment,
    Rig as Rig,
    misaligned as misaligned,
)
from twinlens.camera.structured_light import (
    Decoded as Decoded,
    GrayCode as GrayCode,
    PhaseShift as PhaseShift,
    Still as Still,
    decode as decode,
    decode_sequence as decode_sequence,
)
from twinlens.camera.truth import (
    Correspondence as Correspondence,
    ObjectTruth as ObjectTruth,
    Projection as Projection,
    Truth as Truth,
)
