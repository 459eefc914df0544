"""The data: random scenes of recipe.toml, exposed again from their stored light, as tensors through a DataLoader."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import variants
from torch.utils.data import DataLoader, default_convert

import twinlens as tl
from twinlens.cli.progress import progress_bar
from twinlens.dataset import StoredSample
from twinlens.factory import generate, read_recipe, worker_processes
from twinlens.matching import grey
from twinlens.seeds import derived_seed
from twinlens.sensor import Mismatch, Sensor

NOISELESS = {"shot_noise": False, "read_noise": 0.0, "dark_current": 0.0, "prnu": 0.0, "dsnu": 0.0}
GEOMETRY = ("pitch_px", "yaw_px", "roll_px", "scale_px", "distortion_px")
"""Fields of a mismatch that the stored light already has."""


def make_dataset(recipe: Path, folder: Path, workers: int, **changes: Any) -> tl.Dataset:
    """The dataset of a recipe with some keys changed; an incomplete one is resumed."""
    with progress_bar(f"generating {folder.name}") as report:
        outcome = generate(read_recipe(recipe, changes), folder, engine=worker_processes(workers), report=report)
    if not outcome.complete:
        raise SystemExit(f"{folder}: {outcome.there} of {outcome.count} samples")
    return tl.Dataset(folder)


@dataclass(frozen=True)
class Exposed:
    """A pair exposed from the stored light of a sample, by new cameras and with new noise.

    level : of the mismatch of exposure, light and colour, by default the sample's; its alignment is kept.
    noise : whether the sensor has any.
    light : a variant of the stored light (variants.py), kept in `folder`.
    """

    draw: int = 0
    level: str = ""
    noise: bool = True
    light: str = ""
    folder: Path = Path()

    def __call__(self, stored: StoredSample) -> dict[str, Any]:
        written = stored.record["record"]
        old = written["sensor"]
        seed = derived_seed(written["seed"], self.draw)
        level = self.level or old["mismatch"]["level"]
        mismatch = Mismatch.draw(level, seed, **{name: old["mismatch"][name] for name in GEOMETRY})
        sensor = Sensor(**{**old, "mismatch": mismatch, **({} if self.noise else NOISELESS)})
        if self.light:
            light = variants.light_of(stored, self.light, self.folder)
        else:
            light = [stored.radiance(view) for view in (0, 1)]
        photos = sensor.expose_rig(light, rig=stored.photographed_by, lens=stored.lens(0).lens, seed=seed)
        left, right = (grey(photo.image) for photo in photos)
        known = (stored.mask_nonocc(0) == 255) & np.isfinite(stored.disparity(0))
        disparity = np.where(known, stored.disparity(0), np.float32(-1))
        return {"left": left, "right": right, "disparity": disparity}


def collated(samples: list[Mapping[str, Any]]) -> dict[str, Any]:
    """A batch of tensors."""
    return default_convert(tl.collate(samples))


def load(dataset: tl.Dataset, exposed: Callable[[StoredSample], dict[str, Any]]) -> dict[str, Any]:
    """All pairs of a dataset as tensors: left and right uint8 (N, H, W), disparity float32, -1 unknown or occluded."""
    loader = DataLoader(dataset.map(exposed), batch_size=len(dataset), collate_fn=collated)
    return next(iter(loader))


def family(stored: StoredSample) -> str:
    return stored.record["record"]["spec"]["scene"]


def is_sharp(stored: StoredSample) -> bool:
    """Whether the sample was taken at f/32, with next to no blur."""
    return stored.lens(0).lens.aperture_diameter < 1e-3  # metres
