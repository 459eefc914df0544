"""Cameras, the lenses in front of them, and rigs of several: plain frozen data, no rendering."""

from twinlens.camera.aperture import Annulus, Aperture, Disk, MaskAperture, Polygon
from twinlens.camera.distortion import BrownConrady, Distortion, KannalaBrandt
from twinlens.camera.film import film_image
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import BareAperture, Lens, Pinhole, ThinLens, film_distance
from twinlens.camera.misalignment import ALIGNED, Misalignment, misaligned
from twinlens.camera.remap import undistort_maps
from twinlens.camera.rig import Rig
from twinlens.camera.truth import MATERIAL_KINDS, Correspondence, Truth

__all__ = [
    "ALIGNED",
    "MATERIAL_KINDS",
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
