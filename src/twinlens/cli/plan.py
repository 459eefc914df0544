"""`twinlens plan`: plan a stereo rig."""

import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from twinlens.camera.presets import find_camera
from twinlens.cli.options import POSITIVE, Sectioned, Whole, json_option, print_json
from twinlens.cli.places import FIGURE_FILE, PATH
from twinlens.dataset.files import write_file
from twinlens.errors import InputError
from twinlens.factory import camera_text
from twinlens.optics.planning import RigPlan, plan_rig
from twinlens.optics.rig_task import Light, RigChoice, RigTask
from twinlens.scoring import recipe_toml
from twinlens.sensor import light_on_grey

INFEASIBLE = 1
"""The exit code for a task that no rig meets."""
_SECTIONS = {
    "Known": ("depth", "size", "camera", "fov", "focal_length_mm", "pixel_pitch_um", "sensor_width_mm",
              "disparity_error_px"),
    "Free, or fixed by one number": ("baseline", "f_number", "focus"),
    "Limits": ("depth_error_mm", "blur_px", "airy_px", "overlap", "max_disparities"),
    "Light": ("lux", "longest_exposure", "sensor", "snr"),
    "Output": ("output", "figure", "as_json"),
}  # fmt: skip
_DEPTHS = 5
_Shown = tuple[str, float, str]  # the name of a limit, the factor of its unit, and the unit
_LIMITS: dict[str, _Shown] = {
    "depth error": ("depth error", 1e3, "mm"),
    "blur": ("blur circle", 1, "px"),
    "diffraction": ("Airy disk", 1, "px"),
    "noise": ("exposure", 1e3, "ms"),
    "overlap": ("overlap", 100, "%"),
    "disparities": ("disparities", 1, ""),
    "smallest baseline": ("smallest baseline", 1e3, "mm"),
    "largest baseline": ("largest baseline", 1e3, "mm"),
    "shortest focal length": ("shortest focal length", 1, "mm"),
    "longest focal length": ("longest focal length", 1, "mm"),
    "smallest f-number": ("smallest f-number", 1, ""),
    "largest f-number": ("largest f-number", 1, ""),
}
_FIELDS_OF_VIEW: dict[str, _Shown] = {
    "shortest focal length": ("largest field of view", 1, "degrees"),
    "longest focal length": ("smallest field of view", 1, "degrees"),
}
_ROWS = (
    ("depth error",), ("blur",), ("diffraction",), ("noise",), ("overlap",), ("disparities",),
    ("smallest baseline", "largest baseline"), ("shortest focal length", "longest focal length"),
    ("smallest f-number", "largest f-number"),
)  # fmt: skip
_OPTIONS = {"fov_x_deg": "--fov", "depth_range": "--depth", "depth_error": "--depth-error-mm",
            "focus_distance": "--focus", "least_snr": "--snr", "illuminance_lux": "--lux"}  # fmt: skip


@click.command("plan", cls=Sectioned, sections=_SECTIONS)
@click.option("--depth", required=True, metavar="NEAR,FAR", help="Depths to measure, metres.")
@click.option("--size", help="Image size, WIDTHxHEIGHT.  [default: 640x480, or the camera's]")
@click.option("--camera", help="A camera of `twinlens cameras`: its size, pixels, lens and baseline, unless given.")
@click.option("--fov", metavar="DEG[,DEG]", help="Horizontal field of view, or its least and most, degrees.")
@click.option("--focal-length-mm", metavar="MM[,MM]", help="Focal length of the lens, instead of --fov.")
@click.option("--pixel-pitch-um", type=POSITIVE, help="Pixel width, micrometres.  [default: 5, or the camera's]")
@click.option("--sensor-width-mm", metavar="MM|FORMAT", help=camera_text.SENSOR_WIDTH_HELP)
@click.option("--disparity-error-px", type=POSITIVE, default=0.1, show_default=True,
              help="Standard deviation of the matcher's disparities.")  # fmt: skip
@click.option("--baseline", metavar="M[,M]", help="Baseline, or its least and most, metres.  [default: 0.01,1]")
@click.option("--f-number", metavar="N[,N]", help="Working f-number, or its least and most.  [default: 1.4,16]")
@click.option("--focus", type=POSITIVE, help="Focus distance, metres.  [default: the middle of the disparities]")
@click.option("--depth-error-mm", type=POSITIVE, help="Tolerated depth error.  [default: as small as possible]")
@click.option("--blur-px", type=POSITIVE, default=1.0, show_default=True, help="Largest blur circle.")
@click.option("--airy-px", type=POSITIVE, default=2.5, show_default=True, help="Largest Airy disk.")
@click.option("--overlap", type=float, default=0.6, show_default=True,
              help="Least share of the left image that the right camera sees at the nearest depth.")  # fmt: skip
@click.option("--max-disparities", type=Whole(3, 1_000_000), default=128, show_default=True,
              help="Most disparities that the matcher searches.")  # fmt: skip
@click.option("--lux", type=POSITIVE, help="Illuminance of the scene.  [default: enough light]")
@click.option("--longest-exposure", metavar="S", help="Longest exposure, seconds; with --lux.  [default: 1/50]")
@click.option("--sensor", help=f"With --lux: {camera_text.SENSOR_HELP}  [default: machine_vision]")
@click.option("--snr", type=POSITIVE, help="Least signal-to-noise ratio of mid-grey; with --lux.  [default: 10]")
@click.option("-o", "--output", type=PATH, help="A .toml file for `twinlens render --rig` and for recipes.")
@click.option("--figure", type=FIGURE_FILE, help="Figure of error, blur and disparity against depth, PNG or SVG.")
@json_option("the plan")
def command(output: Path | None, figure: Path | None, as_json: bool, **options: Any) -> int:
    """Plan a stereo rig: baseline, focal length, aperture and focus.

    With --depth-error-mm the best rig has the smallest baseline that meets it over all depths; otherwise the smallest
    depth error. If no rig meets all limits, the command names the changes that help and exits with 1. docs/planning.md
    has the formulas.

    \b
    Example:  twinlens plan --depth 0.5,3 --fov 60 --size 1280x960 --pixel-pitch-um 3.45
              twinlens plan --depth 1,4 --fov 50,70 --depth-error-mm 20 --lux 300 --figure plan.png -o plan.toml
              twinlens plan --depth 0.4,2 --camera realsense-d435
    """
    plan = plan_rig(_task(options))
    if plan.best is not None:
        if output is not None:
            write_file(output, recipe_toml(plan.best.tables).encode())
        if figure is not None:
            from twinlens.report.plan_figure import plan_figure

            write_file(figure, plan_figure(plan, figure.suffix[1:].lower()))
    if as_json:
        print_json(_record(plan))
    else:
        click.echo("\n".join(_infeasible_lines(plan) if plan.best is None else _lines(plan, plan.best)))
    return INFEASIBLE if plan.best is None else 0


def _task(options: Mapping[str, Any]) -> RigTask:
    given = {name: value for name, value in options.items() if value is not None}
    depths = camera_text.parse_numbers("--depth", given["depth"], (2,), "NEAR,FAR in metres, such as 0.5,3")
    known = {"depth_range": (depths[0], depths[1]), **_camera(given)}
    for name in ("fov", "focal_length_mm", "baseline", "f_number"):
        if name in given:
            known[name] = _range(f"--{name.replace('_', '-')}", given[name])
    if "fov" in known:
        known["fov_x_deg"] = known.pop("fov")
        if "focal_length_mm" not in given:
            known.pop("focal_length_mm", None)  # the camera's
    if "depth_error_mm" in given:
        known["depth_error"] = 1e-3 * given["depth_error_mm"]
    if "focus" in given:
        known["focus_distance"] = given["focus"]
    same = ("disparity_error_px", "blur_px", "airy_px", "overlap", "max_disparities")
    try:
        return RigTask(**known, **{name: given[name] for name in same}, light=_light(given, known["pixel_pitch_um"]))
    except InputError as error:
        field, _, rest = str(error).partition(" ")
        if field == "give":
            raise InputError("give exactly one of --fov and --focal-length-mm, or a --camera") from error
        option = f"--{field.replace('_', '-')}" if field in known | given else field
        raise InputError(f"{_OPTIONS.get(field, option)} {rest}") from error


def _camera(given: Mapping[str, Any]) -> dict[str, Any]:
    """Size and pixel pitch; of a preset also its lens and baseline."""
    width, height = camera_text.parse_size(given.get("size"), given.get("camera"))
    known: dict[str, Any] = {"width": width, "height": height, "pixel_pitch_um": 5.0}
    if "camera" in given:
        preset = find_camera(given["camera"])
        camera = preset.resized(width, height)
        known |= {"pixel_pitch_um": camera.pixel_pitch_um, "focal_length_mm": 1e3 * camera.film_distance}
        known |= {name: value for name in ("baseline", "f_number") if (value := getattr(preset, name)) is not None}
    pixel = ("pixel_pitch_um", "sensor_width_mm")
    intrinsics = camera_text.parse_intrinsics({name: given[name] for name in pixel if name in given})
    if len(intrinsics) > 1:
        raise InputError("--pixel-pitch-um and --sensor-width-mm exclude each other")
    if "sensor_width_mm" in intrinsics:
        intrinsics = {"pixel_pitch_um": 1e3 * intrinsics["sensor_width_mm"] / width}
    return known | intrinsics


def _light(given: Mapping[str, Any], pixel_pitch_um: float) -> Light | None:
    if "lux" not in given:
        for name in ("longest_exposure", "sensor", "snr"):
            if name in given:
                raise InputError(f"--{name.replace('_', '-')} needs --lux")
        return None
    text = given.get("longest_exposure", "1/50")
    exposure = camera_text.parse_exposure(text)
    if exposure is None or exposure.gain != 1:
        raise InputError(f"--longest-exposure must be seconds, such as 1/50, got {text!r}")
    sensor = camera_text.parse_sensor(given.get("sensor", "machine_vision"))
    return light_on_grey(sensor, given["lux"], pixel_pitch_um, exposure.time, given.get("snr", 10.0))


def _range(option: str, text: str) -> Any:
    numbers = camera_text.parse_numbers(option, text, (1, 2), "one number, or the least and the most, such as 2,4")
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def _record(plan: RigPlan) -> dict[str, Any]:
    record = {"task": asdict(plan.task), "objective": plan.objective, "feasible": plan.best is not None}
    record |= {"limits": plan.limits, "used": plan.used, "ranges": plan.feasible, "binding": plan.binding}
    record |= {"reasons": plan.reasons, "changes": plan.changes, "best": None}
    if (best := plan.best) is not None:
        names = (
            "baseline", "fx", "focal_length", "fov_x_deg", "f_number", "aperture_diameter", "focus_distance",
            "depth_of_field", "hyperfocal_distance", "airy_px", "search", "smallest_distance",
        )  # fmt: skip
        depths = _depths(best)
        curves = {name: getattr(best, name)(depths) for name in ("disparity", "depth_error", "blur_px", "overlap")}
        record["best"] = {name: getattr(best, name) for name in names} | {"depths": depths, **curves}
    return record


def _depths(best: RigChoice) -> Any:
    """Depths at equal steps of disparity, the nearest first."""
    near, far = best.task.depth_range
    return 1 / np.linspace(1 / near, 1 / far, _DEPTHS)


def _lines(plan: RigPlan, best: RigChoice) -> list[str]:
    task, (near, far) = plan.task, best.depth_of_field
    least, count = best.search
    distance, limit = best.smallest_distance
    until = "infinity" if far == math.inf else f"{far:.3g} m"
    goal = "depth error" if task.depth_error is None else "baseline that meets the tolerated depth error"
    facts = {
        "baseline": f"{1e3 * best.baseline:.4g} mm",
        "focal length": f"{1e3 * best.focal_length:.4g} mm, fx {best.fx:.5g} px, field of view {best.fov_x_deg:.4g} "
        "degrees",
        "aperture": f"f/{best.f_number:.3g}, {1e3 * best.aperture_diameter:.3g} mm",
        "focus": f"{best.focus_distance:.4g} m; blur circle <= {task.blur_px:g} px from {near:.3g} m to {until}; "
        f"hyperfocal distance {best.hyperfocal_distance:.3g} m",
        "disparities": f"match --min-disparity {least} --num-disparities {count}; "
        f"{task.width * task.height * count / 1e6:.3g} million costs",
        "smallest distance": f"{distance:.3g} m, limited by {_LIMITS[limit][0]}",
    }
    if task.light is not None:
        time = task.light.exposure(best.f_number)
        ratio = task.light.snr(task.light.electrons_per_second * time / best.f_number**2)
        facts["exposure"] = f"{1e3 * time:.3g} ms, signal-to-noise ratio of mid-grey {ratio:.3g}"
    lines = [f"Best rig: the smallest {goal}", *(f"  {name:<18}{text}" for name, text in facts.items())]
    lines += ["", f"  {'depth':>8}{'disparity':>12}{'depth error':>14}{'blur circle':>14}{'overlap':>10}"]
    for z in _depths(best):
        error, blur = f"{1e3 * best.depth_error(z):.3g} mm", f"{best.blur_px(z):.2f} px"
        disparity, overlap = f"{best.disparity(z):.1f} px", f"{100 * best.overlap(z):.0f} %"
        lines.append(f"  {f'{z:.3g} m':>8}{disparity:>12}{error:>14}{blur:>14}{overlap:>10}")
    lines += ["", f"  {'limit':<16}{'used':>14}  allowed"]
    lines += [_limit_line(plan, *names) for names in _ROWS if names[0] in plan.limits]
    spans = {
        "baseline": (1e3, "mm"), "focal_length_mm": (1, "mm"), "f_number": (1, ""), "focus_distance": (1, "m"),
    }  # fmt: skip
    texts = []
    for name, (factor, unit) in spans.items():
        low, high = (f"{factor * end:.4g}" for end in plan.feasible[name])
        label = name.removesuffix("_mm").replace("f_n", "f-n").replace("_", " ")
        texts.append(f"{label} {low if low == high else f'{low} to {high}'} {unit}".rstrip())
    return [*lines, "", f"  Feasible: {', '.join(texts)}"]


def _limit_line(plan: RigPlan, *names: str) -> str:
    """The row of a limit, or of the two ends of a range."""
    label, used = _value(plan, names[0], plan.used[names[0]])
    bounds = sorted((plan.limits[name], _value(plan, name, plan.limits[name])[1]) for name in names)
    allowed = f"{bounds[0][1].split()[0]} to {bounds[-1][1]}"
    if bounds[0] == bounds[-1]:
        allowed = f"fixed at {bounds[0][1]}"
    if len(names) == 1:
        allowed = f"{'at least' if names[0] == 'overlap' else 'at most'} {bounds[0][1]}"
    notes = []
    for name in names:
        if gain := plan.binding.get(name):
            which = f"{_value(plan, name, gain)[0]} binds" if len(names) > 1 else "binds"
            notes.append(f"{which}: 10 % looser gives {100 * gain:.1f} % less {plan.objective}")
    label = label.removeprefix("smallest ").removeprefix("largest ").removeprefix("shortest ")
    return f"  {label:<16}{used:>14}  {allowed:<22}{' '.join(notes)}".rstrip()


def _infeasible_lines(plan: RigPlan) -> list[str]:
    lines = ["Infeasible: no baseline, focal length and f-number meet all limits.", *(f"  {r}" for r in plan.reasons)]
    each = "both changes" if len(plan.changes[0]) == 2 else "all changes" if len(plan.changes[0]) > 2 else "the change"
    lines += ["", f"Feasible with {each} of one line:"]
    for change in plan.changes:
        parts = []
        for name, value in change.items():
            label, needed = _value(plan, name, value, outwards=True)
            parts.append(f"{label} {needed} instead of {_value(plan, name, plan.limits[name])[1]}")
        lines.append(f"  {' and '.join(parts)}")
    return lines


def _value(plan: RigPlan, name: str, value: float, outwards: bool = False) -> tuple[str, str]:
    """The label and the value of a limit; with `outwards` rounded to the looser side."""
    label, factor, unit = (_FIELDS_OF_VIEW if plan.task.fov_x_deg is not None else {}).get(name, _LIMITS[name])
    number = factor * value
    if outwards and number:
        step = 10.0 ** (math.floor(math.log10(number)) - 2)
        number = step * (math.floor if plan.limits[name] > value else math.ceil)(number / step)
    if name == "disparities":
        number = math.ceil(number - 1e-9)
    return label, f"{number:.4g} {unit}".rstrip()
