"""Warnings of what cannot be meant: views of nothing, black or clipped images, objects outside of every view."""

import warnings
from collections.abc import Sequence

import numpy as np

from twinlens.camera import Rig
from twinlens.camera.truth import Truth
from twinlens.dataset import Sample
from twinlens.factory.draws import leaves
from twinlens.factory.gates import grey
from twinlens.factory.plan import is_fixed
from twinlens.factory.recipe import Recipe
from twinlens.families import WIDEST_FOV_DEG
from twinlens.geometry import Float, inverse, transform_points
from twinlens.scenes import Mesh, Scene, SceneObject
from twinlens.scenes.materials import emission_of
from twinlens.scenes.shapes import tessellated
from twinlens.sensor import Sensor

_BLACK = 0.05  # of white; noise in the dark is below
_WHITE = 0.99
_GRID = 9  # points of a box, along each side
_MOST_NAMES = 3  # of objects that a message lists
_ROUNDING_DEG = 1e-6


class ResultWarning(UserWarning):
    """A sample is complete, but cannot be meant; the message names view or object and the likely cause."""


def warn_of_doubts(
    sample: Sample, sensor: Sensor, name: str, scene: Scene | None = None
) -> None:
    """Give one `ResultWarning` with all `doubts` of the sample `name`, if there are any.

    With `scene`, those of the places of its objects too.
    """
    reasons = doubts(sample, sensor)
    if scene is not None and not reasons:
        reasons = misplaced(scene, sample.rig, sample.truths)
    if reasons:
        warnings.warn(f"{name}: {'; '.join(reasons)}", ResultWarning, stacklevel=2)


def warn_of_wide_view(rig: Rig, family: str) -> None:
    """Give a `ResultWarning` if a camera's view is wider than the family's pictures and textures are made for."""
    widest = max(camera.fov_x_deg for camera in rig.cameras)
    if widest > WIDEST_FOV_DEG + _ROUNDING_DEG:
        warnings.warn(
            f"{family}: the view is {widest:.4g} degrees wide, and its scenes are made for up to "
            f"{WIDEST_FOV_DEG:g}: the ends of rooms and tables are seen, and textures are coarse beside the middle "
            "(rig.fov_x_deg)",
            ResultWarning,
            stacklevel=2,
        )


def doubts(sample: Sample, sensor: Sensor) -> list[str]:
    """What is doubtful about a sample that `sensor` took, with the likely cause; empty for most."""
    reasons = []
    blind = [view for view, truth in enumerate(sample.truths) if not truth.hit.any()]
    if blind:
        reasons.append(
            f"{_views(blind)} no surface, so all pixels are unknown: is the camera turned away from the scene?"
        )
    for k, shot in enumerate(sample.shots):
        lens = f" through lens {k}" if k else ""
        greys = [grey(image, sensor) for image in shot.images]
        # A sensor's noise, amplified by the automatic exposure, is not black.
        unlit = shot.record.get("unlit_views", [])
        if unlit:
            reasons.append(
                f"{_views(unlit)} no light at all{lens}: is there a light, and does it reach what is seen?"
            )
        black = [
            view
            for view, values in enumerate(greys)
            if values.max() <= _BLACK and view not in unlit
        ]
        if black:
            reasons.append(
                f"{_views(black)} nothing but black{lens}: is there a light, and is the exposure long enough?"
            )
        white = [view for view, values in enumerate(greys) if values.min() >= _WHITE]
        if white:
            reasons.append(
                f"{_views(white)} nothing but clipped pixels{lens}: is the exposure too long?"
            )
    return reasons


def misplaced(scene: Scene, rig: Rig, truths: Sequence[Truth]) -> list[str]:
    """Which objects of a scene file are outside of every view, as one sentence; empty for most scenes.

    Lamps and surroundings, such as the wall behind a camera, are left out: an object is taken for surroundings if it is
    larger than its distance from the first camera.
    """
    in_view: set[str] = set()
    for truth in truths:
        in_view.update(map(truth.object_name, truth.objects))
    cam_from_world = inverse(rig.world_from_cams[0])
    places = []
    for scene_object in scene.objects:
        if _is_lamp(scene, scene_object) or in_view & _copies(scene_object):
            continue
        low, high = _box(scene_object)
        middle = transform_points(cam_from_world, (low + high) / 2)
        is_surrounding = np.linalg.norm(high - low) > np.linalg.norm(middle)
        if not is_surrounding and not _meets_a_view(low, high, rig):
            places.append(f"{scene_object.name!r} {_direction(middle)}")
    if not places:
        return []
    listed = places[:_MOST_NAMES]
    if len(places) > _MOST_NAMES:
        listed.append(f"{len(places) - _MOST_NAMES} more")
    return [
        f"outside of every view: {', '.join(listed)}; is the place in metres, with z up?"
    ]


def _is_lamp(scene: Scene, scene_object: SceneObject) -> bool:
    """Whether an object gives light, so that it may be meant to be out of view."""
    emissions = (emission_of(scene.materials[name]) for name in scene_object.materials)
    return scene_object.emitter is not None or any(emissions)


def _copies(scene_object: SceneObject) -> set[str]:
    """The names of an object's copies in the ground truth."""
    count = len(scene_object.instances)
    return {f"{scene_object.name}[{i}]" for i in range(count)} or {scene_object.name}


def _box(scene_object: SceneObject) -> tuple[Float, Float]:
    """The smallest and largest world coordinates (3,) of all copies of an object, metres."""
    shape = scene_object.shape
    mesh = shape if isinstance(shape, Mesh) else tessellated(shape)
    placed = transform_points(scene_object.world_from_object, mesh.vertices)
    copies = [transform_points(instance, placed) for instance in scene_object.instances]
    points = np.concatenate(copies or [placed])
    return points.min(axis=0), points.max(axis=0)


def _meets_a_view(low: Float, high: Float, rig: Rig) -> bool:
    """Whether a camera sees a point of a grid in the box: its objects may be hidden, or smaller than a pixel."""
    axes = np.linspace(low, high, _GRID).T
    points = np.stack(np.meshgrid(*axes), axis=-1)
    return any(
        camera.contains(rig.project(index, points)).any()
        for index, camera in enumerate(rig.cameras)
    )


def _direction(middle: Float) -> str:
    """In words, where a point (3,) in the axes of a camera is: x to the right, y down, z ahead."""
    x, y, z = middle.tolist()
    distance = f"{np.linalg.norm(middle):.3g} m"
    if z <= 0:
        return f"{distance} away, behind view 0"
    if abs(x) > abs(y):
        return f"{distance} away, {'right' if x > 0 else 'left'} of view 0"
    return f"{distance} away, {'below' if y > 0 else 'above'} view 0"


def warn_of_lone_patterns(recipe: Recipe) -> None:
    """Give a `ResultWarning` for patterns of a code that are drawn for each sample, where each has another scene."""
    if is_fixed(recipe):
        return
    keys = [
        leaf.key for leaf in leaves(recipe.drawn) if leaf.key.endswith("pattern.frame")
    ]
    if keys:
        warnings.warn(
            f"{recipe.file.name}: {keys[0]} is drawn: each sample shows one pattern, in another scene; for all patterns"
            ' of a scene, as frames of one sample, replace pattern by sequence = [{ type = "gray_code" }]'
            " (docs/projectors.md)",
            ResultWarning,
            stacklevel=2,
        )


def _views(views: list[int]) -> str:
    if len(views) == 1:
        return f"view {views[0]} shows"
    return f"views {', '.join(map(str, views[:-1]))} and {views[-1]} show"
