"""Makes a sample from its spec.

spec -> scene -> rig -> objects -> truth -> gates -> lenses -> photographs -> gates -> Sample
"""

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample
from twinlens.dataset.lens_labels import label_of_table
from twinlens.dataset.record import plain
from twinlens.errors import FileError, InputError, counted, located
from twinlens.factory.doubts import warn_of_doubts, warn_of_wide_view
from twinlens.factory.gates import Rejected, check_photographs, check_truth
from twinlens.factory.ledger import Failure
from twinlens.factory.lenses import View
from twinlens.factory.objects import check_seen, with_objects
from twinlens.factory.overlap import check_overlap
from twinlens.factory.plan import SampleSpec, has_fixed_size, is_fixed, plan
from twinlens.factory.recipe import Recipe
from twinlens.factory.sample import make_sample
from twinlens.factory.settings import (
    ANY_SCENE,
    RecipeSettings,
    SkyTable,
    make_lenses,
    sensor_for,
)
from twinlens.factory.sources import Sources
from twinlens.families import random_scene
from twinlens.rendering import (
    Progress,
    check_lit,
    check_still,
    forget_kernels,
    ground_truth,
)
from twinlens.scenes import Scene, Sky
from twinlens.scenes.bands import NIR_SHARES, in_band
from twinlens.schema import read
from twinlens.seeds import generator
from twinlens.sensor import Sensor


class Exhausted(Exception):  # noqa: N818  the run continues without this sample
    """Every draw of a sample was rejected, for the reasons in `rejections`; `remedy` names what to change."""

    def __init__(self, failure: Failure) -> None:
        draws, last = len(failure.rejections), failure.rejections[-1]["found"]
        super().__init__(
            f"sample {failure.index}: {counted(draws, 'draw')} rejected; last reason: {last}"
        )
        self.rejections, self.remedy = failure.rejections, failure.remedy


def make(recipe: Recipe, index: int, progress: Progress | None = None) -> Sample:
    """Make a sample of a recipe from the first of its draws that passes the gates.

    Its record has the `spec`, the `rejections` of earlier draws, and in `sources_sha256` the digest of the files.

    Raises Exhausted if all draws were rejected (only one is made if no other can pass), and FileError for
    a file that cannot be read or has changed since the recipe's first sample was made.
    """
    made = sample_or_failure(recipe, index, progress)
    if isinstance(made, Failure):
        raise Exhausted(made)
    return made


def sample_or_failure(
    recipe: Recipe,
    index: int,
    progress: Progress | None = None,
    note: Callable[[str], object] = lambda text: None,
) -> Sample | Failure:
    """The sample as `make` returns it, or why all its draws were rejected.

    `note` is called with a text when a draw was rejected and another one is made.
    """
    rejections: list[dict[str, Any]] = []
    remedy, attempts = "", recipe.gates.attempts
    try:
        for attempt in range(attempts):
            spec = plan(recipe, index, attempt)
            _check_scene_file(recipe, spec)
            try:
                with _impossible_draws_rejected(recipe):
                    sample = _produced(recipe, spec, progress)
                    # Rendering has opened a scene.xml again, which may have changed meanwhile.
                    _check_scene_file(recipe, spec)
            except Rejected as rejected:
                rejections.append(rejected.record(attempt))
                remedy = rejected.remedy
                if _is_final(recipe, rejected):
                    break
                if attempt + 1 < attempts:
                    last = rejected.reason
                    note(f"draw {attempt + 2} of {attempts}; last rejected: {last}")
            else:
                warn_of_noise(sample, index)
                digest = recipe.sources.digest
                return _with_record(
                    sample, rejections=rejections, sources_sha256=digest
                )
    finally:
        # Kernels of a random scene are of no use to the next one.
        if recipe.varied_scenes:
            forget_kernels()
    return Failure(index, remedy, plain(rejections))


def _is_final(recipe: Recipe, rejected: Rejected) -> bool:
    """Whether every other draw of the sample would be rejected, too."""
    if rejected.depends_on is not None:
        return has_fixed_size(recipe, rejected.depends_on)
    return is_fixed(recipe) and not rejected.noisy


def _check_scene_file(recipe: Recipe, spec: SampleSpec) -> None:
    """Raise FileError if the scene's file cannot be read or has changed."""
    if spec.kind == "scene":
        recipe.sources.scene(spec.scene)


@contextmanager
def _impossible_draws_rejected(recipe: Recipe) -> Iterator[None]:
    """Turn the error of an impossible draw into its rejection; files that cannot be read stay errors."""
    try:
        yield
    except FileError:
        raise
    except InputError as error:
        # Datasets record no local paths.
        text = str(error).replace(f"{recipe.file.parent}/", "")
        remedy = "the value that the message names"
        raise Rejected("impossible draw", text, remedy) from error


def _with_record(sample: Sample, **more: Any) -> Sample:
    return dataclasses.replace(sample, record={**sample.record, **more})


class NoiseWarning(UserWarning):
    """The renderer's noise of a sample is above its limit with the most samples per pixel."""


def warn_of_noise(sample: Sample, index: int) -> None:
    """Give a NoiseWarning if the sample's noise is above its limit."""
    ratios: list[float] = []
    for shot in sample.shots:
        ratios += shot.record.get("light_paths_over_sensor", ())
    limit = sample.record["noise"]
    if limit is not None and max(ratios) > limit:
        used = max(shot.record["spp"] for shot in sample.shots)
        text = f"renderer noise {max(ratios):.2g} x sensor noise with {used} samples per pixel, limit {limit:g} not met"
        warnings.warn(f"sample {index}: {text}", NoiseWarning, stacklevel=2)


def _produced(recipe: Recipe, spec: SampleSpec, progress: Progress | None) -> Sample:
    """Make the sample of a spec; the same spec and files give the same sample.

    Raises Rejected by a gate, FileError for a file that cannot be read, InputError for an impossible spec.
    """
    sources, gates = recipe.sources, recipe.gates
    # Datasets record messages, so that the recipe's name in them has no folder.
    file = Path(recipe.file.name)
    settings = read(RecipeSettings, dict(spec.drawn), file)
    if spec.kind == "family":
        check_overlap(spec.scene, settings, gates, file, sources.file)
    objects = settings.scene.objects
    base = _lit_scene(spec, settings, sources)
    moved = base.at(base.world_from_left @ settings.scene.jitter.pose())
    rig, sensor = _cameras(spec, settings, moved, sources, file)
    scene = with_objects(base, objects, rig.nominal, spec.seed, sources.folder, file)
    if scene is not base:
        sources.check_files(scene)

    def check(truths: Sequence[Truth]) -> None:
        check_truth(gates, scene, rig, truths, spec.ndisp)
        check_seen(objects, truths)

    truths = ground_truth(
        scene, rig.nominal, sky_disparity=settings.sky_disparity, check=check
    )
    view = View(scene, rig.nominal.cameras[0], truths, spec.seed)
    sample = make_sample(
        scene,
        sensor.misalign(rig),
        make_lenses(settings, view, file, sources.file),
        settings.shoot(spec.seed, sensor, spec.keep),
        truths=truths,
        labels=[label_of_table(table) for table in spec.drawn.get("lenses", ())],
        progress=progress,
    )
    check_photographs(gates, sample, sensor)
    warn_of_doubts(sample, sensor, f"sample {spec.index}")
    if spec.kind == "family":
        warn_of_wide_view(rig.nominal, spec.scene)
    with_bound = dataclasses.replace(sample, ndisp=spec.ndisp)
    return _with_record(with_bound, spec=dataclasses.asdict(spec))


def _cameras(
    spec: SampleSpec,
    settings: RecipeSettings,
    scene: Scene,
    sources: Sources,
    file: Path,
) -> tuple[Rig, Sensor]:
    """The calibrated rig at the viewpoint of a scene, and its sensor with a mismatch for each camera."""
    rig = settings.rig_of(scene, scene.rig, file, sources.file)
    return rig, sensor_for(rig, spec.drawn, spec.seed, scene.rig, file)


def check_draws(recipe: Recipe, index: int) -> None:
    """Raise InputError if all draws of a sample are impossible.

    Such are a mismatch that does not fit the rig, views that have nothing in common, and a scene without light.

    A family's scene is not made; what depends on it is checked when the sample is made.
    """
    last = 0 if is_fixed(recipe) else recipe.gates.attempts - 1
    for attempt in range(last + 1):
        try:
            checked = _dry_run(recipe, index, attempt)
        except InputError:
            # The dataset records impossible draws, if another one is possible.
            if attempt == last:
                raise
        else:
            _check_light(recipe, *checked)
            return


def _dry_run(
    recipe: Recipe, index: int, attempt: int
) -> tuple[RecipeSettings, Scene, Rig]:
    """What a draw is made of, without rendering. Raises InputError for an impossible draw."""
    file = Path(recipe.file.name)
    spec = plan(recipe, index, attempt)
    settings = read(RecipeSettings, dict(spec.drawn), file)
    scene = recipe.sources.scene(spec.scene) if spec.kind == "scene" else ANY_SCENE
    with located(f"{file}: scenes"):
        check_still(scene)
    if spec.kind == "family":
        check_overlap(spec.scene, settings, recipe.gates, file, recipe.sources.file)
    rig, sensor = _cameras(spec, settings, scene, recipe.sources, file)
    nominal = make_lenses(settings, None, file, recipe.sources.file)
    with located(str(file)):
        sensor.misalign(rig)
        for lens in nominal:
            sensor.lenses(rig, lens)
        settings.shoot(spec.seed, sensor).check(rig, nominal)
    return settings, scene, rig


def _check_light(
    recipe: Recipe, settings: RecipeSettings, scene: Scene, rig: Rig
) -> None:
    """Raise InputError for a scene of a file that no camera would see, for want of light in its band."""
    is_lit = settings.sky or settings.scene.objects or rig.projectors
    if is_lit or scene is ANY_SCENE:
        return
    bands = set[str]().union(*(camera.bands for camera in rig.cameras))
    with located(f"{recipe.file}: scenes"):
        for band in bands:
            check_lit(in_band(scene, band), band)


def family_scene(
    family: str, seed: int, settings: RecipeSettings, sources: Sources
) -> Scene:
    """The scene of a family that a sample's seed and settings give."""
    width, height = settings.width, settings.height
    return random_scene(
        family,
        int(generator(seed, "scene").integers(1 << 31)),
        assets=sources.families_assets,
        depth_range=settings.scene.depth_range,
        object_count=settings.scene.object_count,
        aspect=width / height,
        width=width,
        own_lights=settings.sky is None,
    )


def _scene(spec: SampleSpec, settings: RecipeSettings, sources: Sources) -> Scene:
    if spec.kind == "scene":
        return sources.scene(spec.scene)
    return family_scene(spec.scene, spec.seed, settings, sources)


def _lit_scene(spec: SampleSpec, settings: RecipeSettings, sources: Sources) -> Scene:
    """The scene of a spec under its sky, with its factor of the scene's own light."""
    scene = _scene(spec, settings, sources)
    if settings.sky is not None:
        scene = _lit(scene, settings.sky, sources, spec.seed)
    if settings.scene.ambient != 1:
        scene = scene.with_ambient(settings.scene.ambient)
    return scene


def under_sky(
    scene: Scene, table: Mapping[str, Any], folder: Path, seed: int = 0
) -> Scene:
    """The scene lit by the `[sky]` of a recipe in `folder`; `seed` draws one of several files. Raises InputError."""
    checked = read(SkyTable, table, "sky")
    return _lit(scene, checked, Sources(folder, skies=(checked.file,)), seed)


def _lit(scene: Scene, table: SkyTable, sources: Sources, seed: int) -> Scene:
    name, pixels = sources.sky(table.file, generator(seed, "sky"))
    record = {
        "file": name,
        "sha256": sources.digests[name],
        **table.model_dump(exclude={"file"}, exclude_none=True),
    }
    share = NIR_SHARES[table.nir] if isinstance(table.nir, str) else table.nir
    return scene.lit_by(
        Sky(pixels, table.turn_deg, table.scale, table.visible, record, share),
        table.lamps,
    )
