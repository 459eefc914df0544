"""Closed forms of the shapes that ground truth is tested with: naive, in float64, in world coordinates.

A body has all parameters t at which rays o + t d of one origin (3,) cross it, (K, N), +inf where they do not, and its
normal at points (N, 3).
"""

from dataclasses import dataclass

import numpy as np

BEHIND = 1e-9


@dataclass(frozen=True)
class Ball:
    centre: np.ndarray
    radius: float
    relative = 3e-6

    def crossings(self, o, d):
        along = ((self.centre - o) * d).sum(-1) / (d * d).sum(-1)
        miss = np.linalg.norm(o + along[:, None] * d - self.centre, axis=-1)
        reach = root(self.radius**2 - miss**2) / np.linalg.norm(d, axis=-1)
        return clean([along - reach, along + reach])

    def normal(self, p):
        return (p - self.centre) / self.radius


@dataclass(frozen=True)
class Tube:
    """The mantle of a cylinder, open at both ends."""

    start: np.ndarray
    axis: np.ndarray  # unit
    length: float
    radius: float
    relative = 3e-6

    def crossings(self, o, d):
        m, w = (
            np.cross(o - self.start, self.axis),
            np.cross(d, self.axis),
        )  # distance to the axis as a vector
        a = (w * w).sum(-1)
        b = (m * w).sum(-1)
        c = (m * m).sum(-1) - self.radius**2
        half = root(b * b - a * c)
        t = np.stack([(-b - half) / a, (-b + half) / a])
        height = ((o + t[..., None] * d - self.start) * self.axis).sum(-1)
        return clean(np.where((height >= 0) & (height <= self.length), t, np.nan))

    def normal(self, p):
        out = p - self.start
        return (out - (out @ self.axis)[:, None] * self.axis) / self.radius


@dataclass(frozen=True)
class Plate:
    """A rectangle: centre and two half edges at right angles."""

    centre: np.ndarray
    right: np.ndarray
    up: np.ndarray
    relative = 3e-6

    def crossings(self, o, d):
        t, p = on_plane(o, d, self.centre, np.cross(self.right, self.up))
        inside = np.ones(len(d), bool)
        for edge in (self.right, self.up):
            inside &= np.abs((p - self.centre) @ edge) <= edge @ edge
        return clean([np.where(inside, t, np.nan)])

    def normal(self, p):
        return np.broadcast_to(unit(np.cross(self.right, self.up)), p.shape)


@dataclass(frozen=True)
class Coin:
    centre: np.ndarray
    axis: np.ndarray  # unit
    radius: float
    relative = 3e-6

    def crossings(self, o, d):
        t, p = on_plane(o, d, self.centre, self.axis)
        return clean(
            [
                np.where(
                    np.linalg.norm(p - self.centre, axis=-1) <= self.radius, t, np.nan
                )
            ]
        )

    def normal(self, p):
        return np.broadcast_to(self.axis, p.shape)


@dataclass(frozen=True)
class Hull:
    """A convex solid: the points with normals . p <= offsets; a box, or a tessellated sphere."""

    normals: np.ndarray  # (F, 3), unit
    offsets: np.ndarray  # (F,)
    relative = 1e-6

    @classmethod
    def of_triangles(cls, corners: np.ndarray) -> "Hull":
        normals = unit(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        )
        normals *= np.sign(
            ((corners[:, 0] - corners.mean(axis=(0, 1))) * normals).sum(-1)
        )[:, None]
        return cls(normals, (normals * corners[:, 0]).sum(-1))

    def crossings(self, o, d):
        rate = d @ self.normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (self.offsets - o @ self.normals.T) / rate
        enter = np.where(rate < 0, t, -np.inf).max(-1)
        leave = np.where(rate > 0, t, np.inf).min(-1)
        return clean(np.where(enter <= leave, [enter, leave], np.nan))

    def normal(self, p):
        return self.normals[np.argmax(p @ self.normals.T - self.offsets, axis=-1)]


@dataclass(frozen=True)
class Soup:
    """Triangles one by one, by the signed volumes of the ray with their edges (Pluecker's coordinates)."""

    corners: np.ndarray  # (F, 3, 3)
    relative = 1e-6

    def crossings(self, o, d):
        a, b, c = np.moveaxis(self.corners - o, 1, 0)
        volumes = np.stack(
            [np.cross(b, c) @ d.T, np.cross(c, a) @ d.T, np.cross(a, b) @ d.T]
        )
        inside = (volumes >= 0).all(axis=0) | (volumes <= 0).all(axis=0)
        with np.errstate(divide="ignore", invalid="ignore"):
            t = (a * np.cross(b, c)).sum(-1)[:, None] / volumes.sum(axis=0)
        return clean(np.where(inside, t, np.nan))

    def normal(self, p):
        n = unit(
            np.cross(
                self.corners[:, 1] - self.corners[:, 0],
                self.corners[:, 2] - self.corners[:, 0],
            )
        )
        off = np.abs(p @ n.T - (self.corners[:, 0] * n).sum(-1))
        return n[np.argmin(off, axis=-1)]


def first_hits(bodies, o, d):
    """(t, body, label) of the nearest crossing, body -1 where none; a label is one smooth piece of one body."""
    t = np.full(len(d), np.inf)
    body = np.full(len(d), -1)
    label = np.full(len(d), -1)
    for index, thing in enumerate(bodies):
        crossings = thing.crossings(o, d)
        crossings = np.where(crossings > BEHIND, crossings, np.inf)
        nearest = crossings.argmin(axis=0)
        mine = np.take_along_axis(crossings, nearest[None], axis=0)[0]
        closer = mine < t
        t, body = np.where(closer, mine, t), np.where(closer, index, body)
        label = np.where(closer, 1000 * index + nearest, label)
    return t, body, label


def seen_from(bodies, centre, points, share=1e-7):
    """Whether each point is visible from `centre`; hits in the last `share` of the distance are ignored."""
    seen = np.ones(len(points), bool)
    for thing in bodies:
        t = thing.crossings(centre, points - centre)
        seen &= ~((t > BEHIND) & (t < 1 - share)).any(axis=0)
    return seen


def on_plane(o, d, point, normal):
    with np.errstate(divide="ignore", invalid="ignore"):
        t = ((point - o) @ normal) / (d @ normal)
        return t, o + t[:, None] * d


def clean(rows):
    """NaN is no crossing."""
    return np.nan_to_num(np.asarray(rows), nan=np.inf, posinf=np.inf, neginf=np.inf)


def root(x):
    """The square root, NaN below zero."""
    return np.sqrt(np.where(x >= 0, x, np.nan))


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)
