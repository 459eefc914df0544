"""The command line: one short module a command, named in `COMMANDS`, and the one place that prints, asks or exits.

Exit codes: 0 success; 1 twinlens's own failure, what `verify` finds wrong, or a board without scores; 2 bad usage or
bad input, in one line; 130 interrupted.
"""

import errno
import importlib
import os
import sys
from collections.abc import Sequence
from typing import Any

import click

import twinlens
from twinlens.cli.interrupts import INTERRUPTED, end, take_over, told
from twinlens.cli.renewal import Renewal, begin_anew, is_possible
from twinlens.errors import TwinlensError, unknown

COMMANDS = {
    "demo": "Render, match and score a small benchmark, and make its page.",
    "doctor": "Show which rendering backend works here, why, and what to install.",
    "scenes": "List the bundled scenes.",
    "render": "Photograph scenes with a stereo rig; write pairs with exact truth.",
    "generate": "Make a dataset from a recipe: varied scenes, resumable, in parallel.",
    "reconstruct": "Make points and a surface of a sample's views; compare with the truth.",
    "rectify": "Rectify two views of a sample; disparities are cast anew.",
    "show": "Draw what a sample holds: its epipolar geometry, ...",
    "verify": "Check a dataset: checksums, and whether its truth is true.",
    "describe": "Write a dataset's card and its Croissant metadata.",
    "export": "Write a dataset in the layout of KITTI, ETH3D, Middlebury, ...",
    "match": "Match two images; write the disparity map.",
    "benchmark": "Run matchers on a dataset and score them; make the leaderboard.",
    "score": "Score disparity maps that something else made.",
    "study": "Sweep one physical quantity; table, figures and what was found.",
    "report": "Make the leaderboard page of a board that was measured.",
}


class _Group(click.Group):
    """Loads a command's module only when that command is used, so that --help is quick."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            raise click.UsageError(str(unknown("command", cmd_name, COMMANDS)))
        command: click.Command = importlib.import_module(f"twinlens.cli.{cmd_name}").command
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.command(cls=_Group, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 110})
@click.version_option(twinlens.__version__, prog_name="twinlens")
def cli() -> None:
    """Physically based synthetic stereo: real optics, exact ground truth, and a benchmark for stereo matchers.

    \b
    Example:  twinlens render staircase --lens pinhole --lens f/1.4 --sensor-width-mm 36 -o out
              twinlens benchmark out --methods sad,zncc:block_size=15 -o board
    """


def console() -> None:
    """What `twinlens` and `python -m twinlens` do: the process is the command line's, which may begin it anew."""
    ender = take_over()
    code = run(renewable=is_possible())
    ender.code = code  # all is done and said: an interrupt of what is left to do at the end, ends it
    if code == INTERRUPTED:
        end("")  # Python's own way out is long enough for a third interrupt to end it by its signal
    sys.exit(code)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and leave the process with its exit code."""
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None, *, renewable: bool = False) -> int:
    """Run the command line; the exit code. Everything twinlens refuses becomes one line on the error stream.

    `renewable`: whether a command may put a fresh process in this one's place, and go on there.
    """
    try:
        result = _run(arguments, renewable)
        sys.stdout.flush()
    except click.exceptions.NoArgsIsHelpError as help_page:
        help_page.show()
        return 2
    except click.MissingParameter as error:
        return _refuse(_with_help(error), 2)
    except click.ClickException as error:
        return _refuse(error.format_message(), 2)
    except TwinlensError as error:
        return _refuse(str(error), error.exit_code)
    except MemoryError as error:
        return _refuse(f"not enough memory ({error}); make the images smaller", 2)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # the reader left; nothing more to say
        return 1
    except OSError as error:
        if error.errno in (errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EPERM, errno.EDQUOT):
            return _refuse(f"{error.filename or 'output'}: {error.strerror}", 2)
        raise
    except (KeyboardInterrupt, click.Abort) as error:
        return _refuse(told(error), INTERRUPTED)
    return result if isinstance(result, int) else 0


def _run(arguments: Sequence[str] | None, renewable: bool) -> Any:
    try:
        return cli.main(args=arguments, prog_name="twinlens", standalone_mode=False, obj=renewable)
    except Renewal as again:
        begin_anew(again.progress)
    return cli.main(args=arguments, prog_name="twinlens", standalone_mode=False, obj=False)


def _with_help(error: click.MissingParameter) -> str:
    """What is missing, and what it is."""
    meaning = getattr(error.param, "help", None)
    return error.format_message().rstrip(".") + (f": {meaning}" if meaning else "")


def _refuse(message: str, code: int) -> int:
    print(f"twinlens: {' '.join(message.split())}", file=sys.stderr)
    return code
