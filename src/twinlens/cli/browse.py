"""`twinlens browse`: an offline page of a dataset."""

from pathlib import Path

import click

from twinlens.cli.options import json_option, print_result
from twinlens.cli.places import PATH, PLACE, check_creatable, refuse_others
from twinlens.cli.progress import interrupt_note, progress_bar
from twinlens.dataset import Dataset, Place
from twinlens.errors import InputError, counted
from twinlens.report.dataset_page import is_page, write_dataset_page


@click.command("browse")
@click.argument("dataset", type=PLACE)
@click.option(
    "-o",
    "--output",
    type=PATH,
    help="Folder of the page.  [default: DATASET/browse]",
)
@json_option("the result")
def command(dataset: Place, output: Path | None, as_json: bool) -> None:
    """Write a page to browse DATASET: thumbnails, histograms of all recorded values, channels of a sample on a click.

    The page needs no network and no server, and loads only the pictures that are in sight. Rerun the command after the
    dataset has changed, or to resume; pictures of samples that have not changed are kept.

    \b
    Example:  twinlens browse out
              twinlens browse s3://bucket/out -o page
    """
    if output is None and not isinstance(dataset, Path):
        raise InputError(f"{dataset}: is in a bucket; name a folder for the page (-o)")
    folder = output if output is not None else Path(str(dataset)) / "browse"
    samples = Dataset(dataset)
    if output is None and samples[0].folder == samples.path:
        raise InputError(
            f"{dataset}: is a single sample; name a folder for the page (-o)"
        )
    check_creatable(folder)
    if not is_page(folder):
        refuse_others(folder, (), "page of `twinlens browse`")
    kept = "pictures are kept; run the same command to resume"
    with progress_bar("drawing") as report, interrupt_note(lambda: kept):
        shown = write_dataset_page(samples, folder, report)
    problems = {sample.name: sample.problem for sample in shown if sample.problem}
    page = folder / "index.html"
    lines = [f"{page}: {counted(len(shown), 'sample')}"]
    lines += [f"{name}: {problem}" for name, problem in problems.items()]
    record = {"page": str(page), "samples": len(shown), "problems": problems}
    print_result(as_json, record, *lines)
