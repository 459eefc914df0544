"""Make the figures of docs/study_results.md: `python docs/studies.py [--keep] [NAME ...]`.

Each study runs with its defaults into out/studies/NAME, one to four minutes each. `--keep` reuses existing tables there
instead. One figure of each study is written to docs/studies/NAME.png with a reduced palette.
"""

import io
import sys
from pathlib import Path

import numpy as np
from PIL import Image

from twinlens.report.plots import draw, encode
from twinlens.report.study_files import write_study
from twinlens.studies import STUDIES, from_csv, run_study

HERE = Path(__file__).parent
BUILD = HERE.parent / "out" / "studies"
SHOWN = {
    "aperture": "fixed",
    "pinhole": "sharpness",
    "focus": "map",
    "defocus": "distance",
    "window": "window",
    "baseline": "depth-error",
    "focal-length": "wrong",
    "radiometric": "radiometric",
    "texture": "contrast",
    "active": "ambient",
}
WIDEST, COLOURS = 1000, 160


def main(names: list[str], keep: bool) -> None:
    """Write docs/studies/NAME.png for these studies, or for all; `keep` reuses existing tables."""
    for name in names or STUDIES:
        study, folder = STUDIES[name], BUILD / name
        if not (keep and (folder / "table.csv").exists()):
            write_study(folder, run_study(study))
        table = from_csv((folder / "table.csv").read_text(), study.all_columns)
        figure = next(figure for figure in study.figures if figure.name == SHOWN[name])
        small(encode(draw(figure, table), "png"), HERE / "studies" / f"{name}.png")


def small(png: bytes, path: Path) -> None:
    """Save the image at most `WIDEST` pixels wide, in `COLOURS` colours."""
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    scale = min(1.0, WIDEST / picture.width)
    size = tuple(int(side) for side in np.rint(scale * np.array(picture.size)))
    path.parent.mkdir(exist_ok=True)
    picture.resize(size, Image.Resampling.LANCZOS).quantize(
        COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=4
    ).save(path, optimize=True)


if __name__ == "__main__":
    main([word for word in sys.argv[1:] if word != "--keep"], keep="--keep" in sys.argv)
