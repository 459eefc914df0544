"""`twinlens match`: two images in, a disparity map out."""

import json
import time
from pathlib import Path

import click
import numpy as np

from twinlens.errors import InputError


@click.command("match")
@click.argument("left", type=click.Path(path_type=Path))
@click.argument("right", type=click.Path(path_type=Path))
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), help="The map: a .pfm file.")
@click.option("--method", default="zncc", show_default=True, help="A matcher, as zncc or sad:block_size=15,lr_check=1.")
@click.option("--ndisp", type=click.IntRange(min=1), default=64, show_default=True, help="Disparities to search.")
@click.option("--min-disparity", type=int, default=0, show_default=True, help="The first of them, pixels.")
@click.option("--picture", type=click.Path(path_type=Path), help="Also write the map as a colour PNG.")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(
    left: Path,
    right: Path,
    output: Path,
    method: str,
    ndisp: int,
    min_disparity: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Match LEFT and RIGHT, a rectified pair, and write the left image's disparity (+inf where unknown).

    \b
    Example:  twinlens match out/staircase/im0.png out/staircase/im1.png --ndisp 64 -o disp.pfm
    """
    from twinlens.cli.images import read_image
    from twinlens.dataset import write_pfm, write_png
    from twinlens.matching import parse_method

    if output.suffix.lower() != ".pfm":
        raise InputError(f"--output {output}: a disparity map is written as .pfm; --picture makes a PNG to look at")
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--picture {picture}: must end in .png")
    spec = parse_method(method)
    images = [read_image(path) for path in (left, right)]
    begun = time.perf_counter()
    disparity = spec(*images, num_disparities=ndisp, min_disparity=min_disparity)
    seconds = time.perf_counter() - begun
    write_pfm(output, disparity)
    if picture is not None:
        from twinlens.report import colourise

        write_png(picture, colourise(disparity, min_disparity, min_disparity + ndisp - 1))
    known = float(np.isfinite(disparity).mean())
    if as_json:
        answer = {"output": str(output), "method": spec.text, "known_fraction": known, "seconds": seconds}
        click.echo(json.dumps(answer, indent=1))
    else:
        click.echo(f"{output}: {spec.text}, {known:.1%} of the pixels matched, {seconds:.2f} s with compiling")
