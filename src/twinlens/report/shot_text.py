"""What the lens and the exposure of a sample do, as text: depth of field, blur, depth error, time and gain."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from twinlens import optics
from twinlens.dataset import Sample
from twinlens.geometry import depth_error
from twinlens.optics.rig_task import RigTask

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
    lens, fx, rig = sample.shots[k].lens, sample.rig.cameras[0].fx, sample.rig.nominal
    depth = sample.truths[0].depth[sample.truths[0].hit]
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
    shot = sample.shots[k]
    taken = shot.record["exposures"][0]
    number = taken["working_f_number"]
    exposure = f"{_format_time(taken['time_s'])}, gain {taken['gain']:.3g}"
    exposure += _format_noise(sample, k)
    if shot.lens.aperture_diameter == 0:
        return f"{text}: exposed as f/{number:g}, {exposure}"
    shown = f"{number:.0f}" if 99.5 <= number < 1e5 else f"{number:.2g}"
    line = f"{text}: f/{shown}, {exposure}"
    if number >= _FASTEST or shot.lens.is_bare:
        return line
    line += " (the blur is as specified, but no lens on the market is this fast"
    if text.startswith("f/"):
        return f"{line})"  # an f-number does not depend on the size of the sensor
    camera = sample.rig.cameras[0]
    width = 1e-3 * camera.width * camera.pixel_pitch_um
    remedy = f"--sensor-width-mm {width * 1.4 / number:.2g} gives f/1.4"
    return f"{line}: this sensor is {width:.3g} mm wide; {remedy})"


def _format_time(seconds: float) -> str:
    """An exposure time as photographers write it: 12 us, 1/60 s, 0.5 s."""
    if seconds < 1e-4:
        return f"{1e6 * seconds:.3g} us"
    return f"1/{1 / seconds:.0f} s" if seconds < 0.1 else f"{seconds:.3g} s"


def _format_noise(sample: Sample, k: int) -> str:
    """The noise of the renderer beside that of the sensor; empty if it was not measured."""
    record = sample.shots[k].record
    ratios = record.get("light_paths_over_sensor")
    if not ratios:
        return ""
    largest, limit = max(ratios), sample.record["noise"]
    noise = f", renderer noise {largest:.2g} x sensor noise, {record['spp']} samples"
    if limit is not None and largest > limit:
        noise += f" (limit {limit:g} not met)"
    return noise
