"""Samples from a recipe or a scene: the only package that joins scenes, rendering, sensor and dataset."""

from twinlens.factory.gates import Gates, Rejected
from twinlens.factory.generate import Estimate, Outcome, estimate, generate
from twinlens.factory.plan import SampleSpec, plan, spec_from_plain
from twinlens.factory.produce import make, produce
from twinlens.factory.recipe import Recipe, read_recipe, recipe_from_table
from twinlens.factory.remake import rectified_sample, remake
from twinlens.factory.sample import add_sample, check_common_view, default_rig, make_sample
from twinlens.factory.sources import Sources
from twinlens.factory.workers import dask_cluster, in_process, worker_processes

__all__ = [
    "Estimate",
    "Gates",
    "Outcome",
    "Recipe",
    "Rejected",
    "SampleSpec",
    "Sources",
    "add_sample",
    "check_common_view",
    "dask_cluster",
    "default_rig",
    "estimate",
    "generate",
    "in_process",
    "make",
    "make_sample",
    "plan",
    "produce",
    "read_recipe",
    "recipe_from_table",
    "rectified_sample",
    "remake",
    "spec_from_plain",
    "worker_processes",
]
