"""`twinlens scenes`: what there is to photograph."""

import json

import click


@click.command("scenes")
@click.option("--json", "as_json", is_flag=True, help="Print the list as JSON.")
def command(as_json: bool) -> None:
    """List the bundled scenes: name, depth range, and what each is there to stress.

    \b
    Example:  twinlens scenes
    """
    from twinlens.scenes import bundled_scenes, load_scene

    scenes = [load_scene(name) for name in bundled_scenes()]
    if as_json:
        rows = [
            {"name": s.name, "depth_range": s.depth_range, "baseline": s.baseline, "description": s.description}
            for s in scenes
        ]
        click.echo(json.dumps(rows, indent=1))
        return
    width = max(len(scene.name) for scene in scenes)
    for scene in scenes:
        near, far = scene.depth_range
        click.echo(f"{scene.name:<{width}}  {near:5.2f} to {far:5.2f} m  {scene.description}")
