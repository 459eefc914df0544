"""Every study at a tiny size: rows, findings, figures, reproducibility, errors."""

import functools
import math
from dataclasses import replace

import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.report.plots import draw
from twinlens.studies import (
    STUDIES,
    active,
    aperture,
    defocus,
    depth_error,
    focus,
    from_csv,
    pinhole,
    run_study,
    stage,
    texture,
    to_csv,
    window,
)

METHODS = {
    "active": ("zncc", "depth_camera"),
    "window": ("sad", "census"),
    "radiometric": ("sad", "census"),
}
SLOW = ("active", "aperture", "defocus", "focal-length", "focus", "pinhole")
"""Studies with tests of their own in other files; `baseline` runs the same code as `focal-length`."""

SOME = [
    pytest.param(name, marks=pytest.mark.slow if name in SLOW else ())
    for name in STUDIES
]
TINY = {"width": 64, "height": 48, "spp": 2}


SHORT_SWEEPS = (
    (active, "SWEEPS", {"ambient": (0.5, 109.0), "distance": (1.0,), "power": (0.36,), "texture": (0.2,)}),
    (defocus, "OFFSETS", (0.0, 0.2)),
    (defocus, "DIAMETERS", (0.01,)),
    (defocus, "STEPS", 9),
    (depth_error, "DEPTHS", (1.0, 4.0)),
    (stage, "PHASES", (0.25,)),
    (texture, "CONTRASTS", (0.04, 0.06, 0.08, 0.32)),
    (texture, "SCALES_PX", (1.0, 2.5)),
    (pinhole, "DIAMETERS_MM", (2.0, 0.6, 0.29, 0.23, 0.15, 0.07)),
    (pinhole, "SHOWN_MM", (pinhole.BOX_MM, 0.35)),
    (pinhole, "_PLATE_SPP", 4),
    (focus, "_LINE_SPP", 64),
    (focus, "BLURS_PX", (6.0, 12.0)),
    (aperture, "F_NUMBERS", (1.0, 5.6, 8.0, 11.0, 32.0)),
    (window, "SIZES", (3, 9, 21)),
)  # fmt: skip


@pytest.fixture(scope="module", autouse=True)
def _fewer():
    with pytest.MonkeyPatch.context() as patch:
        for module, name, values in SHORT_SWEEPS:
            patch.setattr(module, name, values)
        sweeps = {"baseline": depth_error.BY_BASELINE, "focal-length": depth_error.BY_FOCAL_LENGTH}  # fmt: skip
        for name, sweep in sweeps.items():
            planes, factors = sweep.planes[::2], sweep.factors[1::2]
            part = replace(sweep, planes=planes, factors=factors)
            patch.setitem(STUDIES, name, replace(STUDIES[name], measure=part.measure))
        yield


def run(name, **more):
    study = STUDIES[name]
    scenes = study.defaults.scenes[:1]
    methods = study.defaults.methods and METHODS.get(name, ("zncc", "census"))
    choices = {"scenes": scenes, "methods": methods, "seeds": 1, **TINY, **more}
    return run_study(study, **choices)


@pytest.fixture(scope="module")
def results(_fewer):
    """Results of studies by name, each run once."""
    return functools.cache(run)


@pytest.mark.parametrize("name", SOME)
def test_rows_are_well_formed(results, name):
    result = results(name)
    assert len(result.table) > 3
    assert set(result.table.values("seed")) == {0.0}
    for column in result.study.columns:
        values = [row[column.name] for row in result.table]
        assert any(value != "" and value == value for value in values), column.name
        assert column.text
        if column.unit == "%":
            shares = [float(value) for value in values if not math.isnan(float(value))]
            assert all(0 <= value <= 100 for value in shares)


@pytest.mark.parametrize("name", SOME)
def test_every_seed_tests_the_same_claims(results, name):
    """The rows repeated with another seed: as many findings, and equal findings of equal rows."""
    result = results(name)
    again = [{**row, "seed": 1.0} for row in result.table]
    both = replace(result.table, rows=(*result.table.rows, *again))
    assert len(result.study.conclude(both)) == len(result.findings)
    texts = [support.finding.text for support in result.findings]
    single = result.study.conclude(both.where(seed=1.0))
    assert [finding.text for finding in single] == texts


@pytest.mark.parametrize("name", SOME)
def test_conclusions_from_some_of_the_methods_or_scenes(results, name):
    """Open claims have no verdict, and NaN is never printed."""
    study, table = results(name).study, results(name).table
    columns = {column.name for column in table.columns}
    for column in columns & {"method", "scene"}:
        for value in table.values(column):
            for finding in study.conclude(table.where(**{column: value})):
                assert "nan" not in finding.sentence
                assert not (finding.has_verdict and math.isnan(finding.measured.value))


@pytest.mark.parametrize("name", SOME)
def test_figures_are_drawn_from_the_csv_read_back(results, name):
    result = results(name)
    table = from_csv(to_csv(result.table), result.study.all_columns)
    assert to_csv(table) == to_csv(result.table)
    for figure in result.study.figures:
        sheet = draw(figure, table)
        assert all(axes.get_ylabel() for axes in sheet.axes)


@pytest.mark.parametrize(
    "name",
    [name if name == "texture" else pytest.param(name, marks=pytest.mark.slow) for name in STUDIES],
)  # fmt: skip
def test_the_same_seed_gives_the_same_bytes(results, name):
    shares = []
    again = run(name, progress=lambda share, label: shares.append(share))
    assert to_csv(again.table) == to_csv(results(name).table)
    assert shares == sorted(shares)
    assert shares[0] == 0


def test_a_study_by_name_returns_its_table_which_depends_on_the_seed(results):
    table = tl.study("texture", methods="zncc", seeds=1, first_seed=5, **TINY)
    assert set(table.values("method")) == {"zncc"}
    errors = table.numbers("error_px")
    assert (errors > 0).all()
    other_seed = results("texture").table.where(method="zncc").numbers("error_px")
    assert errors.tolist() != other_seed.tolist()


WRONG_CHOICES = {
    "did you mean 'aperture'": ("apertur", {}),
    "did you mean 'staircase'": ("window", {"scenes": ("stairs",)}),
    "takes no scenes": ("texture", {"scenes": ("cards",)}),
    "takes no methods": ("pinhole", {"methods": ("sad",)}),
    "did you mean 'zncc'": ("window", {"methods": ("zncd",)}),
    "at least one seed": ("window", {"seeds": 0}),
    "at least one seed, each >= 0": ("window", {"first_seed": -1}),
    "must be distinct": ("window", {"scenes": ("cards", "cards")}),
    "unknown choice of a study 'sedes'; did you mean 'seeds'": ("window", {"sedes": 3}),
    "spp of a study": ("window", {"spp": 0}),
    "width of a study must be a whole number >= 64, got 63": ("texture", {"width": 63}),
    "height of a study must be a whole number >= 48, got 47": ("window", {"width": 64, "height": 47}),
}  # fmt: skip


@pytest.mark.parametrize("message", WRONG_CHOICES)
def test_invalid_choices_raise(message):
    name, choices = WRONG_CHOICES[message]
    with pytest.raises(InputError, match=message):
        tl.study(name, **choices)
