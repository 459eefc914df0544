"""Options of commands: numbers, help in sections, pairs of cameras; an error for an option that is given twice."""

import contextlib
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import click

from twinlens.errors import InputError, check_int, check_number
from twinlens.settings import Field, fields_of


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


class SettingType(click.ParamType):  # type: ignore[type-arg]
    """A value of a declared setting. An InputError names the option."""

    def __init__(self, field: Field) -> None:
        self.field = replace(field, optional=False)  # an option is left out instead
        self.name = {int: "integer", float: "number"}.get(field.kind, "text")

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Any:
        parsed = self.field.parse(value) if isinstance(value, str) else value
        try:
            return self.field.checked(parsed)
        except InputError as error:
            option = param.opts[0] if param else self.field.name
            raise InputError(f"{option} {error}") from None


def setting(
    cls: type[Any], name: str, option: str = "", *, default: Any = None, note: str = ""
) -> Callable[[Any], Any]:
    """The option of a declared setting of a class: its type, and its help with unit, range and default.

    option : by default `--` and the name, of a bool also `--no-`.
    default : shown in the help; `note` is shown in its place, for a default that depends on others.
    """
    field = fields_of(cls)[name]
    flag = f"--{name.replace('_', '-')}"
    if field.kind is bool:
        text = option or (f"{flag}/--no-{flag[2:]}" if default else flag)
        return click.option(
            text,
            name,
            is_flag=True,
            default=bool(default),
            show_default=bool(default),
            help=field.setting.help,
        )
    shown = note or ("" if default is None else f"default: {default}")
    limits = "; ".join(part for part in (field.note, shown) if part)
    return click.option(
        option or flag,
        name,
        type=SettingType(field),
        default=default,
        help=f"{field.setting.help}  [{limits}]" if limits else field.setting.help,
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
    _, _, params = command.make_parser(context).parse_args(list(arguments))
    for param, count in Counter(params).items():
        if (
            count > 1
            and isinstance(param, click.Option)
            and not (param.multiple or param.is_flag or param.count)
        ):
            raise click.UsageError(
                f"option {param.opts[-1]} is given {count} times; give it once"
            )


def search_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of the range of disparities to search, in pairs that have one of their own."""
    options = [
        click.option(
            "--num-disparities",
            "--ndisp",
            type=Whole(1, 65536),
            help="Number of disparities to search.  [default: that of calib.txt, else of the truth, else 64]",
        ),
        click.option(
            "--min-disparity",
            type=DISPARITY,
            help="The smallest disparity, pixels.  [default: 0, or less if calib.txt or the truth is negative]",
        ),
    ]
    for option in reversed(options):
        command = option(command)
    return command


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


def rectify_hint(rig: Any, output: Any) -> str:
    """What to do with samples in `output` whose first two cameras are not a rectified pair; empty for others."""
    from twinlens.camera.rectification import (
        rectify,
    )  # imports NumPy and SciPy, which --help does not need

    if len(rig) < 2 or rig.nominal.is_rectified():
        return ""
    try:
        rectify(rig.nominal)
    except InputError as error:
        return f"no disparity, and no rectification: {error}"
    return (
        "no disparity: the first two cameras are not a rectified pair; "
        f"`twinlens rectify {output} -o {output}-rectified` makes one of each sample"
    )
