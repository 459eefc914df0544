"""Poses and intrinsics of a rig in other programs' files, axes and pixel conventions converted: COLMAP, OpenCV, NeRF.

Middlebury's calib.txt, which describes a rectified pair only, is in `twinlens.dataset.codecs.calib`.
"""

from twinlens.dataset.poses.colmap import read_colmap, write_colmap
from twinlens.dataset.poses.nerf import read_transforms, write_transforms
from twinlens.dataset.poses.opencv_yaml import read_opencv, write_opencv

__all__ = ["read_colmap", "read_opencv", "read_transforms", "write_colmap", "write_opencv", "write_transforms"]
