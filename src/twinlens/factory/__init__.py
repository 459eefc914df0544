"""From a recipe, or a scene, to samples: the only room that joins scenes, rendering, the sensor and the dataset."""

from twinlens.factory.estimate import Estimate, estimate
from twinlens.factory.gates import Gates, Rejected
from twinlens.factory.generate import Outcome, generate
from twinlens.factory.plan import SampleSpec, plan, spec_from_plain
from twinlens.factory.produce import make, produce
from twinlens.factory.recipe import Recipe, read_recipe, recipe_from_table
from twinlens.factory.rectified import rectified_sample
from twinlens.factory.remake import remake, scene_of
from twinlens.factory.sample import default_rig, make_sample
from twinlens.factory.sources import Sources

__all__ = [
    "Estimate",
    "Gates",
    "Outcome",
    "Recipe",
    "Rejected",
    "SampleSpec",
    "Sources",
    "default_rig",
    "estimate",
    "generate",
    "make",
    "make_sample",
    "plan",
    "produce",
    "read_recipe",
    "recipe_from_table",
    "rectified_sample",
    "remake",
    "scene_of",
    "spec_from_plain",
]
