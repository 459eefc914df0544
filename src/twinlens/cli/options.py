"""Options of commands: numbers, help in sections, pairs of cameras; an error for an option that is given twice."""

import contextlib
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import click

from twinlens.errors import InputError, check_int, check_number

denoise_option = click.option(
    "--denoise/--no-denoise",
    default=True,
    show_default=True,
    help="Remove the renderer's noise; adds a small bias.",
)


def json_option(what: str) -> Callable[[Any], Any]:
    """The option --json of a command, its parameter `as_json`."""
    return click.option(
        "--json", "as_json", is_flag=True, help=f"Print {what} as JSON."
    )


def print_json(record: Any) -> None:
    """Print plain data as JSON, NaN as null, infinity as "inf"."""
    from twinlens.dataset.record import (
        plain,
    )  # imports NumPy and SciPy, which --help does not need

    click.echo(json.dumps(plain(record, nan_as_null=True), indent=1, allow_nan=False))


def print_result(as_json: bool, record: Any, *lines: str) -> None:
    """Print the record as JSON, or else the lines."""
    if as_json:
        print_json(record)
    else:
        click.echo("\n".join(lines))


class Whole(click.IntRange):
    """A whole number from `min` to `max`. An InputError names the option."""

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        with contextlib.suppress(ValueError):
            value = int(value)
        check_int(
            param.opts[0] if param else "value", value, int(self.min or 0), self.max
        )
        return value


class Positive(click.FloatRange):
    """A finite number > 0, at most `most`. An InputError names the option."""

    def __init__(self, most: float | None = None) -> None:
        super().__init__(0, most, min_open=True)

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        with contextlib.suppress(ValueError):
            value = float(value)
        allowed = "> 0" if self.max is None else f"> 0 and <= {self.max:.0f}"
        most = math.inf if self.max is None else self.max
        check_number(
            param.opts[0] if param else "value",
            value,
            f"a finite number {allowed}",
            above=0,
            most=most,
        )
        return value


POSITIVE, SECONDS, DISPARITY = Positive(), Positive(1e6), Whole(-65536, 65536)
noise_option = click.option(
    "--noise",
    type=POSITIVE,
    help="Double the samples, to at most 1024, until the renderer's noise is at most this multiple of the sensor's,"
    " such as 0.3.",
)


class Sectioned(click.Command):
    """A command whose --help groups its options: `sections` maps headings to parameter names."""

    def __init__(
        self, *args: Any, sections: Mapping[str, Sequence[str]], **kwargs: Any
    ) -> None:
        super().__init__(*args, **kwargs)
        self._sections = sections

    def format_options(
        self, ctx: click.Context, formatter: click.HelpFormatter
    ) -> None:
        """Write one list of options for each section, and the remaining ones under "Options"."""
        left = {
            option.name: option
            for option in self.get_params(ctx)
            if isinstance(option, click.Option)
        }
        for heading, names in {**self._sections, "Options": tuple(left)}.items():
            options = [left.pop(name) for name in tuple(left) if name in names]
            with formatter.section(heading):
                formatter.write_dl(
                    [
                        record
                        for option in options
                        if (record := option.get_help_record(ctx))
                    ]
                )


def refuse_repeated(
    command: click.Command, arguments: Sequence[str], group: click.Context
) -> None:
    """Raise click.UsageError for an option that takes one value and is given twice; click would drop the first."""
    context = click.Context(
        command, parent=group
    )  # it has the names of --help, which a command keeps
    _, _, given = command.make_parser(context).parse_args(list(arguments))
    for param, count in Counter(given).items():
        if (
            count > 1
            and isinstance(param, click.Option)
            and not (param.multiple or param.is_flag or param.count)
        ):
            raise click.UsageError(
                f"option {param.opts[-1]} is given {count} times; give it once"
            )


def parse_pair(text: str, sample: Any, count: int) -> tuple[int, int]:
    """The two cameras of `--cameras A,B`, out of the `count` of a sample, which is named in messages.

    >>> parse_pair("0,2", "out/cards", 3)
    (0, 2)
    """
    if count < 2:
        raise InputError(f"{sample}: has one view; a pair needs two")
    parts = [part.strip() for part in text.split(",")]
    if len(parts) != 2 or not all(part.isdecimal() for part in parts):
        raise InputError(f"--cameras must be A,B, such as 0,1, got {text!r}")
    a, b = (int(part) for part in parts)
    if a == b or max(a, b) >= count:
        raise InputError(
            f"--cameras {text}: must be two different cameras from 0 to {count - 1}"
        )
    return a, b


def parse_pixel(text: str, width: int, height: int) -> tuple[int, int]:
    """The pixel of `--at U,V`, column and row, in an image of this size.

    >>> parse_pixel("12,3", 64, 48)
    (12, 3)
    """
    parts = [part.strip() for part in text.split(",")]
    inside = len(parts) == 2 and all(part.isdecimal() for part in parts)
    if not inside or int(parts[0]) >= width or int(parts[1]) >= height:
        raise InputError(
            f"--at must be U,V, a column from 0 to {width - 1} and a row from 0 to {height - 1}, got {text!r}"
        )
    return int(parts[0]), int(parts[1])
