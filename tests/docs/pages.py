"""The examples of a documentation page: its blocks, its commands and what it shows of their output; run as printed."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from twinlens.cli import run


def blocks(page: Path, *kinds: str) -> list[tuple[str, str]]:
    """(kind, text) of the code blocks of these kinds ("sh", "python", ...), in order."""
    return re.findall(
        rf"```({'|'.join(kinds)})\n(.*?)```", page.read_text(), flags=re.DOTALL
    )


class Command(NamedTuple):
    """A command line of a page, without comments, and the output that the page shows below it, if it does."""

    line: str
    shown: str | None


def listings(page: Path) -> Iterator[list[str]]:
    """The lines of each fenced or indented block; a line that ends with a backslash and the next one are one."""
    fenced: list[str] | None = None
    indented: list[str] = []
    for line in page.read_text().replace("\\\n", " ").splitlines():
        is_fence = line.lstrip().startswith("```")
        if fenced is not None and not is_fence:
            fenced.append(line)
            continue
        if line.startswith("    ") and not is_fence:
            indented.append(line[4:])
            continue
        if indented:
            yield indented
            indented = []
        if is_fence:
            if fenced is not None:
                yield fenced
            fenced = [] if fenced is None else None
    if indented:
        yield indented


def commands(page: Path) -> Iterator[Command]:
    """The command lines of a page's blocks, in order.

    In a block with lines that begin with `$ `, these are the commands, and the lines below each are its output.
    """
    for lines in listings(page):
        is_transcript = any(line.startswith("$ ") for line in lines)
        if not is_transcript:
            yield from (Command(line.strip(), None) for line in lines if line.strip())
            continue
        for part in re.split(r"^\$ ", "\n".join(lines) + "\n", flags=re.MULTILINE)[1:]:
            line, _, shown = part.partition("\n")
            yield Command(line, shown)


def run_block(kind: str, text: str, folder: Path) -> str:
    """Run a shell or Python block in `folder`, without lines of `make`, and return what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    lines = "\n".join(
        line for line in text.splitlines() if not line.startswith("make ")
    )
    command = (
        ["bash", "-euc", lines]
        if kind == "sh"
        else [sys.executable, "-W", "error", "-c", text]
    )
    child = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, "PATH": path},
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert child.returncode == 0, child.stderr
    return child.stdout


def run_block_here(kind: str, text: str, folder: Path) -> str:
    """As `run_block`, in this process, which has imported everything; the commands of a shell block are twinlens's."""
    printed = io.StringIO()
    with contextlib.chdir(folder), contextlib.redirect_stdout(printed):
        if kind == "python":
            exec(compile(text, "block", "exec"), {})
            return printed.getvalue()
        for line in text.splitlines():
            program, *arguments = shlex.split(line)
            if program == "make":
                continue
            assert program == "twinlens", line
            assert run(arguments) == 0, line
    return printed.getvalue()
