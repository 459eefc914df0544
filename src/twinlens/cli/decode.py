"""`twinlens decode`: projector positions and points from the frames of structured light, compared with the truth."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import Whole, json_option, print_result
from twinlens.cli.places import PATH, PLACE, check_new
from twinlens.cli.progress import progress_bar
from twinlens.dataset import Dataset, Place, StoredSample, open_sample
from twinlens.dataset.dataset import MANIFEST
from twinlens.dataset.files import write_folder
from twinlens.dataset.record import encode_json
from twinlens.reconstruction.decoding import RECORD, decode_sample


@click.command("decode")
@click.argument("place", type=PLACE, metavar="SAMPLE|DATASET")
@click.option("-o", "--output", required=True, type=PATH, help="Folder of the results.")
@click.option(
    "--lens", type=Whole(0), default=0, show_default=True, help="Number of the lens."
)
@click.option(
    "--projector",
    type=Whole(0),
    help="Number of the projector.  [default: the first with a coded sequence]",
)
@click.option(
    "--least",
    type=click.FloatRange(0, 1),
    default=0.05,
    show_default=True,
    help="Modulation that a pixel needs, of that of the image's bright pixels.",
)
@click.option("--overwrite", is_flag=True, help="Replace earlier results.")
@json_option("the comparison with the truth")
def command(
    place: Place, output: Path, overwrite: bool, as_json: bool, **options: Any
) -> None:
    """Decode the sequence of patterns that a projector shows in the frames of a sample, or of each sample of a dataset.

    Each view gets the projector columns and rows (u, v) of its pixels, the mask of those that are valid, the modulation
    and the triangulated points (decoded0.npz, points0.ply), and a picture: the image, the decoded and the true
    positions, and the error up to 2 pixels (decoded0.png). decoded.json has the errors of positions and points against
    the truth of projection, and the shares of pixels that are decoded.

    \b
    Example:  twinlens decode out/0000000 -o decoded
    """
    check_new(output, overwrite, RECORD, "decoded patterns")
    if (place / MANIFEST).exists():
        samples: list[StoredSample] = list(Dataset(place))
    else:
        samples = [open_sample(place)]
    is_dataset = (place / MANIFEST).exists()
    records: dict[str, Any] = {}

    def files() -> Iterator[tuple[str, bytes]]:
        for number, sample in enumerate(samples):
            report(number / len(samples), sample.name)
            folder = f"{sample.name}/" if is_dataset else ""
            views = decode_sample(sample, **options)
            for i, view in enumerate(views):
                for name, content in view.files(i).items():
                    yield f"{folder}{name}", content
            records[sample.name] = [view.record() for view in views]
        yield RECORD, encode_json(record)

    record = {"place": str(place), **options, "samples": records}
    with progress_bar("decoding") as report:
        write_folder(output, files(), overwrite)
    lines = [
        f"{output}: {name}, view {i}: {_text(view)}"
        for name, views in records.items()
        for i, view in enumerate(views)
    ]
    print_result(as_json, record, *lines)


def _text(view: Mapping[str, Any]) -> str:
    """The shares and median errors of a view."""
    text = f"{view['valid_share']:.1%} of the pixels decoded"
    truth = view["against_truth"]
    if not truth:
        return f"{text}; no truth to compare with"
    parts = [f"{_percent(truth['decoded_of_lit'])} of the lit ones"]
    coded = [axis for axis in ("u", "v") if f"{axis}_px" in truth]
    for axis in coded:
        parts += [f"{axis} {_number(truth[f'{axis}_px']['median'])} px"]
    parts.append(f"points {_number(truth['point_mm']['median'])} mm (median errors)")
    return f"{text}, {', '.join(parts)}"


def _percent(share: float | None) -> str:
    return "none" if share is None else f"{share:.1%}"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"
