"""`twinlens study`: the list, studies from files, one-line errors."""

import json

import pytest

OWN = """
from twinlens.studies import Column, Figure, Finding, Measured, Setup, Study, mean_of

def measure(setup):
    return Measured([{"scene": "none", "seed": s, "x": x, "y": 2.0 * x} for s in setup.seeds for x in (1.0, 3.0)])

def conclude(table):
    return [Finding("On average y is {}", mean_of(table, "y"), True)]

STUDY = Study("mine", "What is y?", (Column("x", "", "x"), Column("y", "", "y")), measure, conclude,
              (Figure("y", "y of x", "x", "y"),), Setup((), (), (0, 1)))
"""


@pytest.fixture
def study_file(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    return path


def test_a_study_from_a_file(twinlens, study_file, tmp_path):
    code, out, err = twinlens(
        "study", study_file, "--seeds", "3", "--first-seed", "4", "-o", tmp_path / "out"
    )
    assert code == 0, err
    assert (
        "On average y is 4 (range of 3: 4 to 4).\n    holds; 3 of 3 seeds support it.\n"
        in out
    )
    assert (tmp_path / "out" / "table.csv").read_text().splitlines()[1:3] == [
        "none,4,1,2",
        "none,4,3,6",
    ]
    assert (tmp_path / "out" / "index.html").exists()


def test_json_has_the_findings(twinlens, study_file, tmp_path):
    study_file.write_text(
        "print('read')\n"
        + OWN.replace(
            "def measure(setup):", "def measure(setup):\n    print('measured')"
        )
    )
    code, out, _ = twinlens("study", study_file, "--json", "-o", tmp_path / "out")
    assert code == 0
    assert json.loads(out)["findings"][0]["measured"] == 4


def refused(twinlens, *arguments):
    code, out, err = twinlens("study", *arguments)
    assert code == 2, (out, err)
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_an_earlier_study_is_replaced_only_on_request(twinlens, study_file, tmp_path):
    """Other files never are; this is checked before the study runs."""
    output, figures = tmp_path / "out", tmp_path / "out" / "figures"
    line = (study_file, "--seeds", "1", "-o", output)
    output.mkdir()
    letter = output / "index.html"
    letter.write_text("mine")
    assert "contains 'index.html' and no study.json" in refused(twinlens, *line)
    assert letter.read_text() == "mine"
    letter.unlink()
    assert twinlens("study", *line)[0] == 0
    study_file.write_text(OWN.replace('Figure("y"', 'Figure("other"'))
    assert "exists already; choose another name, or" in refused(twinlens, *line)
    assert sorted(path.stem for path in figures.iterdir()) == ["y", "y"]
    assert twinlens("study", *line, "--overwrite")[0] == 0
    names = sorted(path.name for path in figures.iterdir())
    assert names == ["other.png", "other.svg"]


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        ("return Measured(", "return list(", "mine: `measure` must return Measured(rows) with rows, got ["),
        ("for x in (1.0, 3.0)", "for x in ()", "with rows, got no rows"),
        ('"x": x, "y": 2.0 * x', '"y": 2.0 * x', "mine: no row has the column 'x'"),
        ("return [Finding(", "return None and [Finding(", "`conclude` must return a list of Findings, got None"),
        ("def measure(setup):", "def measure(setup):\n    raise OSError('boom')", "mine.py, line 5: OSError: boom"),
        ("from twinlens", "raise SystemExit(7)\nfrom twinlens", "mine.py, line 2: SystemExit: 7"),
        ("def measure", "def", "SyntaxError"),
        ("STUDY =", "OTHER =", "no study found"),
        ('"x", "y"),), Setup', '"x", "yy"),), Setup', "the figure 'y': unknown column 'yy'; did you mean 'y'?"),
    ],
)  # fmt: skip
def test_an_error_in_a_study_file_is_one_line_with_its_location(
    twinlens, study_file, tmp_path, line, instead, message
):
    assert line in OWN
    study_file.write_text(OWN.replace(line, instead, 1))
    assert message in refused(twinlens, study_file, "-o", tmp_path / "out")
    assert not (tmp_path / "out").exists()
