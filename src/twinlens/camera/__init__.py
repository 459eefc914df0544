"""Cameras, lenses and rigs of several cameras: immutable data and the geometry that follows from it. No rendering.

`multiview` (epipolar geometry, triangulation) and `rectification` work on a `Rig`; `film` on images.
"""

from twinlens.camera.aperture import Annulus, Aperture, Disk, MaskAperture, Polygon
from twinlens.camera.distortion import BrownConrady, Distortion, KannalaBrandt
from twinlens.camera.film import film_image
from twinlens.camera.intrinsics import Camera, undistort_maps
from twinlens.camera.lens import BareAperture, Lens, Pinhole, ThinLens, film_distance
from twinlens.camera.rig import ALIGNED, Misalignment, Rig, misaligned
from twinlens.camera.truth import Correspondence, Truth

__all__ = [
    "ALIGNED",
    "Annulus",
    "Aperture",
    "BareAperture",
    "BrownConrady",
    "Camera",
    "Correspondence",
    "Disk",
    "Distortion",
    "KannalaBrandt",
    "Lens",
    "MaskAperture",
    "Misalignment",
    "Pinhole",
    "Polygon",
    "Rig",
    "ThinLens",
    "Truth",
    "film_distance",
    "film_image",
    "misaligned",
    "undistort_maps",
]
