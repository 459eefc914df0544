"""Rigs in the files of COLMAP, NeRF programs and OpenCV, with axes and pixel conventions converted.

Middlebury's calib.txt, for rectified pairs only, is in `twinlens.dataset.codecs.calib`.
"""

from twinlens.dataset.poses.colmap import read_colmap, write_colmap
from twinlens.dataset.poses.nerf import read_transforms, write_transforms
from twinlens.dataset.poses.opencv_yaml import read_opencv, write_opencv

__all__ = ["read_colmap", "read_opencv", "read_transforms", "write_colmap", "write_opencv", "write_transforms"]
