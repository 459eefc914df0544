"""`twinlens methods`: the matching methods with their options."""

import click

from twinlens.cli.options import json_option, print_json
from twinlens.matching.methods import METHODS, find_method, method_tables, option_text


@click.command("methods")
@click.argument("names", nargs=-1, metavar="[METHOD]...")
@json_option("every method with all of its options")
@click.option("--markdown", is_flag=True, help="Print the tables of docs/methods.md.")
def command(names: tuple[str, ...], as_json: bool, markdown: bool) -> None:
    """List the matching methods; with METHOD..., their options, defaults and meanings.

    \b
    Example:  twinlens methods
              twinlens methods zncc sgm
              twinlens methods --json
    """
    if markdown:
        click.echo(method_tables(), nl=False)
        return
    methods = [find_method(name).reference() for name in names or METHODS]
    if as_json:
        print_json(methods)
        return
    for entry in methods:
        click.echo(f"{entry['method']:18}{entry['description']}")
        for row in entry["options"] if names else ():
            click.echo(
                f"  {row['option']:16}{option_text(row['default']):12}{row['meaning']}"
            )
    if not names:
        click.echo("\nFor the options of a method: twinlens methods NAME")
