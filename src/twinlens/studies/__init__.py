"""Studies: sweeps of one physical quantity, such as aperture, focus or baseline, and its effect on stereo matching.

A study is one module or package that defines a `Study`; `STUDIES` lists the included ones.
"""

from twinlens.studies.model import (
    Figure as Figure,
    Finding as Finding,
    Measured as Measured,
    Picture as Picture,
    Result as Result,
    SeedSupport as SeedSupport,
    Setup as Setup,
    Study as Study,
    compared as compared,
    predicted as predicted,
    sweep as sweep,
)
from twinlens.studies.run import (
    STUDIES as STUDIES,
    find_study as find_study,
    run_study as run_study,
    study as study,
)
from twinlens.studies.stage import Stage as Stage, stream as stream
from twinlens.studies.table import (
    Column as Column,
    Table as Table,
    from_csv as from_csv,
    mean_of as mean_of,
    paired_difference as paired_difference,
    to_csv as to_csv,
)
