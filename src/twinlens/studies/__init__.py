"""Studies: sweeps of one physical quantity, such as aperture, focus or baseline, and its effect on stereo matching.

A study is one module or package that defines a `Study`; `STUDIES` lists the included ones.
"""

from twinlens.studies.advice import advice as advice
from twinlens.studies.findings import (
    FAILS as FAILS,
    HOLDS as HOLDS,
    OPEN as OPEN,
    Finding as Finding,
    Needs as Needs,
    SeedSupport as SeedSupport,
    bounded as bounded,
    compared as compared,
    predicted as predicted,
)
from twinlens.studies.intervals import (
    mean_of as mean_of,
    paired_difference as paired_difference,
)
from twinlens.studies.model import (
    Figure as Figure,
    Measured as Measured,
    Picture as Picture,
    Result as Result,
    Setup as Setup,
    Study as Study,
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
    to_csv as to_csv,
)
