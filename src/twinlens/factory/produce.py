"""From a spec to a sample: the scene found or made, the rig placed, the gates asked, the photographs taken.

spec -> scene -> rig -> truth -> gates -> lenses -> photographs -> gates -> Sample
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from twinlens.camera import Rig
from twinlens.dataset import Sample
from twinlens.errors import InputError
from twinlens.factory.draws import stream
from twinlens.factory.gates import Gates, Rejected, check_photographs, check_truth
from twinlens.factory.lenses import View, lens_from_table
from twinlens.factory.plan import SampleSpec, plan
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import make_sample
from twinlens.factory.settings import Settings, read_settings
from twinlens.rendering import ground_truth
from twinlens.scenes import Scene, bundled_scenes, load_scene, rig_from_table
from twinlens.scenes.table import At, Source

Progress = Callable[[float], None]
_SCENES_KEPT = 8


class Exhausted(Exception):  # noqa: N818  the run goes on without this sample
    """Every draw of a sample was turned away; `rejections` says why, `remedy` what in the recipe to change."""

    def __init__(self, index: int, rejections: list[dict[str, Any]], remedy: str) -> None:
        super().__init__(f"sample {index}: {len(rejections)} draws turned away; {rejections[-1]['found']}")
        self.index, self.rejections, self.remedy = index, rejections, remedy


def make(recipe: Recipe, index: int, progress: Progress | None = None) -> Sample:
    """The `index`-th sample of a recipe, in the first of its draws that passes the gates.

    Its record has the `spec`, and under `rejections` why the draws before were turned away. Raises Exhausted when all
    were, which a mistake in the recipe may cause as well as bad luck.
    """
    rejections: list[dict[str, Any]] = []
    remedy = ""
    for attempt in range(recipe.gates.attempts):
        spec = plan(recipe, index, attempt)
        find_scene(spec, recipe.folder)
        try:
            sample = produce(spec, recipe.folder, recipe.assets, recipe.gates, progress)
        except Rejected as turned:
            rejections.append({"attempt": attempt, "reason": turned.reason, "found": turned.found})
            remedy = turned.remedy
        except InputError as error:
            found = str(error).replace(f"{recipe.folder}/", "")  # a dataset names no place of this machine
            rejections.append({"attempt": attempt, "reason": "impossible draw", "found": found})
            remedy = "what the message names"
        else:
            return dataclasses.replace(sample, record={**sample.record, "rejections": rejections})
    raise Exhausted(index, rejections, remedy)


def produce(
    spec: SampleSpec,
    folder: Path = Path(),
    assets: Mapping[str, tuple[str, ...]] | None = None,
    gates: Gates | None = None,
    progress: Progress | None = None,
) -> Sample:
    """The sample of a spec; the same spec gives the same sample.

    Parameters
    ----------
    folder : Path
        Where scene files and `assets` (folders by their kind) are found: the recipe's own.
    gates : Gates, optional
        None asks no gate.

    Raises Rejected where a gate turns it away, and InputError for a spec that cannot be.
    """
    at = At(Source(Path("recipe.toml")))  # without its folder: messages are kept in the dataset
    settings = read_settings(spec.drawn, at)
    scene = _scene(spec, settings, folder, assets or {})
    rig = _rig(scene, settings, at)
    truths = ground_truth(scene, rig.nominal, sky_disparity=settings.sky_disparity)
    if gates is not None:
        check_truth(gates, scene, rig, truths, spec.ndisp)
    view = View(scene, rig.nominal.cameras[0], truths, spec.seed)
    sample = make_sample(
        scene,
        rig,
        [lens_from_table(table, view, at / "lenses" / k) for k, table in enumerate(settings.lenses)],
        spp=settings.spp,
        seed=spec.seed,
        sensor=settings.sensor,
        exposure=settings.exposure,
        diffraction=settings.diffraction,
        sky_disparity=settings.sky_disparity,
        keep_radiance="radiance" in spec.keep,
        truths=truths,
        progress=progress,
    )
    if gates is not None:
        check_photographs(gates, sample, settings.sensor)
    return dataclasses.replace(sample, ndisp=spec.ndisp, record={**sample.record, "spec": spec.plain()})


def _rig(scene: Scene, settings: Settings, at: At) -> Rig:
    """The recipe's rig where the jitter puts it. The scene's own rig is the recipe's where that says nothing."""
    moved = scene.at(scene.world_from_left @ settings.jitter)
    table = settings.rig or scene.rig or {}
    return rig_from_table(table, moved, settings.width, settings.height, at / "rig")


def _scene(spec: SampleSpec, settings: Settings, folder: Path, assets: Mapping[str, tuple[str, ...]]) -> Scene:
    found = find_scene(spec, folder)
    if found is not None:
        return found
    from twinlens.scenes.families import random_scene

    return random_scene(
        spec.scene,
        int(stream(spec.seed, "scene").integers(1 << 31)),
        assets=_assets(folder, tuple(sorted(assets.items()))),
        depth_range=settings.depth_range,
        object_count=settings.object_count,
        aspect=settings.width / settings.height,
        width=settings.width,
    )


def find_scene(spec: SampleSpec, folder: Path) -> Scene | None:
    """The scene of a spec that names one; None where it is made anew. A file that is no scene is nobody's bad luck."""
    if spec.kind != "scene":
        return None
    return _loaded(spec.scene if spec.scene in bundled_scenes() else str(folder / spec.scene))


@functools.lru_cache(_SCENES_KEPT)
def _loaded(name_or_path: str) -> Scene:
    """A scene of a file, kept: the renderer keeps what it built of it as long as it lives."""
    return load_scene(name_or_path)


@functools.lru_cache(1)
def _assets(folder: Path, given: tuple[tuple[str, tuple[str, ...]], ...]) -> Any:
    from twinlens.scenes.families import Assets

    return Assets.from_folders(**{kind: [folder / name for name in names] for kind, names in given})
