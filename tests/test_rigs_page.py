"""The examples of docs/rigs.md run as printed."""

import doctest
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[1] / "docs" / "rigs.md"


@pytest.mark.skipif(not PAGE.exists(), reason="the page is not beside these tests")
def test_examples_run_as_printed():
    failed, tried = doctest.testfile(str(PAGE), module_relative=False)
    assert tried > 5
    assert failed == 0
