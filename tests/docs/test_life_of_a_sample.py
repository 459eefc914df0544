"""docs/life_of_a_sample.md names functions that exist."""

import importlib
import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "docs" / "life_of_a_sample.md"
PACKAGES = "camera|dataset|factory|families|rendering|scenes|schema|sensor"
pytestmark = pytest.mark.skipif(not PAGE.exists(), reason="docs/ is not available")


def resolve(name):
    """The module or attribute of a dotted name below twinlens."""
    parts = name.split(".")
    value = importlib.import_module(f"twinlens.{parts[0]}")
    for number, part in enumerate(parts[1:], start=2):
        try:
            value = importlib.import_module(f"twinlens.{'.'.join(parts[:number])}")
        except ModuleNotFoundError:
            value = getattr(value, part)
    return value


def test_every_function_exists():
    words = rf"(?<![\w./])(?:{PACKAGES})(?:\.(?!json)\w+)+"
    names = set(re.findall(words, PAGE.read_text()))
    assert len(names) > 15
    missing = []
    for name in sorted(names):
        try:
            resolve(name)
        except AttributeError:
            missing.append(name)
    assert missing == []
