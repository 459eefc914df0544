"""`twinlens rectify`: a rectified pair from two views of any cameras."""

from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import json_option, parse_pair, print_result
from twinlens.cli.places import PATH, PLACE, check_new
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Place, open_sample, write_sample
from twinlens.factory import rectified_sample
from twinlens.factory.camera_text import parse_misalignment
from twinlens.scenes import load_scene


@click.command("rectify")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option(
    "-o", "--output", required=True, type=PATH, help="Folder of the new sample."
)
@click.option(
    "--cameras",
    default="0,1",
    show_default=True,
    help="The left and the right view, counted from 0.",
)
@click.option(
    "--pictures",
    default="maps",
    show_default=True,
    help="maps: warp the images; render: render new ones.",
)
@click.option("--fit", default="focal", show_default=True,
              help="Focal length: focal (mean of both), all (both images fit) or valid (no empty pixels).")  # fmt: skip
@click.option("--own-centres", is_flag=True,
              help="Centre each new view on what its camera sees; doffs is then not 0.")  # fmt: skip
@click.option("--misalignment", metavar="NAME=VALUE,...",
              help="Errors of the right camera: vertical_px, pitch_deg, yaw_deg, roll_deg, focal, k1.")  # fmt: skip
@click.option(
    "--scene", metavar="FILE", help="Scene file; required if the scene is not bundled."
)
@click.option("--folder", type=PATH, default=".", show_default=True,
              help="Folder of the recipe, if the sample has objects or a sky of it.")  # fmt: skip
@click.option("--overwrite", is_flag=True, help="Replace an existing sample.")
@json_option("what was written")
def command(
    sample: Place,
    output: Path,
    cameras: str,
    scene: str | None,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Rectify two views of a sample, so that matching pixels share a row, with new ground truth.

    \b
    Example:  twinlens rectify out/cards -o rectified/cards --fit valid --own-centres
    """
    check_new(output, overwrite)
    stored = open_sample(sample)
    left, right = parse_pair(cameras, sample, len(stored.rig))
    with progress_bar("rectifying") as report:
        made = rectified_sample(
            stored, None if scene is None else load_scene(scene), left, right,
            zero_doffs=not options.pop("own_centres"), misalignment=parse_misalignment(options.pop("misalignment")),
            progress=lambda fraction: report(fraction, ""), **options,
        )  # fmt: skip
    files = write_sample(output, made, overwrite)
    rig = made.rig.nominal
    fx, doffs = rig.cameras[0].fx, rig.doffs()
    record = {"sample": str(output), "files": sorted(files), "fx": fx, "doffs": doffs}
    print_result(
        as_json,
        record,
        f"{output}: {len(files)} files, fx {fx:.6g} px, doffs {doffs:.6g} px",
    )
