"""`twinlens demo`: a small benchmark of a pinhole, a wide-aperture lens and a real pair of cameras."""

import shutil
import time
from pathlib import Path

import click

from twinlens.camera import Pinhole, ThinLens
from twinlens.cli.boards import print_board, run_board
from twinlens.cli.options import json_option, setting
from twinlens.cli.places import PATH, check_samples, refuse_others
from twinlens.cli.progress import progress_bar
from twinlens.dataset import (
    Dataset,
    Manifest,
    Row,
    describe,
    write_manifest,
    write_sample,
)
from twinlens.errors import counted
from twinlens.factory import Shoot, default_rig, make_sample
from twinlens.optics import middle_focus
from twinlens.rendering import backend
from twinlens.scenes import load_scene
from twinlens.scoring import Board, DatasetPairs, Groups, group_means, motorcycle
from twinlens.sensor import DEFAULT_MISMATCH, Mismatch, Sensor

# Their edges, thin parts, slants, plain areas and shadows are those of real pairs (docs/realism.md).
SCENES = ("tabletop", "corner", "yard")
METHODS = (
    "sad:block_size=7",
    "sad:block_size=21",
    "zncc:block_size=7",
    "zncc:block_size=21",
)
WIDTH, HEIGHT = 400, 300
SPP = 16
APERTURE_OVER_BASELINE = (
    0.5  # blur circle: half a pixel per pixel of disparity from the focus
)
PROTOCOL, REGION = "middlebury-v3", "nonocc"


@click.command("demo")
@click.option(
    "-o",
    "--output",
    default="demo",
    show_default=True,
    type=PATH,
    help="Folder of the results.",
)
@setting(Shoot, "denoise", default=True)
@json_option("the board")
def command(output: Path, denoise: bool, as_json: bool) -> None:
    """Render three scenes with a pinhole and with a wide-aperture lens, match them and a real pair, compare the scores.

    The two rendered cameras have typical tolerances. The real pair is Middlebury's Motorcycle with measured truth.
    OUTPUT receives the dataset, the board and its page.

    \b
    Example:  twinlens demo -o demo
    """
    refuse_others(output, ("dataset",), "board")
    used, start = backend(), time.perf_counter()
    click.echo(f"rendering with {used.variant} ({used.reason})", err=True)
    if not denoise:
        click.echo(
            "the images are not denoised: the renderer's noise raises all errors",
            err=True,
        )
    dataset, board_folder = output / "dataset", output / "board"
    check_samples(dataset, SCENES, overwrite=True)
    _render(dataset, denoise)
    if (board_folder / "board.json").exists():
        shutil.rmtree(board_folder)  # of an earlier demo, perhaps with another backend
    rendered = time.perf_counter()
    _compare(DatasetPairs(Dataset(dataset), [motorcycle()]), board_folder, as_json)
    seconds = time.perf_counter() - rendered
    click.echo(
        f"rendered in {rendered - start:.0f} s, matched and scored in {seconds:.0f} s",
        err=True,
    )


def _compare(pairs: DatasetPairs, folder: Path, as_json: bool) -> None:
    """Match and score the pairs, and print the means of the two lenses and of the real pair."""
    click.echo(
        f"matching {counted(len(pairs), 'pair')} with {counted(len(METHODS), 'method')}",
        err=True,
    )
    groups = {
        "pinhole": [name for name in pairs.aliases if name.endswith("pinhole")],
        "wide aperture": [name for name in pairs.aliases if " · lens" in name],
        "real pair": ["motorcycle"],
    }
    board = run_board(
        pairs, METHODS, folder, (PROTOCOL,), ("all", REGION), title="twinlens demo",
        page_options=lambda board: {"groups": groups, "notes": _notes(board, groups)},
    )  # fmt: skip
    print_board(board, folder, as_json, groups=groups, notes=_notes(board, groups))


def _render(dataset: Path, denoise: bool) -> None:
    """Render every scene with both lenses and write them as a dataset."""
    rows = []
    with progress_bar("rendering") as report:
        for i, name in enumerate(SCENES):
            click.echo(f"rendering {name}, scene {i + 1} of {len(SCENES)}", err=True)
            scene = load_scene(name)
            rig = default_rig(scene, WIDTH, HEIGHT)
            wide = ThinLens(
                APERTURE_OVER_BASELINE * rig.baseline(),
                middle_focus(*scene.depth_range),
            )
            mismatch = Mismatch.draw(seed=i, **DEFAULT_MISMATCH)
            sample = make_sample(
                scene, mismatch.misalign(rig), (Pinhole(), wide),
                Shoot(spp=SPP, denoise=denoise, sensor=Sensor(mismatch=mismatch)),
                progress=lambda fraction, i=i, name=name: report((i + fraction) / len(SCENES), name),  # type: ignore[misc]
            )  # fmt: skip
            rows.append(
                Row(
                    name,
                    write_sample(dataset / name, sample, overwrite=True),
                    {"scene": name},
                )
            )
    write_manifest(dataset, Manifest(tuple(rows), seed=0))
    describe(dataset)


def _notes(board: Board, groups: Groups) -> list[str]:
    """The effects of the lens and of the real cameras on the scores, one sentence or two each."""
    pinhole, wide, real = group_means(board, PROTOCOL, REGION, groups).values()
    best, best_wide, best_real = (
        next(iter(column)) for column in (pinhole, wide, real)
    )
    worst = max(pinhole, key=lambda method: abs(wide[method] - pinhole[method]))
    rank = list(real).index(best) + 1
    lens = (
        f"The lens blurs what is out of focus; {worst} changes most, from {pinhole[worst]:.1f}% to "
        f"{wide[worst]:.1f}% bad pixels. Best with the pinhole: {best} "
        f"({pinhole[best]:.1f}%); with the lens: {best_wide} ({wide[best_wide]:.1f}%)."
    )
    cameras = (
        f"The rendered cameras have typical tolerances. {best} is best with the pinhole, and number {rank} of "
        f"{len(real)} on the real pair ({real[best]:.1f}%), where {best_real} is best ({real[best_real]:.1f}%)."
    )
    return [lens, cameras]
