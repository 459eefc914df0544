"""Rigs in the calibration files of other programs. Never renders."""

from twinlens.calibrations.reading import read_rig as read_rig
from twinlens.calibrations.rig_files import NamedRig as NamedRig
from twinlens.calibrations.rig_tables import rig_table as rig_table
