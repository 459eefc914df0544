"""The data: random scenes of recipe.toml, exposed again from their stored light, as tensors through a DataLoader."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
import variants
from torch.utils.data import DataLoader, default_convert

import twinlens as tl
from twinlens.cli.progress import progress_bar
from twinlens.dataset import StoredSample
from twinlens.errors import InputError
from twinlens.factory import generate, plan, read_recipe, worker_processes
from twinlens.factory.recipe import Recipe
from twinlens.factory.settings import ANY_SCENE, RecipeSettings, sensor_for
from twinlens.matching import grey
from twinlens.schema import read
from twinlens.scoring import Pair
from twinlens.seeds import derived_seed
from twinlens.sensor import Exposure, Mismatch, Sensor, mismatch_table

NOISELESS = {
    "shot_noise": False,
    "read_noise": 0.0,
    "dark_current": 0.0,
    "prnu": 0.0,
    "dsnu": 0.0,
}
NOISE_SCENES = 16  # exposed with noise too
ALIGNMENT = (
    "pitch_px",
    "yaw_px",
    "roll_px",
    "scale_px",
    "distortion_px",
    "right_mm",
    "down_mm",
    "forward_mm",
)
"""Fields of a mismatch that the stored light already has."""


def checked_recipe(recipe: Path, **changes: Any) -> Recipe:
    """The recipe with some keys changed.

    Raises InputError unless it has random families, stores the light, and has a rectified pair of 8-bit cameras.
    """
    found = read_recipe(recipe, changes)
    if found.kind != "family":
        raise InputError(
            f"{recipe}: replace scenes by families; held-out scenes would be those of the training"
        )
    if "radiance" not in found.keep:
        raise InputError(
            f'{recipe}: add keep = ["radiance"]; training exposes the stored light again'
        )
    for spec in (plan(found, index) for index in range(found.count)):
        rig = read(RecipeSettings, dict(spec.drawn), recipe).rig_of(
            ANY_SCENE, None, recipe, found.sources.file
        )
        if len(rig) != 2 or not rig.is_rectified():
            raise InputError(
                f"{recipe}: rig: training needs a rectified pair; remove layout and cameras"
            )
        if (bits := sensor_for(rig, spec.drawn, spec.seed, None, recipe).bits) != 8:
            raise InputError(f"{recipe}: sensor.bits: training needs 8, got {bits}")
    return found


def make_dataset(recipe: Recipe, folder: Path, workers: int) -> tl.Dataset:
    """The dataset of a recipe; an incomplete one is resumed."""
    with progress_bar(f"generating {folder.name}") as report:
        outcome = generate(
            recipe, folder, engine=worker_processes(workers), report=report
        )
    if not outcome.complete:
        raise SystemExit(f"{folder}: {outcome.there} of {outcome.count} samples")
    return tl.Dataset(folder)


@dataclass(frozen=True)
class Exposed:
    """A pair exposed from the stored light of a sample, by new cameras and with new noise.

    The mismatch is drawn anew, but for the alignment and, unless `level` is given, the fields that the recipe gives:
    these keep the sample's values. Disparities below 0 are left out.

    draw : number of the exposure.
    level : level of the mismatch, by default the sample's.
    noise : whether the sensor has noise.
    light : name of a variant of the stored light (variants.py), which is kept in `folder`.
    """

    draw: int = 0
    level: str = ""
    noise: bool = True
    light: str = ""
    folder: Path = Path()

    def __call__(self, stored: StoredSample) -> dict[str, Any]:
        written = stored.record["record"]
        sensor = Sensor.from_record(written["sensor"])
        seed = derived_seed(written["seed"], self.draw)
        sensor = sensor.replace(
            mismatch=self.mismatch(sensor, written["spec"]["drawn"], seed)
        )
        if not self.noise:
            sensor = sensor.replace(**NOISELESS)
        exposure = (
            None if written["exposure"] is None else Exposure(**written["exposure"])
        )
        if self.light:
            light = variants.light_of(stored, self.light, self.folder)
        else:
            light = [stored.radiance(view) for view in (0, 1)]
        photos = sensor.expose_rig(
            light,
            rig=stored.photographed_by,
            lens=stored.lens(0).lens,
            seed=seed,
            exposure=exposure,
        )
        left, right = (grey(photo.image) for photo in photos)
        known = (stored.mask_nonocc(0) == 255) & np.isfinite(stored.disparity(0))
        disparity = np.where(known, stored.disparity(0), np.float32(-1))
        return {"left": left, "right": right, "disparity": disparity}

    def mismatch(self, sensor: Sensor, drawn: Mapping[str, Any], seed: int) -> Mismatch:
        """The mismatch of this exposure by the sensor of a sample, whose recipe gave `drawn`."""
        old = sensor.mismatch_of(1)
        table = mismatch_table(drawn.get("sensor", {}))
        given = (table[0] if isinstance(table, list) else table).keys() - {"level"}
        kept = {*ALIGNMENT, *(() if self.level else given)}
        return Mismatch.draw(
            self.level or old.level, seed, **{name: getattr(old, name) for name in kept}
        )


def collated(samples: list[Mapping[str, Any]]) -> dict[str, Any]:
    """A batch of tensors."""
    return default_convert(tl.collate(samples))


def load(
    dataset: tl.Dataset, exposed: Callable[[StoredSample], dict[str, Any]]
) -> dict[str, Any]:
    """All pairs of a dataset as tensors: left and right uint8 (N, H, W), disparity float32, -1 unknown or occluded."""
    loader = DataLoader(
        dataset.map(exposed), batch_size=len(dataset), collate_fn=collated
    )
    return next(iter(loader))


def training_draws(
    dataset: tl.Dataset, exposed: Exposed, draws: int
) -> list[dict[str, Any]]:
    """The pairs exposed `draws` times without noise, and the noise of each grey level: what `network.train` takes."""
    clean = [
        load(dataset, replace(exposed, draw=draw, noise=False)) for draw in range(draws)
    ]
    noise = torch.zeros(256)
    if exposed.noise:
        some = dataset[:NOISE_SCENES]
        noise = noise_of_levels(
            load(some, replace(exposed, draw=0))["left"], clean[0]["left"][: len(some)]
        )
    return [{**pairs, "noise": noise} for pairs in clean]


def noise_of_levels(noisy: torch.Tensor, clean: torch.Tensor) -> torch.Tensor:
    """(256,): the standard deviation of the noise of each grey level, from uint8 images with and without it."""
    difference, levels = noisy.numpy().astype(float) - clean.numpy(), clean.numpy() // 8
    deviations = {
        8 * i + 4: difference[levels == i].std()
        for i in range(32)
        if (levels == i).sum() >= 1000
    }
    return torch.from_numpy(
        np.interp(np.arange(256), list(deviations), list(deviations.values())) / 255
    ).float()


def halved(pair: Pair) -> Pair:
    """The pair with both images averaged over 2x2 pixels, and the disparities where all four agree within 1."""
    height, width = (2 * (size // 2) for size in pair.disp0.shape)

    def fours(array: Any) -> Any:
        return np.stack([array[i:height:2, j:width:2] for i in (0, 1) for j in (0, 1)])

    images = [
        np.round(fours(image).mean(0)).astype(image.dtype)
        for image in (pair.im0, pair.im1)
    ]
    disparity = fours(pair.disp0)
    known = (np.isfinite(disparity) & (fours(pair.mask0_nonocc) == 255)).all(0)
    known &= np.ptp(np.where(known, disparity, 0), axis=0) <= 1
    return Pair(
        pair.name, *images, np.where(known, np.where(known, disparity, 0).mean(0) / 2, np.inf).astype(np.float32),
        known, (pair.ndisp + 1) // 2, min_disparity=pair.min_disparity // 2,
    )  # fmt: skip


def family(stored: StoredSample) -> str:
    return stored.record["record"]["spec"]["scene"]


def is_sharp(stored: StoredSample) -> bool:
    """Whether the sample was taken at f/32, with next to no blur."""
    return stored.lens(0).lens.aperture_diameter < 1e-3  # metres
