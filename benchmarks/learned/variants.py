"""Other pictures of the same scenes: not denoised, by aligned cameras, or with random textures.

The ground truth stays. The light is kept in the work folder.
"""

import dataclasses
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from twinlens.dataset import StoredSample
from twinlens.families import random_scene
from twinlens.rendering import render_measured
from twinlens.scenes import Bitmap, Scene
from twinlens.seeds import generator
from twinlens.sensor import Sensor


def scene_of(stored: StoredSample) -> Scene:
    """The random scene of a sample."""
    spec = stored.record["record"]["spec"]
    width, height = spec["drawn"]["width"], spec["drawn"]["height"]
    seed = int(generator(spec["seed"], "scene").integers(1 << 31))
    return random_scene(spec["scene"], seed, aspect=width / height, width=width)


def with_random_textures(scene: Scene, seed: int) -> Scene:
    """The scene with every texture replaced by coloured noise, whose grains have a random size."""
    materials = {}
    for number, (name, material) in enumerate(scene.materials.items()):
        color = material.base_color
        if isinstance(color, Bitmap):
            random = generator(seed, "texture", number)
            noise = _noise(color.pixels.shape, random).astype(color.pixels.dtype)
            color = dataclasses.replace(color, pixels=noise)
        materials[name] = dataclasses.replace(material, base_color=color)
    return dataclasses.replace(scene, materials=materials)


def _noise(shape: tuple[int, ...], random: np.random.Generator) -> np.ndarray:
    grain = np.exp(random.uniform(np.log(0.5), np.log(12)))  # texels
    noise = gaussian_filter(
        random.standard_normal(shape), (grain, grain, 0), mode="wrap"
    )
    noise = random.uniform(0.2, 0.6, shape[2]) * np.exp(
        random.uniform(0.1, 0.6) * noise / noise.std()
    )
    return np.clip(noise, 0.01, 0.95)


def light_of(stored: StoredSample, kind: str, folder: Path) -> list[np.ndarray]:
    """Both images (H, W, 3) of a variant, float32: "unchanged", "aligned", "not denoised" or "random textures"."""
    file = folder / kind.replace(" ", "-") / f"{stored.name}.npy"
    if not file.exists():
        shot, scene = stored.lens(0), scene_of(stored)
        if kind == "random textures":
            scene = with_random_textures(scene, shot.record["seed"])
        rig, lens = (
            stored.photographed_by,
            Sensor.from_record(stored.record["record"]["sensor"]).lenses,
        )
        if kind == "aligned":
            rig, lens = stored.rig, Sensor().lenses
        seen, _ = render_measured(
            scene,
            rig,
            lens(rig, shot.lens),
            shot.record["spp"],
            shot.record["seed"],
            denoise=kind != "not denoised",
        )
        file.parent.mkdir(parents=True, exist_ok=True)
        part = file.with_suffix(".part.npy")
        np.save(part, np.array([view.image for view in seen], np.float32))
        part.rename(file)
        print(f"{kind}: {stored.name}", flush=True)
    return list(np.load(file))
