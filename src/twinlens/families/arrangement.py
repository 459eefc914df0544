"""Bodies placed on a level surface: footprints apart, some bodies on top of others.

A body is placed on another only if it is stable there: its whole contact lies within the level top of the one below,
and its centre of mass lies above the contact of every body that carries it.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twinlens.families.bodies import Body
from twinlens.families.draws import Rng, one_of, weighted
from twinlens.families.poses import similarity
from twinlens.families.stable_poses import StablePose, gap, inside_by, stable_poses
from twinlens.geometry import Float

_CLEARANCE = 1e-4  # of a body's size: gap between bodies that touch, so that no two surfaces coincide
_TRIES, _TRIES_ON_TOP = 60, 6
_HIGHEST_STACK = 4
_LYING = {"bottle": 0.12, "cup": 0.08, "candle": 0.1, "tin": 0.08, "pawn": 0.15, "cone": 0.1}
"""Probabilities that upright bodies of these kinds lie on their side."""


@dataclass(frozen=True, eq=False)
class Placement:
    """A body in a stable pose, rotated about z by `spin` (3, 3); `place` (3,) is level with its lowest point."""

    body: Body
    rest: StablePose
    spin: Float
    place: Float

    @property
    def pose(self) -> Float:
        """world_from_object (4, 4)."""
        turn = self.spin @ self.rest.turn
        low = float((self.body.solid.mesh.vertices @ turn.T)[:, 2].min()) * self.body.size
        return similarity(turn, self.place - [0, 0, low], self.body.size)

    def moved(self, polygon: Float) -> Float:
        """An outline (N, 2) of the stable pose, in the world."""
        return np.asarray(polygon @ self.spin[:2, :2].T + self.place[:2])

    @cached_property
    def footprint(self) -> Float:
        """Its outline (N, 2) in the world, seen from above."""
        return self.moved(self.rest.footprint)

    @property
    def top(self) -> float:
        """The height of its highest point."""
        return float(self.place[2] + self.rest.height)


@dataclass(frozen=True, eq=False)
class Area:
    """A level area for bodies.

    `sample(rng, rest)` draws a position (2,), `contains(footprint)` accepts an outline (N, 2); `height` and `spacing`,
    the least distance between footprints, are in metres. A share `stacked` of the bodies is tried on top of others
    first.
    """

    sample: Callable[[Rng, StablePose], Float]
    contains: Callable[[Float], bool]
    height: float
    spacing: float
    stacked: float


def choose_rest(body: Body, rng: Rng) -> StablePose | None:
    """A stable pose by its probability; upright bodies stand, or lie with the probability in `_LYING`."""
    found = stable_poses(body.solid.mesh, body.size)
    if not found:
        return None
    if body.solid.upright:
        best = max(found, key=lambda rest: rest.turn[2, 2])
        if best.turn[2, 2] > 0.9 and rng.random() >= _LYING.get(body.kind, 0.0):
            return best
    return weighted(rng, found, [rest.probability for rest in found])


def arrange(bodies: Sequence[tuple[Body, StablePose, Rng]], area: Area) -> list[Placement]:
    """Place bodies one after the other, each with its own random stream; bodies without a free place are left out."""
    pile = _Pile(area.spacing)
    for body, rest, rng in bodies:
        on_top = bool(pile.placed) and rng.random() < area.stacked
        if not (on_top and pile.add_on_top(body, rest, rng)):
            pile.add_on_area(body, rest, rng, area)
    return pile.placed


@dataclass(eq=False)
class _Pile:
    """The bodies placed so far; `carrier` maps a body's index to that of the body below it."""

    spacing: float
    placed: list[Placement] = field(default_factory=list)
    carrier: dict[int, int] = field(default_factory=dict)

    def add_on_area(self, body: Body, rest: StablePose, rng: Rng, area: Area) -> None:
        """Place the body on the area."""
        for _ in range(_TRIES):
            spin = _random_spin(body, rng)
            place = np.append(area.sample(rng, rest), area.height + _CLEARANCE * body.size)
            trial = Placement(body, rest, spin, place)
            if area.contains(trial.footprint) and self._is_apart(trial):
                self.placed.append(trial)
                return

    def add_on_top(self, body: Body, rest: StablePose, rng: Rng) -> bool:
        """Place the body on a level top that carries nothing yet; it may overhang, but not into a taller neighbour."""
        for index in rng.permutation(len(self.placed)):
            below = self.placed[index]
            if below.rest.top is None or index in self.carrier.values() or len(self._stack(index)) >= _HIGHEST_STACK:
                continue
            slab = below.moved(below.rest.top)
            for _ in range(_TRIES_ON_TOP):
                spin = _random_spin(body, rng)
                offset = spin[:2, :2] @ rest.support.mean(axis=0)
                xy = slab.mean(axis=0) - offset + rng.normal(0, 0.06, 2) * body.size
                trial = Placement(body, rest, spin, np.append(xy, below.top + _CLEARANCE * body.size))
                on_slab = min(inside_by(slab, corner) for corner in trial.moved(rest.support)) > 0
                if on_slab and self._is_balanced(trial, index) and self._is_apart(trial):
                    self.carrier[len(self.placed)] = int(index)
                    self.placed.append(trial)
                    return True
        return False

    def _stack(self, index: int) -> list[int]:
        """The indices of a body and of all bodies below it, from the top down."""
        stack = [index]
        while stack[-1] in self.carrier:
            stack.append(self.carrier[stack[-1]])
        return stack

    def _is_balanced(self, trial: Placement, index: int) -> bool:
        """Whether the new body's centre of mass lies above the contact of every body that carries it.

        Each of those is balanced without it; two centres of mass above a convex contact have a mean above it.
        """
        balance = trial.moved(trial.rest.centre[None, :2])[0]
        carriers = [self.placed[each] for each in self._stack(index)]
        return all(inside_by(below.moved(below.rest.support), balance) > 0 for below in carriers)

    def _is_apart(self, trial: Placement) -> bool:
        """Whether the footprint is apart from those of all bodies that reach as high as its lowest point."""
        return all(
            other.top < trial.place[2]
            or np.linalg.norm(trial.place[:2] - other.place[:2]) > trial.rest.reach + other.rest.reach + self.spacing
            or gap(trial.footprint, other.footprint) > self.spacing
            for other in self.placed
        )


def _random_spin(body: Body, rng: Rng) -> Float:
    """A rotation (3, 3) about z; books and cartons lie roughly square to the table."""
    if body.kind in ("book", "carton"):
        angle = one_of(rng, [0.0, np.pi / 2]) + rng.normal(0, 0.35)
    else:
        angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
