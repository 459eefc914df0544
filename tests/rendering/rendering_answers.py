"""The analytic truth of a view, and the distance of pixels from its edges, with independent projections."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tests.rendering.rendering_bodies import first_hits, seen_from

ROUND = [(np.cos(a), np.sin(a)) for a in np.arange(8) * np.pi / 4]


@dataclass(frozen=True)
class View:
    """One camera of a rig among bodies, and its partner."""

    bodies: list
    rig: object
    index: int

    @property
    def camera(self):
        return self.rig.cameras[self.index]

    @property
    def pose(self):
        return self.rig.world_from_cams[self.index]

    @property
    def other(self):
        """0 and 1 are a pair, 2 and 3, ...; the last of an odd number has its left neighbour."""
        couple = 2 * (self.index // 2) + 1 - self.index % 2
        return couple if couple < len(self.rig.cameras) else self.index - 1

    def pixels(self):
        c = self.camera
        return np.array(
            [(u, v) for v in range(c.height) for u in range(c.width)], dtype=float
        )

    def directions(self, pixels):
        c = self.camera
        x = (pixels[:, 0] - c.cx) / c.fx
        y = (pixels[:, 1] - c.cy) / c.fy
        return np.stack([x, y, np.ones(len(x))], axis=1) @ self.pose[:3, :3].T

    def hits(self, pixels):
        """(z, body, label): t is the depth, since directions have z = 1."""
        return first_hits(self.bodies, self.pose[:3, 3], self.directions(pixels))

    def points(self, pixels, z):
        return self.pose[:3, 3] + z[:, None] * self.directions(pixels)

    def pixels_in(self, index, points):
        """Where a camera of the rig sees points; NaN behind it."""
        c = self.rig.cameras[index]
        pose = self.rig.world_from_cams[index]
        x, y, z = ((points - pose[:3, 3]) @ pose[:3, :3]).T
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(z > 0, [c.fx * x / z + c.cx, c.fy * y / z + c.cy], np.nan).T

    def visible(self, pixels):
        """Whether the partner sees what these pixels hit: inside its image, and nothing in between."""
        return self._visible(pixels, self.hits(pixels))

    def _visible(self, pixels, hits):
        z, body, _ = hits
        seen = np.zeros(len(pixels), bool)
        points = self.points(pixels[body >= 0], z[body >= 0])
        c = self.rig.cameras[self.other]
        u, v = self.pixels_in(self.other, points).T
        inside = (u >= -0.5) & (u < c.width - 0.5) & (v >= -0.5) & (v < c.height - 0.5)
        seen[body >= 0] = inside & seen_from(
            self.bodies, self.rig.world_from_cams[self.other][:3, 3], points
        )
        return seen

    @cached_property
    def all_hits(self):
        """`hits`, `visible`, `normals` and `cosine` of every pixel, kept: they cost the most."""
        return self.hits(self.pixels())

    @cached_property
    def all_visible(self):
        return self._visible(self.pixels(), self.all_hits)

    @cached_property
    def all_normals(self):
        return self._normals(self.pixels(), self.all_hits)

    @cached_property
    def all_cosines(self):
        return self._cosine(self.pixels(), self.all_normals)

    def normals(self, pixels):
        """Closed-form normals of what is hit, turned towards the camera; 0 where nothing is."""
        return self._normals(pixels, self.hits(pixels))

    def _normals(self, pixels, hits):
        z, body, _ = hits
        normal = np.zeros((len(pixels), 3))
        for index, thing in enumerate(self.bodies):
            mine = body == index
            normal[mine] = thing.normal(self.points(pixels[mine], z[mine]))
        away = (normal * self.directions(pixels)).sum(-1) > 0
        return np.where(away[:, None], -normal, normal)

    def cosine(self, pixels):
        """Of the angle at which the ray meets the surface; 0 is grazing."""
        return self._cosine(pixels, self.normals(pixels))

    def _cosine(self, pixels, normals):
        d = self.directions(pixels)
        return np.abs((normals * d).sum(-1)) / np.linalg.norm(d, axis=-1)

    def near_edge(self, answer, pixels, distance_px):
        """Whether `answer(pixels)` changes within `distance_px` of each pixel."""
        if not len(pixels):
            return np.zeros(0, bool)
        here = answer(pixels)
        changes = np.zeros(len(pixels), bool)
        for step in ROUND:
            changes |= answer(pixels + distance_px * np.array(step)) != here
        return changes

    def label(self, pixels):
        return self.hits(pixels)[2]
