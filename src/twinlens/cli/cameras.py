"""`twinlens cameras`: the cameras that rigs and recipes know by name."""

import click

from twinlens.camera.film import SENSOR_WIDTHS_MM
from twinlens.camera.presets import CAMERAS
from twinlens.cli.options import json_option, print_json


@click.command("cameras")
@json_option("every camera with its source")
def command(as_json: bool) -> None:
    """List the cameras for `[camera]` in recipes and rigs, with the sources of their figures, and the sensor formats.

    \b
    Example:  twinlens cameras
    """
    cameras = [preset.reference(name) for name, preset in CAMERAS.items()]
    if as_json:
        print_json({"cameras": cameras, "sensor_widths_mm": SENSOR_WIDTHS_MM})
        return
    for camera in cameras:
        size = f"{camera['width']}x{camera['height']} pixels of {camera['pixel_pitch_um']:g} um"
        lens = f"{camera['focal_length_mm']:.4g} mm" + (
            f" f/{camera['f_number']:g}" if camera["f_number"] else ""
        )
        baseline = (
            [f"baseline {1e3 * camera['baseline']:g} mm"] if camera["baseline"] else []
        )
        click.echo(f"{camera['name']}: {camera['description']}")
        click.echo(
            "  "
            + ", ".join([size, lens, f"{camera['fov_x_deg']:.1f} degrees", *baseline])
        )
        click.echo(f"  Source: {camera['source']}")
    formats = ", ".join(
        f"{name} ({width:g} mm)" for name, width in SENSOR_WIDTHS_MM.items()
    )
    click.echo(f"\nSensor formats and their widths: {formats}")
