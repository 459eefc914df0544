"""`radiometric`: the two eyes differ in gain, gamma, vignetting or noise. Which cost minds least?

The question of Hirschmueller and Scharstein, Evaluation of Stereo Matching Costs on Images with Radiometric
Differences, PAMI 31(9), 2009: they change the right image of a pair and find census the most robust of all. Here the
photograph is made once per scene and seed; each difference is then put on the right picture, as they did, but for
noise, which the sensor adds.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.camera import Pinhole
from twinlens.sensor import Sensor
from twinlens.studies.bootstrap import mean_of, paired_difference
from twinlens.studies.stage import Stage, stream
from twinlens.studies.study import Figure, Finding, Measured, Setup, Study, sweep
from twinlens.studies.table import Column, Row, Table

Image = NDArray[Any]

GAINS = (0.5, 0.7, 1.0, 1.4, 2.0)
GAMMAS = (0.5, 0.7, 1.0, 1.4, 2.0)
VIGNETTES = (1.0, 0.85, 0.7, 0.5, 0.3)
"""What is left of the light in the corners of the right image."""
NOISES = (0.0, 2.0, 4.0, 8.0, 16.0)
"""Standard deviation in grey levels, both eyes, each its own."""
SENSOR = Sensor.preset("ideal", output="srgb")


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


Change = Callable[[Image, float, int], Image]
CHANGES: Mapping[str, tuple[Change, tuple[float, ...], bool]] = {
    "gain": (_gain, GAINS, False),
    "gamma": (_gamma, GAMMAS, False),
    "vignetting": (_vignetting, VIGNETTES, False),
    "noise": (_noise, NOISES, True),
}
"""Name -> what it does to a picture, how strongly, and whether both eyes get it."""


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, difference, strength and matcher."""
    rows: list[Row] = []
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        radiance = stage.photograph(Pinhole(), setup.spp, stream(seed, 0))
        pictures = stage.expose(radiance, Pinhole(), stream(seed, 1), SENSOR)
        for change, (_, amounts, _) in CHANGES.items():
            for amount in amounts:
                changed = changed_pair(pictures, change, amount, seed)
                for method, scores in stage.errors(changed, setup.methods).items():
                    rows.append(
                        {"scene": scene, "seed": seed, "change": change, "amount": amount, "method": method, **scores}
                    )
    return Measured(rows, notes={"sensor": dataclasses.asdict(SENSOR)})


def changed_pair(pictures: Sequence[Image], change: str, amount: float, seed: int) -> tuple[Image, Image]:
    """The pair with this difference between its eyes."""
    apply, _, both = CHANGES[change]
    left = apply(pictures[0], amount, stream(seed, 2)) if both else pictures[0]
    return left, apply(pictures[1], amount, stream(seed, 3))


def conclude(table: Table) -> list[Finding]:
    """For each difference the most robust cost, and census against the rest."""
    return [_most_robust(table, change) for change in CHANGES] + [_census_first(table)]


def _rise(table: Table, change: str, method: str) -> float:
    """How much worse the matcher is, on average over the strengths, than without the difference; percent points."""
    rows = table.where(change=change, method=method)
    neutral = 0.0 if change == "noise" else 1.0
    return mean_of(rows, "totbad2").value - mean_of(rows.where(amount=neutral), "totbad2").value


def _most_robust(table: Table, change: str) -> Finding:
    strongest = {"gain": 2.0, "gamma": 2.0, "vignetting": 0.3, "noise": 16.0}[change]
    rows = table.where(change=change, amount=strongest)
    best = min(table.values("method"), key=lambda method: mean_of(rows.where(method=method), "totbad2").value)
    measured = mean_of(rows.where(method=best), "totbad2")
    return Finding(f"Under {change} ({strongest:g}) {best} has the fewest wrong pixels", measured, True, "%")


def _census_first(table: Table) -> Finding:
    """Census rises least of the costs that are compared window by window, over gain, gamma and vignetting together."""
    methods = [str(method) for method in table.values("method")]
    changes = [change for change in CHANGES if change != "noise"]
    rises = {method: float(np.mean([_rise(table, change, method) for change in changes])) for method in methods}
    text = "Census loses least of the local costs to gain, gamma and vignetting (Hirschmueller and Scharstein, 2009)"
    local = {method: rise for method, rise in rises.items() if not method.startswith("sgm")}
    others = [method for method in local if method.partition(":")[0] != "census"]
    census = next((method for method in local if method.partition(":")[0] == "census"), None)
    if census is None or not others:
        return Finding(text + ": not asked, census or its rivals are missing", mean_of(table, "totbad2"), False, "%")
    rival = min(others, key=lambda method: local[method])
    changed = table.where(change=tuple(changes))
    margin = paired_difference(changed, "totbad2", "method", rival, census)
    return Finding(f"{text}; next is {rival}", margin, local[census] <= local[rival] + 0.5, "percent points fewer")


STUDY = Study(
    name="radiometric",
    question="The eyes differ in gain, gamma, vignetting or noise: which cost minds least?",
    columns=(
        Column("change", "", "difference between the eyes"),
        Column("amount", "", "strength"),
        Column("method", "", "matcher"),
        Column("totbad2", "%", "pixels wrong by more than 2 px or unknown"),
        Column("totbad1", "%", "pixels wrong by more than 1 px or unknown"),
        Column("avgerr", "px", "mean error"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure(
            "radiometric",
            "Errors of each cost when the eyes differ",
            x="amount",
            y="totbad2",
            by="method",
            panel="change",
        ),
    ),
    defaults=Setup(
        scenes=("staircase", "tabletop", "cards"),
        methods=("sad", "ssd", "ncc", "zsad", "zncc", "census", "rank", "birchfield_tomasi", "sgm"),
        seeds=(0, 1, 2),
    ),
)
