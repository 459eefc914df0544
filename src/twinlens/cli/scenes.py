"""`twinlens scenes`: the bundled scenes."""

import click

from twinlens.cli.options import json_option, print_json
from twinlens.scenes import bundled_headings


@click.command("scenes")
@json_option("the list")
def command(as_json: bool) -> None:
    """List the bundled scenes with their depth ranges and what each one tests.

    \b
    Example:  twinlens scenes
    """
    scenes = bundled_headings()
    if as_json:
        print_json(scenes)
        return
    width = max(len(scene["name"]) for scene in scenes)
    for scene in scenes:
        near, far = scene["depth_range"]
        click.echo(
            f"{scene['name']:<{width}}  {near:5.2f} to {far:5.2f} m  {scene['description']}"
        )
