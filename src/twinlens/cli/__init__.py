"""The command line: one module per command, listed in `COMMANDS`. Only this package prints and exits.

Exit codes: 0 success; 1 an internal error, findings of `verify`, or a board without scores; 2 bad usage or bad input,
reported in one line; 130 interrupted.
"""

import errno
import faulthandler
import importlib
import os
import signal
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import click

import twinlens
from twinlens.cli.options import refuse_repeated
from twinlens.errors import TwinlensError, is_interrupt, unknown
from twinlens.processes import deferred_interrupts

INTERRUPTED = 130
"""The exit code of an interrupted command: 128 + SIGINT, as in shells."""

COMMANDS = {
    "demo": "Render, match and score a small benchmark; write its page.",
    "doctor": "Show which rendering backend is used, why, and what to install.",
    "scenes": "List the bundled scenes.",
    "cameras": "List the cameras that rigs and recipes know by name.",
    "plan": "Plan a stereo rig: baseline, focal length, aperture, focus.",
    "render": "Render scenes with a stereo rig; write pairs with exact ground truth.",
    "generate": "Make a dataset from a recipe; resumable, parallel.",
    "reconstruct": "Reconstruct points and a surface from a sample; compare with the truth.",
    "decode": "Decode the structured light of samples; compare with the truth.",
    "rectify": "Rectify two views of each sample, with exact ground truth.",
    "show": "Draw a sample's epipolar geometry, the costs of a pixel, or confidences.",
    "verify": "Check a dataset: checksums, and consistency of its ground truth.",
    "statistics": "Compare the images of a dataset with real pairs.",
    "describe": "Write a dataset's card and its Croissant metadata.",
    "subset": "Merge datasets, or take a part of one; new splits, fewer channels.",
    "browse": "Write an offline page to browse a dataset.",
    "export": "Write a dataset in the layout of KITTI, ETH3D, Middlebury, ...",
    "methods": "List the matching methods and their options.",
    "match": "Match two images; write a disparity map.",
    "benchmark": "Run matchers on a dataset, score them, and write the leaderboard.",
    "score": "Score disparity maps made by other programs.",
    "agree": "Compare the rankings of two leaderboards.",
    "study": "Sweep one physical quantity; write table, figures and findings.",
    "report": "Write the leaderboard page of an existing board.",
}


class _Group(click.Group):
    """Imports a command's module only when that command is used, so that --help is fast."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            raise click.UsageError(str(unknown("command", cmd_name, COMMANDS)))
        with (
            deferred_interrupts()
        ):  # an interrupt within an import may be raised as another exception
            command: click.Command = importlib.import_module(
                f"twinlens.cli.{cmd_name}"
            ).command
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        name, command, rest = super().resolve_command(ctx, args)
        if command is not None:
            refuse_repeated(command, rest, ctx)
        return name, command, rest

    def format_commands(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.command(
    cls=_Group,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110},
)
@click.version_option(twinlens.__version__, prog_name="twinlens")
def cli() -> None:
    """Physically based synthetic stereo images, their exact ground truth, and a benchmark for stereo matchers.

    \b
    Example:  twinlens render staircase --lens pinhole --lens f/1.4 --sensor-width-mm 36 -o out
              twinlens benchmark out --methods sad,zncc:block_size=15 -o board
    """


def console() -> None:
    """Entry point of `twinlens` and `python -m twinlens`. SIGTERM, which batch systems send, is handled as Ctrl-C.

    A crash in native code, as of a user's matcher, prints the Python frames that led to it.
    """
    faulthandler.enable()
    if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    code = run()
    for kind in (signal.SIGINT, signal.SIGTERM):
        signal.signal(
            kind, signal.SIG_IGN
        )  # the result is printed: a late interrupt must not change the exit code
    sys.exit(code)


_ERRORS_OF_FILES = {
    errno.ENOSPC,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.EDQUOT,
    errno.ENAMETOOLONG,
    errno.ELOOP,
}
"""Errors of the operating system that a user can mend: a full disk, missing rights, a path that cannot be."""


def run(arguments: Sequence[str] | None = None) -> int:
    """Run the command line and return the exit code. An error becomes one line on the error stream."""
    try:
        with _warnings_as_lines():
            result = cli.main(
                args=arguments, prog_name="twinlens", standalone_mode=False
            )
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as help_page:
        help_page.show()
        return 2
    except BrokenPipeError:
        # The reader has closed the pipe; Python's flush at the exit would fail again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    except (Exception, KeyboardInterrupt) as error:
        line = _line_of(error)
        if line is None:
            raise
        return _report_error(*line)
    return result if isinstance(result, int) else 0


def _line_of(error: BaseException) -> tuple[str, int] | None:
    """What an error says in one line, and the exit code; None for a bug, which keeps its traceback."""
    match error:
        case click.MissingParameter():
            message = error.format_message().rstrip(".")
            meaning = getattr(error.param, "help", None)
            return f"{message}: {meaning}" if meaning else message, 2
        case click.ClickException():
            return error.format_message(), 2
        case TwinlensError():
            return str(error), error.exit_code
        case MemoryError():
            return f"not enough memory ({error}); make the images smaller", 2
        case OSError() if error.errno in _ERRORS_OF_FILES:
            return f"{error.filename or 'output'}: {error.strerror}", 2
        case KeyboardInterrupt() | click.Abort():
            # click wraps the interrupt, whose text says what is kept.
            is_wrapped = not isinstance(error, KeyboardInterrupt)
            text = str((error.__cause__ if is_wrapped else error) or "")
            return f"interrupted; {text}" if text else "interrupted", INTERRUPTED
        case RuntimeError() if is_interrupt(error):
            return "interrupted", INTERRUPTED
    return None


@contextmanager
def _warnings_as_lines() -> Iterator[None]:
    """Print each different warning for users once, as one line on the error stream."""
    shown: set[str] = set()

    def show(message: Warning | str, *_: Any, **__: Any) -> None:
        line = " ".join(str(message).split())
        if line not in shown:
            shown.add(line)
            click.echo(f"twinlens: warning: {line}", err=True)

    with warnings.catch_warnings():
        warnings.filterwarnings("always", category=UserWarning)
        warnings.showwarning = show
        yield


def _report_error(message: str, code: int) -> int:
    """Print the message as one line on the error stream and return the exit code."""
    print(f"twinlens: {' '.join(message.split())}", file=sys.stderr)
    return code
