"""`radiometric`: the two eyes differ in gain, gamma, vignetting or noise. Which cost minds least?

The question of Hirschmueller and Scharstein, Evaluation of Stereo Matching Costs on Images with Radiometric
Differences, PAMI 31(9), 2009: they change the right image of a pair and find census the most robust of all. Here the
photograph is made once per scene and seed, by a sensor without noise of its own; each difference is then put on the
right picture as they did, and noise on both. What noise the light paths leave in the photographs is measured, from its
two halves, and said beside the protocol.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Pinhole
from twinlens.matching import StereoMatcher, parse_method
from twinlens.sensor import Sensor, auto_exposure
from twinlens.studies.bootstrap import Interval, brief, mean_of, paired_difference, unsigned
from twinlens.studies.model import Figure, Finding, Measured, Setup, Study, is_above, sweep
from twinlens.studies.stage import SCORES, Stage, stream
from twinlens.studies.table import Column, Row, Table

Image = NDArray[Any]

SENSOR = Sensor.preset("ideal", output="srgb", shot_noise=False)


def _gain(picture: Image, amount: float, seed: int) -> Image:
    return _levels(picture * amount)


def _gamma(picture: Image, amount: float, seed: int) -> Image:
    return _levels(255.0 * (picture / 255.0) ** amount)


def _vignetting(picture: Image, amount: float, seed: int) -> Image:
    height, width = picture.shape[:2]
    y, x = np.ogrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    falloff = 1.0 - (1.0 - amount) * (x**2 + y**2) / 2.0
    return _levels(picture * falloff[..., None])


def _noise(picture: Image, amount: float, seed: int) -> Image:
    return _levels(picture + amount * np.random.default_rng(seed).standard_normal(picture.shape))


def _levels(values: NDArray[Any]) -> Image:
    levels: Image = np.rint(np.clip(values, 0, 255)).astype(np.uint8)
    return levels


@dataclass(frozen=True)
class Change:
    """A difference between the eyes: what it does to a picture of 8 bits, how strongly, and which amount is none."""

    apply: Callable[[Image, float, int], Image]
    amounts: tuple[float, ...]
    neutral: float
    text: str
    both: bool = False


CHANGES: Mapping[str, Change] = {
    "gain": Change(_gain, (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, "factor on the right picture's levels"),
    "gamma": Change(_gamma, (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, "exponent of the right picture's levels"),
    "vignetting": Change(_vignetting, (0.3, 0.5, 0.7, 0.85, 1.0), 1.0, "light left in the right picture's corners"),
    "noise": Change(_noise, (0.0, 2.0, 4.0, 8.0, 16.0), 0.0, "noise of either picture, s.d. (grey levels)", both=True),
}


_NOTHING = Interval(*3 * (float("nan"),))


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, difference, strength and matcher."""
    rows: list[Row] = []
    left_over: dict[str, list[float]] = {}
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        pictures, grain = photographs(stage, setup.spp, seed)
        left_over.setdefault(scene, []).append(grain)
        for name, change in CHANGES.items():
            for amount in change.amounts:
                place = {"scene": scene, "seed": seed, "change": name, "amount": amount}
                found = stage.errors(changed_pair(pictures, change, amount, seed), setup.methods)
                rows += [{**place, "method": method, **scores} for method, scores in found.items()]
    grains = {scene: float(np.sqrt(np.mean(np.square(values)))) for scene, values in left_over.items()}
    text = ", ".join(f"{scene} {brief(grain)}" for scene, grain in grains.items())
    return Measured(
        rows,
        notes={"sensor": dataclasses.asdict(SENSOR), "light_path_noise": grains},
        remarks={"noise of the light paths": f"{text} grey levels of 255, rms, before any difference is put on"},
    )


def photographs(stage: Stage, spp: int, seed: int) -> tuple[tuple[Image, Image], float]:
    """The pair of `spp` samples a pixel, and the noise its light paths leave in the left picture, rms grey levels.

    It is taken by two halves: their mean is the photograph, and half their difference has its mean's deviation.
    """
    halves = [stage.photograph(Pinhole(), max(spp // 2, 1), stream(seed, 0, half)) for half in range(2)]
    light = [0.5 * (first + second) for first, second in zip(*halves, strict=True)]
    exposure = auto_exposure(light, sensor=SENSOR, cameras=stage.rig.cameras, lens=Pinhole())
    first, second = (
        stage.expose(half, Pinhole(), stream(seed, 1), SENSOR, exposure)[0].astype(np.float64) for half in halves
    )
    grain = 0.5 * float(np.sqrt(np.mean((first - second) ** 2)))
    return stage.expose(light, Pinhole(), stream(seed, 1), SENSOR, exposure), grain


def changed_pair(pictures: Sequence[Image], change: Change, amount: float, seed: int) -> tuple[Image, Image]:
    """The pair with this difference between its eyes."""
    left = change.apply(pictures[0], amount, stream(seed, 2)) if change.both else pictures[0]
    return left, change.apply(pictures[1], amount, stream(seed, 3))


def conclude(table: Table) -> list[Finding]:
    """For each difference the best of the local costs; and whether census is the best of them over all."""
    changed = table.where(lambda row: row["amount"] != CHANGES[str(row["change"])].neutral)
    local = changed.where(lambda row: is_local(str(row["method"])))
    return [*(_fewest(local.where(change=change), change) for change in CHANGES), _census(local)]


def is_local(method: str) -> bool:
    """Whether the method is a cost over one fixed block whose least value wins; networks and programs are none.

    >>> [is_local(method) for method in ("census:block_size=5", "zncc:optimisation=sgm8", "sgm4", "adaptive")]
    [True, False, False, False]
    """
    spec = parse_method(method)
    if spec.method.matcher is not StereoMatcher:
        return False
    matcher = spec.matcher()
    return bool(matcher.optimisation == "wta" and matcher.support == "fixed")


def _ranking(rows: Table) -> list[str]:
    wrong = {str(method): rows.where(method=method).numbers("totbad2").mean() for method in rows.values("method")}
    return sorted(wrong, key=lambda method: float(wrong[method]))


def _fewest(rows: Table, change: str) -> Finding:
    """The cost with the fewest wrong pixels on average over the strengths, and how far the next one is."""
    if not len(rows):
        text = f"Under {change} a local cost has the fewest wrong pixels: takes one among the methods"
        return Finding(text, _NOTHING, holds=False, asked=False)
    best, *others = _ranking(rows)
    if not others:
        text = f"Under {change} {best}, asked alone, has {{}} of its pixels wrong"
        return Finding(text, mean_of(rows, "totbad2"), True, "%", answer=best)
    margin = paired_difference(rows, "totbad2", "method", others[0], best)
    said, way = unsigned(margin, "fewer", "more")
    text = f"Under {change} {best} has the fewest wrong pixels of the local costs, {{}} {way} than {others[0]}"
    return Finding(text, said, is_above(margin), "percent points", answer=best)


def _census(rows: Table) -> Finding:
    text = "Over all four differences census has the fewest wrong pixels, as Hirschmueller and Scharstein (2009) report"
    ranking = _ranking(rows)
    census = next((method for method in ranking if method.partition(":")[0] == "census"), None)
    rivals = [method for method in ranking if method != census]
    if census is None or not rivals:
        return Finding(f"{text}: takes census and a rival among the methods", _NOTHING, holds=False, asked=False)
    margin = paired_difference(rows, "totbad2", "method", rivals[0], census)
    said, way = unsigned(margin, "fewer", "more")
    return Finding(f"{text}: {{}} {way} than {rivals[0]}", said, is_above(margin), "percent points")


STUDY: Study = Study(
    name="radiometric",
    question="The eyes differ in gain, gamma, vignetting or noise: which cost minds least?",
    columns=(
        Column("change", "", "difference between the eyes"),
        Column("amount", "", "strength"),
        Column("method", "", "matcher"),
        *SCORES,
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("radiometric", "Wrong pixels of each cost when the eyes differ", "amount", "totbad2", by="method",
               panel="change", x_of={name: change.text for name, change in CHANGES.items()}),
    ),
    defaults=Setup(
        ("staircase", "tabletop", "cards"),
        ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard", "census", "rank", "birchfield_tomasi", "sgm"),
        (0, 1, 2),
        spp=64,
    ),
)  # fmt: skip
