"""`twinlens render`: scenes in, samples of a dataset out."""

import json
import math
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from twinlens.cli.options import Sectioned
from twinlens.cli.places import PATH, PLACE, check_samples, manifest_of
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.errors import InputError
from twinlens.factory.camera_text import (
    APERTURE_HELP,
    DISTORTION_HELP,
    EXPOSURE_HELP,
    LENS_HELP,
    MISMATCH_HELP,
    SENSOR_HELP,
    parse_aperture,
    parse_distortion,
    parse_exposure,
    parse_lens,
    parse_mismatch,
    parse_numbers,
    parse_sensor,
    parse_size,
)
from twinlens.optics import middle_focus

if TYPE_CHECKING:
    from twinlens.camera import Aperture, Lens, Rig
    from twinlens.dataset import Place, Row, Sample
    from twinlens.scenes import Scene
    from twinlens.sensor import Sensor

FASTEST = 0.95
"""The smallest f-number of a photographic lens that is sold, to be read as a measure and no law."""

_NO_WIDTH = "every lens here is a pinhole of no width, where it changes nothing; add a lens, as --lens thin:20"

_SECTIONS = {
    "Lens": ("lenses", "aperture", "diffraction"),
    "Camera": (
        "size", "fov", "focal_length_px", "principal_point", "distortion", "pixel_pitch_um", "sensor_width_mm",
        "baseline", "rig",
    ),
    "Light and sensor": ("sensor", "bits", "exposure", "mismatch"),
    "Rendering": ("spp", "seed"),
    "Output": ("output", "radiance", "sky_disparity", "overwrite", "as_json"),
}  # fmt: skip


@click.command("render", cls=Sectioned, sections=_SECTIONS)
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...")
@click.option(
    "-o", "--output", required=True, type=PLACE, help="Folder of the dataset, or a bucket's address (s3://...)."
)
@click.option("--lens", "lenses", multiple=True, default=("pinhole",), show_default=True, help=LENS_HELP)
@click.option("--aperture", default="disk", show_default=True, help=APERTURE_HELP)
@click.option("--diffraction", is_flag=True, help="Blur by the Airy pattern of each lens; disks only.")
@click.option("--size", default="640x480", show_default=True, help="Image size, WIDTHxHEIGHT.")
@click.option("--fov", type=float, help="Horizontal field of view, degrees.  [default: the scene's]")
@click.option("--focal-length-px", metavar="FX[,FY]", help="Focal length in pixels, instead of --fov.")
@click.option("--principal-point", metavar="CX,CY", help="In pixels, centres at integers.  [default: the middle]")
@click.option("--distortion", metavar="K", help=DISTORTION_HELP)
@click.option("--pixel-pitch-um", type=float, help="Width of a pixel.  [default: 5]")
@click.option("--sensor-width-mm", type=float, help="Of the whole image, as 36, instead of --pixel-pitch-um.")
@click.option("--baseline", type=float, help="Stereo base, metres.  [default: the scene's]")
@click.option("--rig", type=PATH, help="A .toml with a rig's table; see docs/rigs.md.")
@click.option("--sensor", default="machine_vision", show_default=True, help=SENSOR_HELP)
@click.option("--bits", type=click.Choice(["8", "16"]), help="Of a channel of the pictures.  [default: 8]")
@click.option("--exposure", default="auto", metavar="TIME_S[,GAIN]", help=EXPOSURE_HELP)
@click.option("--mismatch", metavar="NAME=VALUE,...", help=MISMATCH_HELP)
@click.option("--spp", type=click.IntRange(1, 1_000_000), default=64, show_default=True, help="Samples a pixel.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of every random draw.")
@click.option("--radiance", is_flag=True, help="Keep the linear images too (radiance0.exr, radiance1.exr).")
@click.option("--sky-disparity", is_flag=True, help="Give rays that hit nothing the disparity at infinity.")
@click.option("--overwrite", is_flag=True, help="Replace samples that are there already.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def command(scenes: tuple[str, ...], output: "Place", overwrite: bool, as_json: bool, **asked: Any) -> None:
    """Photograph SCENE... (bundled names, scene.toml or Mitsuba .xml files) with a stereo rig.

    Every scene becomes one sample, OUTPUT/<scene>: im0.png and im1.png for the first lens, lens-1/, lens-2/, ... for
    the others, and beside them the exact truth that they share. OUTPUT/dataset.json lists the samples. OUTPUT is a
    new folder, an empty one, or one that render made, to which samples are added.

    TWINLENS_BACKEND=scalar, llvm or cuda in the environment chooses what renders; see `twinlens doctor`.

    \b
    Example:  twinlens render staircase cards --lens pinhole --lens f/1.4 --sensor-width-mm 36 -o out
              twinlens render tabletop --lens thin:60@1.2 --aperture polygon:6 -o bokeh
              twinlens render cards --lens f/2 --lens f/4 --sensor-width-mm 36 --exposure 1/150000 -o stops
    """
    from twinlens.scenes import load_scene

    options = {
        "spp": asked["spp"], "seed": asked["seed"], "keep_radiance": asked["radiance"],
        "sky_disparity": asked["sky_disparity"], "diffraction": asked["diffraction"], "sensor": _sensor(asked),
        "exposure": parse_exposure(asked["exposure"]),
    }  # fmt: skip
    aperture = parse_aperture(asked["aperture"])
    jobs = [_job(load_scene(name), asked, aperture) for name in scenes]
    check_samples(output, [scene.name for scene, _, _ in jobs], overwrite)
    made: list[tuple[Row, list[str]]] = []
    with interrupt_note(lambda: "what was finished is kept" if made else ""):
        for job in jobs:
            row, lines = _one(job, asked["lenses"], output, options, overwrite)
            _list(output, row, asked["seed"])
            made.append((row, lines))
    _tell(output, made, as_json)


def _sensor(asked: dict[str, Any]) -> "Sensor":
    changes: dict[str, Any] = {} if asked["bits"] is None else {"bits": int(asked["bits"])}
    if asked["mismatch"] is not None:
        changes["mismatch"] = parse_mismatch(asked["mismatch"])
    return parse_sensor(asked["sensor"]).replace(**changes)


def _job(scene: "Scene", asked: dict[str, Any], aperture: "Aperture") -> "tuple[Scene, Rig, tuple[Lens, ...]]":
    """The scene, the rig that the options ask for, and the lenses on it."""
    from twinlens.factory import default_rig
    from twinlens.scenes import scene_with_rig

    width, height = parse_size(asked["size"])
    if asked["rig"] is not None:
        scene = scene_with_rig(scene, asked["rig"])
    rig = default_rig(scene, width, height, asked["fov"], asked["baseline"], _inside(asked, width))
    if asked["baseline"] is not None and scene.depth_range_known:
        _check_shared(rig, scene)
    focus = middle_focus(*scene.depth_range) if scene.depth_range_known else None
    film = rig.cameras[0].film_distance
    lenses = tuple(parse_lens(text, focus, film, aperture) for text in asked["lenses"])
    _refuse_what_a_pinhole_has_not(lenses, asked)
    return scene, rig, lenses


def _check_shared(rig: "Rig", scene: "Scene") -> None:
    """Parallel views that are farther apart than they are wide where the scene ends show nothing in common."""
    camera, far = rig.cameras[0], scene.depth_range[1]
    wide = far * camera.width / camera.fx
    parallel = len(rig) > 1 and abs(rig.b_from_a(0, 1)[2, 2] - 1) < 1e-9
    if parallel and rig.baseline() >= wide:
        raise InputError(
            f"--baseline {rig.baseline():g}: the views would show nothing in common; at {far:g} m, where {scene.name} "
            f"ends, each is {wide:.3g} m wide"
        )


def _refuse_what_a_pinhole_has_not(lenses: "tuple[Lens, ...]", asked: dict[str, Any]) -> None:
    """Where no lens has any width, its shape and its diffraction would change nothing."""
    if any(lens.aperture_diameter > 0 for lens in lenses):
        return
    if click.get_current_context().get_parameter_source("aperture") is not ParameterSource.DEFAULT:
        raise InputError(f"--aperture {asked['aperture']}: {_NO_WIDTH}")
    if asked["diffraction"]:
        raise InputError(f"--diffraction: {_NO_WIDTH}")


def _inside(asked: dict[str, Any], width: int) -> dict[str, Any]:
    """What the options say of every camera's inside, by the names of a rig's table."""
    for one, other in (("fov", "focal_length_px"), ("pixel_pitch_um", "sensor_width_mm")):
        if asked[one] is not None and asked[other] is not None:
            names = (f"--{name.replace('_', '-')}" for name in (one, other))
            raise InputError(f"{' and '.join(names)} say the same thing twice; keep one")
    for name in ("pixel_pitch_um", "sensor_width_mm"):
        if asked[name] is not None and not 0 < asked[name] < math.inf:
            raise InputError(f"--{name.replace('_', '-')} must be a positive number, got {asked[name]:g}")
    inside: dict[str, Any] = {}
    if asked["focal_length_px"] is not None:
        form = "FX[,FY], positive numbers of pixels, as 700 or 700,690"
        focal = parse_numbers("--focal-length-px", asked["focal_length_px"], 1, 2, form)
        if not all(0 < number < math.inf for number in focal):
            raise InputError(f"--focal-length-px must be {form}, got {asked['focal_length_px']!r}")
        inside |= {"fx": focal[0], "fy": focal[-1]}
    if asked["principal_point"] is not None:
        inside["cx"], inside["cy"] = parse_numbers("--principal-point", asked["principal_point"], 2, 2, "CX,CY")
    if asked["distortion"] is not None:
        model = parse_distortion(asked["distortion"])
        inside["distortion"] = {"model": model.name, **asdict(model)}
    if asked["pixel_pitch_um"] is not None:
        inside["pixel_pitch_um"] = asked["pixel_pitch_um"]
    if asked["sensor_width_mm"] is not None:
        inside["pixel_pitch_um"] = 1e3 * asked["sensor_width_mm"] / width
    return inside


def _one(
    job: "tuple[Scene, Rig, tuple[Lens, ...]]",
    texts: tuple[str, ...],
    output: "Place",
    options: dict[str, Any],
    overwrite: bool,
) -> "tuple[Row, list[str]]":
    """Make and write one sample: its row of the dataset, and a line on each of its lenses."""
    from twinlens.dataset import Row, write_sample
    from twinlens.factory import make_sample

    scene, rig, lenses = job
    with progress_bar(f"rendering {scene.name}") as report, _warned_in_lines():
        sample = make_sample(scene, rig, lenses, progress=lambda fraction: report(fraction, ""), **options)
    row = Row(scene.name, write_sample(output / scene.name, sample, overwrite), {"scene": scene.name})
    return row, [_exposed(sample, k, text) for k, text in enumerate(texts)]


@contextmanager
def _warned_in_lines() -> Iterator[None]:
    """Each warning once, as one line of the error stream."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        yield
    for message in dict.fromkeys(" ".join(str(warning.message).split()) for warning in caught):
        click.echo(f"twinlens: warning: {message}", err=True)


def _exposed(sample: "Sample", k: int, text: str) -> str:
    """What lens k was as a photographer says it: f-number, time, gain; and whether such a lens can be bought."""
    camera, taken = sample.rig.cameras[0], sample.shots[k].record["exposures"][0]
    number, time, gain = taken["working_f_number"], taken["time_s"], taken["gain"]
    line = f"{text}: f/{_f_number(number)}, {_duration(time)}, gain {gain:.3g}"
    if number >= FASTEST or sample.shots[k].lens.name != "thinlens":
        return line
    if text.startswith("f/"):  # of any sensor: a wider one has a wider lens
        return f"{line} (blur as asked, but no lens that is sold is so fast)"
    width = 1e-3 * camera.width * camera.pixel_pitch_um
    return (
        f"{line} (blur as asked, but no lens that is sold is so fast: this sensor is {width:.3g} mm wide; "
        f"--sensor-width-mm {width * 1.4 / number:.2g} makes it f/1.4)"
    )


def _f_number(number: float) -> str:
    """As engraved: two digits, and no power of ten before there must be.

    >>> _f_number(1.414), _f_number(142.8), _f_number(8.6e7)
    ('1.4', '143', '8.6e+07')
    """
    return f"{number:.0f}" if 99.5 <= number < 1e5 else f"{number:.2g}"


def _duration(time: float) -> str:
    """Seconds as they stand on a shutter's dial; what no shutter does, in microseconds.

    >>> _duration(1 / 60), _duration(0.39), _duration(2e-5)
    ('1/60 s', '0.39 s', '20 us')
    """
    if time < 1e-4:
        return f"{1e6 * time:.3g} us"
    return f"1/{1 / time:.0f} s" if time < 0.1 else f"{time:.3g} s"


def _list(output: "Place", row: "Row", seed: int) -> None:
    """Write dataset.json (the samples it knew, with the new one in its place or at the end) and the card.

    Its recipe and what else it says stay. Where samples were made with several seeds it names none; each has its own.
    """
    from twinlens.dataset import Manifest, describe, write_manifest

    before = manifest_of(output) or Manifest((), seed=seed)
    known = {each.name: each for each in before.rows} | {row.name: row}
    shared = before.seed if before.recipe or before.seed == seed else None
    write_manifest(output, Manifest(tuple(known.values()), before.recipe, shared, before.info))
    describe(output)


def _tell(output: "Place", made: "list[tuple[Row, list[str]]]", as_json: bool) -> None:
    from twinlens.rendering import backend

    used = backend()
    if as_json:
        samples = [{"name": row.name, "folder": str(output / row.name), "files": sorted(row.files)} for row, _ in made]
        click.echo(json.dumps({"dataset": str(output), "backend": used.variant, "samples": samples}, indent=1))
        return
    for row, lines in made:
        click.echo(f"{output / row.name}: {len(row.files)} files")
        for line in lines:
            click.echo(f"  {line}")
    click.echo(f"rendered with {used.variant} ({used.reason})" + (f"; {used.advice}" if used.advice else ""))
