"""Point clouds and meshes from depth maps: conversion, fusion of many views, and evaluation against the true surface.

The formulas and their sources are in docs/reconstruction.md.
"""

from twinlens.reconstruction.evaluation import (
    Comparison as Comparison,
    compare as compare,
)
from twinlens.reconstruction.fusion import (
    fuse as fuse,
    integrate as integrate,
    surface_of as surface_of,
)
from twinlens.reconstruction.surface import (
    Cloud as Cloud,
    DepthView as DepthView,
    Surface as Surface,
    mesh_of as mesh_of,
    points_of as points_of,
    sampled as sampled,
    view_of_disparity as view_of_disparity,
    view_of_truth as view_of_truth,
    write_glb as write_glb,
    write_ply as write_ply,
)
