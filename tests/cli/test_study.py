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
def own(tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(OWN)
    return path


def test_the_list_names_every_study(twinlens):
    code, out, _ = twinlens("study", "list")
    assert code == 0
    assert [line.split()[0] for line in out.splitlines()] == [
        "aperture", "pinhole", "focus", "defocus", "window", "baseline", "focal-length", "radiometric", "texture",
        "active",
    ]  # fmt: skip
    assert set(json.loads(twinlens("study", "list", "--json")[1])) == {
        line.split()[0] for line in out.splitlines()
    }


def test_a_study_from_a_file(twinlens, own, tmp_path):
    code, out, err = twinlens(
        "study", own, "--seeds", "3", "--first-seed", "4", "-o", tmp_path / "out"
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


def test_json_has_the_findings(twinlens, own, tmp_path):
    own.write_text(
        "print('read')\n"
        + OWN.replace(
            "def measure(setup):", "def measure(setup):\n    print('measured')"
        )
    )
    code, out, _ = twinlens("study", own, "--json", "-o", tmp_path / "out")
    assert code == 0
    assert json.loads(out)["findings"][0]["measured"] == 4


def refused(twinlens, *arguments):
    code, out, err = twinlens("study", *arguments)
    assert code == 2, (out, err)
    assert out == ""
    assert err.count("\n") == 1
    return err


def test_errors_are_one_line(twinlens, own, tmp_path):
    o = ("-o", tmp_path / "out")
    assert "did you mean 'pinhole'" in refused(twinlens, "pinhol", *o)
    assert "Missing option '-o' / '--output': " in refused(twinlens, "window")
    assert "did you mean 'staircase'" in refused(
        twinlens, "window", "--scene", "stairs", *o
    )
    assert "did you mean 'zncc'" in refused(twinlens, "window", "--methods", "zncd", *o)
    assert "takes no scenes" in refused(twinlens, "texture", "--scene", "cards", *o)
    assert "seeds" in refused(twinlens, "window", "--seeds", "0", *o)
    assert "WIDTHxHEIGHT" in refused(twinlens, "window", "--size", "9", *o)
    assert "no such file" in refused(twinlens, tmp_path / "absent.py", *o)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("STUDY = 3", "no study found"),
        ("1/0", "ZeroDivisionError"),
        ("def", "SyntaxError"),
    ],
)
def test_files_without_a_study_raise(twinlens, tmp_path, text, words):
    path = tmp_path / "mine.py"
    path.write_text(text)
    error = refused(twinlens, path, "-o", tmp_path / "out")
    assert words in error
    assert str(path) in error


def test_an_undecided_claim_has_no_verdict(twinlens, tmp_path):
    path = tmp_path / "mine.py"
    path.write_text(
        OWN.replace(
            'mean_of(table, "y"), True', 'mean_of(table, "y"), False, decided=False'
        )
    )
    code, out, err = twinlens("study", path, "-o", tmp_path / "out")
    assert code == 0, err
    assert "no verdict: not decided" in out
    assert "hold" not in out
    assert (
        json.loads((tmp_path / "out" / "study.json").read_text())["findings"][0][
            "holds"
        ]
        is None
    )
    page = (tmp_path / "out" / "index.html").read_text()
    assert "No verdict" in page
    assert "not hold" not in page.lower()


def test_results_never_overwrite_other_files(twinlens, own, tmp_path):
    """Checked before the study runs."""
    (tmp_path / "letters").mkdir()
    (tmp_path / "letters" / "index.html").write_text("mine")
    for place, message in (("letters", "contains 'index.html' and no study.json"), ("mine.py", "is a file where"),
                        ("mine.py/out", "is a file where")):  # fmt: skip
        code, out, err = twinlens("study", own, "-o", tmp_path / place)
        assert (code, out) == (2, "")
        assert message in err
        assert err.count("\n") == 1
    assert (tmp_path / "letters" / "index.html").read_text() == "mine"
    assert [entry.name for entry in (tmp_path / "letters").iterdir()] == ["index.html"]
    assert twinlens("study", own, "-o", tmp_path / "new" / "place")[0] == 0


def test_an_earlier_study_is_replaced_only_on_request(twinlens, own, tmp_path):
    output = tmp_path / "out"
    assert twinlens("study", own, "-o", output)[0] == 0
    own.write_text(OWN.replace('Figure("y"', 'Figure("other"'))
    table = (output / "table.csv").stat().st_mtime_ns
    error = refused(twinlens, own, "--seeds", "1", "-o", output)
    assert (
        error
        == f"twinlens: {output}: exists already; choose another name, or add --overwrite\n"
    )
    assert (output / "table.csv").stat().st_mtime_ns == table
    assert twinlens("study", own, "--seeds", "1", "-o", output, "--overwrite")[0] == 0
    assert sorted(path.name for path in (output / "figures").iterdir()) == [
        "other.png",
        "other.svg",
    ]


@pytest.mark.parametrize(
    ("line", "instead", "message"),
    [
        ("return Measured(", "return list(", "mine: `measure` must return Measured(rows) with rows, got ["),
        ("for x in (1.0, 3.0)", "for x in ()", "with rows, got no rows"),
        ('"x": x, "y": 2.0 * x', '"y": 2.0 * x', "mine: no row has the column 'x'"),
        ("return [Finding(", "return None and [Finding(", "`conclude` must return a list of Findings, got None"),
        ("def measure(setup):", "def measure(setup):\n    raise OSError('boom')", "mine.py, line 5: OSError: boom"),
        ("from twinlens", "1 / 0\nfrom twinlens", "mine.py, line 2: ZeroDivisionError: division by zero"),
        ("from twinlens", "raise SystemExit(7)\nfrom twinlens", "mine.py, line 2: SystemExit: 7"),
        ("(0, 1)))", "2))", "mine.py, line 11: TypeError"),
        ('"x", "y"),), Setup', '"x", "yy"),), Setup', "the figure 'y': unknown column 'yy'; did you mean 'y'?"),
    ],
)  # fmt: skip
def test_an_error_in_a_study_file_is_one_line_with_its_location(
    twinlens, own, tmp_path, line, instead, message
):
    assert line in OWN
    own.write_text(OWN.replace(line, instead, 1))
    code, out, err = twinlens("study", own, "-o", tmp_path / "out")
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "out").exists()
