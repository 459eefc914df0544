"""What each ingredient of the frozen benchmark changes: its rankings and image statistics without it.

    python benchmarks/frozen/ablations.py [--work out/frozen]

Run `run.py` first, with the same work folder. Differences of exposure, light and colour are left out by exposing the
stored radiance again, with the same noise. Without misalignment, or with matte surfaces, the images are rendered again,
and kept in the work folder. Pinhole images of the first `COUNT` samples only. Adds a table to README.md.
"""

import dataclasses
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import run
import tables

from twinlens.camera import Pinhole, Rig
from twinlens.dataset import Dataset, StoredSample
from twinlens.families import random_scene
from twinlens.rendering import render
from twinlens.scenes import Scene, load_scene
from twinlens.scoring import Pair, agreement, load_pair, pair_statistics, read_board, summarize
from twinlens.seeds import generator
from twinlens.sensor import Mismatch, Sensor

COUNT = 12  # samples of each dataset
LEFT_OUT: dict[str, tuple[str, ...]] = {
    "gain and black level": ("gain", "time", "black_level"),
    "shading and f-number": ("f_number", "shading_right", "shading_down", "shading_corner"),
    "glare and stray light": ("veiling_glare", "stray_light"),
    "different sharpness": ("blur_px",),
    "different colours": ("filter_shift", "white_balance_red", "white_balance_blue", "tone_exponent"),
}
"""Fields of Mismatch that are made equal in both cameras."""


def sensor_of(stored: StoredSample) -> Sensor:
    """The sensor that took a sample."""
    fields = stored.record["record"]["sensor"]
    return Sensor(**{**fields, "mismatch": Mismatch(**fields["mismatch"])})


def equal(sensor: Sensor, fields: Iterable[str]) -> Sensor:
    """The sensor with some differences between its cameras removed."""
    return sensor.replace(
        mismatch=dataclasses.replace(sensor.mismatch, **{name: getattr(Mismatch(), name) for name in fields})
    )


def exposed(stored: StoredSample, radiance: list[np.ndarray], rig: Rig, sensor: Sensor) -> Pair:
    """The pinhole's pair, exposed from `radiance` with the sample's seed."""
    seed = stored.lens(0).record["seed"]
    photos = sensor.expose_rig(radiance, rig=rig, lens=Pinhole(), seed=seed)
    return dataclasses.replace(load_pair(stored), im0=photos[0].image, im1=photos[1].image)


def rendered(stored: StoredSample, scene: Scene, rig: Rig, folder: Path) -> list[np.ndarray]:
    """Denoised images of another scene or rig with the sample's seed, kept in `folder`."""
    file = folder / f"{stored.name}.npy"
    if not file.exists():
        shot = stored.lens(0).record
        images = np.array(render(scene, rig, Pinhole(), shot["spp"], shot["seed"], denoise=True))
        folder.mkdir(parents=True, exist_ok=True)
        np.save(file, images)
        print(file, flush=True)
    return list(np.load(file))


def scene_of(stored: StoredSample) -> Scene:
    """The scene of a sample of one of the two recipes."""
    spec = stored.record["record"]["spec"]
    if spec["kind"] == "scene":
        return load_scene(spec["scene"])
    width, height = spec["drawn"]["width"], spec["drawn"]["height"]
    seed = int(generator(spec["seed"], "scene").integers(1 << 31))
    return random_scene(spec["scene"], seed, aspect=width / height, width=width)


def variants(dataset: Dataset, name: str, work: Path) -> dict[str, list[Pair]]:
    """The pairs of every ablation."""
    found: dict[str, list[Pair]] = {}
    for stored in dataset[:COUNT]:
        sensor, rig = sensor_of(stored), stored.photographed_by
        radiance = [stored.radiance(camera) for camera in range(2)]
        for label, fields in LEFT_OUT.items():
            found.setdefault(label, []).append(exposed(stored, radiance, rig, equal(sensor, fields)))
        plain = sensor.replace(vignetting=False)
        found.setdefault("vignetting", []).append(exposed(stored, radiance, rig, plain))
        aligned = rendered(stored, scene_of(stored), stored.rig, work / f"{name}-aligned")
        found.setdefault("misalignment", []).append(exposed(stored, aligned, stored.rig, sensor))
        same = sensor.replace(mismatch=Mismatch())
        found.setdefault("any difference of the cameras", []).append(exposed(stored, aligned, stored.rig, same))
        matte = rendered(stored, with_matte_surfaces(scene_of(stored)), rig, work / f"{name}-matte")
        found.setdefault("gloss, metal and glass", []).append(exposed(stored, matte, rig, sensor))
    return found


def with_matte_surfaces(scene: Scene) -> Scene:
    """The scene with every material replaced by a diffuse one of the same colour; metal and glass become grey."""
    materials = {name: {"type": "twosided", "bsdf": matte(plugin)} for name, plugin in scene.materials.items()}
    return dataclasses.replace(scene, materials=materials)


def matte(plugin: Mapping[str, Any]) -> dict[str, Any]:
    """A diffuse material of a material's colour."""
    for key in ("reflectance", "diffuse_reflectance", "base_color"):
        if key in plugin:
            return {"type": "diffuse", "reflectance": plugin[key]}
    inner = next((value for value in plugin.values() if isinstance(value, Mapping) and "type" in value), None)
    grey = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    return grey if inner is None or plugin["type"] in ("conductor", "roughconductor") else matte(inner)


def main() -> None:
    options = run.arguments(__doc__)
    rows: list[dict[str, Any]] = []
    for name in run.DATASETS:
        board = read_board(run.HERE / f"{name}.json")
        full = tables.with_samples(board, tables.samples_of(board, "pinhole")[:COUNT])
        for label, pairs in variants(Dataset(options.work / name), name, options.work).items():
            board = run.make_board(f"{name} without {label}", pairs, options.work, ("nonocc",))
            tau = agreement(full, board, metric=tables.METRIC).tau
            summary = {key: values[0] for key, values in summarize([pair_statistics(pair) for pair in pairs]).items()}
            rows.append({"name": label, "dataset": name, "tau": f"{tau.value:.2f}", "statistics": summary})
    run.publish("ablations", rows)


if __name__ == "__main__":
    main()
