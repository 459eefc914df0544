"""What each ingredient of the frozen benchmark changes: its rankings and image statistics without it.

    python benchmarks/frozen/ablations.py [--work out/frozen] [--count 2 2]

Run `run.py` first, with the same work folder. Images through the lens of the first samples of each dataset. Differences
of the sensors are left out by exposing the stored radiance again, with the same noise. Differences of the lenses and of
the alignment need another second image, materials and light both images: these are kept in the work folder, with the
boards. Takes about six minutes of processor time per sample. Adds a table to README.md.
"""

import argparse
import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import run
import tables

from twinlens.camera import Lens, Pinhole, Rig
from twinlens.dataset import Dataset, StoredSample
from twinlens.families import random_scene
from twinlens.rendering import render
from twinlens.scenes import Color, Material, Scene, Sky, load_scene
from twinlens.scenes.materials import ColorValue, lambert
from twinlens.scoring import (
    Board,
    Pair,
    agreement,
    load_pair,
    pair_statistics,
    run_benchmark,
    summarize,
)
from twinlens.seeds import derived_seed, generator
from twinlens.sensor import Mismatch, Sensor
from twinlens.sensor.light import vignetting

COUNTS = (
    2,
    2,
)  # samples of `bundled` and `families`; 5 and 4 have each scene and each family once
LENS = 1  # of the recipes: f/1.4
CLOSED = "room"  # a bundled scene that an even sky does not light
EXPOSED: dict[str, tuple[str, ...]] = {
    "gain": ("gain",),
    "exposure time": ("time",),
    "black level": ("black_level",),
    "lens shading": ("shading_right", "shading_down", "shading_corner"),
    "veiling glare": ("veiling_glare",),
    "stray light": ("stray_light",),
    "sharpness": ("blur_px",),
    "colour filters": ("filter_shift",),
    "white balance": ("white_balance_red", "white_balance_blue"),
    "tone curve": ("tone_exponent",),
}
"""Fields of Mismatch that are made equal in both cameras; the stored radiance is exposed again."""
RENDERED: dict[str, tuple[str, ...]] = {
    "(nothing; second image rendered again)": (),
    "f-number": ("f_number",),
    "focus": ("focus_um",),
    "focal length": ("scale_px",),
    "rotation": ("pitch_px", "yaw_px", "roll_px"),
    "translation": ("right_mm", "down_mm", "forward_mm"),
    "distortion": ("distortion_px",),
    "any difference of the cameras": tuple(vars(Mismatch())),
}
"""The same, where the second image is rendered again."""


def equal(sensor: Sensor, fields: Iterable[str]) -> Sensor:
    """The sensor with some differences between its cameras removed."""
    return sensor.replace(
        mismatch=dataclasses.replace(
            sensor.mismatch, **{name: getattr(Mismatch(), name) for name in fields}
        )
    )


class Ablations:
    """The pairs of one sample without each ingredient. `folder` keeps what is rendered."""

    def __init__(self, stored: StoredSample, folder: Path) -> None:
        self.stored, self.folder = stored, folder
        self.shot = stored.lens(LENS)
        self.sensor = Sensor.from_record(stored.record["record"]["sensor"])
        self.rig = stored.photographed_by
        self.radiance = [self.shot.radiance(camera) for camera in range(2)]

    def pairs(self) -> Iterator[tuple[str, Pair]]:
        """The pair with everything, then without each ingredient."""
        yield "everything", load_pair(self.stored, LENS)
        for label, fields in EXPOSED.items():
            yield label, self.exposed(self.radiance, equal(self.sensor, fields))
        unlit = self.sensor.replace(vignetting=False)
        for label, kept in (
            ("natural vignetting", self._mechanical),
            ("mechanical vignetting", self._natural),
        ):
            images = [
                image * kept(i)[..., None] for i, image in enumerate(self.radiance)
            ]
            yield label, self.exposed(images, unlit)
        for label, fields in RENDERED.items():
            yield label, self.rendered_second(label, equal(self.sensor, fields))
        for label, change in SCENES.items():
            if (
                change is not with_textured_surfaces
                or self.stored.record["record"]["spec"]["kind"] == "family"
            ):
                yield label, self.rendered_scene(label, change)

    def exposed(
        self, radiance: Sequence[np.ndarray], sensor: Sensor, rig: Rig | None = None
    ) -> Pair:
        """The pair, exposed from `radiance` with the sample's seed."""
        seed = self.shot.record["seed"]
        photos = sensor.expose_rig(
            radiance, rig=rig or self.rig, lens=self.shot.lens, seed=seed
        )
        return dataclasses.replace(
            load_pair(self.stored, LENS), im0=photos[0].image, im1=photos[1].image
        )

    def rendered_second(self, label: str, sensor: Sensor) -> Pair:
        """The pair with another second image, of the rig and the lens of `sensor`."""
        rig = sensor.misalign(self.stored.rig)
        lenses = sensor.lenses(rig, self.shot.lens)
        seed = derived_seed(
            self.shot.record["seed"], "second camera"
        )  # not the noise of the first camera
        images = self._kept(
            label, lambda: self._rendered(scene_of(self.stored), rig, lenses, seed)
        )
        return self.exposed([self.radiance[0], images[1]], sensor, rig)

    def rendered_scene(
        self, label: str, change: Callable[[StoredSample], Scene]
    ) -> Pair:
        """The pair of a changed scene, by the same cameras."""
        lenses = self.sensor.lenses(self.rig, self.shot.lens)
        seed = self.shot.record["seed"]
        images = self._kept(
            label, lambda: self._rendered(change(self.stored), self.rig, lenses, seed)
        )
        return self.exposed(images, self.sensor)

    def _rendered(
        self, scene: Scene, rig: Rig, lenses: Sequence[Lens], seed: int
    ) -> list[np.ndarray]:
        """Images with the samples per pixel and the sampler of the sample's own."""
        sampler = self.stored.record["record"]["sampler"]
        return render(
            scene,
            rig,
            lenses,
            self.shot.record["spp"],
            seed,
            denoise=True,
            sampler=sampler,
        )

    def _kept(self, label: str, make: Callable[[], list[np.ndarray]]) -> np.ndarray:
        file = (
            self.folder
            / label.strip("()").partition(";")[0].replace(" ", "-")
            / f"{self.stored.name}.npy"
        )
        if not file.exists():
            images = np.array(make())
            file.parent.mkdir(parents=True, exist_ok=True)
            np.save(file, images)
        return np.asarray(np.load(file))

    def _natural(self, camera: int) -> np.ndarray:
        return vignetting(self.rig.cameras[camera], Pinhole())

    def _mechanical(self, camera: int) -> np.ndarray:
        return vignetting(self.rig.cameras[camera], self.shot.lens) / self._natural(
            camera
        )


def scene_of(stored: StoredSample, **changes: Any) -> Scene:
    """The scene of a sample of one of the two recipes; `changes` are arguments of `random_scene`."""
    spec = stored.record["record"]["spec"]
    if spec["kind"] == "scene":
        return load_scene(spec["scene"])
    width, height = spec["drawn"]["width"], spec["drawn"]["height"]
    seed = int(generator(spec["seed"], "scene").integers(1 << 31))
    return random_scene(
        spec["scene"], seed, aspect=width / height, width=width, **changes
    )


def with_matte_surfaces(stored: StoredSample) -> Scene:
    """The scene with every material replaced by a diffuse one of the same colour; metal and glass become grey."""
    scene = scene_of(stored)
    materials = {
        name: lambert(_color(material), two_sided=True)
        for name, material in scene.materials.items()
    }
    return dataclasses.replace(scene, materials=materials)


def _color(material: Material) -> ColorValue:
    has_no_color = material.model in ("metal", "glass")
    return Color((0.5, 0.5, 0.5)) if has_no_color else material.base_color


def with_textured_surfaces(stored: StoredSample) -> Scene:
    """A random scene without plain walls, table tops and floors."""
    return scene_of(stored, plain_surfaces=False)


def under_even_light(stored: StoredSample) -> Scene:
    """The scene under a sky that is equally bright in all directions, in place of all lamps and windows."""
    spec = stored.record["record"]["spec"]
    scene = (
        scene_of(stored)
        if spec["kind"] == "scene"
        else scene_of(stored, own_lights=False)
    )
    return scene.lit_by(Sky(np.ones((4, 8, 3), dtype=np.float32)), lamps=False)


SCENES: dict[str, Callable[[StoredSample], Scene]] = {
    "gloss, clear coat, metal, sheen and glass": with_matte_surfaces,
    "plain walls, table tops and floors": with_textured_surfaces,
    "light from the side": under_even_light,
}
"""Changes of the scene, for which both images are rendered again."""


def arguments() -> argparse.Namespace:
    """The options."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--work", type=Path, default=Path("out/frozen"), help="folder of the datasets"
    )
    parser.add_argument(
        "--count",
        type=int,
        nargs=2,
        default=COUNTS,
        help="samples of bundled and of families",
    )
    return parser.parse_args()


def main() -> None:
    options = arguments()
    rows: list[dict[str, Any]] = []
    for name, count in zip(run.DATASETS, options.count, strict=True):
        if count == 0:
            continue
        work = options.work / "ablations" / name
        found: dict[str, list[Pair]] = {}
        samples = [
            each
            for each in Dataset(options.work / name)
            if each.record["record"]["scene"] != CLOSED
        ]
        for i, stored in enumerate(samples[:count]):
            for label, pair in Ablations(stored, work).pairs():
                found.setdefault(label, []).append(pair)
                print(f"{name}, sample {i + 1} of {count}: without {label}", flush=True)
        full = board_of(found["everything"], work)
        for label, pairs in found.items():
            board = full if label == "everything" else board_of(pairs, work, label)
            tau = agreement(full, board, metric=tables.METRIC).tau
            summary = {
                key: values[0]
                for key, values in summarize(
                    [pair_statistics(pair) for pair in pairs]
                ).items()
            }
            rows.append(
                {
                    "name": label,
                    "dataset": name,
                    "tau": f"{tau.value:.2f}",
                    "statistics": summary,
                }
            )
            print(f"{name} without {label}: tau-b {rows[-1]['tau']}", flush=True)
    run.publish("ablations", rows)


def board_of(pairs: Sequence[Pair], work: Path, label: str = "everything") -> Board:
    """The board of all methods on some pairs, kept in the work folder."""
    file = work / f"{label.replace(' ', '-').replace(',', '')}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    return run_benchmark(
        pairs, run.METHODS, protocol=run.PROTOCOL, regions=("nonocc",), save=file
    )


if __name__ == "__main__":
    main()
