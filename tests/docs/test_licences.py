"""docs/licences.md lists every package that twinlens needs, and none of the core forbids commercial use."""

import importlib.util
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def licences():
    spec = importlib.util.spec_from_file_location("licences", ROOT / "docs/licences.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def listed():
    """Name -> (licence, what needs it), from the page."""
    text = (ROOT / "docs/licences.md").read_text()
    rows = re.findall(
        r"^\| ([a-z0-9-]+) \| [^|]+ \| ([^|]+) \| ([^|]+) \|$", text, re.M
    )
    return {name: (licence, users) for name, licence, users in rows}


def names(requirements):
    """Names of packages as in metadata: lower case, with hyphens."""
    heads = [re.match(r"[\w.-]+", text)[0] for text in requirements]
    return {re.sub(r"[-_.]+", "-", head).lower() for head in heads}


def test_every_direct_dependency_is_on_the_page(licences):
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    of_core = {name for name, (_, users) in listed().items() if users == "core"}
    assert names(project["dependencies"]) <= of_core
    for extra in licences.EXTRAS:
        assert names(project["optional-dependencies"][extra]) <= set(listed())


def test_the_page_says_what_the_packages_state(licences):
    page = listed()
    for name, _, licence, users in licences.table():
        if name in page:  # other versions may need other packages
            assert page[name] == (licence, users)


def test_the_core_allows_commercial_use(licences):
    for name, (licence, users) in listed().items():
        if users == "core":
            assert licences.allows_commercial_use(licence), name


@pytest.mark.parametrize(
    ("text", "allowed"),
    [
        ("MIT", True),
        ("BSD-2-Clause AND Apache-2.0 WITH LLVM-exception", True),
        ("GPL-3.0-only OR MIT", True),
        ("The MIT License (MIT)", True),
        ("GPL-3.0-only", False),
        ("MIT AND CC-BY-NC-4.0", False),
        ("Polyform-Noncommercial-1.0.0", False),
        ("not stated", False),
    ],
)
def test_licences_are_judged_by_all_of_their_parts(licences, text, allowed):
    assert licences.allows_commercial_use(text) is allowed
