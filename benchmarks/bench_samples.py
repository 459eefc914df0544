"""The effect of rendering noise on wrong pixels: direct renders with increasing samples per pixel.

    python benchmarks/bench_samples.py [--size 240x180] [--seeds 1] [--write]

Scenes, pixel pitch and sensor are those of the study `aperture`, at equal brightness without diffraction. Each pair is
rendered directly, exposed, and matched by SSD. Wrong are non-occluded pixels with an error above 2 px or without a
disparity. `expected` is the study's prediction, which includes sensor noise only, from the sharp images at f/11 with
the most samples. Values are means over the seeds, with the range in brackets. Rendering noise falls with the samples;
sensor noise does not.

A seed takes about 4.7 CPU minutes with LLVM. `--write` replaces the table in docs/studies.md.
"""

import argparse
import statistics
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from twinlens.sensor import Exposure
from twinlens.studies.aperture import automatic
from twinlens.studies.aperture.theory import PIXEL_PITCH_UM, SENSOR, SHARP_AT, Evidence, Model
from twinlens.studies.stage import Stage, stream

SCENES, F_NUMBERS, SAMPLES = ("cards", "staircase"), (1.0, 2.0, 4.0), (16, 64, 256)
PAGE = Path(__file__).parents[1] / "docs" / "studies.md"
HEAD = f"| | {SAMPLES[0]} samples |" + "".join(f" {spp} |" for spp in SAMPLES[1:]) + " expected |"


class Theory(NamedTuple):
    """A seed and the texture measured on its sharp images."""

    seed: int
    evidence: Evidence


def rows(size: tuple[int, int], seeds: Sequence[int], samples: Sequence[int] = SAMPLES) -> Iterator[tuple[str, list]]:
    """(scene and f-number, for each number of samples and for the prediction: the percentages of all seeds)."""
    for scene in SCENES:
        model = Model.of(Stage.of(scene, *size, pixel_pitch_um=PIXEL_PITCH_UM))
        theories = [theory(model, seed, samples[-1]) for seed in seeds]
        for number in F_NUMBERS:
            yield (
                f"{scene}, f/{number:g}",
                list(zip(*(row(model, number, each, samples) for each in theories), strict=True)),
            )


def row(model: Model, number: float, known: Theory, samples: Sequence[int]) -> list[float]:
    """The percentages of one seed, and the prediction at the exposure of the last."""
    shots = [photographed(model, number, known.seed, spp) for spp in samples]
    lens = model.lens(number)
    blur = model.blur(lens)
    return [wrong for wrong, _ in shots] + [known.evidence.expected(lens, shots[-1][1], blur, diffracts=False)[0]]


def photographed(model: Model, number: float, seed: int, spp: int) -> tuple[float, Exposure]:
    """SSD's percentage of wrong pixels on a direct render, and its exposure."""
    stage, lens = model.stage, model.lens(number)
    radiance = stage.photograph(model.full_size(lens), spp, stream(seed, 10, spp))
    exposure = automatic(stage, lens, radiance)
    pictures = stage.expose(radiance, lens, stream(seed, 11, spp), SENSOR, exposure)
    return stage.errors(pictures, ("ssd",))["ssd"]["totbad2"], exposure


def theory(model: Model, seed: int, spp: int) -> Theory:
    """The texture measured on the sharp images of a seed."""
    stage, lens = model.stage, model.lens(SHARP_AT)
    sharp = stage.photograph(model.full_size(lens), spp, stream(seed, 12))
    return Theory(seed, Evidence.of(stage, lens, model.blur(lens), sharp))


def cell(values: Sequence[float]) -> str:
    """The mean, with the range if the values differ."""
    mean, least, most = (f"{value:.2g}" for value in (statistics.mean(values), min(values), max(values)))
    return f"{mean} %" if least == most else f"{mean} % ({least} to {most})"


def replace_table(page: str, table: Sequence[str]) -> str:
    """The page with the table of the same first line replaced."""
    lines = page.splitlines()
    start = lines.index(HEAD)
    end = next(k for k in range(start, len(lines)) if not lines[k].startswith("|"))
    return "\n".join([*lines[:start], *table, *lines[end:]]) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--size", default="240x180", help="image size (default: the study's)")
    parser.add_argument("--seeds", type=int, default=1, help="number of seeds")
    parser.add_argument("--write", action="store_true", help="replace the table in docs/studies.md")
    options = parser.parse_args()
    width, height = (int(side) for side in options.size.split("x"))
    table = [HEAD, "| --- |" + " ---: |" * (len(SAMPLES) + 1)]
    print("\n".join(table), flush=True)
    for name, values in rows((width, height), range(options.seeds)):
        table.append(f"| {name} | {' | '.join(map(cell, values))} |")
        print(table[-1], flush=True)
    if options.write:
        PAGE.write_text(replace_table(PAGE.read_text(), table))


if __name__ == "__main__":
    main()
