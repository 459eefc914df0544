"""Digital images from radiance, after EMVA standard 1288: light on the film, electrons, digital numbers, an image."""

from twinlens.sensor.exposure import Exposure as Exposure
from twinlens.sensor.light import ParaxialWarning as ParaxialWarning
from twinlens.sensor.metering import (
    auto_exposure as auto_exposure,
    light_on_grey as light_on_grey,
)
from twinlens.sensor.mismatch import (
    DEFAULT_MISMATCH as DEFAULT_MISMATCH,
    LEVELS as LEVELS,
    Mismatch as Mismatch,
    level_table as level_table,
    mismatch_table as mismatch_table,
)
from twinlens.sensor.model import Photo as Photo, Sensor as Sensor
from twinlens.sensor.presets import PRESETS as PRESETS
