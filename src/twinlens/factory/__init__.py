"""From a scene to a sample: the only room that joins scenes, rendering, the sensor and the dataset."""

from twinlens.factory.remake import remake
from twinlens.factory.sample import default_rig, make_sample

__all__ = ["default_rig", "make_sample", "remake"]
