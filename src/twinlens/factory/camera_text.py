"""Sizes, lenses, apertures, distortions, exposures and sensors as command-line options write them.

The grammar of each option is in its `_HELP` text; errors begin with the option's name.
"""

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any, TypeVar

from twinlens.camera import (
    ALIGNED,
    Annulus,
    Aperture,
    BareAperture,
    BrownConrady,
    Disk,
    Distortion,
    KannalaBrandt,
    Lens,
    Misalignment,
    Pinhole,
    Polygon,
    ThinLens,
)
from twinlens.camera.film import SENSOR_WIDTHS_MM, sensor_width_mm
from twinlens.dataset import Sample
from twinlens.errors import InputError, check_number, format_value, unknown
from twinlens.sensor import PRESETS, Exposure, Mismatch, Sensor

Made = TypeVar("Made")

LENSES = {
    "pinhole": "pinhole",
    "thin": "thin:DIAMETER_MM[@FOCUS_M]",
    "f/": "f/N[@FOCUS_M]",
    "hole": "hole:DIAMETER_MM@FILM_MM",
}
LENS_HELP = (
    " | ".join(LENSES.values()) + "; may be given several times. "
    "The default focus is at the middle of the scene's disparities."
)
APERTURES = {
    "disk": "disk",
    "polygon": "polygon:BLADES[:ROTATION_DEG[:ROUNDNESS]]",
    "annulus": "annulus:INNER",
    "mask": "mask:FILE",
}
APERTURE_HELP = (
    " | ".join(APERTURES.values()) + ". Shape of the opening of every lens and hole. "
    "ROUNDNESS is 0 to 1, INNER a fraction of the radius, FILE a grey image, white where light passes."
)
DISTORTION_HELP = (
    "k1,k2[,p1,p2[,k3[,k4,k5,k6]]] in OpenCV's order (Brown-Conrady), or fisheye:k1[,k2,k3,k4] (Kannala-Brandt)."
)
EXPOSURE_HELP = (
    "TIME_S[,GAIN], such as 1/60 or 0.01,4: one exposure for all lenses, so smaller apertures give darker images.  "
    "[default: automatic for each lens]"
)
MISMATCH_HELP = "Differences of the right camera: gain=1.1,exposure=1.05 (factors), black=2 (DN)."
SENSOR_WIDTH_HELP = (
    f"Width of the sensor in mm, or its format ({', '.join(SENSOR_WIDTHS_MM)}), instead of --pixel-pitch-um."
)
SENSOR_HELP = f"{', '.join(PRESETS)}; parameters may be changed: phone:prnu=0.01,filters=mono,output=linear."

_MISMATCHES = {"gain": "gain", "exposure": "time", "black": "black_level"}
_BOOLEANS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) of `640x480`.

    >>> parse_size("640x480")
    (640, 480)
    """
    sides = re.fullmatch(r"([0-9]{1,9})[xX]([0-9]{1,9})", text)
    if sides is None:
        raise InputError(f"--size must be WIDTHxHEIGHT, such as 640x480, got {format_value(text)}")
    return int(sides[1]), int(sides[2])


def parse_lens(text: str, focus: float | None, film_distance: float, aperture: Aperture | None = None) -> Lens:
    """A lens by the grammar of LENS_HELP. `focus` (m) is the default focus; None makes the text's own mandatory.

    >>> parse_lens("thin:20@1.5", focus=2.0, film_distance=0.004)
    ThinLens(aperture_diameter=0.02, focus_distance=1.5, aperture=Disk())
    """
    where, shape = f"--lens {text!r}", aperture or Disk()
    forms = f"a lens is one of {' | '.join(LENSES.values())}"
    kind, colon, rest = ("f/", "/", text[2:]) if text.startswith("f/") else text.partition(":")
    if meant := re.fullmatch(r"[fF]/?([0-9.].*)", text if kind != "f/" else ""):
        raise InputError(f"{where}: an f-number is f/N[@FOCUS_M]; did you mean 'f/{meant[1]}'?")
    if kind not in LENSES:
        raise InputError(f"{where}: {unknown('lens', kind, LENSES)}; {forms}")
    if kind == "pinhole":
        if colon:
            raise InputError(f"{where}: a pinhole has no parameters; {forms}")
        return Pinhole()
    amount, at, place = rest.partition("@")
    if not amount or (kind == "hole" and not at) or (at and not place):
        raise InputError(f"{where}: a number is missing; must be {LENSES[kind]}")
    if not at and focus is None:
        raise InputError(f"{where}: the scene has no depth range; add the focus distance, such as {text}@2.5")
    size = _number(amount, where)
    distance = _number(place, where) if at else float(focus or math.inf)
    if kind == "hole":
        return _with_location(where, lambda: BareAperture(1e-3 * size, 1e-3 * distance, shape))
    if kind == "thin":
        return _with_location(where, lambda: ThinLens(1e-3 * size, distance, shape))
    return _with_location(where, lambda: ThinLens.from_f_number(size, distance, film_distance, shape))


def parse_aperture(text: str) -> Aperture:
    """An aperture's shape by the grammar of APERTURE_HELP.

    >>> parse_aperture("polygon:6:15")
    Polygon(blades=6, rotation_deg=15.0, roundness=0.0)
    """
    where = f"--aperture {text!r}"
    kind, _, rest = text.partition(":")
    if kind not in APERTURES:
        raise InputError(f"{where}: {unknown('aperture', kind, APERTURES)}")
    if kind == "mask" and rest:
        from twinlens.factory.lenses import read_mask

        return read_mask(Path(rest))
    parts = rest.split(":") if rest else []
    low, high = {"disk": (0, 0), "polygon": (1, 3), "annulus": (1, 1), "mask": (1, 1)}[kind]
    if not low <= len(parts) <= high:
        raise InputError(f"{where}: must be {APERTURES[kind]}")
    numbers = [_number(part, where) for part in parts]
    if kind == "polygon":
        blades = int(numbers[0]) if numbers[0].is_integer() else numbers[0]
        return _with_location(where, lambda: Polygon(blades, *numbers[1:]))  # type: ignore[arg-type]
    return _with_location(where, lambda: Annulus(numbers[0])) if kind == "annulus" else Disk()


def parse_distortion(text: str) -> Distortion:
    """A distortion by the grammar of DISTORTION_HELP.

    >>> parse_distortion("-0.2,0.05").k2, parse_distortion("fisheye:0.01").k1
    (0.05, 0.01)
    """
    model, colon, rest = text.rpartition(":")
    where = f"--distortion {text!r}"
    if colon and model not in ("fisheye", KannalaBrandt.name, BrownConrady.name):
        raise InputError(f"{where}: {unknown('model', model, ('fisheye', BrownConrady.name))}")
    if model in ("fisheye", KannalaBrandt.name):
        numbers = parse_numbers("--distortion", rest, 1, 4, f"{model}:k1[,k2,k3,k4]")
        return _with_location(where, lambda: KannalaBrandt(*numbers))
    numbers = parse_numbers("--distortion", rest, 1, 8, "k1,k2,p1,p2,k3,k4,k5,k6 (1 to 8 numbers)")
    return _with_location(where, lambda: BrownConrady(*numbers))


def parse_exposure(text: str) -> Exposure | None:
    """An exposure by the grammar of EXPOSURE_HELP; None for "auto".

    >>> parse_exposure("1/50,2")
    Exposure(time=0.02, gain=2.0)
    """
    if text == "auto":
        return None
    where = f"--exposure {text!r}"
    time, comma, gain = text.partition(",")
    numerator, slash, denominator = time.partition("/")
    seconds = _number(numerator, where)
    if slash:
        divisor = _number(denominator, where)
        if not divisor > 0:
            raise InputError(f"{where}: {time!r} is not a time; a fraction of a second is written 1/60")
        seconds /= divisor
    factor = _number(gain, where) if comma else 1.0
    return _with_location(where, lambda: Exposure(seconds, factor))


def parse_mismatch(text: str) -> Mismatch:
    """A mismatch by the grammar of MISMATCH_HELP.

    >>> parse_mismatch("exposure=1.05,black=2")
    Mismatch(gain=1.0, time=1.05, black_level=2.0)
    """
    where = f"--mismatch {text!r}"
    changes = {_MISMATCHES[key]: value for key, value in _named_numbers(where, text, _MISMATCHES).items()}
    return _with_location(where, lambda: Mismatch(**changes))


def parse_misalignment(text: str | None) -> Misalignment:
    """Errors left in a rectification, by name.

    >>> parse_misalignment("vertical_px=1.5,roll_deg=0.2")
    Misalignment(vertical_px=1.5, pitch_deg=0.0, yaw_deg=0.0, roll_deg=0.2)
    """
    if text is None:
        return ALIGNED
    where = f"--misalignment {text!r}"
    given = _named_numbers(where, text, vars(ALIGNED))
    return _with_location(where, lambda: Misalignment(**given))


def parse_sensor(text: str) -> Sensor:
    """A sensor by the grammar of SENSOR_HELP: a preset with changed parameters.

    >>> parse_sensor("ideal:bits=16,shot_noise=no").shot_noise
    False
    """
    preset, colon, rest = text.partition(":")
    where = f"--sensor {text!r}"
    if preset not in PRESETS:
        raise InputError(f"{where}: {unknown('sensor', preset, PRESETS)}")
    known = {field.name: field.default for field in fields(Sensor) if field.name != "mismatch"}
    given = _pairs(where, rest, known, "parameter") if colon else {}
    changes = {key: _like(known[key], value, f"{where}, {key}") for key, value in given.items()}
    return _with_location(where, lambda: Sensor.preset(preset, **changes))


def parse_numbers(option: str, text: str, least: int, most: int, form: str) -> list[float]:
    """`least` to `most` numbers separated by commas; `form` describes them in errors.

    >>> parse_numbers("--principal-point", "320,240.5", 2, 2, "CX,CY")
    [320.0, 240.5]
    """
    parts = text.split(",")
    if not (least <= len(parts) <= most and all(part.strip() for part in parts)):
        raise InputError(f"{option} must be {form}, got {text!r}")
    return [_number(part.strip(), f"{option} {text!r}") for part in parts]


def _like(example: Any, text: str, where: str) -> Any:
    """`text` as a value of the type of `example`; the numbers of a tuple are separated by slashes."""
    if isinstance(example, bool):
        if text not in _BOOLEANS:
            raise InputError(f"{where} must be yes or no, got {text!r}")
        return _BOOLEANS[text]
    if isinstance(example, str):
        return text
    if isinstance(example, tuple):
        return tuple(_number(part, where) for part in text.split("/"))
    value = _number(text, where)
    return int(value) if isinstance(example, int) and value.is_integer() else value


def _pairs(where: str, text: str, known: Collection[str], kind: str) -> dict[str, str]:
    """The names and values of `a=1,b=2`, each name once and known."""
    pairs: dict[str, str] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals and value) or name in pairs:
            raise InputError(f"{where}: must be NAME=VALUE,NAME=VALUE, each name once; got {part!r}")
        if name not in known:
            raise InputError(f"{where}: {unknown(kind, name, known)}")
        pairs[name] = value
    return pairs


def _named_numbers(where: str, text: str, known: Collection[str]) -> dict[str, float]:
    return {name: _number(value, where) for name, value in _pairs(where, text, known, "quantity").items()}


def _number(text: str, where: str) -> float:
    """A number, inf included; NaN is refused."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise InputError(f"{where}: {text!r} is not a number")
    return value


def _with_location(where: str, make: Callable[[], Made]) -> Made:
    """The result of `make`; its errors begin with `where`."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{where}: {error}") from error


def parse_intrinsics(options: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a rig's table that the options of `twinlens render` set for all cameras.

    >>> parse_intrinsics({"focal_length_px": "700", "sensor_width_mm": "35mm"})
    {'fx': 700.0, 'fy': 700.0, 'sensor_width_mm': 36.0}
    """
    given = {name: value for name, value in options.items() if value is not None}
    for one, other in (("fov", "focal_length_px"), ("pixel_pitch_um", "sensor_width_mm")):
        if one in given and other in given:
            names = (f"--{name.replace('_', '-')}" for name in (one, other))
            raise InputError(f"{' and '.join(names)} exclude each other")
    found: dict[str, Any] = {}
    if "focal_length_px" in given:
        form = "FX[,FY], positive numbers of pixels, such as 700 or 700,690"
        focal = parse_numbers("--focal-length-px", given["focal_length_px"], 1, 2, form)
        if not all(0 < number < math.inf for number in focal):
            raise InputError(f"--focal-length-px must be {form}, got {given['focal_length_px']!r}")
        found |= {"fx": focal[0], "fy": focal[-1]}
    if "principal_point" in given:
        found["cx"], found["cy"] = parse_numbers("--principal-point", given["principal_point"], 2, 2, "CX,CY")
    if "distortion" in given:
        model = parse_distortion(given["distortion"])
        found["distortion"] = {"model": model.name, **asdict(model)}
    if "pixel_pitch_um" in given:
        check_number("--pixel-pitch-um", given["pixel_pitch_um"], "a positive number", above=0)
        found["pixel_pitch_um"] = given["pixel_pitch_um"]
    if "sensor_width_mm" in given:
        found["sensor_width_mm"] = _parse_sensor_width(given["sensor_width_mm"])
    return found


def _parse_sensor_width(text: str) -> float:
    try:
        return sensor_width_mm(float(text) if re.fullmatch(r"[-+.0-9e]+|[+-]?(inf|nan)", text) else text)
    except (InputError, ValueError) as error:
        raise InputError(f"--sensor-width-mm {text}: {error}") from error


_FASTEST = 0.95
"""The smallest f-number of photographic lenses on the market; an indication, not a limit."""


def format_exposure(sample: Sample, k: int, text: str) -> str:
    """F-number, time and gain of lens k, which the option `text` describes; and whether such a lens can be bought."""
    camera, taken = sample.rig.cameras[0], sample.shots[k].record["exposures"][0]
    number, time, gain = taken["working_f_number"], taken["time_s"], taken["gain"]
    line = f"{text}: f/{_f_number(number)}, {_duration(time)}, gain {gain:.3g}"
    if number >= _FASTEST or sample.shots[k].lens.name != "thinlens":
        return line
    fast = "the blur is as specified, but no lens on the market is this fast"
    if text.startswith("f/"):  # independent of the sensor's size
        return f"{line} ({fast})"
    width = 1e-3 * camera.width * camera.pixel_pitch_um
    return (
        f"{line} ({fast}: this sensor is {width:.3g} mm wide; --sensor-width-mm {width * 1.4 / number:.2g} gives f/1.4)"
    )


def _f_number(number: float) -> str:
    """Two digits, without an exponent below 1e5.

    >>> _f_number(1.414), _f_number(142.8), _f_number(8.6e7)
    ('1.4', '143', '8.6e+07')
    """
    return f"{number:.0f}" if 99.5 <= number < 1e5 else f"{number:.2g}"


def _duration(time: float) -> str:
    """Seconds as on a shutter's dial; microseconds below 0.1 ms.

    >>> _duration(1 / 60), _duration(0.39), _duration(2e-5)
    ('1/60 s', '0.39 s', '20 us')
    """
    if time < 1e-4:
        return f"{1e6 * time:.3g} us"
    return f"1/{1 / time:.0f} s" if time < 0.1 else f"{time:.3g} s"
