"""`twinlens cameras`: the cameras that rigs and recipes know by name, and what a calibration file holds."""

import math
from pathlib import Path
from typing import Any

import click
from scipy.spatial.transform import Rotation

from twinlens.calibrations import NamedRig, doubt_of_lengths, read_rig
from twinlens.camera import BrownConrady, Camera, Rig
from twinlens.camera.film import SENSOR_WIDTHS_MM
from twinlens.camera.presets import CAMERAS
from twinlens.camera.rectification import rectify
from twinlens.cli.options import json_option, print_json, print_result
from twinlens.cli.places import PATH
from twinlens.errors import InputError, counted
from twinlens.factory.camera_text import parse_size
from twinlens.geometry import Float


@click.command("cameras")
@click.option(
    "--read",
    "files",
    type=PATH,
    multiple=True,
    metavar="FILE",
    help="Print the cameras of a calibration file as `render --rig` understands them; give it twice for two files.",
)
@click.option(
    "--size",
    metavar="WIDTHxHEIGHT",
    help="Of the images, for a file without it.",
)
@json_option("every camera with its source, or those of the file")
def command(files: tuple[Path, ...], size: str | None, as_json: bool) -> None:
    """List the cameras for `[camera]` in recipes and rigs, with the sources of their figures, and the sensor formats.

    With --read, print what a calibration file holds: image sizes, fields of view, distortion, and each camera's place
    in the axes of the first: x right, y down, z forward. Files of OpenCV, ROS, Kalibr, EuRoC, COLMAP,
    transforms.json, Middlebury's calib.txt and a rig's .toml are read.

    \b
    Example:  twinlens cameras
              twinlens cameras --read stereo.yml
              twinlens cameras --read left.yaml --read right.yaml
    """
    if size and not files:
        raise InputError("--size is of the images of a file; name the file by --read")
    if files:
        rig = read_rig(*files, size=parse_size(size) if size else None)
        print_result(as_json, _record(rig), *_described(rig, files))
        return
    cameras = [preset.reference(name) for name, preset in CAMERAS.items()]
    if as_json:
        print_json({"cameras": cameras, "sensor_widths_mm": SENSOR_WIDTHS_MM})
        return
    for camera in cameras:
        size_text = f"{camera['width']}x{camera['height']} pixels of {camera['pixel_pitch_um']:g} um"
        lens = f"{camera['focal_length_mm']:.4g} mm" + (
            f" f/{camera['f_number']:g}" if camera["f_number"] else ""
        )
        baseline = (
            [f"baseline {1e3 * camera['baseline']:g} mm"] if camera["baseline"] else []
        )
        click.echo(f"{camera['name']}: {camera['description']}")
        click.echo(
            "  "
            + ", ".join(
                [size_text, lens, f"{camera['fov_x_deg']:.1f} degrees", *baseline]
            )
        )
        click.echo(f"  Source: {camera['source']}")
    formats = ", ".join(
        f"{name} ({width:g} mm)" for name, width in SENSOR_WIDTHS_MM.items()
    )
    click.echo(f"\nSensor formats and their widths: {formats}")


def _record(named: NamedRig) -> dict[str, Any]:
    """What a calibration holds, as plain values."""
    cameras = []
    for i, (name, camera) in enumerate(
        zip(named.names, named.rig.cameras, strict=True)
    ):
        first_from_cam = named.rig.b_from_a(i, 0)
        cameras.append(
            {
                "name": name,
                **{key: getattr(camera, key) for key in ("width", "height")},
                **{key: getattr(camera, key) for key in ("fx", "fy", "cx", "cy")},
                "distortion": camera.distortion and camera.distortion.name,
                "field_deg": _fields_of_view(camera),
                "translate": first_from_cam[:3, 3].tolist(),
                "euler_deg": _euler_deg(first_from_cam),
                "distance": math.dist(first_from_cam[:3, 3], (0, 0, 0)),
            }
        )
    record: dict[str, Any] = {"cameras": cameras, "is_rectified": _is_rectified(named)}
    if record["is_rectified"]:
        record["doffs"] = named.rig.doffs()
    if named.ndisp is not None:
        record["ndisp"] = named.ndisp
    return record


def _is_rectified(named: NamedRig) -> bool:
    return len(named.rig) == 2 and named.rig.is_rectified()


def _fields_of_view(camera: Camera) -> list[float]:
    """Degrees from edge to edge of the image, along the row and the column of the principal point."""
    left, right = camera.rays([[-0.5, camera.cy], [camera.width - 0.5, camera.cy]])
    top, bottom = camera.rays([[camera.cx, -0.5], [camera.cx, camera.height - 0.5]])
    # A fisheye may see more than 180 degrees: angles are measured from the axis, in the plane of x or y and z.
    across = math.atan2(right[0], right[2]) - math.atan2(left[0], left[2])
    down = math.atan2(bottom[1], bottom[2]) - math.atan2(top[1], top[2])
    return [math.degrees(across), math.degrees(down)]


def _euler_deg(pose: Float) -> list[float]:
    """Turns about the fixed axes x, then y, then z, as `euler_deg` of a rig's table has them."""
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
    return [float(angle) for angle in angles]


def _described(named: NamedRig, files: tuple[Path, ...]) -> list[str]:
    """What a calibration holds, in lines."""
    record = _record(named)
    cameras = record["cameras"]
    lines = [f"{', '.join(map(str, files))}: {counted(len(cameras), 'camera')}"]
    for i, camera in enumerate(cameras):
        lines += _intrinsics_lines(i, camera)
        if i:
            lines.append(_place_line(camera))
    lines.append(
        "The centre of the first pixel is at 0 here and in OpenCV's files, at 0.5 in COLMAP's and transforms.json."
    )
    if doubt := doubt_of_lengths(named, [str(file) for file in files]):
        lines.append(f"{doubt[0].upper()}{doubt[1:]}.")
    may_be_fisheye = any(map(_may_be_fisheye, named.rig.cameras))
    if may_be_fisheye and not named.has_model:
        lines.append(
            "Read as k1 k2 p1 p2. If the coefficients are those of cv2.fisheye, name the file in a rig's .toml: "
            'file = "...", fisheye = true.'
        )
    wide = [str(i) for i, camera in enumerate(named.rig.cameras) if camera.is_wide]
    if wide:
        lines.append(
            "Not for samples, which hold depth along the axis: cameras that see 90 degrees or more from theirs "
            f"({', '.join(wide)}). Crop their images: a smaller width and height, and cx and cy less by what is cut "
            "left and above. `tl.render` takes them as they are."
        )
    elif len(cameras) == 2 and not record["is_rectified"]:
        lines.append(_rectify_line(named))
    if record["is_rectified"]:
        lines.append(_rectified_line(record))
    return lines


def _rectified_line(record: dict[str, Any]) -> str:
    """That a pair is rectified, and the numbers that only such a pair has."""
    parts = [f"A rectified pair: doffs = cx1 - cx0 = {record['doffs']:.6g} px"]
    if "ndisp" in record:
        parts.append(
            f"ndisp = {record['ndisp']}, of the file's own scene: another one has other disparities"
        )
    return "; ".join(parts) + "."


def _may_be_fisheye(camera: Camera) -> bool:
    """Whether a distortion has the four coefficients k1 k2 p1 p2, as many as a fisheye's."""
    distortion = camera.distortion
    return (
        isinstance(distortion, BrownConrady)
        and not any(distortion.coefficients[4:])
        and any(distortion.coefficients[2:4])
    )


def _rectify_line(named: NamedRig) -> str:
    try:
        rectify(named.rig)
    except InputError as error:
        if _can_be_exchanged(named.rig):
            return (
                "Not a rectified pair: camera 1 is left of camera 0. `twinlens rectify --cameras 1,0` makes one of "
                "each sample, with disparities; or exchange the cameras in the calibration."
            )
        return f"Not a rectified pair, and none can be made of it: {error}."
    return "Not a rectified pair: `twinlens rectify` makes one of each sample, with disparities."


def _can_be_exchanged(rig: Rig) -> bool:
    try:
        rectify(rig, left=1, right=0)
    except InputError:
        return False
    return True


def _intrinsics_lines(i: int, camera: dict[str, Any]) -> list[str]:
    across, down = camera["field_deg"]
    size = f"{camera['width']}x{camera['height']} pixels"
    model = camera["distortion"] or "no"
    focal = f"fx {camera['fx']:.6g}, fy {camera['fy']:.6g}"
    centre = f"cx {camera['cx']:.6g}, cy {camera['cy']:.6g}"
    return [
        f"camera {i} ({camera['name']}): {size}, {across:.1f} x {down:.1f} degrees, {model} distortion",
        f"  {focal}, {centre} px",
    ]


def _place_line(camera: dict[str, Any]) -> str:
    right, down, forward = map(_metres, camera["translate"])
    turns = ", ".join(f"{round(angle, 4) + 0.0:g}" for angle in camera["euler_deg"])
    return (
        f"  {_metres(camera['distance'])} m from camera 0: {right} right, {down} down, {forward} forward; "
        f"turned by euler_deg = [{turns}] (about x, then y, then z)"
    )


def _metres(length: float) -> str:
    """A length to the micrometre, which is finer than a calibration is; files keep all digits."""
    return f"{round(length, 6) + 0.0:g}"  # adding zero makes -0.0 positive
