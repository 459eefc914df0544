"""`twinlens render`: scenes in, samples of a dataset out."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from twinlens.cli.progress import progress_bar
from twinlens.cli.specs import LENS_HELP, middle_focus, parse_lens, parse_size
from twinlens.errors import InputError, OutputError

if TYPE_CHECKING:
    from twinlens.camera import Lens, Rig
    from twinlens.dataset import Row
    from twinlens.scenes import Scene


@click.command("render")
@click.argument("scenes", nargs=-1, required=True, metavar="SCENE...")
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="Folder of the dataset.")
@click.option("--lens", "lenses", multiple=True, default=("pinhole",), show_default=True, help=LENS_HELP)
@click.option("--size", default="640x480", show_default=True, help="Image size, WIDTHxHEIGHT.")
@click.option("--fov", type=float, help="Horizontal field of view, degrees.  [default: the scene's]")
@click.option("--baseline", type=float, help="Stereo base, metres.  [default: the scene's]")
@click.option("--spp", type=click.IntRange(1, 1_000_000), default=64, show_default=True, help="Samples a pixel.")
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of every random draw.")
@click.option("--sensor", default="machine_vision", show_default=True, help="ideal, machine_vision or phone.")
@click.option("--radiance", is_flag=True, help="Keep the linear images too (radiance0.exr, radiance1.exr).")
@click.option("--overwrite", is_flag=True, help="Replace samples that are there already.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def command(
    scenes: tuple[str, ...],
    output: Path,
    lenses: tuple[str, ...],
    size: str,
    fov: float | None,
    baseline: float | None,
    spp: int,
    seed: int,
    sensor: str,
    radiance: bool,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Photograph SCENE... (bundled names, scene.toml or Mitsuba .xml files) with a stereo rig.

    Every scene becomes one sample, OUTPUT/<scene>: im0.png and im1.png for the first lens, lens-1/, lens-2/, ... for
    the others, and beside them the exact truth that they share. OUTPUT/dataset.json lists the samples.

    \b
    Example:  twinlens render staircase cards --lens pinhole --lens thin:20 -o out
    """
    from twinlens.factory import default_rig
    from twinlens.scenes import load_scene
    from twinlens.sensor import Sensor

    width, height = parse_size(size)
    jobs = []
    for name in scenes:
        scene = load_scene(name)
        rig = default_rig(scene, width, height, fov, baseline)
        focus = middle_focus(scene.depth_range) if scene.depth_range_known else None
        jobs.append((scene, rig, tuple(parse_lens(text, focus, rig.cameras[0].film_distance) for text in lenses)))
    _check_names([scene.name for scene, _, _ in jobs], output, overwrite)
    options = {"spp": spp, "seed": seed, "keep_radiance": radiance, "sensor": Sensor.preset(sensor)}
    rows = [_one(job, output, options, overwrite) for job in jobs]
    _list(output, rows, seed)
    _tell(output, rows, as_json)


def _check_names(names: list[str], output: Path, overwrite: bool) -> None:
    double = next((name for name in names if names.count(name) > 1), None)
    if double is not None:
        raise InputError(f"two scenes are named {double!r}; a sample's folder has its scene's name")
    there = next((name for name in names if (output / name).exists()), None)
    if there is not None and not overwrite:
        raise OutputError(f"{output / there}: is there already; name another folder, or add --overwrite")


def _one(job: "tuple[Scene, Rig, tuple[Lens, ...]]", output: Path, options: dict[str, Any], overwrite: bool) -> "Row":
    from twinlens.dataset import Row, write_sample
    from twinlens.factory import make_sample

    scene, rig, lenses = job
    with progress_bar(f"rendering {scene.name}") as report:
        sample = make_sample(scene, rig, lenses, progress=lambda fraction: report(fraction, ""), **options)
    return Row(scene.name, write_sample(output / scene.name, sample, overwrite), {"scene": scene.name})


def _list(output: Path, rows: "list[Row]", seed: int) -> None:
    """Write dataset.json: the samples it knew, with the new ones in their places or at the end."""
    from twinlens.dataset import Manifest, read_manifest, write_manifest

    known = {row.name: row for row in read_manifest(output).rows} if (output / "dataset.json").exists() else {}
    write_manifest(output, Manifest(tuple((known | {row.name: row for row in rows}).values()), seed=seed))


def _tell(output: Path, rows: "list[Row]", as_json: bool) -> None:
    from twinlens.rendering import backend

    used = backend()
    if as_json:
        samples = [{"name": row.name, "folder": str(output / row.name), "files": sorted(row.files)} for row in rows]
        click.echo(json.dumps({"dataset": str(output), "backend": used.variant, "samples": samples}, indent=1))
        return
    for row in rows:
        click.echo(f"{output / row.name}: {len(row.files)} files")
    click.echo(f"rendered with {used.variant} ({used.reason})" + (f"; {used.advice}" if used.advice else ""))
