"""Samples from a recipe or a scene: the only package that joins scenes, rendering, sensor and dataset."""

from twinlens.factory.generate import Estimate, Outcome, estimate, generate
from twinlens.factory.plan import plan
from twinlens.factory.produce import make, produce
from twinlens.factory.recipe import read_recipe, recipe_from_table
from twinlens.factory.remake import rectified_sample, remake
from twinlens.factory.sample import add_sample, check_common_view, default_rig, make_sample
from twinlens.factory.workers import dask_cluster, in_process, worker_processes

__all__ = [
    "Estimate",
    "Outcome",
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
    "worker_processes",
]
