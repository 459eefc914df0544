"""The near infrared reflectance that twinlens takes from a colour, against measured spectra of materials.

    pip download --no-deps earthlib==1.1.0 && unzip earthlib-1.1.0-*.whl "earthlib/data/*"
    python benchmarks/bench_nir.py earthlib/data [--write]

The library (earthlib, MIT licence) has spectra from 400 to 2450 nm of soils (ICRAF-ISRIC), of roofs, roads, paints,
wood and litter (measured with ASD field spectrometers), and simulated canopies (PROSAIL). The colour of a spectrum is
its linear sRGB under a spectrum of equal energy, where white is (1, 1, 1); its near infrared reflectance is the mean
from 800 to 900 nm. Nothing was fitted to them.

`--write` writes the table to benchmarks/nir.md.
"""

import argparse
import csv
import re
from pathlib import Path

import numpy as np

from twinlens.rendering.backends import mitsuba
from twinlens.scenes.bands import nir_reflectance

PAGE = Path(__file__).with_name("nir.md")
TEXT = """# Near infrared reflectance by rule

`python benchmarks/bench_nir.py FOLDER --write`: the rule of docs/bands.md and measured spectra of earthlib 1.1.0.
Medians of the spectra; errors are medians of the absolute value. The rule was not fitted to them.

{table}
The rule is too bright for soils, wood, roofs and roads, where the largest channel alone is nearer. For greenery the
largest channel is far too dark. The library has no textiles and no plastics.
"""
GROUPS = {
    "greenery, simulated": ("canopy",),
    "bark, litter": ("bark", "litter", "npv"),
    "wood": ("wood", "wood_shingle"),
    "soil, dirt, sand": ("soil", "dirt", "sand"),
    "paint": ("paint",),
    "clay and concrete tiles": ("tile", "concrete_tile"),
    "roads, pavements, gravel": (
        "road",
        "sidewalk",
        "parking_lot",
        "driveway",
        "asphalt",
        "gravel",
    ),
    "roof shingles of asphalt": ("comp_shingle",),
}
_RGB_FROM_XYZ = np.linalg.inv(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
_WHITE = np.array([0.9505, 1.0, 1.089])


def spectra(folder: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Wavelengths (W,) in nm, reflectances (N, W), and the kinds (N,) of material."""
    header = (folder / "spectra.sli.hdr").read_text()
    values = re.search(r"wavelength = \{([^}]*)\}", header)
    assert values is not None
    wavelengths = 1e3 * np.array(values[1].split(","), dtype=np.float64)  # micrometres
    reflectances = np.fromfile(folder / "spectra.sli", dtype="<f4").reshape(
        -1, len(wavelengths)
    )
    with (folder / "spectra.csv").open() as file:
        kinds = np.array([row["LEVEL_3"] for row in csv.DictReader(file)])
    return wavelengths, reflectances.astype(np.float64), kinds


def colours(wavelengths: np.ndarray, reflectances: np.ndarray) -> np.ndarray:
    """Linear sRGB (N, 3)."""
    grid = np.arange(400.0, 781.0, 5.0)
    matching = np.array(
        [
            [np.ravel(each)[0] for each in mitsuba().cie1931_xyz(float(nm))]
            for nm in grid
        ]
    )
    seen = np.array([np.interp(grid, wavelengths, each) for each in reflectances])
    return np.maximum(
        seen @ (matching / matching.sum(axis=0)) * _WHITE @ _RGB_FROM_XYZ.T, 0
    )


def table(folder: Path) -> str:
    wavelengths, reflectances, kinds = spectra(folder)
    rgb = colours(wavelengths, reflectances)
    true = reflectances[:, (wavelengths > 799) & (wavelengths < 901)].mean(axis=1)
    rule, largest = nir_reflectance(rgb), rgb.max(axis=1)
    lines = [
        "| spectra | number | largest channel | NIR, measured | NIR, rule | error, rule | error, largest channel |",
        "| --- | --- | --- | --- | --- | --- | --- |",
    ]
    for name, members in GROUPS.items():
        own = np.isin(kinds, members)
        errors = (
            np.median(np.abs(found[own] - true[own])) for found in (rule, largest)
        )
        levels = (np.median(values[own]) for values in (largest, true, rule))
        cells = [
            name,
            str(own.sum()),
            *(f"{value:.2f}" for value in (*levels, *errors)),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    made = table(options.folder)
    print(made)
    if options.write:
        PAGE.write_text(TEXT.format(table=made))


if __name__ == "__main__":
    main()
