"""`twinlens rectify`: rectified pairs from two views of any cameras, of one sample or of a dataset."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from twinlens.camera.rectification import FITS
from twinlens.cli.options import json_option, parse_pair, print_result
from twinlens.cli.places import PATH, PLACE, check_new, check_samples
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset import (
    Dataset,
    Place,
    Sample,
    StoredSample,
    open_sample,
    write_sample,
)
from twinlens.dataset.dataset import MANIFEST
from twinlens.errors import check_known, counted, located
from twinlens.factory import add_sample, rectified_sample, sources_of
from twinlens.factory.camera_text import parse_misalignment
from twinlens.factory.rectified import PICTURES
from twinlens.rendering import Progress
from twinlens.scenes import load_scene


@click.command("rectify")
@click.argument("place", type=PLACE, metavar="DATASET[/SAMPLE]")
@click.option(
    "-o",
    "--output",
    required=True,
    type=PATH,
    help="Folder of the new dataset or sample.",
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
              help="Focal length: focal (mean of both), all (both images fit), valid (no empty pixels) or opencv "
                   "(focal length and centre as cv2.stereoRectify chooses them). Of a fisheye of 170 degrees or more, "
                   "focal and valid show the part around the middle of its image.")  # fmt: skip
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
    place: Place,
    output: Path,
    cameras: str,
    scene: str | None,
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Rectify two views of each sample of a dataset, so that matching pixels share a row, with new ground truth.

    A dataset becomes a dataset. Samples of warped images have valid0.png and valid1.png: 255 where a rectified pixel
    lies in its photograph. Scenes of families and bundled scenes are made again from the record; for other files of
    the recipe, name its folder by --folder.

    \b
    Example:  twinlens rectify out -o rectified
              twinlens rectify out/cards -o rectified/cards --fit valid --own-centres
    """
    # Before the output folder, whose error would hide these.
    check_known("--fit", options["fit"], FITS)
    check_known("--pictures", options["pictures"], PICTURES)
    options["zero_doffs"] = not options.pop("own_centres")
    options["misalignment"] = parse_misalignment(options.pop("misalignment"))
    is_dataset = (place / MANIFEST).exists()
    if scene is not None:
        options["scene"] = load_scene(scene)
    else:
        dataset = place if is_dataset else place.parent
        options["sources"] = sources_of(dataset, options["folder"])
    rectify = _Rectifier(cameras, options)
    if is_dataset:
        _rectify_dataset(place, output, rectify, overwrite, as_json)
    else:
        _rectify_sample(place, output, rectify, overwrite, as_json)


@dataclass(frozen=True)
class _Rectifier:
    """The rectified pair of a stored sample, with the options of the command."""

    cameras: str
    options: Mapping[str, Any]

    def __call__(self, stored: StoredSample, progress: Progress) -> Sample:
        left, right = parse_pair(self.cameras, stored.name, len(stored.rig))
        return rectified_sample(stored, left=left, right=right, progress=progress, **self.options)  # fmt: skip


def _rectify_sample(
    place: Place, output: Path, rectify: _Rectifier, overwrite: bool, as_json: bool
) -> None:
    check_new(output, overwrite)
    stored = open_sample(place)
    with progress_bar("rectifying") as report:
        made = rectify(stored, lambda fraction: report(fraction, ""))
    files = write_sample(output, made, overwrite)
    record = {"sample": str(output), "files": sorted(files), **_calibration(made)}
    print_result(
        as_json,
        record,
        f"{output}: {counted(len(files), 'file')}, {_calibration_text(made)}",
    )


def _rectify_dataset(
    place: Place, output: Path, rectify: _Rectifier, overwrite: bool, as_json: bool
) -> None:
    dataset = Dataset(place)
    infos = {row.name: row.info for row in dataset.manifest.rows}
    check_samples(output, list(dataset.names), overwrite)
    records: list[dict[str, Any]] = []
    lines: list[str] = []
    with interrupt_note(lambda: "finished samples are kept" if records else ""):
        for stored in dataset:
            with (
                progress_bar(f"rectifying {stored.name}") as report,
                located(stored.name),
            ):
                made = rectify(stored, lambda part, report=report: report(part, ""))  # type: ignore[misc]
            add_sample(output, stored.name, made, None, overwrite, infos[stored.name])
            records.append({"sample": stored.name, **_calibration(made)})
            lines.append(f"{output / stored.name}: {_calibration_text(made)}")
    print_result(as_json, {"dataset": str(output), "samples": records}, *lines)


def _calibration(made: Sample) -> dict[str, float]:
    rig = made.rig.nominal
    return {"fx": rig.cameras[0].fx, "doffs": rig.doffs()}


def _calibration_text(made: Sample) -> str:
    values = _calibration(made)
    return f"fx {values['fx']:.6g} px, doffs {values['doffs']:.6g} px"
