"""`twinlens match`: two images in, a disparity map out."""

import json
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from twinlens.cli.places import PATH
from twinlens.errors import InputError

DEFAULT_METHOD = "zncc"
DEFAULT_NDISP = 64
DEFAULT_WINDOW = 35
"""The largest window that a method has unless told otherwise."""
WINDOWS = ("block_size", "census_window", "median")


@click.command("match")
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@click.option("-o", "--output", required=True, type=PATH, help="The map: a .pfm file.")
@click.option("--method", help="A matcher, as zncc or sad:block_size=15,lr_check=1.  [default: zncc]")
@click.option(
    "--command", "program", metavar="COMMAND",
    help="Or any program, as 'prog {left} {right} {out}': reads two PNGs, writes a PFM; {num_disparities} and "
    "{min_disparity} are known too. No shell reads it.",
)  # fmt: skip
@click.option("--time-limit", type=float, help="Seconds that the program may take.  [default: 600]")
@click.option("--ndisp", type=click.IntRange(min=1), help="Disparities to search.  [default: 64]")
@click.option("--min-disparity", type=int, default=0, show_default=True, help="The first of them, pixels.")
@click.option("--picture", type=PATH, help="Also write the map as a colour PNG.")
@click.option("--json", "as_json", is_flag=True, help="Print the findings as JSON.")
def command(
    left: Path,
    right: Path,
    output: Path,
    method: str | None,
    program: str | None,
    time_limit: float | None,
    ndisp: int | None,
    min_disparity: int,
    picture: Path | None,
    as_json: bool,
) -> None:
    """Match LEFT and RIGHT, a rectified pair, and write the left image's disparity (+inf where unknown).

    \b
    Example:  twinlens match out/staircase/im0.png out/staircase/im1.png --ndisp 64 -o disp.pfm
              twinlens match im0.png im1.png --command "./prog {left} {right} {out}" -o disp.pfm
    """
    from twinlens.dataset import read_image, write_pfm, write_png

    if output.suffix.lower() != ".pfm":
        raise InputError(f"--output {output}: a disparity map is written as .pfm; --picture makes a PNG to look at")
    if picture is not None and picture.suffix.lower() != ".png":
        raise InputError(f"--picture {picture}: must end in .png")
    _check_spared((left, right), {"--output": output, "--picture": picture})
    search = {"num_disparities": DEFAULT_NDISP if ndisp is None else ndisp, "min_disparity": min_disparity}
    matcher, name = _matcher(method, program, time_limit, **search)
    if ndisp is not None and not hasattr(matcher, "num_disparities"):
        raise InputError(f"--ndisp: {name} searches the disparities that it was made for")
    images = [read_image(path) for path in (left, right)]
    check_size(matcher, images[0].shape[:2])
    begun = time.perf_counter()
    disparity = matcher.match(*images)
    seconds = time.perf_counter() - begun
    write_pfm(output, disparity)
    if picture is not None:
        from twinlens.report import colourise

        write_png(picture, colourise(disparity, *picture_range(disparity, matcher)))
    known = float(np.isfinite(disparity).mean())
    if as_json:
        answer = {"output": str(output), "method": name, "known_fraction": known, "seconds": seconds}
        click.echo(json.dumps(answer, indent=1))
    else:
        click.echo(f"{output}: {name}, {known:.1%} of the pixels matched, {seconds:.2f} s with compiling")


def _check_spared(inputs: tuple[Path, ...], outputs: dict[str, Path | None]) -> None:
    """Refuse to write over the images that are matched, or into a sample, whose truth a map must not replace."""
    for option, place in outputs.items():
        if place is None:
            continue
        if any(place.exists() and path.exists() and place.samefile(path) for path in inputs):
            raise InputError(f"{option} {place}: is one of the two images; name another file")
        if (place.absolute().parent / "sample.json").exists():
            raise InputError(f"{option} {place}: stands in a sample of a dataset; write it elsewhere")


def check_size(matcher: Any, size: tuple[int, ...]) -> None:
    """Refuse options that no image of that (H, W) can need: they are mistakes, and some take all memory.

    Two pixels of one row of W are at most W - 1 apart, so there are 2 W - 1 disparities; and a window with a side of
    2 max(H, W) - 1 sees the whole image from every pixel.
    """
    height, width = size
    most = max(2 * width - 1, DEFAULT_NDISP)  # the default suits a thumbnail too
    wide = f"an image {width} pixels wide has disparities from {1 - width} to {width - 1}"
    count, first = getattr(matcher, "num_disparities", 1), getattr(matcher, "min_disparity", 0)
    if count > most:
        raise InputError(f"num_disparities (--ndisp) is {count}: {wide}, {2 * width - 1} in all")
    if not -width < first < width:
        raise InputError(f"min_disparity is {first}: {wide}")
    largest = max(2 * max(size) - 1, DEFAULT_WINDOW)
    for option in WINDOWS:
        if getattr(matcher, option, 0) > largest:
            raise InputError(
                f"{option} is {getattr(matcher, option)}: a window of {largest} sees all of an image of {width} x "
                f"{height} from every pixel"
            )


def picture_range(disparity: NDArray[np.float32], matcher: Any) -> tuple[float, float]:
    """What the picture's colours span: the disparities searched, or found, where the matcher does not say or knows one.

    Two numbers apart at least 1, so that a map of one value has a colour too.
    """
    known = disparity[np.isfinite(disparity)]
    low, high = (float(known.min()), float(known.max())) if known.size else (0.0, 1.0)
    first, count = getattr(matcher, "min_disparity", None), getattr(matcher, "num_disparities", None)
    if first is not None and count is not None and count > 1:
        low, high = float(first), float(first + count - 1)
    return low, max(high, low + 1.0)


def _matcher(method: str | None, program: str | None, time_limit: float | None, **search: int) -> tuple[Any, str]:
    """The matcher asked for, and what it is called."""
    from twinlens.matching import Program, parse_method

    if program is None:
        if time_limit is not None:
            raise InputError("--time-limit ends a program; it needs --command")
        spec = parse_method(method or DEFAULT_METHOD)
        return spec.matcher(**search), spec.name
    if method is not None:
        raise InputError("--method and --command both name a matcher; give one of them")
    runner = Program(program, **search)
    return (runner if time_limit is None else replace(runner, timeout_s=time_limit)), program
