"""Depth from stereo, focus, defocus, dual pixels and a light field of one scene, scored by the same function.

    python benchmarks/bench_depth_cues.py [--scenes cards,tabletop] [--write]

All methods compute the map of the same view. Maps of inverse depth are converted to the disparity of the stereo pair,
fx B / z, and scored over the pixels visible in both of its views. Every lens has the same aperture, and images
of a method have one exposure and get the same white noise. `--write` writes the table to benchmarks/depth_cues.md.
"""

import argparse
from pathlib import Path

import numpy as np

import twinlens as tl

SIZE, FOV, APERTURE, NOISE, SIDE, STEPS = (160, 120), 50.0, 0.03, 0.02, 11, 64
SPP = 256
PAGE = Path(__file__).with_name("depth_cues.md")
HEAD = """# Depth from stereo, focus, defocus and dual pixels

`python benchmarks/bench_depth_cues.py --write`. One view of each scene, 160x120; lenses with an aperture of 30 mm, and
white noise of 2 % of the mean in every image. Stereo has two such lenses at the scene's baseline. Errors are of the
disparity of this baseline, over pixels visible in both of its views; unknown pixels count as wrong in `totbad`. The
last column is the median error of the depth of known pixels. Windows are 11x11.

"""
COLUMNS = (
    "scene",
    "method",
    "totbad1.0 %",
    "totbad2.0 %",
    "avgerr px",
    "depth error mm",
)


def grey(image: np.ndarray) -> np.ndarray:
    return np.asarray(image, np.float64).mean(axis=-1)


def samples(lens, parts=None):
    points, shares = tl.aperture_points(lens, parts)
    return [tl.ApertureSamples(points, share, lens.vergence) for share in shares]


class View:
    """A scene's rig, and its images with noise."""

    def __init__(self, name: str) -> None:
        self.scene = tl.load_scene(name)
        self.camera = tl.Camera.from_fov(*SIZE, FOV)
        self.rig = tl.Rig.stereo(
            self.camera, self.scene.baseline, world_from_left=self.scene.world_from_left
        )
        self.left = tl.Rig([self.camera], [self.scene.world_from_left])
        self.truth = tl.ground_truth(self.scene, self.rig)[0]
        self.near, self.far = self.scene.depth_range
        self.seed = 0

    def focus(self, share: float) -> float:
        """The vergence from the far (0) to the near end (1)."""
        return (1 - share) / self.far + share / self.near

    def lens(self, share: float) -> tl.ThinLens:
        return tl.ThinLens(APERTURE, 1 / self.focus(share))

    def noisy(self, images):
        """Grey images with a common mean of 1, and noise."""
        self.seed += 1
        random, pictures = (
            np.random.default_rng(self.seed),
            np.array([grey(image) for image in images]),
        )
        return pictures / pictures.mean() + NOISE * random.standard_normal(
            pictures.shape
        )

    def images(self, lens, rig=None, parts=None):
        self.seed += 1
        return tl.render(
            self.scene, rig or self.left, lens, SPP, self.seed, parts=parts
        )

    def defocus(self, images, apertures):
        found = tl.inverse_depth_from_defocus(
            self.noisy(images), apertures, self.camera.fx, 0.9 * self.near, 1.1 * self.far, steps=STEPS,
            block_size=SIDE,
        )  # fmt: skip
        return self.camera.fx * self.scene.baseline * found

    def maps(self):
        """(method, disparity) of every method."""
        middle, ndisp = (
            self.lens(0.5),
            16
            * int(np.ceil(1.1 * self.camera.fx * self.scene.baseline / self.near / 16)),
        )
        pair = self.noisy(self.images(middle, self.rig)).astype(np.float32)
        for method in ("zncc", "sgm"):
            yield (
                f"stereo, `{method}`",
                tl.match(*pair, method=method, num_disparities=ndisp),
            )
        shares = np.linspace(0, 1, 9)
        stack, lenses = (
            [self.images(self.lens(share))[0] for share in shares],
            [self.lens(share) for share in shares],
        )
        sharpest = tl.inverse_depth_from_focus(
            self.noisy(stack),
            [each.vergence for each in lenses],
            block_size=SIDE,
            neighbours=2,
        )
        yield "stack of 9, sharpest", self.camera.fx * self.scene.baseline * sharpest
        yield (
            "stack of 9, maximum likelihood",
            self.defocus(stack, [samples(each)[0] for each in lenses]),
        )
        ends = [0, len(shares) - 1]
        yield (
            "two focus distances",
            self.defocus(
                [stack[k] for k in ends], [samples(lenses[k])[0] for k in ends]
            ),
        )
        halves = self.images(middle, parts=tl.Dual())[0]
        yield "dual pixels", self.defocus(halves, samples(middle, tl.Dual()))
        yield "light field 3x3", self.defocus(*self.light_field())

    def light_field(self):
        """Pinholes on the aperture, with principal points that move the focus to the middle."""
        step, vergence = APERTURE / 3, self.focus(0.5)
        places = [(x * step, y * step) for y in (-1, 0, 1) for x in (-1, 0, 1)]
        images = []
        for x, y in places:
            shift = self.camera.fx * vergence * np.array((x, y))
            camera = self.camera.replace(
                cx=self.camera.cx + shift[0], cy=self.camera.cy + shift[1]
            )
            pose = self.scene.world_from_left.copy()
            pose[:3, 3] += pose[:3, :3] @ (x, y, 0)
            images.append(self.images(tl.Pinhole(), tl.Rig([camera], [pose]))[0])
        return images, [
            tl.ApertureSamples([place], vergence=vergence) for place in places
        ]


def row(view: View, method: str, disparity: np.ndarray) -> str:
    truth = view.truth
    found = disparity.astype(np.float32)
    scores = tl.evaluate(found, truth.disparity, mask_nonocc=truth.visible).nonocc
    known = (
        np.isfinite(found) & (found > 0) & truth.visible & np.isfinite(truth.disparity)
    )
    depth = view.camera.fx * view.scene.baseline / found[known]
    error = 1e3 * np.median(np.abs(depth - truth.depth[known]))
    numbers = [f"{scores[name]:.1f}" for name in ("totbad1.0", "totbad2.0")]
    return f"| {view.scene.name} | {method} | {' | '.join(numbers)} | {scores['avgerr']:.2f} | {error:.1f} |"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scenes", default="cards,tabletop", help="Names of bundled scenes."
    )
    parser.add_argument(
        "--write",
        action="store_true",
        help="Write the table to benchmarks/depth_cues.md.",
    )
    arguments = parser.parse_args()
    lines = [
        f"| {' | '.join(COLUMNS)} |",
        "| --- | --- |" + " ---: |" * (len(COLUMNS) - 2),
    ]
    print("\n".join(lines))
    for name in arguments.scenes.split(","):
        view = View(name)
        for method, disparity in view.maps():
            lines.append(row(view, method, disparity))
            print(lines[-1], flush=True)
    if arguments.write:
        PAGE.write_text(HEAD + "\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
