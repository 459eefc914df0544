"""Bodies set down on a level surface: footprints apart, some on top of others where the contact can be shown, and
clear of what stands beside those.

A body goes on top of another only if it rests there as on a table: its whole contact lies within the level top of the
one below, and the two together keep their balance on what carries them.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from twinlens.families.bodies import Drawn
from twinlens.families.resting import Rest, Rng, gap, inside_by, rests, turn_about_z
from twinlens.families.stage import placed
from twinlens.geometry import Float

CLEARANCE = 1e-4
"""Of a body's size: what is left between bodies that touch, so that no two surfaces coincide."""

_TRIES = 60
_LYING = {"bottle": 0.12, "cup": 0.08, "candle": 0.1, "tin": 0.08, "pawn": 0.15, "cone": 0.1}


@dataclass(frozen=True, eq=False)
class Standing:
    """A body at its place: its rest, turned about z by `spin` (3, 3), moved to `place` (3,), which its lowest point
    is level with."""

    drawn: Drawn
    rest: Rest
    spin: Float
    place: Float

    @property
    def pose(self) -> Float:
        """world_from_object (4, 4)."""
        turn = self.spin @ self.rest.turn
        low = float((self.drawn.solid.mesh.vertices @ turn.T)[:, 2].min()) * self.drawn.size
        return placed(turn, self.place - [0, 0, low], self.drawn.size)

    def moved(self, polygon: Float) -> Float:
        """An outline (N, 2) of the rest where it stands."""
        return np.asarray(polygon @ self.spin[:2, :2].T + self.place[:2])

    @cached_property
    def footprint(self) -> Float:
        """Its shadow's outline (N, 2) in the world."""
        return self.moved(self.rest.footprint)

    @property
    def top(self) -> float:
        """The height of its highest point."""
        return float(self.place[2] + self.rest.height)

    @property
    def balance(self) -> Float:
        """Its centre of mass seen from above (2,)."""
        return np.asarray(self.moved(self.rest.centre[None, :2])[0])


def choose_rest(drawn: Drawn, rng: Rng) -> Rest | None:
    """How a body comes to lie: as it is made to stand, or on one of its sides by their likelihood."""
    found = rests(drawn.solid.mesh, drawn.size)
    if not found:
        return None
    best = max(found, key=lambda rest: rest.turn[2, 2])
    if drawn.solid.upright and best.turn[2, 2] > 0.9 and rng.random() >= _LYING.get(drawn.solid.kind, 0.0):
        return best
    if drawn.solid.upright and drawn.solid.kind not in _LYING and best.turn[2, 2] > 0.9:
        return best
    weights = np.array([rest.likelihood for rest in found])
    return found[int(rng.choice(len(found), p=weights / weights.sum()))]


def arrange(
    bodies: list[tuple[Drawn, Rest, Rng]],
    where: Callable[[Rng, Rest], Float],
    height: float,
    allowed: Callable[[Float], bool],
    spacing: float,
    stacked: float,
) -> list[Standing]:
    """Set bodies down one after the other; one that finds no free place is left out.

    Parameters
    ----------
    where : callable
        A place (2,) to try, drawn from the body's own stream.
    height : float
        Of the surface.
    allowed : callable
        Whether a footprint (N, 2) may lie there.
    spacing : float
        Least distance between footprints, metres.
    stacked : float
        How often a body is tried on top of another first.
    """
    done: list[Standing] = []
    carried: dict[int, int] = {}
    for drawn, rest, rng in bodies:
        standing = None
        if done and rng.random() < stacked:
            standing = _on_top(drawn, rest, rng, done, carried, spacing)
        if standing is None:
            standing = _beside(drawn, rest, rng, done, where, height, allowed, spacing)
        if standing is not None:
            done.append(standing)
    return done


def _beside(
    drawn: Drawn,
    rest: Rest,
    rng: Rng,
    done: list[Standing],
    where: Callable[[Rng, Rest], Float],
    height: float,
    allowed: Callable[[Float], bool],
    spacing: float,
) -> Standing | None:
    for _ in range(_TRIES):
        spin = turn_about_z(_angle(drawn, rng))
        trial = Standing(drawn, rest, spin, np.append(where(rng, rest), height + CLEARANCE * drawn.size))
        if allowed(trial.footprint) and _apart(trial, done, spacing):
            return trial
    return None


def _apart(trial: Standing, others: list[Standing], spacing: float) -> bool:
    """Whether its footprint is clear of all those that reach as high as its lowest point."""
    outline, reach = trial.footprint, trial.rest.reach
    return all(
        other.top < trial.place[2]
        or np.linalg.norm(trial.place[:2] - other.place[:2]) > reach + other.rest.reach + spacing
        or gap(outline, other.footprint) > spacing
        for other in others
    )


def _angle(drawn: Drawn, rng: Rng) -> float:
    """Books and cartons lie more or less square to the table, everything else as it likes."""
    if drawn.solid.kind in ("book", "carton"):
        return float(rng.choice([0.0, np.pi / 2]) + rng.normal(0, 0.35))
    return float(rng.uniform(0, 2 * np.pi))


def _on_top(
    drawn: Drawn, rest: Rest, rng: Rng, done: list[Standing], carried: dict[int, int], spacing: float
) -> Standing | None:
    """Standing on the level top of a body that carries nothing yet; recorded in `carried` as index -> carrier.

    It may jut out over its carriers, but not into a neighbour that is taller than these.
    """
    for index in rng.permutation(len(done)):
        below = done[index]
        if below.rest.top is None or index in carried.values() or _depth_of(index, carried) >= 3:
            continue
        slab = below.moved(below.rest.top)
        middle = slab.mean(axis=0)
        for _ in range(6):
            spin = turn_about_z(_angle(drawn, rng))
            offset = spin[:2, :2] @ rest.support.mean(axis=0)
            xy = middle - offset + rng.normal(0, 0.06, 2) * drawn.size
            trial = Standing(drawn, rest, spin, np.append(xy, below.top + CLEARANCE * drawn.size))
            support = trial.moved(rest.support)
            rests_there = min(inside_by(slab, corner) for corner in support) > 0
            if rests_there and _balanced(trial, index, done, carried) and _apart(trial, done, spacing):
                carried[len(done)] = int(index)
                return trial
    return None


def _depth_of(index: int, carried: dict[int, int]) -> int:
    depth = 0
    while index in carried:
        index = carried[index]
        depth += 1
    return depth


def _balanced(trial: Standing, index: int, done: list[Standing], carried: dict[int, int]) -> bool:
    """Whether the new body's weight lies above the contact of every body that carries it.

    Each of those keeps its balance alone; with two centres of mass above a convex contact, so is that of both.
    """
    while True:
        below = done[index]
        if inside_by(below.moved(below.rest.support), trial.balance) <= 0:
            return False
        if index not in carried:
            return True
        index = carried[index]
