"""`twinlens rectify`: a pair of any cameras made into a rectified one."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from twinlens.camera import ALIGNED, Misalignment
from twinlens.cli.camera_specs import parse_pairs
from twinlens.cli.places import PATH, PLACE, check_free, check_replaceable
from twinlens.cli.progress import progress_bar
from twinlens.cli.samples import open_sample, parse_pair
from twinlens.cli.specs import number, told
from twinlens.errors import InputError, unknown

if TYPE_CHECKING:
    from twinlens.dataset import Place


@click.command("rectify")
@click.argument("sample", type=PLACE, metavar="DATASET/SAMPLE")
@click.option("-o", "--output", required=True, type=PATH, help="Folder of the new sample.")
@click.option("--cameras", default="0,1", show_default=True, help="The left and the right view, counted from 0.")
@click.option("--pictures", default="maps", show_default=True, help="maps: warp them; render: take them anew.")
@click.option("--fit", default="focal", show_default=True, help="focal (keep it), all (of both images) or valid.")
@click.option("--own-centres", is_flag=True, help="Centre each image on what it sees; doffs tells.")
@click.option("--misalignment", metavar="NAME=VALUE,...", help="Left in: vertical_px, pitch_deg, yaw_deg, roll_deg.")
@click.option("--scene", metavar="FILE", help="The scene's file, where it is not a bundled one.")
@click.option("--overwrite", is_flag=True, help="Replace a sample that is there already.")
@click.option("--json", "as_json", is_flag=True, help="Print what was written as JSON.")
def command(
    sample: "Place",
    output: Path,
    cameras: str,
    pictures: str,
    fit: str,
    own_centres: bool,
    misalignment: str | None,
    scene: str | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Rectify two views of a sample: rows agree, and disparities are exact, cast anew through the new cameras.

    \b
    Example:  twinlens rectify out/cards -o rectified/cards --fit valid --own-centres
    """
    from twinlens.dataset import write_sample
    from twinlens.factory import rectified_sample
    from twinlens.scenes import load_scene

    check_free(output, overwrite)
    check_replaceable(output)
    stored = open_sample(sample)
    left, right = parse_pair(cameras, len(stored.rig))
    with progress_bar("rectifying") as report:
        made = rectified_sample(
            stored, None if scene is None else load_scene(scene), left, right, pictures=pictures, fit=fit,
            zero_doffs=not own_centres, misalignment=parse_misalignment(misalignment),
            progress=lambda fraction: report(fraction, ""),
        )  # fmt: skip
    files = write_sample(output, made, overwrite)
    rig = made.rig.nominal
    told = {"sample": str(output), "files": sorted(files), "fx": rig.cameras[0].fx, "doffs": rig.doffs()}
    summary = f"{output}: {len(files)} files, fx {rig.cameras[0].fx:.6g} px, doffs {rig.doffs():.6g} px"
    click.echo(json.dumps(told, indent=1) if as_json else summary)


def parse_misalignment(text: str | None) -> Misalignment:
    """The error that `text` names.

    >>> parse_misalignment("vertical_px=1.5,roll_deg=0.2")
    Misalignment(vertical_px=1.5, pitch_deg=0.0, yaw_deg=0.0, roll_deg=0.2)
    """
    if text is None:
        return ALIGNED
    where, known = f"--misalignment {text!r}", list(vars(ALIGNED))
    given = parse_pairs(where, text)
    for name in given:
        if name not in known:
            raise InputError(f"{where}: {unknown('quantity', name, known)}")
    return told(where, lambda: Misalignment(**{name: number(value, where) for name, value in given.items()}))
