"""`twinlens render`: render scenes as samples of a dataset."""

from pathlib import Path
from typing import Any, NamedTuple

import click
from click.core import ParameterSource

from twinlens.camera import Camera, RecipeLens, Rig
from twinlens.cli.options import (
    POSITIVE,
    Sectioned,
    json_option,
    print_json,
    rectify_hint,
    setting,
)
from twinlens.cli.places import PATH, PLACE, check_samples
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset import Place, Row, Sample
from twinlens.errors import InputError, counted, file_hint, located
from twinlens.factory import (
    Shoot,
    add_sample,
    camera_text,
    check_common_view,
    default_rig,
    make_sample,
    under_sky,
)
from twinlens.factory.doubts import warn_of_doubts
from twinlens.factory.images_text import images_text
from twinlens.factory.lenses import (
    APERTURE_HELP,
    LENS_HELP,
    View,
    format_lens,
    make_lens,
    parse_aperture,
    parse_lens,
)
from twinlens.factory.settings import read_rig_file
from twinlens.rendering import backend, check_still
from twinlens.report import shot_text
from twinlens.scenes import Scene, load_scene, scene_with_rig
from twinlens.sensor import Sensor
from twinlens.settings import fields_of

_Made = tuple[Row, list[str], list[dict[str, Any]]]
"""A sample's row, the exposure through each lens, and `optics_of` each lens."""
_NO_APERTURE = (
    "has no effect, every lens is a pinhole; add a lens such as --lens thin:20"
)

_SECTIONS = {
    "Lens": ("lenses", "aperture", "diffraction", "dual_pixel"),
    "Camera": (
        "camera", "size", "fov", "focal_length_px", "principal_point", "distortion", "pixel_pitch_um",
        "sensor_width_mm", "baseline", "rig",
    ),
    "Light and sensor": ("sky", "sensor", "bits", "exposure", "mismatch"),
    "Rendering": ("spp", "denoise", "noise", "seed"),
    "Output": ("output", "keep_radiance", "keep_models", "sky_disparity", "overwrite", "as_json"),
}  # fmt: skip


@click.command("render", cls=Sectioned, sections=_SECTIONS)
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...")
@click.option(
    "-o",
    "--output",
    required=True,
    type=PLACE,
    help="Dataset folder or bucket address (s3://...).",
)
@click.option(
    "--lens",
    "lenses",
    multiple=True,
    default=("pinhole",),
    show_default=True,
    help=LENS_HELP,
)
@click.option("--aperture", default="disk", show_default=True, help=APERTURE_HELP)
@setting(Shoot, "diffraction")
@setting(Shoot, "dual_pixel")
@click.option(
    "--camera",
    metavar="NAME",
    help="A camera that exists, with its baseline; see `twinlens cameras`.",
)
@click.option(
    "--size", help="Image size, WIDTHxHEIGHT.  [default: 640x480, or that of --camera]"
)
@click.option(
    "--fov",
    type=POSITIVE,
    help="Horizontal field of view, at most 179 degrees.  [default: the scene's]",
)
@click.option(
    "--focal-length-px",
    metavar="FX[,FY]",
    help="Focal length in pixels, instead of --fov.",
)
@click.option("--principal-point", metavar="CX,CY",
              help="Principal point; pixel centres are at integers.  [default: the image centre]")  # fmt: skip
@click.option("--distortion", metavar="K", help=camera_text.DISTORTION_HELP)
@setting(Camera, "pixel_pitch_um", note="default: 5.0")
@click.option(
    "--sensor-width-mm", metavar="MM|FORMAT", help=camera_text.SENSOR_WIDTH_HELP
)
@click.option(
    "--baseline", type=POSITIVE, help="Baseline, metres.  [default: the scene's]"
)
@click.option(
    "--rig",
    "rig",
    type=PATH,
    multiple=True,
    help="A .toml file with the rig and, without --lens, its lenses; or a calibration of OpenCV, ROS, Kalibr, EuRoC, "
    "COLMAP, Middlebury or a NeRF program, the option given twice where it is two files; see docs/rigs.md.",
)
@click.option(
    "--sky",
    type=PATH,
    help="A .exr, .hdr or .png panorama that lights the scenes instead of their lights.",
)
@click.option(
    "--sensor",
    default="machine_vision",
    show_default=True,
    help=camera_text.SENSOR_HELP,
)
@setting(Sensor, "bits", note="default: 8")
@click.option(
    "--exposure",
    default="auto",
    metavar="TIME_S[,GAIN]",
    help=camera_text.EXPOSURE_HELP,
)
@click.option(
    "--mismatch", metavar="LEVEL|NAME=VALUE,...", help=camera_text.MISMATCH_HELP
)
@setting(Shoot, "spp", default=12)
@setting(Shoot, "denoise", default=True)
@setting(Shoot, "noise")
@setting(Shoot, "seed", default=0)
@setting(Shoot, "keep_radiance", "--radiance")
@setting(Shoot, "keep_models", "--models")
@setting(Shoot, "sky_disparity")
@click.option("--overwrite", is_flag=True, help="Replace existing samples.")
@json_option("the files written")
def command(
    scenes: tuple[str, ...],
    output: Place,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Render SCENE... (bundled names, scene.toml or Mitsuba .xml files) with a stereo rig.

    Each scene becomes one sample, OUTPUT/<scene>: im0.png and im1.png for the first lens, lens-1/, lens-2/, ... for
    the others, and their common ground truth. OUTPUT/dataset.json lists the samples. OUTPUT is a new or empty folder,
    or one written by `render`, to which samples are added.

    The environment variable TWINLENS_BACKEND=llvm or cuda selects the backend; see `twinlens doctor`.

    \b
    Example:  twinlens render staircase cards --lens pinhole --lens f/1.4 --sensor-width-mm 36 -o out
              twinlens render tabletop --lens thin:60@1.2 --aperture polygon:6 -o bokeh
              twinlens render cards --lens f/2 --lens f/4 --sensor-width-mm 35mm --exposure 1/150000 -o stops
              twinlens render cards --camera oak-d --size 640x400 --sky studio.exr -o bench
    """
    sensor = camera_text.parse_sensor(options["sensor"])
    if options["bits"] is not None:
        sensor = sensor.replace(bits=options["bits"])
    plain = {name: options[name] for name in fields_of(Shoot) if name in options}
    exposure = camera_text.parse_exposure(options["exposure"])
    shoot = Shoot(**{**plain, "sensor": sensor, "exposure": exposure})
    jobs = [_job(load_scene(name), sensor, options) for name in scenes]
    check_samples(output, [job.scene.name for job in jobs], overwrite)
    made: list[_Made] = []
    with interrupt_note(lambda: "finished samples are kept" if made else ""):
        for job in jobs:
            sample = _rendered(job, shoot)
            row = add_sample(output, job.scene.name, sample, options["seed"], overwrite)
            texts = [text for text, _ in job.lenses]
            exposures = [
                shot_text.format_exposure(sample, k, text)
                for k, text in enumerate(texts)
            ]
            effects = [shot_text.optics_of(sample, k) for k in range(len(texts))]
            made.append((row, exposures, effects))
    if not as_json:
        denoise = str(options["denoise"]).lower()
        mismatch = options["mismatch"] or "none"
        spp = str(options["spp"])
        click.echo(images_text(options["sensor"], mismatch, spp, denoise))
    _print(output, made, as_json)
    if not as_json:
        hints = dict.fromkeys(rectify_hint(job.rig, output) for job in jobs)
        for hint in filter(None, hints):
            click.echo(hint, err=True)


class _Job(NamedTuple):
    """What the options describe for a scene: the rig, the lenses with their texts, and the sensor with its mismatch."""

    scene: Scene
    rig: Rig
    lenses: list[tuple[str, RecipeLens]]
    sensor: Sensor


def _rendered(job: _Job, shoot: Shoot) -> Sample:
    """The sample of a job, with a progress bar and warnings of what looks wrong in it."""
    scene, sensor = job.scene, job.sensor
    with progress_bar(f"rendering {scene.name}") as report:
        sample = make_sample(
            scene,
            sensor.misalign(job.rig),
            [lens for _, lens in job.lenses],
            shoot.replace(sensor=sensor),
            labels=[text for text, _ in job.lenses],
            progress=lambda part: report(part, ""),
        )
    warn_of_doubts(sample, sensor, scene.name, scene)
    return sample


def _job(scene: Scene, sensor: Sensor, options: dict[str, Any]) -> _Job:
    """The job of a scene. Raises InputError for options that do not fit it or each other, and a scene that moves."""
    check_still(scene)
    width, height = camera_text.parse_size(options["size"], options["camera"])
    if options["sky"] is not None:
        scene = _under_sky(scene, options["sky"], options["seed"])
    tables: list[Any] = []
    if options["rig"]:
        stated = (width, height) if options["size"] else None
        table, key, tables = read_rig_file(options["rig"], stated)
        scene = scene_with_rig(scene, options["rig"][0], table, key)
    intrinsics = camera_text.parse_intrinsics(options)
    with camera_text.options_named(options):
        rig = default_rig(
            scene, width, height, options["fov"], options["baseline"], intrinsics
        )
    _check_size(rig, options)
    if options["baseline"] is not None and scene.depth_range_known:
        check_common_view(rig, scene)
    lenses = _lenses(View(scene, rig.cameras[0], ()), tables, options)
    if all(lens.aperture_diameter == 0 for _, lens in lenses):
        _refuse_aperture_options(options)
    if options["mismatch"] is not None:
        layout = (scene.rig or {}).get("layout", "")
        mismatch = camera_text.parse_mismatch(
            options["mismatch"], options["seed"], len(rig), layout
        )
        sensor = sensor.replace(mismatch=mismatch)
    return _Job(scene, rig, lenses, sensor)


def _under_sky(scene: Scene, file: Path, seed: int) -> Scene:
    """The scene under the panorama of --sky."""
    with located("--sky"):
        if not file.exists():
            raise InputError(f"no file or folder {str(file)!r}{file_hint(file)}")
        return under_sky(scene, {"file": file.name}, file.parent, seed)


def _refuse_aperture_options(options: dict[str, Any]) -> None:
    """Raise InputError for options that have no effect where all lenses are pinholes."""
    if _is_given("aperture"):
        raise InputError(f"--aperture {options['aperture']}: {_NO_APERTURE}")
    for name in ("diffraction", "dual_pixel"):
        if options[name]:
            raise InputError(f"--{name.replace('_', '-')}: {_NO_APERTURE}")


def _check_size(rig: Rig, options: dict[str, Any]) -> None:
    """Raise InputError where --size is another size than the rig's file has."""
    camera = rig.cameras[0]
    size = f"{camera.width}x{camera.height}"
    if options["size"] and options["size"].lower() != size:
        raise InputError(
            f"--size {options['size']}: the rig's images have {size} pixels; leave --size out"
        )


def _lenses(
    view: View, tables: list[Any], options: dict[str, Any]
) -> list[tuple[str, RecipeLens]]:
    """The lenses of the options, or those of the rig's file in `tables`, with their texts."""
    if tables and not _is_given("lenses"):
        if _is_given("aperture"):
            raise InputError(
                "--aperture is for --lens; the lenses of a file have a 'shape'"
            )
        made = [
            make_lens(table, view, lambda name: options["rig"][0].parent / name)
            for table in tables
        ]
        return [(format_lens(lens), lens) for lens in made]
    aperture = parse_aperture(options["aperture"])
    lenses: list[tuple[str, RecipeLens]] = []
    for text in options["lenses"]:
        lens = parse_lens(text, view, aperture)
        if lens in (earlier for _, earlier in lenses):
            raise InputError(
                f"--lens {text}: is given twice; it would make the same images"
            )
        lenses.append((text, lens))
    return lenses


def _is_given(name: str) -> bool:
    return (
        click.get_current_context().get_parameter_source(name)
        is not ParameterSource.DEFAULT
    )


def _print(output: Place, made: list[_Made], as_json: bool) -> None:
    used = backend()
    if as_json:
        samples = [
            {
                "name": row.name,
                "folder": str(output / row.name),
                "files": sorted(row.files),
                "lenses": effects,
            }
            for row, _, effects in made
        ]
        print_json(
            {"dataset": str(output), "backend": used.variant, "samples": samples}
        )
        return
    for row, exposures, effects in made:
        click.echo(f"{output / row.name}: {counted(len(row.files), 'file')}")
        for exposure, lens_effects in zip(exposures, effects, strict=True):
            click.echo(f"  {exposure}\n    {shot_text.format_optics(lens_effects)}")
        if error := shot_text.format_depth_error(effects[0]):
            click.echo(f"  {error}")
    click.echo(f"rendered with {used.variant} ({used.reason})")
