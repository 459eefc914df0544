"""`twinlens scenes`: the bundled scenes."""

import json
from dataclasses import asdict

import click


@click.command("scenes")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def command(as_json: bool) -> None:
    """List the bundled scenes with their depth ranges and what each one tests.

    \b
    Example:  twinlens scenes
    """
    from twinlens.scenes import bundled_headings

    scenes = bundled_headings()
    if as_json:
        click.echo(json.dumps([asdict(scene) for scene in scenes], indent=1))
        return
    width = max(len(scene.name) for scene in scenes)
    for scene in scenes:
        near, far = scene.depth_range
        click.echo(f"{scene.name:<{width}}  {near:5.2f} to {far:5.2f} m  {scene.description}")
