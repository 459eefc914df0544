"""Sweeps of one physical quantity, composed of the rooms below: what aperture, focus, baseline or noise do to stereo.

A study is one short file that ends in a `Study`; `STUDIES` lists those that come along.
"""

from twinlens.studies.bootstrap import Interval, bootstrap, log_slope, mean_of, over_scenes, paired_difference
from twinlens.studies.catalogue import STUDIES, find_study, study
from twinlens.studies.model import Figure, Finding, Measured, Picture, Result, Setup, Stands, Study, sweep
from twinlens.studies.run import run_study
from twinlens.studies.stage import Stage, stream
from twinlens.studies.table import Column, Table, from_csv, to_csv

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
    "Stage",
    "Stands",
    "Study",
    "Table",
    "bootstrap",
    "find_study",
    "from_csv",
    "log_slope",
    "mean_of",
    "over_scenes",
    "paired_difference",
    "run_study",
    "stream",
    "study",
    "sweep",
    "to_csv",
]
