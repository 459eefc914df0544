"""Sizes, lenses, apertures, distortions, exposures and sensors as command-line options write them.

Each `_HELP` text shows the syntax of its option. Texts are read as the tables of a recipe are; errors begin with the
option's name.
"""

import math
import re
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from typing import Any

import numpy as np

from twinlens import optics
from twinlens.camera import (
    ALIGNED,
    BrownConrady,
    Distortion,
    KannalaBrandt,
    Misalignment,
)
from twinlens.camera.film import SENSOR_WIDTHS_MM, sensor_width_mm
from twinlens.camera.presets import find_camera
from twinlens.dataset import Sample
from twinlens.errors import InputError, format_value, located, unknown
from twinlens.factory import settings
from twinlens.geometry import depth_error
from twinlens.optics.rig_task import RigTask
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


TYPICAL_DISPARITY_ERROR = RigTask.disparity_error_px
"""Pixels, standard deviation: about twice that of ZNCC on fine texture without noise."""


def optics_of(sample: Sample, k: int) -> dict[str, Any]:
    """What lens k does with the depths of the first view, metres and pixels.

    depths : the nearest and the farthest; None if the view is empty, as are `blur_px` and `depth_error` at them.
    blur_px : on the axis.
    depth_of_field, hyperfocal_distance : for a blur circle of one pixel; None for a lens that does not know them, the
        latter also without a lens.
    depth_error : for `TYPICAL_DISPARITY_ERROR`; None also unless the first two cameras are a rectified pair.
    """
    lens, camera, rig = sample.shots[k].lens, sample.rig.cameras[0], sample.rig.nominal
    fx, depth = camera.fx, sample.truths[0].depth[sample.truths[0].hit]
    depths = lens.depth_of_field(fx)
    is_focused = depths is not None and not lens.is_bare
    effects: dict[str, Any] = {
        "depths": None, "blur_px": None, "depth_error": None,
        "depth_of_field": depths,
        "hyperfocal_distance": optics.hyperfocal_distance(lens.aperture_diameter, fx) if is_focused else None,
    }  # fmt: skip
    if depth.size:
        ends = [float(depth.min()), float(depth.max())]
        blur = np.abs(lens.blur_px(ends, fx))
        effects |= {"depths": ends, "blur_px": blur.tolist()}
        if sample.is_rectified:
            effects["depth_error"] = depth_error(
                ends, fx, rig.baseline(), TYPICAL_DISPARITY_ERROR
            ).tolist()
    return effects


def format_optics(effects: Mapping[str, Any]) -> str:
    """Depth of field, hyperfocal distance and blur of `optics_of`."""
    parts = []
    if effects["depth_of_field"] is not None:
        near, far = effects["depth_of_field"]
        if near == 0:
            return "sharp at every depth"
        parts.append(_format_sharp(near, far))
    if effects["hyperfocal_distance"] is not None:
        parts.append(f"hyperfocal distance {effects['hyperfocal_distance']:.3g} m")
    if effects["depths"] is not None:
        parts.append(f"blur circle {_at_depths(effects, 'blur_px', 'px', 2)}")
    return ", ".join(parts)


def _format_sharp(near: float, far: float) -> str:
    if near == math.inf:
        return "not sharp to 1 px at any depth"
    until = "infinity" if far == math.inf else f"{far:.3g} m"
    return f"sharp to 1 px from {near:.3g} m to {until}"


def format_depth_error(effects: Mapping[str, Any]) -> str:
    """The expected depth error of `optics_of`; empty if it is unknown."""
    if effects["depth_error"] is None:
        return ""
    millimetres = {
        **effects,
        "depth_error": [1e3 * error for error in effects["depth_error"]],
    }
    errors = _at_depths(millimetres, "depth_error", "mm", 3)
    return (
        f"depth error {errors}, for a disparity error of {TYPICAL_DISPARITY_ERROR:g} px"
    )


def _at_depths(effects: Mapping[str, Any], name: str, unit: str, digits: int) -> str:
    pairs = zip(effects[name], effects["depths"], strict=True)
    return " and ".join(
        f"{value:.{digits}g} {unit} at {depth:.3g} m" for value, depth in pairs
    )


_FASTEST = 0.95
"""The smallest f-number of photographic lenses on the market; an indication, not a limit."""


def format_exposure(sample: Sample, k: int, text: str) -> str:
    """F-number, time and gain of lens k, which the option `text` describes; and whether such a lens can be bought."""
    shot, camera = sample.shots[k], sample.rig.cameras[0]
    taken = shot.record["exposures"][0]
    number, time, gain = taken["working_f_number"], taken["time_s"], taken["gain"]
    if time < 1e-4:
        duration = f"{1e6 * time:.3g} us"
    else:
        duration = f"1/{1 / time:.0f} s" if time < 0.1 else f"{time:.3g} s"
    exposure = f"{duration}, gain {gain:.3g}"
    if ratios := shot.record.get("light_paths_over_sensor"):
        exposure += f", renderer noise {max(ratios):.2g} x sensor noise, {shot.record['spp']} samples"
        if (bound := sample.record["noise"]) is not None and max(ratios) > bound:
            exposure += f" (limit {bound:g} not met)"
    if shot.lens.aperture_diameter == 0:
        return f"{text}: exposed as f/{number:g}, {exposure}"
    shown = f"{number:.0f}" if 99.5 <= number < 1e5 else f"{number:.2g}"
    line = f"{text}: f/{shown}, {exposure}"
    if number >= _FASTEST or shot.lens.is_bare:
        return line
    line += " (the blur is as specified, but no lens on the market is this fast"
    if text.startswith("f/"):  # independent of the sensor's size
        return f"{line})"
    width = 1e-3 * camera.width * camera.pixel_pitch_um
    return f"{line}: this sensor is {width:.3g} mm wide; --sensor-width-mm {width * 1.4 / number:.2g} gives f/1.4)"
