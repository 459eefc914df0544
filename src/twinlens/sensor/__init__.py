"""Digital images from radiance, after EMVA standard 1288: light on the film, electrons, digital numbers, an image.

`light` computes electrons per second, `noise` counts and reads them, `picture` develops the numbers into an image and
`exposure` chooses time and gain. `Sensor.expose` applies all of them.
"""

from twinlens.sensor.exposure import Exposure, Mismatch, auto_exposure
from twinlens.sensor.light import ParaxialWarning
from twinlens.sensor.model import Photo, Sensor
from twinlens.sensor.presets import PRESETS

__all__ = ["PRESETS", "Exposure", "Mismatch", "ParaxialWarning", "Photo", "Sensor", "auto_exposure"]
