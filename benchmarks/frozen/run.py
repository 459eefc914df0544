"""The frozen benchmark: render its dataset, run its matchers, and write the published page.

    python benchmarks/frozen/run.py [--work out/frozen]

`benchmark.toml` in this folder defines the benchmark. The dataset and the board are kept in the work folder,
and the next run reuses them. README.md and board.json in this folder are the published results. The same seed gives the
same images on one backend; on another backend their noise differs.
"""

import argparse
import json
import tomllib
from pathlib import Path
from typing import Any

import evidence
import table

from twinlens.camera import Pinhole, ThinLens
from twinlens.cli.boards import run_board
from twinlens.dataset import Dataset, Manifest, Row, motorcycle, write_manifest, write_sample
from twinlens.factory import default_rig, make_sample
from twinlens.matching import parse_methods
from twinlens.optics import middle_focus
from twinlens.rendering import backend
from twinlens.scenes import Scene, load_scene
from twinlens.scoring import DatasetPairs, load_pair
from twinlens.sensor import Mismatch, Sensor

HERE = Path(__file__).parent


def render_sample(folder: Path, name: str, scene: Scene, definition: dict[str, Any], *, unequal_gain: bool) -> Row:
    """Render a scene through both lenses, or through the pinhole only, with another gain of the right camera."""
    rig = default_rig(scene, definition["width"], definition["height"])
    wide = ThinLens(definition["aperture_of_baseline"] * rig.baseline(), middle_focus(*scene.depth_range))
    sensor = Sensor.preset(definition["sensor"], vignetting=False)
    if unequal_gain:
        sensor = sensor.replace(mismatch=Mismatch(gain=definition["mismatch"]["gain"]))
    lenses = (Pinhole(),) if unequal_gain else (Pinhole(), wide)
    sample = make_sample(scene, rig, lenses, spp=definition["spp"], seed=definition["seed"], sensor=sensor)
    return Row(name, write_sample(folder / name, sample, overwrite=True), {"scene": scene.name})


def render(folder: Path, definition: dict[str, Any]) -> None:
    """Render all samples and then write the manifest, so that a folder with a manifest is complete."""
    jobs = [(name, name, False) for name in definition["scenes"]]
    mismatched = definition["mismatch"]["scene"]
    jobs.append((f"{mismatched}-gain", mismatched, True))
    rows = []
    for name, scene, unequal_gain in jobs:
        print(f"rendering {name}", flush=True)
        rows.append(render_sample(folder, name, load_scene(scene), definition, unequal_gain=unequal_gain))
    write_manifest(folder, Manifest(tuple(rows), recipe=definition, seed=definition["seed"]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--work", type=Path, default=Path("out/frozen"), help="folder of the dataset and the board")
    options = parser.parse_args()
    definition = tomllib.loads((HERE / "benchmark.toml").read_text())
    dataset, output = options.work / "dataset", options.work / "board"
    if not (dataset / "dataset.json").exists():
        render(dataset, definition)
    pairs = DatasetPairs(Dataset(dataset), [motorcycle()])
    print(f"matching {len(pairs)} pairs with {len(definition['methods'])} methods", flush=True)
    board = run_board(
        pairs, parse_methods(definition["methods"]), output,
        (definition["protocol"],), tuple(definition["regions"]), title=definition["title"],
    )  # fmt: skip
    statistics = {pair.name: (evidence.correlation(pair), evidence.offset(pair)) for pair in map(load_pair, pairs)}
    board_file = json.loads((output / "board.json").read_text())
    (HERE / "board.json").write_text(json.dumps(board_file, separators=(",", ":")) + "\n")
    findings = (HERE / "findings.md").read_text()
    (HERE / "README.md").write_text(table.page(board, definition, backend().variant, findings, statistics))
    print(f"{HERE / 'README.md'}, {(output / 'index.html').resolve().as_uri()}")


if __name__ == "__main__":
    main()
