"""Cameras, the lenses in front of them, and rigs of several: plain frozen data, no rendering."""

from twinlens.camera.aperture import Annulus, Aperture, Disk, MaskAperture, Polygon
from twinlens.camera.distortion import BrownConrady, Distortion, KannalaBrandt
from twinlens.camera.film import film_image
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import BareAperture, Lens, Pinhole, ThinLens, film_distance
from twinlens.camera.misalignment import ALIGNED, Misalignment, misaligned
from twinlens.camera.remap import undistort_maps
from twinlens.camera.rig import Rig

__all__ = [
    "ALIGNED",
    "Annulus",
    "Aperture",
    "BareAperture",
    "BrownConrady",
    "Camera",
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
    "film_distance",
    "film_image",
    "misaligned",
    "undistort_maps",
]
