"""`defocus`: depth from a baseline, from dual pixels and from defocus, at equal light and equal glass.

All cues observe a textured plane and are evaluated by one maximum-likelihood estimator, so that they differ only in
where the light passed an aperture. Equal glass: the apertures of all lenses of a cue have the same total area. Equal
light: the images of a cue together collect the same number of photons per pixel, in equal shares. There is shot noise
but no read noise, so the number of exposures does not matter by itself.

Blur and disparity are one law (Schechner and Kiryati, Depth from Defocus vs. Stereo, IJCV 39(2), 2000). To first order
in the blur, the halves of an aperture are pinholes at their centroids, 4/(3 pi) of the diameter D apart. Two lenses of
half the area each are D/sqrt(2) wide, which is the shortest baseline of a pair.
"""

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from twinlens.camera import Camera, Dual, Paraxial, Pinhole, Rig, ThinLens
from twinlens.camera.parts import Parts, aperture_points
from twinlens.geometry import Float, depth_error, rigid
from twinlens.matching import (
    ApertureSamples,
    inverse_depth_bound,
    inverse_depth_from_defocus,
)
from twinlens.rendering import render
from twinlens.scenes import Scene
from twinlens.scoring.intervals import Interval
from twinlens.seeds import generator
from twinlens.studies.findings import Finding, Needs, predicted
from twinlens.studies.intervals import mean_of, over_scenes
from twinlens.studies.model import Figure, Measured, Setup, Study, sweep
from twinlens.studies.stage import centred_camera, noise_plane, stream
from twinlens.studies.table import Column, Row, Table

FX = 1000.0
FOCUS = 0.5  # 1/m, of all cues; the middle of a focal stack
OFFSETS = (-0.3, -0.2, -0.1, 0.0, 0.1, 0.2, 0.3)  # 1/m, of the planes from the focus
STACK = (-0.3, -0.15, 0.0, 0.15, 0.3)
"""1/m, of the images of a focal stack from its middle."""
DIAMETERS = (0.01, 0.02, 0.04)  # of a single lens, metres
WIDER, WIDER_DIAMETER = (2.0, 4.0, 8.0), 0.01
"""Baselines of more pairs, in those of touching lenses, and the diameter (m) at which they are tried."""
PHOTONS = 1000.0  # per pixel, in all images of a cue together
BLOCK_SIZE = 9
SEARCH, STEPS = 0.1, 33  # 1/m to both sides of the plane
TOUCHING, WIDE, HALVES = "touching pair", "wider pair", "dual pixels"
APERTURES, FOCI = "two apertures", "focal stack"
_RIM = 18  # pixels along the edges that are left out
_MORE_SAMPLES = 4  # of parts: samples are stratified in a pixel, not in each part
_BLIND = 0.25  # of the search; cues with a greater bound are left out of the comparison with it
_TOLERANCE, _MOST = 0.15, 1.5
NEEDS = Needs(pixels=160 * 120)
"""The rim leaves 128 independent blocks: the standard error of a standard deviation is 6 %."""


@dataclass(frozen=True)
class LensView:
    """An image, or the images of the parts, of a lens whose centre is at x in metres."""

    lens: Paraxial
    x: float = 0.0
    parts: Parts | None = None

    def images(self, camera: Camera, scene: Scene, spp: int, seed: int) -> list[Float]:
        """The radiance (H, W) of each part; the principal point moves so that points in focus do not."""
        shifted = camera.replace(cx=camera.cx + camera.fx * FOCUS * self.x)
        rig = Rig([shifted], [rigid(np.eye(3), [self.x, 0.0, 0.0])])
        if self.parts is None:
            images = render(scene, rig, self.lens, spp, seed)[0][None]
        else:
            spp *= _MORE_SAMPLES
            shares = render(scene, rig, self.lens, spp, seed, parts=self.parts)[0]
            images = len(self.parts) * shares
        return list(images.mean(axis=-1).astype(np.float64))

    def apertures(self) -> list[ApertureSamples]:
        """Where the light of the images passed the plane of the apertures; about a pixel apart in the largest blur."""
        largest = (
            FX * self.lens.aperture_diameter * (max(OFFSETS) + max(STACK) + SEARCH)
        )
        points, shares = aperture_points(
            self.lens, self.parts, max(16, 2 * math.ceil(0.5 * largest))
        )
        return [
            ApertureSamples(points + np.array([self.x, 0.0]), share, self.lens.vergence)
            for share in shares
        ]


def cues(diameter: float) -> Iterator[tuple[str, float, list[LensView]]]:
    """(name, baseline in metres, views) of every cue whose glass has the area of a disk of this diameter."""
    lens = ThinLens(diameter, 1 / FOCUS)
    half = ThinLens(diameter / math.sqrt(2), 1 / FOCUS)
    factors = (1.0, *WIDER) if diameter == WIDER_DIAMETER else (1.0,)
    for factor in factors:
        baseline = factor * half.aperture_diameter
        pair = [LensView(half, -baseline / 2), LensView(half, baseline / 2)]
        yield TOUCHING if factor == 1 else WIDE, baseline, pair
    # The centroids of half disks are 4/(3 pi) of the diameter apart.
    yield HALVES, 4 / (3 * math.pi) * diameter, [LensView(lens, parts=Dual())]
    narrow = lens.replace(aperture_diameter=diameter / 2)
    yield APERTURES, 0.0, [LensView(lens), LensView(narrow)]
    distances = [1 / (FOCUS + offset) for offset in STACK]
    stack = [LensView(lens.replace(focus_distance=distance)) for distance in distances]
    yield FOCI, 0.0, stack


def measure(setup: Setup) -> Measured:
    """A row for every seed, plane, diameter and cue."""
    camera = centred_camera(setup.width, setup.height, FX)
    rows: list[Row] = []
    for seed, offset in sweep(setup, setup.seeds, OFFSETS):
        rows += _rows(setup, camera, seed, offset)
    return Measured(rows, notes={"fx_px": FX, "focus_per_m": FOCUS, "stack_per_m": STACK, "photons": PHOTONS,
                                 "block_size": BLOCK_SIZE, "search_per_m": SEARCH})  # fmt: skip


def _rows(setup: Setup, camera: Camera, seed: int, offset: float) -> Iterator[Row]:
    """The errors of every cue for the plane at this offset from the focus, 1/m."""
    plane = OFFSETS.index(offset)
    true = FOCUS + offset
    scene = noise_plane(camera, 0.0, 1 / true, stream(seed, 0, plane), scale_px=1.0)
    pinhole = LensView(Pinhole())
    sharp = pinhole.images(camera, scene, setup.spp, stream(seed, 1, plane))[0]
    for i, diameter in enumerate(DIAMETERS):
        for j, (cue, baseline, views) in enumerate(cues(diameter)):
            key = plane, i, j
            images: list[Float] = []
            apertures: list[ApertureSamples] = []
            for k, view in enumerate(views):
                draw = stream(seed, 2, *key, k)
                radiance = view.images(camera, scene, setup.spp, draw)
                images += [image / sharp.mean() for image in radiance]
                apertures += view.apertures()
            error, bound = _error_and_bound(
                images, sharp / sharp.mean(), apertures, true, stream(seed, 3, *key)
            )
            yield {
                "scene": "plane",
                "seed": seed,
                "cue": cue,
                "aperture_mm": 1e3 * diameter,
                "z_m": 1 / true,
                "baseline_mm": 1e3 * baseline,
                "blur_px": FX * diameter * abs(offset),
                "depth_error_mm": _depth_error_mm(true, error),
                "bound_mm": _depth_error_mm(true, bound)
                if bound < SEARCH
                else math.nan,
                "in_bounds": error / bound if bound < _BLIND * SEARCH else math.nan,
            }


def _depth_error_mm(true: float, error: float) -> float:
    """The depth error of an error of the inverse depth `true`, both in 1/m."""
    return 1e3 * float(depth_error(1 / true, 1.0, 1.0, error))


def _error_and_bound(
    images: list[Float],
    sharp: Float,
    apertures: list[ApertureSamples],
    true: float,
    seed: int,
) -> tuple[float, float]:
    """The robust standard deviation of the errors of 1/z, SEARCH if unknown, and its median bound, both in 1/m."""
    photons, random = PHOTONS / len(images), generator(seed)
    noisy = [random.poisson(photons * image) / photons for image in images]
    estimate = inverse_depth_from_defocus(
        noisy,
        apertures,
        FX,
        1 / (true + SEARCH),
        1 / (true - SEARCH),
        steps=STEPS,
        block_size=BLOCK_SIZE,
    )
    bound = inverse_depth_bound(
        sharp, apertures, FX, true, 1 / math.sqrt(photons), block_size=BLOCK_SIZE
    )
    inner = (slice(_RIM, -_RIM),) * 2
    errors = np.minimum(np.abs(estimate[inner] - true), SEARCH)
    return 1.4826 * float(np.median(errors)), float(np.median(bound[inner]))


def conclude(table: Table) -> list[Finding]:
    """The effective baseline of dual pixels, the crossing of pair and focal stack, and the distance to the bounds."""
    return [_effective_baseline(table), _crossing(table), _efficiency(table)]


def _effective_baseline(table: Table) -> Finding:
    """Errors of dual pixels over those of pairs in focus, relative to the ratio of their baselines."""

    def ratios(unit: Table) -> list[float]:
        logarithms: list[float] = []
        for _, rows in unit.where(blur_px=0.0).groups("aperture_mm"):
            halves = _error_times_baseline(rows.where(cue=HALVES))
            pairs = _error_times_baseline(rows.where(cue=(TOUCHING, WIDE)))
            if halves.size:
                logarithms += np.log(halves / pairs).tolist()
        return logarithms

    measured = over_scenes(
        table, ratios, lambda logarithms: math.exp(float(logarithms.mean()))
    )
    text = "In focus, the depth error of dual pixels is {} times that of a pair with the baseline 4/(3 pi) D"
    return predicted(text, measured, 1.0, _TOLERANCE, needs=NEEDS)


def _error_times_baseline(rows: Table) -> Float:
    return rows.numbers("depth_error_mm") * rows.numbers("baseline_mm")


def _crossing(table: Table) -> Finding:
    """The blur at which the focal stack passes the touching pair, at the largest aperture."""
    largest = table.where(aperture_mm=1e3 * max(DIAMETERS))
    expected = over_scenes(
        largest, lambda unit: crossing(unit, TOUCHING, FOCI, "bound_mm")
    ).value
    measured = over_scenes(
        largest, lambda unit: crossing(unit, TOUCHING, FOCI, "depth_error_mm")
    )
    text = (
        f"With {1e3 * max(DIAMETERS):g} mm of glass, the pair of touching lenses is more precise than the focal stack"
        " up to a blur circle of {}, and less beyond, where their bounds cross"
    )
    return predicted(text, measured, expected, _TOLERANCE, "px", needs=NEEDS)


def crossing(rows: Table, first: str, second: str, column: str) -> float:
    """The blur (px) from which the first cue's value is the larger one; NaN if it is at no blur, or at every blur.

    The mean logarithm of the ratio over both sides of the focus is interpolated linearly between the planes.
    """
    points = []
    for (blur,), part in rows.groups("blur_px"):
        first_logs = np.log(part.where(cue=first).numbers(column))
        second_logs = np.log(part.where(cue=second).numbers(column))
        if first_logs.size and second_logs.size:
            ratio = float(first_logs.mean() - second_logs.mean())
            points.append((float(blur), ratio))
    points.sort()
    for (low, before), (high, after) in itertools.pairwise(points):
        if before <= 0 < after:
            return low + (high - low) * before / (before - after)
    return math.nan


def _efficiency(table: Table) -> Finding:
    """The largest error over its bound, of the means over seeds."""
    groups = table.groups("cue", "aperture_mm", "baseline_mm", "z_m")
    ratios = [mean_of(rows, "in_bounds").value for _, rows in groups]
    largest = max(
        (ratio for ratio in ratios if not math.isnan(ratio)), default=math.nan
    )
    text = f"No depth error exceeds {_MOST:g} times its Cramer-Rao bound"
    # A maximum has no interval.
    seeds = len(table.values("seed"))
    measured = Interval(largest, math.nan, math.nan, seeds, "plane")
    result = "the largest is {} times the bound"
    return Finding(text, measured, largest <= _MOST, result=result, needs=NEEDS)


_SHOWN = (1.25, 2.0, 5.0)
_BY_DISTANCE = (TOUCHING, HALVES, APERTURES, FOCI)
LAW = (
    "Depth follows from how the light that passes different parts of an aperture moves in the image. Two lenses a "
    "baseline B apart move a point by f B / z pixels; one lens of diameter D blurs it by a circle that is "
    "proportional to D |1/z - 1/z_focus|; the two halves of a lens act as a pair with the baseline 4/(3π) D. All "
    "cues here have equal glass (the same total area of lenses) and equal light (the same number of photons), and "
    "are compared with the Cramer-Rao bound of the same estimator."
)
STUDY = Study(
    name="defocus",
    question="Is depth more precise from a baseline, from defocus or from dual pixels, at equal light and equal glass?",
    columns=(
        Column("cue", "", "cue"),
        Column("aperture_mm", "mm", "aperture of one lens"),
        Column("baseline_mm", "mm", "baseline, or distance of the centroids of one lens's images"),
        Column("z_m", "m", "depth"),
        Column("blur_px", "px", "blur circle of one lens"),
        Column("depth_error_mm", "mm", "depth error, robust s.d."),
        Column("bound_mm", "mm", "Cramer-Rao bound"),
        Column("in_bounds", "", "error / bound"),
    ),
    measure=measure,
    conclude=conclude,
    figures=(
        Figure("distance", "Depth error and its bound against distance", "z_m", "depth_error_mm", by="cue",
               panel="aperture_mm", log_x=True, log_y=True, where={"cue": _BY_DISTANCE}, also=("bound_mm",)),
        Figure("aperture", "Depth error and its bound against the aperture", "aperture_mm", "depth_error_mm", by="cue",
               panel="z_m", log_x=True, log_y=True, where={"cue": _BY_DISTANCE, "z_m": _SHOWN}, also=("bound_mm",)),
        Figure("baseline", "Depth error and its bound against the baseline", "baseline_mm",
               "depth_error_mm", by="z_m", log_x=True, log_y=True, also=("bound_mm",),
               where={"cue": (HALVES, TOUCHING, WIDE), "aperture_mm": 1e3 * WIDER_DIAMETER}),
    ),
    law=LAW, docs="docs/study_results.md#defocus", lesson="docs/course/05_aperture_and_depth_of_field.py",
    defaults=Setup((), (), (0, 1, 2), width=160, height=120, spp=256),
)  # fmt: skip
