"""`twinlens demo`: the whole way from scenes to a leaderboard, small enough to watch."""

import time
from collections.abc import Sequence
from pathlib import Path

import click

from twinlens.cli.boards import print_board, run_board
from twinlens.cli.places import PATH, check_samples
from twinlens.cli.progress import progress_bar, tell_stage

SCENES = ("staircase", "cards", "spheres")
METHODS = tuple(f"{cost}:block_size={size}" for cost in ("sad", "ssd", "zncc") for size in (7, 21))
WIDTH, HEIGHT = 400, 300
SPP = {"scalar": 16, "llvm": 32, "cuda": 64}
_APERTURE_OF_BASELINE = 0.5  # blur = A/B |d - d_focus|: half a pixel for each pixel of disparity off the focus


@click.command("demo")
@click.option("-o", "--output", default="demo", show_default=True, type=PATH, help="Folder for it.")
@click.option("--json", "as_json", is_flag=True, help="Print the board as JSON.")
def command(output: Path, as_json: bool) -> None:
    """Photograph three scenes through a pinhole and a wide lens, match them, and score the matches.

    The same matchers run on Middlebury's Motorcycle, a real pair with measured truth. OUTPUT gets the dataset and the
    board with its page.

    \b
    Example:  twinlens demo -o demo
    """
    from twinlens.dataset import Dataset, motorcycle
    from twinlens.rendering import backend
    from twinlens.scoring import DatasetPairs, named_methods

    used, begun = backend(), time.perf_counter()
    click.echo(f"rendering with {used.variant} ({used.reason})", err=True)
    if used.advice:
        click.echo(used.advice, err=True)
    dataset = output / "dataset"
    check_samples(dataset, SCENES, overwrite=True)
    _render(dataset, SPP[used.name])
    rendered = time.perf_counter()
    pairs = [*DatasetPairs(Dataset(dataset)), motorcycle()]
    tell_stage(f"matching {len(pairs)} pairs by {len(METHODS)} methods")
    board = run_board(
        pairs, named_methods(METHODS), output / "board", ("middlebury-v3",), ("all", "nonocc"), title="twinlens demo"
    )
    print_board(board, output / "board", as_json)
    done = time.perf_counter()
    click.echo(f"rendered in {rendered - begun:.0f} s, matched and scored in {done - rendered:.0f} s", err=True)


def _render(dataset: Path, spp: int) -> None:
    """Both lenses of every scene, as a dataset."""
    from twinlens.camera import Pinhole, ThinLens
    from twinlens.dataset import Manifest, Row, describe, write_manifest, write_sample
    from twinlens.factory import default_rig, make_sample
    from twinlens.optics import middle_focus
    from twinlens.scenes import load_scene

    rows: Sequence[Row] = ()
    with progress_bar("rendering") as report:
        for i, name in enumerate(SCENES):
            tell_stage(f"rendering {name}, scene {i + 1} of {len(SCENES)}")
            scene = load_scene(name)
            rig = default_rig(scene, WIDTH, HEIGHT)
            wide = ThinLens(_APERTURE_OF_BASELINE * rig.baseline(), middle_focus(*scene.depth_range))
            sample = make_sample(
                scene, rig, (Pinhole(), wide), spp=spp,
                progress=lambda fraction, i=i, name=name: report((i + fraction) / len(SCENES), name),  # type: ignore[misc]
            )  # fmt: skip
            rows = (*rows, Row(name, write_sample(dataset / name, sample, overwrite=True), {"scene": name}))
    write_manifest(dataset, Manifest(tuple(rows), seed=0))
    describe(dataset)
