"""The small languages of a camera's inside, an exposure and a sensor: `-0.2,0.05`, `1/60,2`, `phone:prnu=0.01`."""

from dataclasses import fields
from typing import Any

from twinlens.camera import BrownConrady, Distortion, KannalaBrandt
from twinlens.cli.specs import number, told
from twinlens.errors import InputError, unknown
from twinlens.sensor import PRESETS, Exposure, Mismatch, Sensor

DISTORTION_HELP = (
    "k1,k2[,p1,p2[,k3[,k4,k5,k6]]] as OpenCV orders them (Brown-Conrady), or fisheye:k1[,k2,k3,k4] (Kannala-Brandt)."
)
EXPOSURE_HELP = (
    "TIME_S[,GAIN], as 1/60 or 0.01,4: one exposure for every lens, so that a smaller aperture is darker.  "
    "[default: automatic, each lens its own]"
)
MISMATCH_HELP = "What the right eye has differently: gain=1.1,exposure=1.05 (factors), black=2 (DN)."
SENSOR_HELP = f"{', '.join(PRESETS)}; figures may be changed, as phone:prnu=0.01,filters=mono,output=linear."

_MISMATCHES = {"gain": "gain", "exposure": "time", "black": "black_level"}
_TRUTHS = {"true": True, "yes": True, "1": True, "false": False, "no": False, "0": False}


def parse_numbers(option: str, text: str, least: int, most: int, form: str) -> list[float]:
    """`least` to `most` numbers with commas between them; `form` says in words what is right.

    >>> parse_numbers("--principal-point", "320,240.5", 2, 2, "CX,CY")
    [320.0, 240.5]
    """
    parts = text.split(",")
    if not (least <= len(parts) <= most and all(part.strip() for part in parts)):
        raise InputError(f"{option} must read {form}, got {text!r}")
    return [number(part.strip(), f"{option} {text!r}") for part in parts]


def parse_distortion(text: str) -> Distortion:
    """The distortion that `text` names, by the grammar of DISTORTION_HELP.

    >>> parse_distortion("-0.2,0.05").k2, parse_distortion("fisheye:0.01").k1
    (0.05, 0.01)
    """
    model, colon, rest = text.rpartition(":")
    if colon and model not in ("fisheye", KannalaBrandt.name, BrownConrady.name):
        raise InputError(f"--distortion {text!r}: {unknown('model', model, ('fisheye', BrownConrady.name))}")
    where = f"--distortion {text!r}"
    if model in ("fisheye", KannalaBrandt.name):
        numbers = parse_numbers("--distortion", rest, 1, 4, f"{model}:k1[,k2,k3,k4]")
        return told(where, lambda: KannalaBrandt(*numbers))
    numbers = parse_numbers("--distortion", rest, 1, 8, "k1,k2,p1,p2,k3,k4,k5,k6 (1 to 8 numbers)")
    return told(where, lambda: BrownConrady(*numbers))


def parse_exposure(text: str) -> Exposure | None:
    """The exposure that `text` names, by the grammar of EXPOSURE_HELP; None for "auto".

    >>> parse_exposure("1/50,2")
    Exposure(time=0.02, gain=2.0)
    """
    if text == "auto":
        return None
    where = f"--exposure {text!r}"
    time, comma, gain = text.partition(",")
    over, slash, under = time.partition("/")
    seconds = number(over, where)
    if slash:
        divisor = number(under, where)
        if not divisor > 0:
            raise InputError(f"{where}: {time!r} is no time; a fraction of a second reads 1/60")
        seconds /= divisor
    factor = number(gain, where) if comma else 1.0
    return told(where, lambda: Exposure(seconds, factor))


def parse_mismatch(text: str) -> Mismatch:
    """The mismatch that `text` names, by the grammar of MISMATCH_HELP.

    >>> parse_mismatch("exposure=1.05,black=2")
    Mismatch(gain=1.0, time=1.05, black_level=2.0)
    """
    where = f"--mismatch {text!r}"
    given = parse_pairs(where, text)
    for key in given:
        if key not in _MISMATCHES:
            raise InputError(f"{where}: {unknown('quantity', key, _MISMATCHES)}")
    changes = {_MISMATCHES[key]: number(value, where) for key, value in given.items()}
    return told(where, lambda: Mismatch(**changes))


def parse_sensor(text: str) -> Sensor:
    """The sensor that `text` names, by the grammar of SENSOR_HELP: a preset, some of its figures changed.

    >>> parse_sensor("ideal:bits=16,shot_noise=no").shot_noise
    False
    """
    preset, colon, rest = text.partition(":")
    where = f"--sensor {text!r}"
    if preset not in PRESETS:
        raise InputError(f"{where}: {unknown('sensor', preset, PRESETS)}")
    known = {field.name: field.default for field in fields(Sensor) if field.name != "mismatch"}
    changes = {}
    for key, value in (parse_pairs(where, rest) if colon else {}).items():
        if key not in known:
            raise InputError(f"{where}: {unknown('figure', key, known)}")
        changes[key] = _like(known[key], value, f"{where}, {key}")
    return told(where, lambda: Sensor.preset(preset, **changes))


def _like(example: Any, text: str, where: str) -> Any:
    """`text` as a value of the kind that `example` is; three numbers are divided by slashes."""
    if isinstance(example, bool):
        if text not in _TRUTHS:
            raise InputError(f"{where} must be yes or no, got {text!r}")
        return _TRUTHS[text]
    if isinstance(example, str):
        return text
    if isinstance(example, tuple):
        return tuple(number(part, where) for part in text.split("/"))
    value = number(text, where)
    return int(value) if isinstance(example, int) and value.is_integer() else value


def parse_pairs(where: str, text: str) -> dict[str, str]:
    """The names and values of `a=1,b=2`; `where` is what a message begins with."""
    pairs: dict[str, str] = {}
    for part in text.split(","):
        name, equals, value = (piece.strip() for piece in part.partition("="))
        if not (name and equals and value) or name in pairs:
            raise InputError(f"{where} must read NAME=VALUE,NAME=VALUE, each name once; got {part!r}")
        pairs[name] = value
    return pairs
