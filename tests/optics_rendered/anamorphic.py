"""An anamorphic lens, as a newcomer would add it to `camera/lens.py`, and what the commands do with it.

`python -m tests.optics_rendered.anamorphic FOLDER` registers the lens, as its place in the union `RecipeLens` would,
runs the commands in FOLDER, and prints what came out as JSON.
"""

import contextlib
import io
import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np

from twinlens import camera
from twinlens.camera.aperture import FULL_DISK, NUMPY, Aperture
from twinlens.camera.lens import DIAMETER, SHAPE, ApertureLens
from twinlens.settings import Setting, Settings

FOCUS = Setting("Depth where it is sharp.", "metres", above=0)


@dataclass(frozen=True)
class Anamorphic(Settings, ApertureLens, noun="lens"):
    """A lens that focuses horizontal and vertical detail at two depths."""

    name: ClassVar[str] = "anamorphic"
    aperture_diameter: Annotated[float, DIAMETER]
    focus_x: Annotated[float, FOCUS]
    focus_y: Annotated[float, FOCUS]
    aperture: Annotated[Aperture, SHAPE] = FULL_DISK

    def through(self, x, y, ax, ay, xp=NUMPY):
        across, down = xp.constant(1 / self.focus_x), xp.constant(1 / self.focus_y)
        return (ax, ay, 0.0), (x - across * ax, y - down * ay, 1.0), 1.0


TEXT = "anamorphic:aperture_diameter=0.02,focus_x=2,focus_y=3.5"
LENS = Anamorphic(0.02, 2.0, 3.5)
RECIPE = """
seed = 11
count = {count}
scenes = ["tiny"]
width = 32
height = 24
spp = 1
denoise = false

[sensor]
mismatch = "consumer"

[[lenses]]
kind = "anamorphic"
aperture_diameter = {{ choice = [0.02] }}
focus_x = 2.0
focus_y = 3.5
aperture = {{ kind = "polygon", blades = 6 }}
"""


def register() -> None:
    """Make `Anamorphic` a lens of recipes, records and --lens. Other rooms must not have been imported yet."""
    lenses = camera.RecipeLens | Anamorphic
    camera.RecipeLens = camera.lens.RecipeLens = lenses


def run(*arguments: object) -> tuple[int, str]:
    """The exit code and what a command printed."""
    from twinlens import cli

    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(out):
        code = cli.run([str(argument) for argument in arguments])
    return code, out.getvalue()


def main(folder: Path) -> dict[str, object]:
    register()
    from tests.factory_recipes import write_recipe
    from twinlens.dataset import Dataset
    from twinlens.factory import remake
    from twinlens.scenes import load_scene

    recipe = write_recipe(folder, RECIPE, count=1)
    render = ["render", folder / "tiny", "--size", "32x24", "--spp", 1, "--lens"]
    rendered, generated = folder / "rendered", folder / "generated"
    polygon = ["--aperture", "polygon:6", "--mismatch", "focus_um=1"]
    codes = [
        run(*render, TEXT, *polygon, "-o", rendered),
        run("verify", rendered),
        run("generate", recipe, "-o", generated),
        run("verify", generated),
    ]
    maps = {}
    for path in (rendered, generated):
        sample = Dataset(path)[0]
        maps[f"{path.name}_depth"] = sample.truth(0).depth
        maps[f"{path.name}_blur"] = sample.lens(0).blur_circle_px(0)
    np.savez(folder / "maps.npz", **maps)
    stored = Dataset(generated)[0]
    record = json.loads((generated / stored.name / "sample.json").read_text())
    again = remake(record, load_scene(folder / "tiny"))
    return {
        "codes": codes,
        "fx": stored.rig.cameras[0].fx,
        "blur_is": record["conventions"]["blur_circle_px"],
        "lens": repr(stored.lens(0).lens),
        "same_again": bool((again.shots[0].images[0] == stored.lens(0).image(0)).all()),
    }


if __name__ == "__main__":
    print(json.dumps(main(Path(sys.argv[1]))))
