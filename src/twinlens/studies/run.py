"""Run a study: measure, round to what the CSV says, conclude for all seeds and for each, and note the protocol."""

import dataclasses
from collections.abc import Mapping, Sequence
from importlib.metadata import version
from typing import Any

from twinlens.errors import InputError
from twinlens.matching import parse_method
from twinlens.rendering import backend
from twinlens.scenes import load_scene
from twinlens.studies.model import Finding, Measured, Progress, Result, Setup, Stands, Study
from twinlens.studies.table import Table, table


def run_study(
    study: Study,
    *,
    scenes: tuple[str, ...] | None = None,
    methods: tuple[str, ...] | None = None,
    seeds: int | None = None,
    first_seed: int = 0,
    progress: Progress | None = None,
    **sizes: int,
) -> Result:
    """Run `study` on these scenes, methods and seeds, each its own default where not given.

    Parameters
    ----------
    scenes, methods : as `Setup` has them.
    seeds : how many repetitions: the seeds first_seed, first_seed + 1, ...
    sizes : width, height, spp.

    The same arguments give the same table on the same backend. Raises InputError for an unknown scene or method, and
    for scenes given to a study that makes its own.
    """
    defaults = study.defaults
    count = len(defaults.seeds) if seeds is None else seeds
    if count < 1 or first_seed < 0:
        raise InputError(f"a study needs one seed or more, each >= 0; got {count} from {first_seed}")
    changes: dict[str, Any] = {"seeds": tuple(range(first_seed, first_seed + count)), **sizes}
    for name, given in (("scenes", scenes), ("methods", methods)):
        if given:
            if not getattr(defaults, name):
                raise InputError(f"the study {study.name} takes no {name}: what it photographs or asks needs none")
            changes[name] = tuple(given)
    if progress is not None:
        changes["progress"] = progress
    setup = dataclasses.replace(defaults, **changes)
    for text in setup.methods:
        parse_method(text)
    for name in setup.scenes:
        load_scene(name)
    measured = study.measure(setup)
    if not isinstance(measured, Measured) or not measured.rows:
        what = "no rows" if isinstance(measured, Measured) else f"{measured!r:.60}"
        raise InputError(f"the study {study.name}: `measure` must return Measured(rows) with a row or more, got {what}")
    rows = table(study.all_columns, measured.rows)
    protocol = _protocol(study, setup, {**measured.notes, **measured.remarks})
    return Result(study, setup, rows, _findings(study, rows), measured.pictures, protocol, measured.remarks)


def _findings(study: Study, rows: Table) -> tuple[Stands, ...]:
    """Each finding, and how many seeds bear it out alone: give the same answer, and hold.

    Findings are matched by their place in the list, so `conclude` must give the same list of questions for any rows.
    """
    seeds = rows.values("seed")
    whole = _concluded(study, rows)
    alone = [_concluded(study, rows.where(seed=seed)) for seed in seeds]
    if any(len(each) != len(whole) for each in alone):
        raise InputError(f"the study {study.name}: `conclude` must give as many findings for a seed's rows as for all")
    return tuple(
        Stands(finding, sum(each[k].holds and each[k].answer == finding.answer for each in alone), len(seeds))
        for k, finding in enumerate(whole)
    )


def _concluded(study: Study, rows: Table) -> Sequence[Finding]:
    found = study.conclude(rows)
    if not isinstance(found, Sequence) or not all(isinstance(each, Finding) for each in found):
        raise InputError(f"the study {study.name}: `conclude` must return a list of Findings, got {found!r:.60}")
    return found


def _protocol(study: Study, setup: Setup, notes: Mapping[str, Any]) -> dict[str, Any]:
    return {
        "study": study.name,
        "question": study.question,
        "scenes": list(setup.scenes),
        "methods": {text: _options(text) for text in setup.methods},
        "seeds": list(setup.seeds),
        "width": setup.width,
        "height": setup.height,
        "spp": setup.spp,
        "backend": backend().variant,
        "versions": {name: version(name) for name in ("twinlens", "mitsuba", "drjit", "numpy")},
        "columns": {column.name: {"unit": column.unit, "text": column.text} for column in study.all_columns},
        **notes,
    }


def _options(text: str) -> dict[str, Any]:
    spec = parse_method(text)
    return {**spec.method.options, **spec.options}
