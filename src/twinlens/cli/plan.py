"""`twinlens plan`: plan a stereo rig."""

from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from twinlens.camera.presets import find_camera
from twinlens.cli.options import (
    POSITIVE,
    Sectioned,
    json_option,
    print_json,
    setting,
)
from twinlens.cli.places import FIGURE_FILE, TOML_FILE
from twinlens.dataset.files import write_file
from twinlens.errors import InputError
from twinlens.factory import camera_text
from twinlens.optics import fov_x_deg
from twinlens.optics.planning import RigPlan, plan_rig
from twinlens.optics.rig_task import Light, RigTask
from twinlens.report.plan_text import even_depths, plan_text
from twinlens.scoring import recipe_toml
from twinlens.sensor import light_on_grey

INFEASIBLE = 1
"""The exit code for a task that no rig meets."""
_SECTIONS = {
    "Known": ("depth", "size", "camera", "fov", "focal_length_mm", "pixel_pitch_um", "sensor_width_mm",
              "disparity_error_px"),
    "Free, or fixed by one number": ("baseline", "f_number", "focus_distance"),
    "Limits": ("depth_error_mm", "blur_px", "airy_px", "overlap", "max_disparities"),
    "Light": ("lux", "longest_exposure", "sensor", "least_snr"),
    "Output": ("output", "figure", "as_json"),
}  # fmt: skip
_OPTIONS = {"fov_x_deg": "--fov", "depth_range": "--depth", "depth_error": "--depth-error-mm",
            "focus_distance": "--focus", "least_snr": "--snr", "illuminance_lux": "--lux"}  # fmt: skip


@click.command("plan", cls=Sectioned, sections=_SECTIONS)
@click.option(
    "--depth", required=True, metavar="NEAR,FAR", help="Depths to measure, metres."
)
@click.option(
    "--size", help="Image size, WIDTHxHEIGHT.  [default: 640x480, or the camera's]"
)
@click.option(
    "--camera",
    help="A camera of `twinlens cameras`: its size, pixels, lens and baseline, unless given.",
)
@click.option(
    "--fov",
    metavar="DEG[,DEG]",
    help="Horizontal field of view, or its least and most, degrees.",
)
@click.option(
    "--focal-length-mm",
    metavar="MM[,MM]",
    help="Focal length of the lens, instead of --fov.",
)
@setting(RigTask, "pixel_pitch_um", note="default: 5, or the camera's")
@click.option(
    "--sensor-width-mm", metavar="MM|FORMAT", help=camera_text.SENSOR_WIDTH_HELP
)
@setting(RigTask, "disparity_error_px", default=RigTask.disparity_error_px)
@click.option(
    "--baseline",
    metavar="M[,M]",
    help="Baseline, or its least and most, metres.  [default: 0.01,1]",
)
@click.option(
    "--f-number",
    metavar="N[,N]",
    help="Working f-number, or its least and most.  [default: 1.4,16]",
)
@setting(
    RigTask,
    "focus_distance",
    "--focus",
    note="default: the middle of the disparities",
)
@click.option(
    "--depth-error-mm",
    type=POSITIVE,
    help="Tolerated depth error.  [default: as small as possible]",
)
@setting(RigTask, "blur_px", default=RigTask.blur_px)
@setting(RigTask, "airy_px", default=RigTask.airy_px)
@setting(RigTask, "overlap", default=RigTask.overlap)
@setting(RigTask, "max_disparities", default=RigTask.max_disparities)
@click.option(
    "--lux", type=POSITIVE, help="Illuminance of the scene.  [default: enough light]"
)
@click.option(
    "--longest-exposure",
    metavar="S",
    help="Longest exposure, seconds; with --lux.  [default: 1/50]",
)
@click.option(
    "--sensor", help=f"With --lux: {camera_text.SENSOR_HELP}  [default: machine_vision]"
)
@setting(Light, "least_snr", "--snr", note="with --lux; default: 10")
@click.option(
    "-o",
    "--output",
    type=TOML_FILE,
    help="A .toml file for `twinlens render --rig` and for recipes.",
)
@click.option(
    "--figure",
    type=FIGURE_FILE,
    help="Figure of error, blur and disparity against depth, PNG or SVG.",
)
@json_option("the plan")
def command(
    output: Path | None, figure: Path | None, as_json: bool, **options: Any
) -> int:
    """Plan a stereo rig: baseline, focal length, aperture and focus.

    With --depth-error-mm the best rig has the smallest baseline that meets it over all depths; otherwise the smallest
    depth error. If no rig meets all limits, the command names the changes that help, writes no file, and exits with 1.
    docs/planning.md has the formulas.

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
        click.echo(plan_text(plan))
    return INFEASIBLE if plan.best is None else 0


def _task(options: Mapping[str, Any]) -> RigTask:
    chosen = {name: value for name, value in options.items() if value is not None}
    depths = camera_text.parse_numbers(
        "--depth", chosen["depth"], (2,), "NEAR,FAR in metres, such as 0.5,3"
    )
    values = {"depth_range": (depths[0], depths[1]), **_camera(chosen)}
    for name in ("fov", "focal_length_mm", "baseline", "f_number"):
        if name in chosen:
            values[name] = _range(f"--{name.replace('_', '-')}", chosen[name])
    if "focal_length_mm" in values:
        values.pop("fov_x_deg", None)  # the camera's
    if "fov" in values:
        values["fov_x_deg"] = values.pop("fov")
    if "depth_error_mm" in chosen:
        values["depth_error"] = 1e-3 * chosen["depth_error_mm"]
    same = (
        "focus_distance",
        "disparity_error_px",
        "blur_px",
        "airy_px",
        "overlap",
        "max_disparities",
    )
    try:
        return RigTask(
            **values,
            **{name: chosen[name] for name in same if name in chosen},
            light=_light(chosen, values["pixel_pitch_um"]),
        )
    except InputError as error:
        message = str(error).removeprefix("rig ").removeprefix("light ")
        field, _, rest = message.partition(" ")
        if field == "give":
            raise InputError(
                "give exactly one of --fov and --focal-length-mm, or a --camera"
            ) from error
        option = f"--{field.replace('_', '-')}" if field in values | chosen else field
        raise InputError(f"{_OPTIONS.get(field, option)} {rest}") from error


def _camera(chosen: Mapping[str, Any]) -> dict[str, Any]:
    """Size and pixel pitch; of a preset also its lens and baseline."""
    width, height = camera_text.parse_size(chosen.get("size"), chosen.get("camera"))
    values: dict[str, Any] = {"width": width, "height": height, "pixel_pitch_um": 5.0}
    if "camera" in chosen:
        preset = find_camera(chosen["camera"])
        camera = preset.resized(width, height)
        values |= {
            "pixel_pitch_um": camera.pixel_pitch_um,
            "fov_x_deg": fov_x_deg(width, camera.fx),
        }
        values |= {
            name: value
            for name in ("baseline", "f_number")
            if (value := getattr(preset, name)) is not None
        }
    pixel = ("pixel_pitch_um", "sensor_width_mm")
    intrinsics = camera_text.parse_intrinsics(
        {name: chosen[name] for name in pixel if name in chosen}
    )
    if len(intrinsics) > 1:
        raise InputError("--pixel-pitch-um and --sensor-width-mm exclude each other")
    if "sensor_width_mm" in intrinsics:
        intrinsics = {"pixel_pitch_um": 1e3 * intrinsics["sensor_width_mm"] / width}
    return values | intrinsics


def _light(chosen: Mapping[str, Any], pixel_pitch_um: float) -> Light | None:
    if "lux" not in chosen:
        options = {"longest_exposure": "--longest-exposure", "sensor": "--sensor"}
        for name, option in {**options, "least_snr": "--snr"}.items():
            if name in chosen:
                raise InputError(f"{option} needs --lux")
        return None
    text = chosen.get("longest_exposure", "1/50")
    exposure = camera_text.parse_exposure(text)
    if exposure is None or exposure.gain != 1:
        raise InputError(
            f"--longest-exposure must be seconds, such as 1/50, got {text!r}"
        )
    sensor = camera_text.parse_sensor(chosen.get("sensor", "machine_vision"))
    return light_on_grey(
        sensor,
        chosen["lux"],
        pixel_pitch_um,
        exposure.time,
        chosen.get("least_snr", 10.0),
    )


def _range(option: str, text: str) -> Any:
    numbers = camera_text.parse_numbers(
        option, text, (1, 2), "one number, or the least and the most, such as 2,4"
    )
    return numbers[0] if len(numbers) == 1 else (numbers[0], numbers[1])


def _record(plan: RigPlan) -> dict[str, Any]:
    record = {
        "task": asdict(plan.task),
        "objective": plan.objective,
        "feasible": plan.best is not None,
    }
    record |= {
        "limits": plan.limits,
        "used": plan.used,
        "ranges": plan.feasible,
        "binding": plan.binding,
    }
    record |= {"reasons": plan.reasons, "changes": plan.changes, "best": None}
    if (best := plan.best) is not None:
        names = (
            "baseline", "fx", "focal_length", "fov_x_deg", "f_number", "aperture_diameter", "focus_distance",
            "depth_of_field", "hyperfocal_distance", "airy_px", "search", "smallest_distance", "exposure", "snr",
        )  # fmt: skip
        depths = even_depths(best)
        curves = {
            name: getattr(best, name)(depths)
            for name in ("disparity", "depth_error", "blur_px", "overlap")
        }
        record["best"] = {name: getattr(best, name) for name in names} | {
            "depths": depths,
            **curves,
        }
    return record
