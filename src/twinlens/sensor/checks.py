"""What a sensor asks of the figures and the seeds that it is given."""

from typing import TYPE_CHECKING, Any

import numpy as np

from twinlens.errors import InputError, check_number, check_triple, format_value, unknown
from twinlens.optics.diffraction import check_wavelengths
from twinlens.sensor import picture
from twinlens.sensor.exposure import Exposure, Mismatch

if TYPE_CHECKING:
    from twinlens.sensor.model import Sensor

OUTPUTS = (*picture.CURVES, "raw")

_RANGES = {
    "full_well": (1.0, 1e9),
    "gamma": (0.01, 100.0),
    "radiance_scale": (1e-12, 1e12),
    "pinhole_f_number": (1e-3, 1e6),
    "longest_exposure": (1e-9, 1e9),
    "largest_gain": (1e-3, 1e9),
    "read_noise": (0.0, 1e9),
    "dark_current": (0.0, 1e9),
    "prnu": (0.0, 10.0),
    "dsnu": (0.0, 1e9),
}
"""Of each number: far beyond any sensor, and near enough for arithmetic."""


def check_seed(name: str, value: int) -> None:
    """InputError unless `value` is a whole number >= 0."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 0:
        raise InputError(f"{name} must be a whole number >= 0, got {format_value(value)}")


def check_figures(sensor: "Sensor") -> dict[str, tuple[float, float, float]]:
    """Raise InputError for the first figure that is out of range; the triples as plain numbers."""
    efficiency = sensor.quantum_efficiency
    allowed = "three positive numbers (red, green, blue)"
    triples = {
        "quantum_efficiency": check_triple("sensor quantum_efficiency", efficiency, allowed),
        "wavelengths": check_wavelengths("sensor wavelengths", sensor.wavelengths),
    }
    if max(triples["quantum_efficiency"]) > 1:
        raise InputError(f"sensor quantum_efficiency is at most 1 electron a photon, got {format_value(efficiency)}")
    for name, (least, most) in _RANGES.items():
        check_number(f"sensor {name}", getattr(sensor, name), f"from {least:g} to {most:g}", least=least, most=most)
    _check_choices(sensor)
    sensor.mismatch.applied(Exposure(sensor.longest_exposure, sensor.largest_gain))
    check_number("sensor black_level", sensor.black_level, "a number of DN >= 0", least=0)
    if sensor.black_level >= sensor.largest_dn:
        raise InputError(f"sensor black_level must lie in 0..{sensor.largest_dn} DN, got {sensor.black_level}")
    check_seed("sensor serial", sensor.serial)
    return triples


def _check_choices(sensor: "Sensor") -> None:
    if not _is_whole(sensor.adc_bits) or not 8 <= sensor.adc_bits <= 16:
        raise InputError(f"sensor adc_bits must be a whole number from 8 to 16, got {format_value(sensor.adc_bits)}")
    if not _is_whole(sensor.bits) or sensor.bits not in (8, 16):
        raise InputError(f"sensor bits must be 8 or 16, got {format_value(sensor.bits)}")
    for name in ("white_balance", "shot_noise", "vignetting"):
        value: Any = getattr(sensor, name)
        if not isinstance(value, (bool, np.bool_)):
            raise InputError(f"sensor {name} must be True or False, got {format_value(value)}")
    for name, known in (("filters", picture.FILTERS), ("output", OUTPUTS)):
        value = getattr(sensor, name)
        if not isinstance(value, str) or value not in known:
            raise unknown(f"sensor {name}", value if isinstance(value, str) else format_value(value), known)
    if not isinstance(sensor.mismatch, Mismatch):
        raise InputError(f"sensor mismatch must be a Mismatch, got {format_value(sensor.mismatch)}")


def _is_whole(value: Any) -> bool:
    return isinstance(value, (int, np.integer)) and not isinstance(value, bool)
