import json

from click.testing import CliRunner

from twinlens.cli.methods import command
from twinlens.matching import METHODS


def test_methods_are_listed_with_their_options():
    assert all(name in CliRunner().invoke(command).output for name in METHODS)
    listed = json.loads(CliRunner().invoke(command, ["--json"]).output)
    assert {entry["method"] for entry in listed} == set(METHODS)
    one = CliRunner().invoke(command, ["sgm"]).output
    assert "optimisation    sgm8" in one
