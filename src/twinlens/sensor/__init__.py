"""Radiance becomes a digital picture: light on the film, electrons, numbers. After EMVA standard 1288.

`light` says how many electrons a second a radiance makes, `noise` counts them and reads them out, `picture` turns the
numbers into an image to look at, `exposure` chooses time and gain. `Sensor.expose` goes the whole way.
"""

from twinlens.sensor.exposure import Exposure, Mismatch, auto_exposure
from twinlens.sensor.light import ParaxialWarning
from twinlens.sensor.model import Sensor
from twinlens.sensor.photo import Photo
from twinlens.sensor.presets import PRESETS

__all__ = ["PRESETS", "Exposure", "Mismatch", "ParaxialWarning", "Photo", "Sensor", "auto_exposure"]
