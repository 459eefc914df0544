"""Sizes, lenses, apertures, distortions, exposures and sensors as command-line options write them.

Each `_HELP` text shows the syntax of its option. Texts are read as the tables of a recipe are; errors begin with the
option's name.
"""

import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

from twinlens.camera import (
    ALIGNED,
    BrownConrady,
    Distortion,
    KannalaBrandt,
    Misalignment,
)
from twinlens.camera.film import SENSOR_WIDTHS_MM, sensor_width_mm
from twinlens.camera.presets import find_camera
from twinlens.errors import InputError, format_value, located, unknown
from twinlens.factory import settings
from twinlens.scenes.rigs import CalibrationError
from twinlens.schema import read
from twinlens.sensor import LEVELS, PRESETS, Exposure, Mismatch, Sensor
from twinlens.settings import (
    NUMBER,
    Field,
    Setting,
    fields_of,
    parse_pairs,
)

_BROWN_CONRADY, _FISHEYE = "k1[,k2[,p1,p2[,k3[,k4,k5,k6]]]]", "fisheye:k1[,k2,k3,k4]"
DISTORTION_HELP = f"{_BROWN_CONRADY} in OpenCV's order (Brown-Conrady), or {_FISHEYE} (Kannala-Brandt)."
EXPOSURE_HELP = (
    "One exposure for all lenses, such as 1/60 or 0.01,4; smaller apertures then give darker images.  "
    "[default: automatic for each lens]"
)
MISMATCH_HELP = (
    f"Differences of the cameras after the first: a level ({', '.join(LEVELS)}), drawn with --seed, or values such as "
    "gain=1.1,time=1.05 (factors), black_level=2 (DN); typical,blur_px=0 combines them. Fields: docs/realism.md."
)
SENSOR_WIDTH_HELP = (
    f"Width of the sensor in mm, or its format ({', '.join(SENSOR_WIDTHS_MM)}), "
    "instead of --pixel-pitch-um."
)
SENSOR_HELP = f"{', '.join(PRESETS)}; parameters follow a colon: phone:prnu=0.01,filters=mono,output=linear."

_SEED = Field("seed", int, False, Setting("Seed of the level.", least=0))
_MISMATCH_FIELDS = {**fields_of(Mismatch), "seed": _SEED}
_MISMATCH = f"NAME=VALUE,NAME=VALUE, or a level ({', '.join(LEVELS)}) alone or first"


def parse_size(text: str | None, camera: str | None = None) -> tuple[int, int]:
    """(width, height) of `640x480`; without a text, that of a camera preset, or 640x480.

    >>> parse_size("640x400"), parse_size(None, "realsense-d435")
    ((640, 400), (1280, 800))
    """
    if text is None and camera is not None:
        with located(f"--camera {camera}"):
            return find_camera(camera).size()
    text = text or "640x480"
    sides = re.fullmatch(r"([1-9][0-9]{0,8})[xX]([1-9][0-9]{0,8})", text)
    if sides is None:
        raise InputError(
            f"--size must be WIDTHxHEIGHT, such as 640x480, got {format_value(text)}"
        )
    return int(sides[1]), int(sides[2])


def parse_distortion(text: str) -> Distortion:
    """A distortion in the syntax of DISTORTION_HELP."""
    model, colon, rest = text.rpartition(":")
    where = f"--distortion {text!r}"
    if colon and model not in ("fisheye", KannalaBrandt.name, BrownConrady.name):
        raise InputError(
            f"{where}: {unknown('model', model, ('fisheye', BrownConrady.name))}"
        )
    fisheye = model in ("fisheye", KannalaBrandt.name)
    counts, form = (
        ((1, 2, 3, 4), _FISHEYE) if fisheye else ((1, 2, 4, 5, 8), _BROWN_CONRADY)
    )
    numbers = parse_numbers("--distortion", rest, counts, form)
    with located(where):
        return KannalaBrandt(*numbers) if fisheye else BrownConrady(*numbers)


def parse_exposure(text: str) -> Exposure | None:
    """An exposure in the syntax of EXPOSURE_HELP; None for "auto"."""
    if text == "auto":
        return None
    match = re.fullmatch(rf"({NUMBER})(?:/({NUMBER}))?(?:,({NUMBER}))?", text)
    if match is None or not float(match[2] or 1) > 0:
        raise InputError(
            f"--exposure must be TIME_S[,GAIN], such as 1/60 or 0.01,4, got {format_value(text)}"
        )
    with located(f"--exposure {text!r}"):
        return Exposure(float(match[1]) / float(match[2] or 1), float(match[3] or 1))


def parse_mismatch(
    text: str, seed: int = 0, cameras: int = 2, layout: str = ""
) -> Mismatch | tuple[Mismatch, ...]:
    """The mismatch of a sensor in the syntax of MISMATCH_HELP; `seed` draws the values of a level for each camera.

    cameras, layout : of the rig. Raises InputError for a rig with one camera, which has no mismatch
        (`settings.only_one_camera`).
    """
    where = f"--mismatch {text!r}"
    first = text.partition(",")[0].strip()
    if first.isidentifier() and first not in _MISMATCH_FIELDS:
        text = f"level={text}"
    with located(where):
        fields = parse_pairs(text, _MISMATCH_FIELDS, _MISMATCH)
    if (problem := settings.only_one_camera(cameras, layout)) and fields != {
        "level": "none"
    }:
        raise InputError(f"{where}: {problem}")
    if "seed" in fields:
        with located(f"{where}: seed"):
            _SEED.checked(fields["seed"])
    of_pair = settings.mismatches_for(fields, 2, seed)
    of_rig = settings.mismatches_for(fields, cameras, seed)
    # The mismatch of a pair is read first: its messages have no number of a camera.
    mismatch = read(settings.MismatchTables, of_pair, where)
    if of_rig != of_pair:
        mismatch = read(settings.MismatchTables, of_rig, where)
    return mismatch  # type: ignore[no-any-return]


def parse_misalignment(text: str | None) -> Misalignment:
    """Errors left in a rectification, by name."""
    if text is None:
        return ALIGNED
    where = f"--misalignment {text!r}"
    with located(where):
        pairs = parse_pairs(text, fields_of(Misalignment))
    return read(CalibrationError, pairs, where)  # type: ignore[no-any-return]


def parse_sensor(text: str, cls: type[Sensor] = Sensor) -> Sensor:
    """A sensor in the syntax of SENSOR_HELP: a preset with changed parameters; / separates the numbers of a list."""
    fields = {name: field for name, field in fields_of(cls).items() if field.is_plain}
    preset, colon, rest = text.partition(":")
    where = f"--sensor {text!r}"
    with located(where):
        pairs = parse_pairs(rest, fields) if colon else {}
    return read(settings.sensor_table(cls), {"preset": preset, **pairs}, where)  # type: ignore[no-any-return]


def parse_numbers(
    option: str, text: str, counts: Collection[int], form: str
) -> list[float]:
    """Numbers separated by commas, as many as one of `counts`; `form` describes them in errors."""
    parts = [part.strip() for part in text.split(",")]
    if len(parts) not in counts or not all(
        re.fullmatch(rf"{NUMBER}|[-+]?inf", part) for part in parts
    ):
        raise InputError(f"{option} must be {form}, got {format_value(text)}")
    return [float(part) for part in parts]


def parse_intrinsics(options: Mapping[str, Any]) -> dict[str, Any]:
    """The keys of a rig's table that the options of `twinlens render` set for all cameras.

    >>> parse_intrinsics({"focal_length_px": "700", "sensor_width_mm": "35mm"})
    {'fx': 700.0, 'fy': 700.0, 'sensor_width_mm': 36.0}
    """
    chosen = {name: value for name, value in options.items() if value is not None}
    values: dict[str, Any] = {}
    if "camera" in chosen:
        values["camera"] = {"preset": chosen["camera"]}
    if "focal_length_px" in chosen:
        form = "FX[,FY] in pixels, such as 700 or 700,690"
        focal = parse_numbers(
            "--focal-length-px", chosen["focal_length_px"], (1, 2), form
        )
        values |= {"fx": focal[0], "fy": focal[-1]}
    if "principal_point" in chosen:
        values["cx"], values["cy"] = parse_numbers(
            "--principal-point", chosen["principal_point"], (2,), "CX,CY"
        )
    if "distortion" in chosen:
        model = parse_distortion(chosen["distortion"])
        values["distortion"] = {"model": model.name, **asdict(model)}
    if "pixel_pitch_um" in chosen:
        values["pixel_pitch_um"] = chosen["pixel_pitch_um"]
    if "sensor_width_mm" in chosen:
        text = chosen["sensor_width_mm"]
        with located(f"--sensor-width-mm {text}"):
            values["sensor_width_mm"] = sensor_width_mm(
                float(text) if re.fullmatch(NUMBER, text) else text
            )
    return values


_RIG_KEYS = {
    "fov_x_deg": "fov", "fx": "focal-length-px", "fy": "focal-length-px", "cx": "principal-point",
    "cy": "principal-point", "distortion": "distortion", "pixel_pitch_um": "pixel-pitch-um",
    "sensor_width_mm": "sensor-width-mm", "baseline": "baseline", "camera.preset": "camera", "camera": "camera",
}  # fmt: skip


@contextmanager
def options_named(options: Mapping[str, Any]) -> Iterator[None]:
    """Replace the keys of a rig in its errors by the options that have set them."""
    try:
        yield
    except InputError as error:
        message = str(error)
        for key, option in _RIG_KEYS.items():
            if options[option.replace("-", "_")] is not None:
                message = re.sub(rf"^rig: {key}\b|'{key}'", f"--{option}", message)
        raise type(error)(message.replace("rig: --", "--")) from error
