"""A command whose --help shows its options in groups."""

from collections.abc import Mapping, Sequence
from typing import Any

import click


class Sectioned(click.Command):
    """`sections` maps a heading to the parameter names below it; what none of them names stands under "Options"."""

    def __init__(self, *args: Any, sections: Mapping[str, Sequence[str]], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._sections = sections

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write one definition list a heading, its options in the order in which they are declared."""
        left = {option.name: option for option in self.get_params(ctx) if isinstance(option, click.Option)}
        for heading, names in {**self._sections, "Options": tuple(left)}.items():
            options = [left.pop(name) for name in tuple(left) if name in names]
            with formatter.section(heading):
                formatter.write_dl([record for option in options if (record := option.get_help_record(ctx))])
