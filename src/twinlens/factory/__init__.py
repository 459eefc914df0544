"""Samples from a recipe or a scene: the only package that joins scenes, rendering, sensor and dataset."""

from twinlens.factory.generate import (
    Estimate as Estimate,
    Outcome as Outcome,
    estimate as estimate,
    generate as generate,
)
from twinlens.factory.plan import plan as plan
from twinlens.factory.produce import (
    make as make,
    under_sky as under_sky,
)
from twinlens.factory.recipe import (
    read_recipe as read_recipe,
    recipe_from_table as recipe_from_table,
)
from twinlens.factory.rectified import (
    rectified_sample as rectified_sample,
    sources_of as sources_of,
)
from twinlens.factory.remake import remake as remake
from twinlens.factory.sample import (
    Shoot as Shoot,
    add_sample as add_sample,
    check_common_view as check_common_view,
    default_rig as default_rig,
    make_sample as make_sample,
)
from twinlens.factory.workers import (
    dask_cluster as dask_cluster,
    in_process as in_process,
    usual_engine as usual_engine,
    worker_processes as worker_processes,
)
