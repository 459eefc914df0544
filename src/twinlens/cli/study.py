"""`twinlens study`: run a study and write its table, figures and findings."""

import json
from pathlib import Path
from typing import Any

import click

from twinlens.cli.places import PATH, check_results, missing_output
from twinlens.cli.progress import progress_bar


@click.command("study")
@click.argument("name")
@click.option("-o", "--output", type=PATH, help="Output folder.  [required, except for 'list']")
@click.option("--scene", "scenes", multiple=True, help="Bundled name or scene file; repeatable.")
@click.option("--methods", "methods", multiple=True, help="Matchers, e.g. sad,zncc:block_size=15; repeatable.")
@click.option("--seeds", type=click.IntRange(1, 1000), help="Number of repetitions.  [default: the study's]")
@click.option("--first-seed", type=click.IntRange(min=0), default=0, show_default=True, help="First seed.")
@click.option("--size", help="Image size, WIDTHxHEIGHT.  [default: the study's]")
@click.option("--spp", type=click.IntRange(1, 1_000_000), help="Samples per pixel.  [default: the study's]")
@click.option("--json", "as_json", is_flag=True, help="Print protocol and findings as JSON.")
def command(
    name: str,
    output: Path | None,
    scenes: tuple[str, ...],
    methods: tuple[str, ...],
    seeds: int | None,
    first_seed: int,
    size: str | None,
    spp: int | None,
    as_json: bool,
) -> None:
    """Run the study NAME and write OUTPUT/table.csv, study.json, figures/ and index.html.

    NAME is an included study (`twinlens study list`) or a Python file that defines STUDY = Study(...), which is
    executed.

    \b
    Example:  twinlens study list
              twinlens study radiometric --scene cards --methods sad,census --seeds 2 -o radiometric
              twinlens study my_study.py -o mine
    """
    if name == "list":
        _list(as_json)
        return
    from twinlens.studies import find_study

    study = find_study(name)
    if output is None:
        raise missing_output()
    check_results(output, "study.json")
    from twinlens.matching import split_methods
    from twinlens.report.study_files import write_study
    from twinlens.studies import run_study

    with progress_bar(f"study {study.name}") as report:
        result = run_study(
            study, scenes=scenes, methods=tuple(split_methods(methods)) if methods else None, seeds=seeds,
            first_seed=first_seed, progress=report, **_sizes(size, spp),
        )  # fmt: skip
    page = write_study(output, result)
    _report(result, page, as_json)


def _list(as_json: bool) -> None:
    from twinlens.studies import STUDIES

    if as_json:
        click.echo(json.dumps({name: study.question for name, study in STUDIES.items()}, indent=1))
        return
    for name, study in STUDIES.items():
        click.echo(f"{name:<14}{study.question}")


def _sizes(size: str | None, spp: int | None) -> dict[str, int]:
    from twinlens.factory.camera_text import parse_size

    sizes = {} if spp is None else {"spp": spp}
    if size is not None:
        sizes["width"], sizes["height"] = parse_size(size)
    return sizes


def _report(result: Any, page: Path, as_json: bool) -> None:
    if as_json:
        click.echo((page.parent / "study.json").read_text())
        return
    for support in result.findings:
        click.echo(f"{support.finding.sentence}.\n    {support.verdict}.")
    click.echo(f"page: {page.resolve().as_uri()}")
