"""From a spec to a sample: the scene found or made, the rig placed, the gates asked, the photographs taken.

spec -> scene -> rig -> truth -> gates -> lenses -> photographs -> gates -> Sample
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twinlens.camera import Rig
from twinlens.dataset import Sample
from twinlens.errors import BackendError, FileError, InputError
from twinlens.factory.gates import Gates, Rejected, check_photographs, check_truth
from twinlens.factory.lenses import View
from twinlens.factory.plan import SampleSpec, is_fixed, plan
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import make_sample
from twinlens.factory.settings import Settings, make_lenses, make_sensor
from twinlens.factory.sources import Sources
from twinlens.rendering import check_lens_supported, ground_truth
from twinlens.scenes import Scene, rig_from_table
from twinlens.schema import read
from twinlens.seeds import generator

Progress = Callable[[float], None]
_FILE = Path("recipe.toml")  # without its folder: messages are recorded in the dataset


class Exhausted(Exception):  # noqa: N818  the run goes on without this sample
    """Every draw of a sample was turned away; `rejections` says why, `remedy` what in the recipe to change."""

    def __init__(self, index: int, rejections: list[dict[str, Any]], remedy: str) -> None:
        super().__init__(f"sample {index}: {len(rejections)} draws turned away; {rejections[-1]['found']}")
        self.index, self.rejections, self.remedy = index, rejections, remedy


def make(recipe: Recipe, index: int, progress: Progress | None = None) -> Sample:
    """The `index`-th sample of a recipe, in the first of its draws that passes the gates.

    Its record has the `spec`, under `rejections` why the draws before were turned away, and under `sources_sha256` what
    the files held that the recipe leads to. Raises Exhausted when all were, which a mistake in the recipe may cause as
    well as bad luck (where nothing is left to chance, the first draw tells), and FileError for a file that cannot be
    read, or that holds something else than when the recipe's first sample was made.
    """
    rejections: list[dict[str, Any]] = []
    remedy = ""
    for attempt in range(recipe.gates.attempts):
        spec = plan(recipe, index, attempt)
        _find_scene(spec, recipe.sources)  # one that cannot be read is nobody's bad luck
        try:
            sample = produce(spec, recipe.sources, recipe.gates, progress)
            _find_scene(spec, recipe.sources)  # a scene.xml was opened again to render it
        except Rejected as turned:
            rejections.append({"attempt": attempt, "reason": turned.reason, "found": turned.found})
            remedy, by_chance = turned.remedy, turned.noisy
        except FileError:
            raise
        except InputError as error:
            found = str(error).replace(f"{recipe.file.parent}/", "")  # a dataset names no place of this machine
            rejections.append({"attempt": attempt, "reason": "impossible draw", "found": found})
            remedy, by_chance = "what the message names", False
        else:
            more = {"rejections": rejections, "sources_sha256": recipe.sources.digest}
            return dataclasses.replace(sample, record={**sample.record, **more})
        if not by_chance and is_fixed(recipe):
            break
    raise Exhausted(index, rejections, remedy)


def produce(
    spec: SampleSpec, sources: Sources | None = None, gates: Gates | None = None, progress: Progress | None = None
) -> Sample:
    """The sample of a spec; the same spec and files give the same sample.

    Parameters
    ----------
    sources : Sources, optional
        The files of its recipe; without them bundled scenes alone are found, and scene files by their path.
    gates : Gates, optional
        None asks no gate.

    Raises Rejected where a gate turns it away, FileError for a file that cannot be read, and InputError for a spec that
    cannot be.
    """
    sources = Sources() if sources is None else sources
    settings = read(Settings, dict(spec.drawn), _FILE)
    scene = _scene(spec, settings, sources)
    rig = _rig(scene, settings)
    truths = ground_truth(scene, rig.nominal, sky_disparity=settings.sky_disparity)
    if gates is not None:
        check_truth(gates, scene, rig, truths, spec.ndisp)
    sensor = make_sensor(settings, _FILE)
    view = View(scene, rig.nominal.cameras[0], truths, spec.seed)
    sample = make_sample(
        scene,
        rig,
        make_lenses(settings, view, _FILE, sources.file),
        spp=settings.spp,
        seed=spec.seed,
        sensor=sensor,
        exposure=None if settings.exposure is None else settings.exposure.exposure(),
        diffraction=settings.diffraction,
        sky_disparity=settings.sky_disparity,
        keep_radiance="radiance" in spec.keep,
        truths=truths,
        progress=progress,
    )
    if gates is not None:
        check_photographs(gates, sample, sensor)
    return dataclasses.replace(sample, ndisp=spec.ndisp, record={**sample.record, "spec": spec.plain()})


def check_backend(recipe: Recipe, index: int) -> None:
    """Raise BackendError where the backend of this process can photograph through the lenses of no draw of a sample.

    No scene is opened for it: what cannot be judged without one is told when the sample is made.
    """
    refusal = None
    for attempt in range(1 if is_fixed(recipe) else recipe.gates.attempts):
        try:
            settings = read(Settings, dict(plan(recipe, index, attempt).drawn), _FILE)
            for lens in make_lenses(settings, None, _FILE, recipe.sources.file):
                check_lens_supported(lens)
        except BackendError as error:
            refusal = error
        except InputError:  # an impossible draw, of which the dataset keeps a record
            return
        else:
            return
    if refusal is not None:
        raise refusal


def _rig(scene: Scene, settings: Settings) -> Rig:
    """The recipe's rig where the jitter puts it. The scene's own rig is the recipe's where that says nothing."""
    moved = scene.at(scene.world_from_left @ settings.scene.jitter.pose())
    table = settings.rig or scene.rig or {}
    return rig_from_table(table, moved, settings.width, settings.height, _FILE, "rig")


def _scene(spec: SampleSpec, settings: Settings, sources: Sources) -> Scene:
    found = _find_scene(spec, sources)
    if found is not None:
        return found
    from twinlens.families import random_scene

    return random_scene(
        spec.scene,
        int(generator(spec.seed, "scene").integers(1 << 31)),
        assets=sources.families_assets,
        depth_range=settings.scene.depth_range,
        object_count=settings.scene.object_count,
        aspect=settings.width / settings.height,
        width=settings.width,
    )


def _find_scene(spec: SampleSpec, sources: Sources) -> Scene | None:
    """The scene of a spec that names one; None where it is made anew."""
    return sources.scene(spec.scene) if spec.kind == "scene" else None
