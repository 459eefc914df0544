"""Write docs/licences.md: the licences of all packages that twinlens needs, by the metadata of this environment.

Run it in an environment with all extras: python docs/licences.py
"""

import re
import sys
import tomllib
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

FILE = Path(__file__).with_suffix(".md")
CORE = "core"
EXTRAS = ("cluster", "gltf", "onnx", "opencv", "parquet", "usd")
"""The extras of users; those of developers (docs, lint, test, train, dist) are not installed with twinlens."""

COMMERCIAL = (
    "0BSD", "Apache", "BSD", "CC0", "HPND", "ISC", "LGPL", "MIT", "MPL", "PSF", "Python Software", "Python-2.0", "TOST",
    "Unlicense", "Zlib",
)  # fmt: skip
"""Beginnings of the names of licences that allow commercial use, also of programs that are not free."""

STATED = {"openexr": "BSD-3-Clause"}
"""Packages whose metadata names no licence: by the file LICENSE.md in them."""

HEAD = """# Licences

twinlens has the MIT licence: you may use it commercially. These are the packages that `pip install twinlens` installs,
and those of its extras, directly or through other packages, with the licence that they state. None of the core forbids
commercial use.
Pebble's LGPL is that of a library: programs of any licence may use it, and may not forbid to replace it.
`python docs/licences.py` writes this page; the versions are those of the environment it ran in.

"""


def closure(group: str) -> Iterator[str]:
    """The packages that twinlens needs for its core or an extra, directly and through others, on this platform."""
    project = tomllib.loads((FILE.parents[1] / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    texts = project["dependencies"] if group == CORE else extras[group]
    waiting = [target for text in texts for target in targets(text, "")]
    seen: set[tuple[str, str]] = set()
    while waiting:
        package = waiting.pop()
        if package in seen:
            continue
        seen.add(package)
        name, extra = package
        yield name
        for text in metadata.requires(name) or ():
            waiting += targets(text, extra)


def targets(text: str, extra: str) -> list[tuple[str, str]]:
    """The package of a requirement, by itself and with each extra that it names; none on another platform."""
    requirement = Requirement(text)
    if requirement.marker and not requirement.marker.evaluate({"extra": extra}):
        return []
    name = canonicalize_name(requirement.name)
    return [(name, part) for part in ("", *requirement.extras)]


def licence(name: str) -> str:
    """The licence that a package states: its SPDX expression, its classifiers, or the first line of its text."""
    if name in STATED:
        return STATED[name]
    info = metadata.metadata(name)
    if expression := info.get("License-Expression"):
        return str(expression)
    classifiers = info.get_all("Classifier") or []
    named = [
        line.split(" :: ")[-1] for line in classifiers if line.startswith("License ::")
    ]
    text = (info.get("License") or "").strip().split("\n")[0]
    # The field is more exact than a classifier such as "BSD License", but some have the whole text there.
    if _is_known(text):
        return text
    return " AND ".join(named) or text or "not stated"


def allows_commercial_use(text: str) -> bool:
    """Whether each alternative's parts are licences that allow it."""
    alternatives = re.split(r"\bOR\b", text)
    return any(all(map(_is_known, re.split(r"\bAND\b", part))) for part in alternatives)


def _is_known(part: str) -> bool:
    name = re.sub(r"^(The|3-Clause|GNU) ", "", part.strip(" ()"))
    return name.startswith(COMMERCIAL)


def table() -> list[tuple[str, str, str, str]]:
    """Name, version, licence, and what needs it: the core, or else the extras."""
    users: dict[str, list[str]] = {}
    for group in (CORE, *EXTRAS):
        for name in closure(group):
            users.setdefault(name, []).append(group)
    rows = []
    for name, groups in sorted(users.items()):
        text = CORE if CORE in groups else ", ".join(groups)
        rows.append((name, metadata.version(name), licence(name), text))
    return rows


def page() -> str:
    """The text of the page. Raises ValueError for a licence of the core that may forbid commercial use."""
    rows = table()
    doubtful = [
        row for row in rows if row[3] == CORE and not allows_commercial_use(row[2])
    ]
    if doubtful:
        raise ValueError(f"read the licences of {doubtful}")
    lines = ["| package | version | licence | needed by |", "| --- | --- | --- | --- |"]
    lines += [f"| {' | '.join(row)} |" for row in rows]
    return HEAD + "\n".join(lines) + "\n"


if __name__ == "__main__":
    FILE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{FILE}\n")
