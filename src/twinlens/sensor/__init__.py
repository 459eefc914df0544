"""Digital images from radiance, after EMVA standard 1288: light on the film, electrons, digital numbers, an image."""

from twinlens.sensor.exposure import Exposure, auto_exposure
from twinlens.sensor.light import ParaxialWarning
from twinlens.sensor.mismatch import Mismatch
from twinlens.sensor.model import Photo, Sensor
from twinlens.sensor.presets import PRESETS
from twinlens.sensor.tolerances import LEVELS

__all__ = [
    "LEVELS",
    "PRESETS",
    "Exposure",
    "Mismatch",
    "ParaxialWarning",
    "Photo",
    "Sensor",
    "auto_exposure",
]
