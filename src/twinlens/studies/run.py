"""Find a study by name, package or file, and run it."""

import contextlib
import dataclasses
import importlib.metadata
import os
import runpy
import time
import traceback
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypedDict, Unpack

from twinlens.errors import (
    FileError,
    InputError,
    TwinlensError,
    check_known,
    file_hint,
    unknown,
)
from twinlens.factory.sample import made_with
from twinlens.matching import parse_method
from twinlens.scenes import load_scene
from twinlens.studies.active import STUDY as ACTIVE
from twinlens.studies.aperture import STUDY as APERTURE
from twinlens.studies.defocus import STUDY as DEFOCUS
from twinlens.studies.depth_error import BASELINE, FOCAL_LENGTH
from twinlens.studies.findings import Finding, SeedSupport, shortages
from twinlens.studies.focus import STUDY as FOCUS
from twinlens.studies.model import Measured, Progress, Result, Setup, Study
from twinlens.studies.pinhole import STUDY as PINHOLE
from twinlens.studies.radiometric import STUDY as RADIOMETRIC
from twinlens.studies.table import Table, filled_table
from twinlens.studies.texture import STUDY as TEXTURE
from twinlens.studies.window import STUDY as WINDOW

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        APERTURE,
        PINHOLE,
        FOCUS,
        DEFOCUS,
        WINDOW,
        BASELINE,
        FOCAL_LENGTH,
        RADIOMETRIC,
        TEXTURE,
        ACTIVE,
    )
}
ENTRY_POINTS = "twinlens.studies"


class Choices(TypedDict, total=False):
    """The arguments of `study` and `run_study`; None is the study's default."""

    scenes: str | tuple[str, ...] | None
    methods: str | tuple[str, ...] | None
    seeds: int | None
    first_seed: int
    progress: Progress | None
    width: int
    height: int
    spp: int


def study(name: str | os.PathLike[str], **choices: Unpack[Choices]) -> Table:
    """Run a study and return its table; `choices` as for `run_study`, which also returns findings and pictures."""
    return run_study(find_study(name), **choices).table


def run_study(study: Study, **choices: Unpack[Choices]) -> Result:
    """Run a study with its defaults, except for the arguments that are given: see `Setup`.

    seeds: the number of repetitions, with the seeds first_seed, first_seed + 1, ... The same arguments give the same
    table on the same backend. Raises InputError for an unknown argument, scene or method, and for scenes or methods
    given to a study that does not use them.
    """
    setup = _setup(study, choices)
    # An unknown matcher or scene is an error before the first hour's work.
    for method in setup.methods:
        parse_method(method)
    for name in setup.scenes:
        load_scene(name)
    start = time.monotonic()
    measured = _measured(study, setup)
    rows = filled_table(study.all_columns, measured.rows)
    protocol = {
        **_protocol(study, setup),
        **measured.notes,
        **measured.remarks,
    }
    return Result(
        study,
        setup,
        rows,
        _findings(study, setup, rows),
        measured.pictures,
        protocol,
        measured.remarks,
        time.monotonic() - start,
    )


def _protocol(study: Study, setup: Setup) -> dict[str, Any]:
    """What is run, for study.json: the setup, the options of the matchers, versions, and the columns."""
    methods = {}
    for text in setup.methods:
        spec = parse_method(text)
        methods[text] = {**spec.method.options, **spec.options}
    columns = {
        column.name: {"unit": column.unit, "text": column.text}
        for column in study.all_columns
    }
    return {
        "study": study.name,
        "question": study.question,
        "scenes": setup.scenes,
        "seeds": setup.seeds,
        "width": setup.width,
        "height": setup.height,
        "spp": setup.spp,
        "methods": methods,
        **made_with(),
        "columns": columns,
    }


def _setup(study: Study, choices: Mapping[str, Any]) -> Setup:
    """The defaults of the study with the user's choices."""
    for name in choices:
        check_known("choice of a study", name, Choices.__annotations__)
    changes = {
        name: value for name, value in choices.items() if value not in (None, (), [])
    }
    count = changes.pop("seeds", len(study.defaults.seeds))
    first = changes.pop("first_seed", 0)
    if count < 1 or first < 0:
        raise InputError(
            f"a study needs at least one seed, each >= 0; got {count} from {first}"
        )
    for name in changes.keys() & {"scenes", "methods"}:
        if not getattr(study.defaults, name):
            raise InputError(f"the study {study.name} takes no {name}")
        value = changes[name]
        changes[name] = (value,) if isinstance(value, str) else tuple(value)
    seeds = tuple(range(first, first + count))
    return dataclasses.replace(study.defaults, seeds=seeds, **changes)


def _measured(study: Study, setup: Setup) -> Measured:
    """The study's measurements; InputError unless there are rows, which together have every column."""
    measured = study.measure(setup)
    if not isinstance(measured, Measured) or not measured.rows:
        result = "no rows" if isinstance(measured, Measured) else f"{measured!r:.60}"
        raise InputError(
            f"the study {study.name}: `measure` must return Measured(rows) with rows, got {result}"
        )
    names = {column.name for column in study.all_columns}
    if missing := names.difference(*measured.rows):
        raise InputError(
            f"the study {study.name}: no row has the column {min(missing)!r}"
        )
    return measured


def _findings(study: Study, setup: Setup, rows: Table) -> tuple[SeedSupport, ...]:
    """The findings of all rows, with the number of seeds that support each one, matched by position, on their own."""
    overall = _concluded(study, rows)
    by_seed = []
    for seed in rows.values("seed"):
        findings = _concluded(study, rows.where(seed=seed))
        if len(findings) != len(overall):
            raise InputError(
                f"the study {study.name}: `conclude` must return as many findings for one seed as for all"
            )
        by_seed.append(findings)
    supports = []
    for number, finding in enumerate(overall):
        alone = [findings[number] for findings in by_seed]
        supports.append(_supported(study, setup, finding, alone))
    return tuple(supports)


def _supported(
    study: Study, setup: Setup, finding: Finding, alone: Sequence[Finding]
) -> SeedSupport:
    """The finding with what its sample lacks, and the number of its repetitions by single seeds that agree with it."""
    supporting = sum(
        single.holds and single.answer == finding.answer for single in alone
    )
    lacking = shortages(finding, setup.width * setup.height, len(setup.seeds))
    scene = finding.measured.scene
    is_one_of_many = scene in setup.scenes and len(study.defaults.scenes) > 1
    place = scene if is_one_of_many else ""
    return SeedSupport(finding, supporting, len(alone), lacking, place)


def _concluded(study: Study, rows: Table) -> Sequence[Finding]:
    findings = study.conclude(rows)
    if not isinstance(findings, Sequence) or not all(
        isinstance(finding, Finding) for finding in findings
    ):
        raise InputError(
            f"the study {study.name}: `conclude` must return a list of Findings, got {findings!r:.60}"
        )
    return findings


def find_study(name: str | os.PathLike[str]) -> Study:
    """The study of this name, from twinlens or an entry point `twinlens.studies`, or the STUDY of this Python file.

    The file's code is executed. Raises InputError for an unknown name, and FileError for a file without a study.
    """
    text = os.fspath(name)
    if text in STUDIES:
        return STUDIES[text]
    if text.endswith(".py"):
        return _from_file(Path(text))
    points = importlib.metadata.entry_points(group=ENTRY_POINTS)
    installed = {point.name: point for point in points}
    if text not in installed:
        raise unknown("study", text, [*STUDIES, *installed])
    point = installed[text]
    return _checked(point.load(), f"the entry point {point.value}")


def _from_file(path: Path) -> Study:
    if not path.is_file():
        raise FileError(
            f"{path}: no such file; a study file is a Python file that defines STUDY = Study(...)"
            f"{file_hint(path)}"
        )
    with _located(path):
        namespace = runpy.run_path(str(path))
    study = _checked(namespace.get("STUDY"), str(path))
    # The functions of the file run later, and their exceptions name the file too.
    return dataclasses.replace(
        study,
        measure=_located(path)(study.measure),
        conclude=_located(path)(study.conclude),
    )


@contextlib.contextmanager
def _located(path: Path) -> Iterator[None]:
    """Turn exceptions in a user's file into a one-line FileError with file and line number."""
    try:
        yield
    except TwinlensError:
        raise
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)
        lines = [frame.lineno for frame in frames if frame.filename == str(path)]
        line = f", line {lines[-1]}" if lines else ""
        message = " ".join(str(error).split())
        raise FileError(f"{path}{line}: {type(error).__name__}: {message}") from error


def _checked(study: Any, where: str) -> Study:
    if not isinstance(study, Study):
        raise InputError(
            f"{where}: no study found; define STUDY = twinlens.studies.Study(...)"
        )
    return study
