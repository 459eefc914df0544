"""Every study at a tiny size: rows, findings, figures, reproducibility, errors."""

import math
from dataclasses import replace

import numpy as np
import pytest

import twinlens as tl
from twinlens.errors import InputError
from twinlens.report.plots import draw
from twinlens.studies import (
    STUDIES,
    Setup,
    Table,
    active,
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
QUICK = ("texture", "radiometric")
"""Studies that are run twice; the others only in slow tests."""
SOME = [
    pytest.param(
        name, marks=pytest.mark.slow if name in ("pinhole", "focal-length") else ()
    )
    for name in STUDIES
]
"""All studies; the test of `baseline` runs the same code as that of `focal-length`."""
TINY = {"width": 96, "height": 72, "spp": 2}


@pytest.fixture(scope="module", autouse=True)
def _fewer():
    """Shorter sweeps."""
    patch = pytest.MonkeyPatch()
    patch.setattr(
        active,
        "SWEEPS",
        {
            "ambient": (0.5, 109.0),
            "distance": (1.0,),
            "power": (0.36,),
            "texture": (0.2,),
        },
    )
    patch.setattr(defocus, "OFFSETS", (0.0, 0.2))
    patch.setattr(defocus, "DIAMETERS", (0.01,))
    patch.setattr(defocus, "STEPS", 9)
    patch.setattr(depth_error, "DEPTHS", (1.0, 4.0))
    patch.setattr(stage, "PHASES", (0.25,))
    patch.setattr(texture, "CONTRASTS", (0.04, 0.06, 0.08, 0.32))
    patch.setattr(texture, "SCALES_PX", (1.0, 2.5))
    patch.setattr(pinhole, "DIAMETERS_MM", (2.0, 0.6, 0.29, 0.23, 0.15, 0.07))
    patch.setattr(pinhole, "SHOWN_MM", (pinhole.BOX_MM, 0.35))
    patch.setattr(pinhole, "_PLATE_SPP", 4)
    for name, whole in (
        ("baseline", depth_error.BY_BASELINE),
        ("focal-length", depth_error.BY_FOCAL_LENGTH),
    ):
        part = replace(whole, planes=whole.planes[::2], factors=whole.factors[1::2])
        patch.setitem(STUDIES, name, replace(STUDIES[name], measure=part.measure))
    patch.setattr(focus, "_LINE_SPP", 64)
    patch.setattr(window, "SIZES", (3, 9, 21))
    yield
    patch.undo()


@pytest.fixture(scope="module")
def results(_fewer):
    made = {}

    def of(name):
        if name not in made:
            made[name] = run(name)
        return made[name]

    return of


def run(name, **more):
    study = STUDIES[name]
    scenes = study.defaults.scenes[:1]
    methods = study.defaults.methods and METHODS.get(name, ("zncc", "census"))
    return run_study(
        study, scenes=scenes, methods=methods, **{"seeds": 1, **TINY, **more}
    )


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
def test_findings_are_sentences_with_a_number(results, name):
    findings = results(name).findings
    assert findings
    for support in findings:
        finding = support.finding
        assert finding.template.count("{}") == 1
        assert "{}" not in finding.sentence
        assert finding.text[-1] != "."
        assert isinstance(finding.holds, (bool, np.bool_))
        assert 0 <= support.supporting <= support.seeds == 1


@pytest.mark.parametrize("name", SOME)
def test_every_seed_tests_the_same_claims(results, name):
    """The rows repeated with another seed: as many findings, and equal findings of equal rows."""
    result = results(name)
    again = tuple({**row, "seed": 1.0} for row in result.table)
    both = replace(result.table, rows=(*result.table.rows, *again))
    single = result.study.conclude(both.where(seed=1.0))
    assert len(single) == len(result.study.conclude(both)) == len(result.findings)
    assert [finding.text for finding in single] == [
        support.finding.text for support in result.findings
    ]


@pytest.mark.parametrize("name", SOME)
def test_conclusions_from_some_of_the_methods_or_scenes(results, name):
    """Open claims have no verdict, and NaN is never printed."""
    result = results(name)
    for column in ("method", "scene"):
        names = [listed.name for listed in result.table.columns]
        for value in result.table.values(column) if column in names else ():
            for finding in result.study.conclude(result.table.where(**{column: value})):
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
    [
        *QUICK,
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in STUDIES
            if name not in QUICK
        ),
    ],
)
def test_the_same_seed_gives_the_same_bytes(results, name):
    assert to_csv(run(name).table) == to_csv(results(name).table)


def test_another_seed_gives_another_table():
    first, second = (run("texture", first_seed=seed).table for seed in (0, 5))
    assert first.numbers("error_px").tolist() != second.numbers("error_px").tolist()


def test_the_panel_of_window(results):
    panel = results("window").pictures[0]
    assert panel.captions[:6] == (
        "left",
        "right",
        "true disparity",
        "SSD, fixed 21x21",
        "adaptive window",
        "semi-global",
    )
    assert all(
        image.shape[:2] == (TINY["height"], TINY["width"]) for image in panel.images
    )


def test_progress_increases_from_zero():
    shares = []
    run("texture", progress=lambda share, label: shares.append(share))
    assert shares == sorted(shares)
    assert shares[0] == 0


def test_study_returns_the_table():
    table = tl.study("texture", methods="zncc", seeds=1, **TINY)
    assert set(table.values("method")) == {"zncc"}
    assert (table.numbers("error_px") > 0).all()


@pytest.mark.parametrize(
    ("name", "choices", "words"),
    [
        ("apertur", {}, "did you mean 'aperture'"),
        ("window", {"scenes": ("stairs",)}, "did you mean 'staircase'"),
        ("window", {"methods": ("zncd",)}, "did you mean 'zncc'"),
        ("texture", {"scenes": ("cards",)}, "takes no scenes"),
        ("pinhole", {"methods": ("sad",)}, "takes no methods"),
        ("window", {"seeds": 0}, "at least one seed"),
        ("window", {"first_seed": -1}, "at least one seed"),
        ("window", {"scenes": ("cards", "cards")}, "must be distinct"),
        ("window", {"spp": 0}, "spp"),
        (
            "window",
            {"sedes": 3},
            "unknown choice of a study 'sedes'; did you mean 'seeds'",
        ),
        (
            "texture",
            {"width": 63},
            "width of a study must be a whole number >= 64, got 63",
        ),
        (
            "window",
            {"width": 64, "height": 47},
            "height of a study must be a whole number >= 48, got 47",
        ),
        ("no/such.py", {}, "no such file"),
    ],
)
def test_invalid_choices_raise(name, choices, words):
    with pytest.raises(InputError, match=words):
        tl.study(name, **choices)


def test_a_setup_without_seeds_raises():
    with pytest.raises(InputError, match="one seed"):
        Setup(("cards",), ("sad",), ())


def test_a_claim_that_the_methods_leave_open_has_no_verdict():
    rest = {"scene": "cards", "seed": 0, "amount": 0.5, "totbad1": 0.0, "avgerr": 0.0}
    rows = tuple(
        {**rest, "change": change, "method": method, "totbad2": wrong}
        for change in ("gain", "gamma", "vignetting", "noise")
        for method, wrong in (("sad", 30.0), ("census", 10.0))
    )
    columns = STUDIES["radiometric"].all_columns
    both, one = (
        STUDIES["radiometric"].conclude(Table(columns, part))[-1]
        for part in (rows, rows[::2])
    )
    none = STUDIES["radiometric"].conclude(
        Table(columns, tuple({**row, "method": "sgm"} for row in rows[::2]))
    )
    assert [finding.has_verdict for finding in none] == 5 * [False]
    assert both.has_verdict
    assert both.holds
    assert not one.has_verdict
    assert "nan" not in one.sentence
