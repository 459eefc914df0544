"""Cut-outs: the texels of a surface that are not there, such as those around a leaf on a card.

A material has them where it has an opacity: `alphaMode` MASK and BLEND of glTF, `map_d` of OBJ, the BSDFs `mask` and
`null`, also below other BSDFs. Ground truth passes texels whose opacity is below `CUT` and ends at the others. The
opacity is evaluated by the texture that the picture uses, so that both have the same edge. Texels of MASK have the
opacity 0 or 1 already (`rendering.materials`).

Images made by our own integrator pass them as the truth does, also where light falls on a surface: what is partly
opaque passes its share.

A thin pane of glass is no cut-out, although Mitsuba gives it the flag of one.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from twinlens.rendering.backends import mitsuba
from twinlens.rendering.build import BuiltScene
from twinlens.rendering.materials import has_pane, parts_of

CUT = 0.5
"""Opacity from which a texel is a surface of the ground truth."""

_BUMPED = ("NormalMap", "BumpMap")  # have the cut-outs of the BSDF below them


class CutOuts:
    """The cut-outs of a scene, for kernels of Dr.Jit.

    Each BSDF with cut-outs has a second one whose null transmission is 1 - opacity, without that of glass below a mask.
    """

    def __init__(self, openings: dict[Any, Any]) -> None:
        mi = mitsuba()
        self._openings = openings  # keeps the BSDFs alive
        handles = np.array([_handle(mi.BSDFPtr(bsdf)) for bsdf in openings])
        table = np.zeros(handles.max() + 1, dtype=np.uint32)
        table[handles] = [_handle(mi.BSDFPtr(bsdf)) for bsdf in openings.values()]
        self._table = mi.UInt32(table)
        lets_through = np.zeros(len(table), dtype=bool)
        lets_through[handles] = [not has_pane(bsdf) for bsdf in openings]
        self._lets_through = mi.Bool(lets_through)

    def _opening(self, handle: Any, active: Any) -> Any:
        """The handle of the second BSDF of each BSDF; 0 where there is none."""
        import drjit as dr

        in_table = active & (handle < dr.width(self._table))
        opening = dr.gather(mitsuba().UInt32, self._table, handle, in_table)
        return dr.select(in_table, opening, 0)

    def has(self, shape: Any) -> bool:
        """Whether a shape has cut-outs."""
        return shape is not None and shape.bsdf() in self._openings

    def transmission(self, si: Any, active: Any) -> Any:
        """The share 1 - opacity of the light that passes at surface interactions; 0 at surfaces without cut-outs."""
        import drjit as dr

        mi = mitsuba()
        opening = self._opening(dr.reinterpret_array(mi.UInt32, si.bsdf()), active)
        has_opening = opening > 0
        bsdf: Any = dr.reinterpret_array(mi.BSDFPtr, opening)
        passed = bsdf.eval_null_transmission(si, has_opening)
        return dr.select(has_opening, passed[0], 0.0)

    def lets_through(self, bsdf: Any) -> Any:
        """Whether all light that passes a BSDF straight on passes its cut-outs: not where there is glass too."""
        import drjit as dr

        handle: Any = dr.reinterpret_array(mitsuba().UInt32, bsdf)
        in_table = handle < dr.width(self._lets_through)
        return dr.gather(mitsuba().Bool, self._lets_through, handle, in_table)

    def passed(self, si: Any, active: Any) -> Any:
        """The share of the light that passes at surface interactions; 0 at other surfaces and where there is glass."""
        return self.transmission(si, active & self.lets_through(si.bsdf()))

    def transmittance(self, scene: Any, si: Any, point: Any, active: Any) -> Any:
        """The share of the light from `point` that reaches surfaces through cut-outs; 0 behind anything else."""
        import drjit as dr

        mi = mitsuba()
        start = _Shadow(mi.Bool(active), si.spawn_ray_to(point), mi.Float(1.0))
        (end,) = dr.while_loop(
            (start,),
            lambda shadow: shadow.active,
            lambda shadow: (self._past(scene, point, shadow),),
        )
        return end.share

    def _past(self, scene: Any, point: Any, shadow: "_Shadow") -> "_Shadow":
        """The shadow rays after their next surface."""
        import drjit as dr

        mi = mitsuba()
        si = scene.ray_intersect(shadow.ray, mi.RayFlags.All, False, shadow.active)
        hit = shadow.active & si.is_valid()
        share = dr.select(hit, shadow.share * self.passed(si, hit), shadow.share)
        return _Shadow(hit & (share > 0), si.spawn_ray_to(point), share)


@dataclass
class _Shadow:
    """Shadow rays on their way: whether they go on, and the share of the light that has passed."""

    active: Any
    ray: Any
    share: Any


def arriving(
    scene: Any, si: Any, point: Any, light: Any, active: Any, openings: CutOuts | None
) -> Any:
    """The part of `light` from a point that reaches the surfaces at `si`, where nothing but cut-outs is between."""
    import drjit as dr

    if openings is None:
        active = active & ~scene.ray_test(si.spawn_ray_to(point), active)
        return dr.select(active, light, 0.0)
    share = openings.transmittance(scene, si, point, active)
    return dr.select(active & (share > 0), light * share, 0.0)


def seen_along(
    scene: Any,
    ray: Any,
    openings: CutOuts | None,
    light_of: Callable[[Any, Any, Any], Any],
    sampler: Any = None,
) -> Any:
    """What rays see: `light_of` their first surfaces, and by the share that passes these, of what is behind cut-outs.

    light_of : of (surface interactions, whether they are wanted, sampler), a colour each. It weights a surface by its
        opacity itself, as BSDFs do.

    Nothing is chosen at random, so that a sum over few rays has no noise of the cut-outs.
    """
    import drjit as dr

    mi = mitsuba()
    if openings is None:
        si = scene.ray_intersect(ray, mi.RayFlags.All, True)
        return light_of(si, mi.Bool(True), sampler)
    start = _Sight(
        mi.Bool(True), mi.Ray3f(ray), mi.Float(1.0), mi.Color3f(0.0), sampler
    )

    def onward(sight: _Sight) -> _Sight:
        si = scene.ray_intersect(sight.ray, mi.RayFlags.All, False, sight.active)
        hit = sight.active & si.is_valid()
        seen = sight.share * light_of(si, sight.active, sight.sampler)
        share = sight.share * openings.passed(si, hit)
        return _Sight(
            hit & (share > 0),
            si.spawn_ray(sight.ray.d),
            share,
            sight.seen + dr.select(sight.active, seen, 0.0),
            sight.sampler,
        )

    (end,) = dr.while_loop(
        (start,), lambda sight: sight.active, lambda sight: (onward(sight),)
    )
    return end.seen


@dataclass
class _Sight:
    """Rays on their way through cut-outs: whether they go on, the share that has passed, and what it has seen."""

    active: Any
    ray: Any
    share: Any
    seen: Any
    sampler: Any


def cut_outs(built: BuiltScene) -> CutOuts | None:
    """The cut-outs of a built scene, None where no surface has any. Found once for each scene."""
    if "cut-outs" not in built.cache:
        openings = {}
        for bsdf in _bsdfs(built):
            opening = opening_of(bsdf)
            if opening is not None:
                openings[bsdf] = opening
        built.cache["cut-outs"] = CutOuts(openings) if openings else None
    return built.cache["cut-outs"]  # type: ignore[no-any-return]


def _bsdfs(built: BuiltScene) -> Iterable[Any]:
    """The BSDFs of a scene, each once."""
    mi = mitsuba()
    if all(body.shape is not None for body in built.bodies):
        return dict.fromkeys(body.shape.bsdf() for body in built.bodies)
    # The shapes of instances in a Mitsuba file are known to the traversal of the whole scene only.
    nodes = mi.traverse(built.mi_scene).hierarchy
    return [node for node in nodes if isinstance(node, mi.BSDF)]


def opening_of(bsdf: Any) -> Any:
    """A BSDF with the null transmission of the cut-outs of `bsdf`; None without any."""
    mi = mitsuba()
    if not int(bsdf.flags()) & int(mi.BSDFFlags.Null):
        return None
    if bsdf.class_name() in _BUMPED:
        (nested,) = parts_of(bsdf, mi.BSDF)
        return opening_of(nested)
    if not has_pane(bsdf):
        return bsdf
    if bsdf.class_name() != "MaskBSDF":
        return None
    (opacity,) = parts_of(bsdf, mi.Texture)
    below = {"type": "diffuse"}
    return mi.load_dict({"type": "mask", "opacity": opacity, "bsdf": below})


def _handle(pointer: Any) -> int:
    """The number of an object in Dr.Jit's registry."""
    import drjit as dr

    return int(np.asarray(dr.reinterpret_array(mitsuba().UInt32, pointer))[0])
