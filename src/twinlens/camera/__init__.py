"""Cameras, the lenses in front of them, and rigs of several: plain frozen data, no rendering."""

from twinlens.camera.aperture import Aperture, Disk
from twinlens.camera.intrinsics import Camera
from twinlens.camera.lens import BareAperture, Lens, Pinhole, ThinLens
from twinlens.camera.rig import Rig

__all__ = ["Aperture", "BareAperture", "Camera", "Disk", "Lens", "Pinhole", "Rig", "ThinLens"]
