"""Studies: sweeps of one physical quantity, such as aperture, focus or baseline, and its effect on stereo matching.

A study is one module or package that defines a `Study`; `STUDIES` lists the included ones.
"""

from twinlens.studies.model import (
    Figure,
    Finding,
    Measured,
    Picture,
    Result,
    SeedSupport,
    Setup,
    Study,
    compared,
    predicted,
    sweep,
)
from twinlens.studies.run import STUDIES, find_study, run_study, study
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Table, from_csv, mean_of, paired_difference, to_csv

__all__ = [
    "STUDIES",
    "Column",
    "Figure",
    "Finding",
    "Measured",
    "Picture",
    "Result",
    "SeedSupport",
    "Setup",
    "Stage",
    "Study",
    "Table",
    "compared",
    "find_study",
    "from_csv",
    "mean_of",
    "paired_difference",
    "predicted",
    "run_study",
    "stream",
    "study",
    "sweep",
    "to_csv",
]
