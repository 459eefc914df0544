"""Point clouds and meshes from depth maps: conversion, fusion of many views, and evaluation against the true surface.

The formulas and their sources are in docs/reconstruction.md.
"""

from twinlens.reconstruction.surface import mesh_of, points_of, view_of_disparity

__all__ = [
    "mesh_of",
    "points_of",
    "view_of_disparity",
]
