"""Bodies placed on a level surface in stable poses: footprints apart, some bodies on top of others.

A body is placed on another only if its whole contact lies within the level top of the one below, and its centre of mass
lies above the contact of every body that carries it.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from twinlens.families.composition import Composition, similarity
from twinlens.families.draws import Rng, one_of, weighted
from twinlens.families.kinds import Body, draw_body
from twinlens.families.things.ground import Layer
from twinlens.geometry import Float
from twinlens.scenes.placement import rotation
from twinlens.scenes.resting import CLEARANCE, Placed
from twinlens.scenes.stable_poses import StablePose, gap, inside_by, stable_poses

_TRIES, _TRIES_ON_TOP = 60, 6
_HIGHEST_STACK = 4
_LYING = {
    "bottle": 0.12,
    "cup": 0.08,
    "candle": 0.1,
    "tin": 0.08,
    "pawn": 0.15,
    "cone": 0.1,
}
"""Probabilities that upright bodies of these kinds lie on their side."""


@dataclass(frozen=True, eq=False)
class RestingBody:
    """A body, and how it lies."""

    body: Body
    at: Placed

    @property
    def pose(self) -> Float:
        turn = self.at.spin @ self.at.rest.turn
        low = (
            float((self.body.solid.mesh.vertices @ turn.T)[:, 2].min()) * self.body.size
        )
        return similarity(turn, self.at.place - [0, 0, low], self.body.size)


@dataclass(frozen=True, eq=False)
class Area:
    """A level rectangle for bodies: `middle` (2,), half its sides (2,), `height` and least `spacing`, metres.

    A share `stacked` of the bodies is tried on top of others first. `sample` draws positions, in half sides. `filled`
    are the layers of what stands there already.
    """

    middle: Float
    half: Float
    height: float
    spacing: float
    stacked: float
    overhang: float = 1.0
    sample: Callable[[Rng, StablePose], Float] = lambda rng, _: rng.uniform(-1, 1, 2)
    filled: Sequence[Layer] = ()

    def is_free(self, trial: Placed) -> bool:
        """Whether a body is clear of the layers that are filled."""
        body = Layer(float(trial.place[2]), trial.top, trial.footprint)
        return all(body.is_clear_of(layer, self.spacing) for layer in self.filled)


def bodies_at_rest(
    scene: Composition,
    name: str,
    parts: Iterable[tuple[int, ...]],
    among: tuple[str, ...] | None = None,
) -> list[tuple[Body, StablePose, Rng]]:
    """A body for each of the `parts`, a stable pose drawn by its probability, and a random stream for its place."""
    resting = []
    faces = 0
    for part in parts:
        body = draw_body(scene, (name, *part), among)
        faces += len(body.solid.mesh.faces) if body.kind else 0
        # A body that is left out here carries none of the others.
        if not scene.has_room_for(faces):
            break
        pose = _draw_pose(body, scene.rng("rest", *part))
        if pose is not None:
            resting.append((body, pose, scene.rng("place", *part)))
    return resting


def _draw_pose(body: Body, rng: Rng) -> StablePose | None:
    """The upright pose of most bodies that stand, or one drawn by its probability; None if no pose is stable."""
    poses = stable_poses(body.solid.mesh, body.size)
    if not poses:
        return None
    most_upright = max(poses, key=lambda pose: float(pose.up[2]))
    can_stand = body.solid.upright and most_upright.up[2] > 0.9
    if can_stand and rng.random() >= _LYING.get(body.kind, 0.0):
        return most_upright
    return weighted(rng, poses, [pose.probability for pose in poses])


def arrange(
    bodies: Sequence[tuple[Body, StablePose, Rng]], area: Area
) -> list[RestingBody]:
    """Place bodies one after the other, each with its own random stream; bodies without a free place are left out."""
    placed: list[Placed] = []
    placements = []
    for body, rest, rng in bodies:
        for trial in _trials(body, rest, rng, placed, area):
            is_clear = all(
                _is_clear(trial, neighbour, area.spacing) for neighbour in placed
            )
            if is_clear and area.is_free(trial):
                placed.append(trial)
                placements.append(RestingBody(body, trial))
                break
    return placements


def _is_clear(trial: Placed, neighbour: Placed, spacing: float) -> bool:
    """Whether a body is above another or beside it; circles around both are compared first, as that is fast."""
    if neighbour.top < trial.place[2]:
        return True
    distance = np.linalg.norm(trial.place[:2] - neighbour.place[:2])
    if distance > trial.rest.reach + neighbour.rest.reach + spacing:
        return True
    return gap(trial.footprint, neighbour.footprint) > spacing


def _trials_on(
    below: Placed, body: Body, rest: StablePose, rng: Rng
) -> Iterator[Placed]:
    """Random placements near the middle of the level top of a body, if it has one, that carry and balance."""
    if below.rest.top is None:
        return
    slab = below.moved(below.rest.top)
    height = below.top + CLEARANCE * body.size
    for _ in range(_TRIES_ON_TOP):
        spin = _random_spin(body, rng)
        offset = spin[:2, :2] @ rest.support.mean(axis=0)
        xy = slab.mean(axis=0) - offset + rng.normal(0, 0.06, 2) * body.size
        trial = Placed(rest, spin, np.append(xy, height), below)
        contact = trial.moved(rest.support)
        is_carried = min(inside_by(slab, corner) for corner in contact) > 0
        if is_carried and trial.balanced():
            yield trial


def _trials(
    body: Body, rest: StablePose, rng: Rng, placed: list[Placed], area: Area
) -> Iterator[Placed]:
    """Random placements on level tops that carry nothing yet, for a share of the bodies, then on the area itself."""
    if placed and rng.random() < area.stacked:
        for index in rng.permutation(len(placed)):
            below = placed[index]
            carries = any(neighbour.below is below for neighbour in placed)
            if not carries and len(below.stack) < _HIGHEST_STACK:
                yield from _trials_on(below, body, rest, rng)
    for _ in range(_TRIES):
        spin = _random_spin(body, rng)
        xy = area.sample(rng, rest) * area.half + area.middle
        trial = Placed(rest, spin, np.append(xy, area.height + CLEARANCE * body.size))
        if (np.abs(trial.footprint - area.middle) < area.half * area.overhang).all():
            yield trial


def _random_spin(body: Body, rng: Rng) -> Float:
    if body.kind in ("book", "carton"):
        angle = one_of(rng, [0.0, np.pi / 2]) + rng.normal(0, 0.35)
    else:
        angle = rng.uniform(0, 2 * np.pi)
    return rotation([0, 0, 1], np.degrees(angle))[:3, :3]
