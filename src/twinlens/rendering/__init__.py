"""Photographs and exact truth of a scene. The only room that imports mitsuba and drjit, and only when it is used."""

from twinlens.rendering.backend import Backend, backend, doctor
from twinlens.rendering.ground_truth import ground_truth
from twinlens.rendering.radiance import render

__all__ = ["Backend", "backend", "doctor", "ground_truth", "render"]
