"""Point clouds and meshes from depth maps: conversion, fusion of many views, and evaluation against the true surface.

The formulas and their sources are in docs/reconstruction.md.
"""

from twinlens.reconstruction.evaluation import Comparison, compare
from twinlens.reconstruction.fusion import fuse, integrate, surface_of
from twinlens.reconstruction.surface import (
    Cloud,
    DepthView,
    Surface,
    mesh_of,
    points_of,
    sampled,
    view_of_disparity,
    view_of_truth,
    write_glb,
    write_ply,
)

__all__ = [
    "Cloud",
    "Comparison",
    "DepthView",
    "Surface",
    "compare",
    "fuse",
    "integrate",
    "mesh_of",
    "points_of",
    "sampled",
    "surface_of",
    "view_of_disparity",
    "view_of_truth",
    "write_glb",
    "write_ply",
]
