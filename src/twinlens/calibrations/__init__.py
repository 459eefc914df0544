"""Rigs in the calibration files of other programs. Never renders."""

from twinlens.calibrations.reading import (
    doubt_of_lengths as doubt_of_lengths,
    read_rig as read_rig,
    warn_of_lengths as warn_of_lengths,
)
from twinlens.calibrations.rig_files import NamedRig as NamedRig
from twinlens.calibrations.rig_tables import rig_table as rig_table
