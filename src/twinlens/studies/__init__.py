"""Sweeps of one physical quantity, composed of the rooms below: what aperture, focus, baseline or noise do to stereo.

A study is one short file that ends in a `Study`; `STUDIES` lists them.
"""

from twinlens.studies import aperture, baseline, focal_length, focus, pinhole, radiometric, texture, window
from twinlens.studies.bootstrap import Interval, bootstrap, mean_of, paired_difference
from twinlens.studies.run import run_study
from twinlens.studies.study import Figure, Finding, Measured, Picture, Result, Setup, Stands, Study, sweep
from twinlens.studies.table import Column, Table, from_csv, to_csv

STUDIES: dict[str, Study] = {
    study.name: study
    for study in (
        aperture.STUDY,
        pinhole.STUDY,
        focus.STUDY,
        window.STUDY,
        baseline.STUDY,
        focal_length.STUDY,
        radiometric.STUDY,
        texture.STUDY,
    )
}

__all__ = [
    "STUDIES",
    "Column",
    "Figure",
    "Finding",
    "Interval",
    "Measured",
    "Picture",
    "Result",
    "Setup",
    "Stands",
    "Study",
    "Table",
    "bootstrap",
    "from_csv",
    "mean_of",
    "paired_difference",
    "run_study",
    "sweep",
    "to_csv",
]
