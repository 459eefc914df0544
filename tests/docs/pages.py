"""Run the examples of a documentation page as printed, and check its links."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

from twinlens.cli import run


def blocks(page: Path, *kinds: str) -> list[tuple[str, str]]:
    """(kind, text) of the code blocks of these kinds ("sh", "python", ...), in order."""
    return re.findall(
        rf"```({'|'.join(kinds)})\n(.*?)```", page.read_text(), flags=re.DOTALL
    )


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
