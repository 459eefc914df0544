"""The frozen benchmark: renders its dataset, runs its matchers, and writes the published table.

    python benchmarks/frozen/run.py [--work out/frozen]

`benchmark.toml` beside this file says everything that decides the result. The dataset and the board with its page stay
in the work folder, and what is there already is not made again; README.md and board.json beside this file are what is
published. The same seed gives the same photographs on one backend; another backend, other noise.
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
from twinlens.optics import middle_focus
from twinlens.rendering import backend
from twinlens.scenes import Scene, load_scene
from twinlens.scoring import DatasetPairs, load_pair, named_methods
from twinlens.sensor import Mismatch, Sensor

HERE = Path(__file__).parent


def render_sample(folder: Path, name: str, scene: Scene, definition: dict[str, Any], *, dull_right: bool) -> Row:
    """One scene through both lenses; or through the pinhole alone, with a right eye of another gain."""
    rig = default_rig(scene, definition["width"], definition["height"])
    wide = ThinLens(definition["aperture_of_baseline"] * rig.baseline(), middle_focus(*scene.depth_range))
    sensor = Sensor.preset(definition["sensor"])
    if dull_right:
        sensor = sensor.replace(mismatch=Mismatch(gain=definition["mismatch"]["gain"]))
    lenses = (Pinhole(),) if dull_right else (Pinhole(), wide)
    sample = make_sample(scene, rig, lenses, spp=definition["spp"], seed=definition["seed"], sensor=sensor)
    return Row(name, write_sample(folder / name, sample, overwrite=True), {"scene": scene.name})


def render(folder: Path, definition: dict[str, Any]) -> None:
    """Every sample of the dataset, and then its manifest: a folder with a manifest is whole."""
    jobs = [(name, name, False) for name in definition["scenes"]]
    mismatched = definition["mismatch"]["scene"]
    jobs.append((f"{mismatched}-gain", mismatched, True))
    rows = []
    for name, scene, dull_right in jobs:
        print(f"rendering {name}", flush=True)
        rows.append(render_sample(folder, name, load_scene(scene), definition, dull_right=dull_right))
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
        pairs, named_methods(definition["methods"]), output,
        (definition["protocol"],), tuple(definition["regions"]), title=definition["title"],
    )  # fmt: skip
    seen = {pair.name: (evidence.correlation(pair), evidence.offset(pair)) for pair in map(load_pair, pairs)}
    board_file = json.loads((output / "board.json").read_text())
    (HERE / "board.json").write_text(json.dumps(board_file, separators=(",", ":")) + "\n")
    findings = (HERE / "findings.md").read_text()
    (HERE / "README.md").write_text(table.page(board, definition, backend().variant, findings, seen))
    print(f"{HERE / 'README.md'}, {(output / 'index.html').resolve().as_uri()}")


if __name__ == "__main__":
    main()
