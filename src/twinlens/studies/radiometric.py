"""`radiometric`: matching costs on image pairs that differ in gain, gamma, vignetting or noise.

After Hirschmueller and Scharstein, Evaluation of Stereo Matching Costs on Images with Radiometric Differences, PAMI
31(9), 2009. Images of a sensor without noise are changed: the right image only, or both by noise.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.random import default_rng

from twinlens.camera import Pinhole
from twinlens.matching import StereoMatcher, parse_method
from twinlens.scoring.intervals import brief
from twinlens.sensor import Sensor, auto_exposure
from twinlens.studies.findings import Finding, fewer_wrong, open_claim
from twinlens.studies.intervals import mean_of
from twinlens.studies.model import Figure, Measured, Setup, Study, sweep
from twinlens.studies.stage import SCORES, Image, Stage, stream
from twinlens.studies.table import Column, Row, Table

SENSOR = Sensor.preset("ideal", output="srgb", shot_noise=False)


@dataclass(frozen=True)
class Change:
    """A radiometric difference: levels(8-bit image, amount, seed), its amounts, and the amount without effect."""

    levels: Callable[[Image, float, int], Image]
    amounts: tuple[float, ...]
    neutral: float
    text: str
    both: bool = False


def _vignetting(picture: Image, amount: float, seed: int) -> Image:
    y, x = np.ogrid[-1 : 1 : picture.shape[0] * 1j, -1 : 1 : picture.shape[1] * 1j]
    return np.asarray(picture * (1.0 - (1.0 - amount) * (x**2 + y**2) / 2.0)[..., None])


CHANGES: Mapping[str, Change] = {
    "gain": Change(lambda picture, amount, seed: picture * amount,
                   (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, "gain of the right image"),
    "gamma": Change(lambda picture, amount, seed: 255.0 * (picture / 255.0) ** amount,
                    (0.5, 0.7, 1.0, 1.4, 2.0), 1.0, "gamma of the right image"),
    "vignetting": Change(_vignetting, (0.3, 0.5, 0.7, 0.85, 1.0), 1.0, "transmission in the right image's corners"),
    "noise": Change(lambda picture, amount, seed: picture + amount * default_rng(seed).standard_normal(picture.shape),
                    (0.0, 2.0, 4.0, 8.0, 16.0), 0.0, "noise of both images, s.d. (grey levels)", both=True),
}  # fmt: skip


def measure(setup: Setup) -> Measured:
    """A row for every scene, seed, difference, amount and matcher."""
    rows: list[Row] = []
    noise: dict[str, list[float]] = {}
    for scene, seed in sweep(setup, setup.seeds):
        stage = Stage.of(scene, setup.width, setup.height)
        pictures, rms = image_pair(stage, setup.spp, seed)
        noise.setdefault(scene, []).append(rms)
        for name, change in CHANGES.items():
            for amount in change.amounts:
                case = {"scene": scene, "seed": seed, "change": name, "amount": amount}
                changed = changed_pair(pictures, change, amount, seed)
                rows += [
                    {**case, "method": method, **scores}
                    for method, scores in stage.errors(changed, setup.methods).items()
                ]
    totals = {
        scene: float(np.sqrt(np.mean(np.square(values))))
        for scene, values in noise.items()
    }
    text = ", ".join(f"{scene} {brief(total)}" for scene, total in totals.items())
    remark = f"{text}; rms grey levels of 255, before any difference is applied"
    return Measured(
        rows,
        notes={"sensor": asdict(SENSOR), "light_path_noise": totals},
        remarks={"rendering noise": remark},
    )


def image_pair(stage: Stage, spp: int, seed: int) -> tuple[tuple[Image, Image], float]:
    """The images of both views, and the rendering noise of the left one, rms grey levels.

    The noise is half the difference of two renders with half the samples each, whose mean is the image.
    """
    halves = [
        stage.photograph(Pinhole(), max(spp // 2, 1), stream(seed, 0, half))
        for half in range(2)
    ]
    light = [0.5 * (first + second) for first, second in zip(*halves, strict=True)]
    exposure = auto_exposure(
        light, sensor=SENSOR, cameras=stage.rig.cameras, lens=Pinhole()
    )
    first, second, whole = (
        stage.expose(radiance, Pinhole(), stream(seed, 1), SENSOR, exposure)
        for radiance in (*halves, light)
    )
    difference = first[0].astype(np.float64) - second[0]
    return whole, 0.5 * float(np.sqrt(np.mean(difference**2)))


def changed_pair(
    pictures: Sequence[Image], change: Change, amount: float, seed: int
) -> tuple[Image, Image]:
    """The pair with this difference between its images, rounded and clipped to 8 bits."""
    left, right = pictures
    if change.both:
        left = _to_8_bits(change.levels(left, amount, stream(seed, 2)))
    right = _to_8_bits(change.levels(right, amount, stream(seed, 3)))
    return left, right


def _to_8_bits(levels: Image) -> Image:
    return np.asarray(np.rint(np.clip(levels, 0, 255)), np.uint8)


def conclude(table: Table) -> list[Finding]:
    """The best local cost under each difference, and whether census is the best over all of them."""
    changed = table.where(
        lambda row: row["amount"] != CHANGES[str(row["change"])].neutral
    )
    local = changed.where(lambda row: is_local(str(row["method"])))
    findings = [_fewest(local.where(change=change), change) for change in CHANGES]
    text = "Over all four differences census has the fewest wrong pixels (Hirschmueller and Scharstein 2009)"
    ranking = _ranking(local)
    census = [method for method in ranking if method.partition(":")[0] == "census"]
    rivals = [method for method in ranking if method not in census[:1]]
    if not census or not rivals:
        return [*findings, open_claim(f"{text}: needs census and another local cost")]
    best, rival = census[0], rivals[0]
    return [*findings, fewer_wrong(text, local, best, rival, f"than {rival}")]


def is_local(method: str) -> bool:
    """Whether the method takes the least cost over one fixed block; networks and external programs do not."""
    spec = parse_method(method)
    if spec.method.matcher is not StereoMatcher:
        return False
    matcher = spec.matcher()
    return bool(matcher.optimisation == "wta" and matcher.support == "fixed")


def _ranking(rows: Table) -> list[str]:
    """The methods by increasing share of wrong pixels."""
    wrong = {
        str(method): float(part.numbers("totbad2").mean())
        for (method,), part in rows.groups("method")
    }
    return sorted(wrong, key=lambda method: wrong[method])


def _fewest(rows: Table, change: str) -> Finding:
    """The cost with the fewest wrong pixels, averaged over the amounts, and its margin over the second best."""
    if not len(rows):
        return open_claim(
            f"Under {change}, one local cost has the fewest wrong pixels: no local cost was run"
        )
    best, *rivals = _ranking(rows)
    if not rivals:
        text = (
            f"Under {change}, {best} is the only local cost; it has {{}} wrong pixels"
        )
        return Finding(text, mean_of(rows, "totbad2"), True, "%", answer=best)
    second = rivals[0]
    text = f"Under {change}, {best} has the fewest wrong pixels of the local costs"
    return fewer_wrong(text, rows, best, second, f"than {second}", answer=best)


LAW = (
    "Real cameras differ in gain, gamma and vignetting, so that corresponding pixels have different values. A "
    "cost that compares values (SAD, SSD) then has its minimum at a wrong disparity. A cost is invariant to a "
    "gain if it normalises the windows (NCC), to a gain and an offset if it subtracts their means too (ZNCC), and "
    "to any increasing function of the values if it compares their order only (census, rank). Order is sensitive "
    "to noise where the window is plain."
)
STUDY = Study(
    name="radiometric",
    question="Which matching cost is most robust to differences in gain, gamma, vignetting or noise?",
    columns=(
        Column("change", "", "radiometric difference"),
        Column("amount", "", "amount"),
        Column("method", "", "matcher"),
        *SCORES,
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("radiometric", "Wrong pixels of each cost under radiometric differences", "amount", "totbad2",
               by="method", panel="change", x_of={name: change.text for name, change in CHANGES.items()}),
    ),
    law=LAW, docs="docs/study_results.md#radiometric", lesson="docs/course/11_sliding_window.py",
    defaults=Setup(
        ("staircase", "tabletop", "cards"),
        ("sad", "ssd", "ncc", "zsad", "zssd", "zncc", "jaccard", "census", "rank", "birchfield_tomasi", "sgm"),
        (0, 1, 2),
    ),
)  # fmt: skip
