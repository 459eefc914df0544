"""`twinlens study`: run a study and write its table, figures and findings."""

from pathlib import Path
from typing import Any

import click

from twinlens.cli.options import Whole, json_option, print_result
from twinlens.cli.places import PATH, check_results, missing_output
from twinlens.cli.progress import progress_bar


@click.command("study")
@click.argument("name")
@click.option(
    "-o", "--output", type=PATH, help="Output folder.  [required, except for 'list']"
)
@click.option(
    "--scene", "scenes", multiple=True, help="Bundled name or scene file; repeatable."
)
@click.option(
    "--methods",
    "methods",
    multiple=True,
    help="Matchers, e.g. sad,zncc:block_size=15; repeatable.",
)
@click.option(
    "--seeds",
    type=Whole(1, 1000),
    help="Number of repetitions.  [default: the study's]",
)
@click.option(
    "--first-seed", type=Whole(0), default=0, show_default=True, help="First seed."
)
@click.option("--size", help="Image size, WIDTHxHEIGHT.  [default: the study's]")
@click.option(
    "--spp", type=Whole(1, 1_000_000), help="Samples per pixel.  [default: the study's]"
)
@click.option("--overwrite", is_flag=True, help="Replace an earlier study.")
@json_option("protocol and findings")
def command(
    name: str,
    output: Path | None,
    methods: tuple[str, ...],
    overwrite: bool,
    as_json: bool,
    **options: Any,
) -> None:
    """Run the study NAME and write OUTPUT/table.csv, study.json, figures/ and index.html.

    NAME is an included study (`twinlens study list`) or a Python file that defines STUDY = Study(...), which is
    executed.

    \b
    Example:  twinlens study list
              twinlens study radiometric --scene cards --methods sad,census --seeds 2 -o radiometric
              twinlens study my_study.py -o mine
    """
    from twinlens.factory.camera_text import parse_size
    from twinlens.matching import split_methods
    from twinlens.report.study_files import write_study
    from twinlens.studies import advice, find_study, run_study

    if name == "list":
        _list_studies(as_json)
        return
    with progress_bar("loading"):
        study = find_study(name)
    if output is None:
        raise missing_output()
    check_results(output, "study.json", overwrite)
    changes = {key: value for key, value in options.items() if value is not None}
    if "size" in changes:
        changes["width"], changes["height"] = parse_size(changes.pop("size"))
    chosen = tuple(split_methods(methods)) if methods else None
    with progress_bar(f"study {study.name}") as report:
        result = run_study(study, methods=chosen, progress=report, **changes)
    page = write_study(output, result)
    if as_json:
        click.echo((output / "study.json").read_text())
        return
    for support in result.findings:
        click.echo(f"{support.finding.sentence}.\n    {support.verdict}.")
    for sentence in advice(result):
        click.echo(sentence)
    click.echo(f"page: {page.resolve().as_uri()}")


def _list_studies(as_json: bool) -> None:
    from twinlens.studies import STUDIES

    questions = {name: study.question for name, study in STUDIES.items()}
    lines = [f"{name:<14}{question}" for name, question in questions.items()]
    print_result(as_json, questions, *lines)
