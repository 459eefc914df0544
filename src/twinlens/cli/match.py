"""`twinlens match`: the disparity map of two images."""

import time
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from twinlens.cli.options import DISPARITY, SECONDS, Whole, json_option, print_result
from twinlens.cli.places import PATH, PNG_FILE, PlaceType, check_creatable
from twinlens.cli.progress import progress_bar
from twinlens.dataset import read_image, write_pfm, write_png
from twinlens.dataset.pictures import colourise, disparity_limits
from twinlens.errors import InputError
from twinlens.matching import Answer, Program, parse_method
from twinlens.matching.contract import (
    DEFAULT_DISPARITIES,
    BaseMatcher,
    check_image_size,
)

DEFAULT_METHOD = "zncc"


@click.command("match")
@click.argument("left", type=PATH)
@click.argument("right", type=PATH)
@click.option(
    "-o",
    "--output",
    required=True,
    type=PlaceType(suffixes=(".pfm",)),
    help="The disparity map, a .pfm file.",
)
@click.option(
    "--method",
    help=f"A matcher, such as zncc or sad:block_size=15,lr_check=1.  [default: {DEFAULT_METHOD}]",
)
@click.option(
    "--command", "program", metavar="COMMAND",
    help="A program in place of --method, such as 'prog {left} {right} {out}': it reads two PNG files and writes a PFM "
    "file. {num_disparities} and {min_disparity} are replaced too. Not run by a shell.",
)  # fmt: skip
@click.option(
    "--time-limit",
    type=SECONDS,
    help="Time limit of the program, seconds.  [default: 600]",
)
@click.option(
    "--num-disparities",
    "--ndisp",
    type=Whole(1),
    help="Number of disparities to search.  [default: 64]",
)
@click.option(
    "--min-disparity",
    type=DISPARITY,
    default=0,
    show_default=True,
    help="The smallest disparity, pixels.",
)
@click.option(
    "--confidence", type=PlaceType(suffixes=(".pfm",)),
    help="Also write the confidence, a .pfm file; the method needs one, such as zncc:confidence=ambiguity.",
)  # fmt: skip
@click.option("--picture", type=PNG_FILE, help="Also write the map as a colour PNG.")
@json_option("the result")
def command(
    left: Path,
    right: Path,
    output: Path,
    confidence: Path | None,
    picture: Path | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Match LEFT and RIGHT, a rectified pair, and write the left image's disparity map (+inf where unknown).

    \b
    Example:  twinlens match out/staircase/im0.png out/staircase/im1.png --num-disparities 64 -o disp.pfm
              twinlens match im0.png im1.png --command "./prog {left} {right} {out}" -o disp.pfm
    """
    _check_outputs(
        (left, right),
        {"--output": output, "--confidence": confidence, "--picture": picture},
    )
    matcher, name = _matcher(**options)
    images = [read_image(path) for path in (left, right)]
    check_image_size(matcher, images[0].shape[:2])
    start = time.perf_counter()
    with progress_bar("matching"):
        answer = matcher.match_with_confidence(*images)
    seconds = time.perf_counter() - start
    if confidence is not None:
        write_pfm(confidence, _confidence(answer, name))
    disparity = answer.disparity
    write_pfm(output, disparity)
    if picture is not None:
        write_png(picture, colourise(disparity, *disparity_limits(disparity, matcher)))
    matched = float(np.isfinite(disparity).mean())
    record = {
        "output": str(output),
        "method": name,
        "known_fraction": matched,
        "seconds": seconds,
    }
    _warn_of_range(disparity, matcher, name)
    text = f"{output}: {name}, {matched:.1%} of the pixels matched, {seconds:.2f} s including compilation"
    print_result(as_json, record, text)


def _warn_of_range(
    disparity: NDArray[np.float32], matcher: BaseMatcher, name: str
) -> None:
    """Warn if most values are outside the searched range, as those of a map in another unit."""
    count = getattr(matcher, "num_disparities", None)
    values = disparity[np.isfinite(disparity)]
    if count is None or not values.size:
        return
    first = getattr(matcher, "min_disparity", 0)
    outside = (values < first - 1) | (values > first + count)
    if np.mean(outside) > 0.5:
        warnings.warn(
            f"{name}: {np.mean(outside):.0%} of the estimates, from {values.min():g} to {values.max():g}, are outside "
            f"the searched {first} to {first + count - 1} px; a map is in pixels (int16 maps of OpenCV are in 1/16 px)",
            stacklevel=2,
        )


def _confidence(answer: Answer, name: str) -> NDArray[np.float32]:
    """The confidence of an answer. Raises InputError if its method computes none."""
    if answer.confidence is None:
        raise InputError(
            f"--confidence: {name} computes none; use a method such as zncc:confidence=ambiguity"
        )
    return answer.confidence


def _check_outputs(images: tuple[Path, ...], outputs: dict[str, Path | None]) -> None:
    """Raise InputError if an output is one of the images, a file in a sample, or below a file."""
    taken: dict[Path, str] = {}
    for option, path in outputs.items():
        if path is None:
            continue
        if (earlier := taken.setdefault(path.absolute(), option)) != option:
            raise InputError(f"{option} {path}: is also {earlier}; choose another file")
        if any(
            path.exists() and image.exists() and path.samefile(image)
            for image in images
        ):
            raise InputError(
                f"{option} {path}: is one of the two images; choose another file"
            )
        if (path.absolute().parent / "sample.json").exists():
            raise InputError(
                f"{option} {path}: is in a sample of a dataset; choose another folder"
            )
        check_creatable(path.parent)


def _matcher(
    method: str | None,
    program: str | None,
    time_limit: float | None,
    num_disparities: int | None,
    min_disparity: int,
) -> tuple[BaseMatcher, str]:
    """The matcher and its name."""
    search = {
        "num_disparities": num_disparities or DEFAULT_DISPARITIES,
        "min_disparity": min_disparity,
    }
    if program is not None:
        if method is not None:
            raise InputError(
                "--method and --command both name a matcher; use one of them"
            )
        runner = Program(program, **search)
        return (
            runner if time_limit is None else replace(runner, timeout_s=time_limit)
        ), program
    if time_limit is not None:
        raise InputError("--time-limit applies to programs only; use it with --command")
    spec = parse_method(method or DEFAULT_METHOD)
    matcher = spec.matcher(**search)
    if num_disparities is not None and (
        "num_disparities" in spec.options or not hasattr(matcher, "num_disparities")
    ):
        raise InputError(f"--num-disparities: the search range of {spec.name} is fixed")
    return matcher, spec.name
