"""`evaluate`: one disparity map against the truth, by one protocol, over named regions."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twinlens.dataset import Calibration
from twinlens.errors import InputError
from twinlens.geometry import Float
from twinlens.scoring.doubts import mistake_of
from twinlens.scoring.metrics import (
    Disparity,
    Mask,
    boolean_mask,
    disparity_map,
    find_metric,
)
from twinlens.scoring.protocols import Pixels, Protocol, find_protocol

RESERVED = ("all", "nonocc")


@dataclass(frozen=True)
class RegionScores(Mapping[str, float]):
    """The metrics of one region, read like a dict: `scores.all["bad2.0"]`, and its pixel counts.

    image: number of pixels of the truth. evaluated: those in the region with known truth. estimated: those of the
    evaluated with an estimate. sparsification: percentage of bad pixels at each of `sparsification.DENSITIES`; empty
    without a confidence.
    """

    image: int
    evaluated: int
    estimated: int
    metrics: Mapping[str, float]
    sparsification: tuple[float, ...] = ()

    def __getitem__(self, name: str) -> float:
        return self.metrics[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.metrics)

    def __len__(self) -> int:
        return len(self.metrics)


@dataclass(frozen=True)
class Scores:
    """The result of `evaluate`. allowed: the lowest and highest possible disparity in pixels of the truth.

    doubt: what is probably wrong with the map's values, such as a factor of 16, in one line; empty for most maps.
    """

    protocol: Protocol
    regions: Mapping[str, RegionScores]
    allowed: tuple[float, float]
    upsampled: int
    rounded: bool
    doubt: str = ""

    @property
    def all(self) -> RegionScores:
        """Every pixel with known truth."""
        return self.regions["all"]

    @property
    def nonocc(self) -> RegionScores:
        """Pixels with known truth visible in both cameras; InputError without a mask_nonocc."""
        if "nonocc" not in self.regions:
            raise InputError(
                "no scores for region 'nonocc': pass evaluate(..., mask_nonocc=mask)"
            )
        return self.regions["nonocc"]

    def __str__(self) -> str:
        """The scores as lines of text: counts of pixels, and each metric with its unit, for every region."""
        lines = [self.protocol.title]
        for name, region in self.regions.items():
            counts = f"{region.evaluated} of {region.image} pixels evaluated, {region.estimated} estimated"
            lines.append(f"{name}: {counts}")
            for key, value in region.items():
                metric = find_metric(key)
                lines.append(f"  {key:<10} {metric.show(value):>10} {metric.unit}")
        if self.doubt:
            lines.append(f"doubtful: {self.doubt}")
        return "\n".join(lines)


def evaluate(
    disp: ArrayLike,
    gt: ArrayLike,
    mask_nonocc: ArrayLike | None = None,
    ndisp: float | None = None,
    *,
    protocol: str | Protocol = "middlebury-v3",
    regions: Mapping[str, ArrayLike] | None = None,
    round_disparity: bool | None = None,
    min_disparity: float = 0.0,
    calibration: Calibration | None = None,
    confidence: ArrayLike | None = None,
) -> Scores:
    """Score a disparity map against the truth.

    Errors are differences in float64 of the values given; `kitti2015` computes in float32, as its devkit does.

    Parameters
    ----------
    disp
        (H, W) estimate in pixels, +inf where unknown. Middlebury v3 also accepts (H/2, W/2) and (H/4, W/4): each value
        is repeated and multiplied by 2 or 4.
    gt
        (H, W) truth in pixels, +inf where unknown. Pixels with unknown truth are not evaluated.
    mask_nonocc, regions
        (H, W) mask of the region `nonocc`, which there is only with a mask, and of further regions by name: bool, or
        uint8 with 255 for True.
    ndisp, min_disparity
        Number of disparities at the resolution of `disp`, None if not known, and the smallest one. Middlebury v3 clips
        estimates to [min_disparity, min_disparity + ndisp]; those above 1000 ndisp are no estimates.
    round_disparity
        Round estimates to whole pixels (halves away from zero) after clipping. None: under Middlebury v3 if the
        calibration has isint=1, as its script `runeval` does.
    calibration
        The pair's calibration. Required by the protocol "points".
    confidence
        The confidence in `disp`, of its size, higher where it is more probably right. Middlebury v3 and ETH3D then
        have sparsification curves, and the metrics auc.

    Raises
    ------
    InputError
        NaN or -inf in a map, sizes that do not fit, a bad mask, an unknown protocol, a region named twice.

    >>> scores = evaluate([[3.0, 5.5, np.inf]], [[3.0, 4.0, 7.0]])
    >>> scores.all["bad1.0"], scores.all["totbad1.0"], scores.all["avgerr"], scores.all.evaluated
    (33.333333333333336, 66.66666666666667, 0.75, 3)
    """
    rules = find_protocol(protocol)
    extra_regions = regions or {}
    _check_request(rules, ndisp, min_disparity, calibration, extra_regions)
    truth, estimate = disparity_map("gt", gt), disparity_map("disp", disp)
    scale = upsampling(estimate.shape, truth.shape, rules)
    if confidence is not None:
        confidence = _confidence_map(confidence, estimate.shape, scale)
    lowest = scale * min_disparity
    highest = math.inf if ndisp is None else scale * (min_disparity + ndisp)
    estimate = upsampled(estimate, scale)
    visible = None
    if mask_nonocc is not None:
        visible = boolean_mask("mask_nonocc", mask_nonocc, truth.shape)
    doffs = 0.0 if calibration is None else calibration.doffs
    doubt = mistake_of(estimate, truth, visible, lowest, highest - 1, doffs)
    estimate, estimated = rules.prepare(estimate, lowest, highest)
    if round_disparity is None:
        round_disparity = rules.rounds_integers and _is_whole(calibration)
    if round_disparity:
        estimate = _rounded(estimate)
    masks = _region_masks(truth.shape, visible, extra_regions)
    pixels = Pixels(estimate, truth, estimated, confidence=confidence)
    scores = {}
    for name, mask in masks.items():
        evaluated = mask & np.isfinite(truth)
        of_region = pixels.at(evaluated)
        if rules.needs_calibration and calibration is not None:
            metres = _point_errors(of_region, np.argwhere(evaluated), calibration)
            of_region = replace(of_region, metres=metres)
        scores[name] = region_scores(rules, of_region, truth.size)
    return Scores(rules, scores, (lowest, highest), scale, round_disparity, doubt)


def _region_masks(
    shape: tuple[int, ...], visible: Mask | None, further: Mapping[str, ArrayLike]
) -> dict[str, Mask]:
    """The masks of the regions: all pixels, the visible ones if they are known, and further ones."""
    masks: dict[str, Mask] = {"all": np.ones(shape, np.bool_)}
    if visible is not None:
        masks["nonocc"] = visible
    for name, mask in further.items():
        masks[name] = boolean_mask(f"region {name!r}", mask, shape)
    return masks


def _check_request(
    rules: Protocol,
    ndisp: float | None,
    min_disparity: float,
    calibration: Calibration | None,
    regions: Mapping[str, ArrayLike],
) -> None:
    if not rules.needs_truth:
        raise InputError(
            f"protocol {rules.name!r} compares no truth: use scoring.check_views"
        )
    if rules.needs_calibration and calibration is None:
        raise InputError(
            f"{rules.title} needs the pair's calibration: evaluate(..., calibration=...)"
        )
    if ndisp is not None and not (math.isfinite(ndisp) and ndisp > 0):
        raise InputError(f"ndisp is {ndisp}: expected a positive number of disparities")
    if not math.isfinite(min_disparity):
        raise InputError(
            f"min_disparity is {min_disparity}: expected a finite number of pixels"
        )
    for name in set(RESERVED) & set(regions):
        raise InputError(
            f"region {name!r} is reserved: pass mask_nonocc, or use another name"
        )


def _is_whole(calibration: Calibration | None) -> bool:
    """Whether the pair's calibration says that its truth is of whole pixels."""
    return calibration is not None and bool(calibration.isint)


def _rounded(estimate: Disparity) -> Disparity:
    """Whole pixels, halves away from zero as C's round(); NumPy rounds halves to even."""
    wide = estimate.astype(np.float64)
    whole = np.copysign(np.floor(np.abs(wide) + 0.5), wide)
    return np.asarray(whole.astype(estimate.dtype))


def region_scores(rules: Protocol, pixels: Pixels, image_size: int) -> RegionScores:
    """The metrics of a region, with those of the sparsification curve if there is a confidence."""
    metrics = rules.measure(pixels)
    rates: tuple[float, ...] = ()
    if rules.auc_threshold is not None:
        curve = pixels.sparsified(rules.auc_threshold)
        if curve is not None:
            area_name, least_name = rules.auc_metrics
            metrics[area_name] = 100 * curve.auc
            metrics[least_name] = 100 * curve.optimal_auc
            rates = tuple(100 * rate for rate in curve.error_rates)
    estimated = int(np.count_nonzero(pixels.estimated))
    return RegionScores(image_size, pixels.truth.size, estimated, metrics, rates)


def upsampling(
    estimate_shape: tuple[int, ...], truth_shape: tuple[int, ...], rules: Protocol
) -> int:
    """Ratio of the truth's size to the map's; InputError unless the protocol allows it."""
    for scale in rules.upsampling:
        if tuple(scale * n for n in estimate_shape) == truth_shape:
            return scale
    height, width = truth_shape
    shapes = [
        (height // scale, width // scale)
        for scale in rules.upsampling
        if height % scale == 0 and width % scale == 0
    ]
    allowed = " or ".join(map(str, shapes))
    raise InputError(
        f"disp has shape {estimate_shape}: {rules.title} expects {allowed} for a truth of {truth_shape}"
    )


def _confidence_map(confidence: ArrayLike, shape: tuple[int, ...], scale: int) -> Float:
    values = np.asarray(confidence)
    if values.dtype.kind not in "biuf" or values.shape != shape:
        raise InputError(
            f"confidence holds {values.dtype} {values.shape}: expected numbers of disp's shape, {shape}"
        )
    return _repeated(values.astype(np.float64), scale)


def upsampled(disp: Disparity, scale: int) -> Disparity:
    """The map repeated `scale` times in both directions, its values multiplied by `scale`."""
    repeated = _repeated(disp, scale)
    return np.asarray(repeated * disp.dtype.type(scale))


def _repeated(values: NDArray[Any], scale: int) -> NDArray[Any]:
    """Each value of (H, W) `scale` times in both directions."""
    return np.repeat(np.repeat(values, scale, axis=0), scale, axis=1)


def _point_errors(
    pixels: Pixels, places: NDArray[np.intp], calibration: Calibration
) -> tuple[Float, Float]:
    """(distance between estimated and true point, distance from the camera to the true point), each (N,) in metres.

    places: (N, 2) rows of (v, u). The first is +inf where either point is undefined (unknown disparity, or
    d + doffs <= 0).
    """
    fx, fy, cx, cy = calibration.cam0
    x, y = (places[:, 1] - cx) / fx, (places[:, 0] - cy) / fy
    # Both points are on the ray through the pixel, of which the part up to depth z has the length z * ray_length.
    ray_length = np.sqrt(1.0 + x**2 + y**2)
    z_estimate = _depth(pixels.estimate, calibration)
    z_true = _depth(pixels.truth, calibration)
    defined = np.isfinite(z_estimate) & np.isfinite(z_true)
    with np.errstate(invalid="ignore"):
        distances = np.where(defined, np.abs(z_estimate - z_true) * ray_length, np.inf)
        return distances, z_true * ray_length


def _depth(disparity: NDArray[np.floating[Any]], calibration: Calibration) -> Float:
    """z in metres; +inf where d + doffs <= 0."""
    in_front = disparity + calibration.doffs > 0
    return calibration.depth(np.where(in_front, disparity, np.inf))
