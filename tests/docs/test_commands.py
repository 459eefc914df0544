"""The command line accepts every `twinlens` command in a shell block of a page: its options and their values."""

import re
import shlex
from pathlib import Path

import click
import pytest

from twinlens.cli import cli

ROOT = Path(__file__).parents[2]
PAGES = sorted(
    page
    for pattern in ("*.md", "docs/*.md", "examples/*.md", "benchmarks/**/*.md")
    for page in ROOT.glob(pattern)
)


def code_lines(page):
    """The lines of fenced and indented blocks; a line that ends with a backslash and the next one are one."""
    is_fenced = False
    for line in page.read_text().replace("\\\n", " ").splitlines():
        if line.lstrip().startswith("```"):
            is_fenced = not is_fenced
        elif is_fenced or line.startswith("    "):
            yield line.strip().removeprefix("$ ")


def commands_of(page):
    """The arguments of each command, without comments, pipes and redirections."""
    for line in code_lines(page):
        if re.match(r"(.*[;&] )?twinlens ", line):
            words = shlex.split(line, comments=True)
            for start in [k for k, word in enumerate(words) if word == "twinlens"]:
                rest = words[start + 1 :]
                is_end = re.compile(r"[|;&]+|\d?>.*").fullmatch
                ends = [k for k, word in enumerate(rest) if is_end(word)]
                yield rest[: ends[0]] if ends else rest


CASES = [
    pytest.param(words, id=f"{page.stem}: {' '.join(words)}"[:90])
    for page in PAGES
    for words in commands_of(page)
]


@pytest.mark.parametrize("words", CASES)
def test_a_command_of_a_page_is_accepted(words):
    name, *arguments = words
    # A command keeps the help option of its first context: that of the command line, which has -h too.
    group = click.Context(cli, **cli.context_settings)
    command = cli.get_command(group, name)
    assert command is not None, name
    if "--help" not in arguments:
        command.make_context(name, arguments, parent=group)
