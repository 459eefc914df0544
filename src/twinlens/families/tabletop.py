"""The family "tabletop": a still life of bodies at rest on a table, with a wall behind and light from one side."""

import math

import numpy as np

from twinlens.families import lighting
from twinlens.families.arrangement import Area, arrange, bodies_at_rest
from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, one_of
from twinlens.families.surfaces import (
    FLOORS,
    TOPS,
    WALLS,
    Sheet,
    surface,
    surface_pattern,
    wall_colors,
)
from twinlens.geometry import Float
from twinlens.scenes.scene import Mesh
from twinlens.scenes.stable_poses import StablePose

_TABLE_HEIGHT = 0.74
_THICKNESS = 0.035


NAMES = frozenset(("table", "wall", "floor", "sun", "key-light", "fill-light"))
"""Names of what scenes have besides bodies, without numbers."""


def compose(scene: Composition) -> None:
    """Add the bodies, then table, wall and floor at suitable distances, then lights."""
    depth_ratio = scene.depth_ratio(2.0, 5.0)
    _set_view(scene, depth_ratio)
    half = float(
        0.5 * scene.view.covered(float(scene.view.depth(np.zeros((1, 3)))[0]))[0]
    )
    _add_still_life(scene, half)
    _add_surroundings(scene, depth_ratio, half)
    rng = scene.rng("light")
    if not (
        scene.assets.hdris
        and rng.random() < 0.6
        and lighting.user_environment(scene, rng)
    ):
        light = lighting.daylight if rng.random() < 0.25 else lighting.key_and_fill
        light(scene, rng, np.array([0.0, 0.0, 0.1]), half)


def _set_view(scene: Composition, depth_ratio: float) -> None:
    """Look down at the origin; the larger the depth ratio, the nearer the camera and the wider its field."""
    rng = scene.rng("view")
    pitch, fov = math.radians(rng.uniform(14, 36)), rng.uniform(38, 56)
    while fov > 12:
        half = math.atan(math.tan(math.radians(fov) / 2) / scene.aspect)
        if (
            math.sin(pitch) * math.cos(half) / math.sin(pitch + half)
            >= 1.45 / depth_ratio
        ):
            break  # depth of the table at the picture's lower edge over that at its middle
        fov *= 0.94
    distance = rng.uniform(0.34, 0.46) / math.tan(math.radians(fov) / 2)
    aim = np.array([0.0, 0.0, 0.07])
    scene.look(
        distance * np.array([0.0, -math.cos(pitch), math.sin(pitch)]) + aim, aim, fov
    )


def _add_still_life(scene: Composition, half: float) -> None:
    """Add bodies in a loose group around the origin, the large ones first and towards the back."""
    bodies = bodies_at_rest(scene, "body", [(index,) for index in range(scene.count)])
    bodies.sort(key=lambda each: -each[1].height * np.ptp(each[1].points[:, 0]))

    def sample(rng: Rng, rest: StablePose) -> Float:
        back = 0.5 * min(rest.height / 0.3, 1.0) - 0.15
        return np.asarray(np.clip(rng.normal([0.0, back], [0.55, 0.45]), -1, 1))

    spacing = float(scene.rng("spacing").uniform(0.003, 0.02))
    area = Area(
        np.zeros(2), np.array([0.8, 0.7]) * half, 0.0, spacing, 0.3, 1.15, sample
    )
    for placement in arrange(bodies, area):
        body = placement.body
        scene.add(
            body.name,
            body.solid.mesh,
            body.material(scene.pixel_at(placement.at.place)),
            placement.pose,
        )


def _add_surroundings(scene: Composition, depth_ratio: float, half: float) -> None:
    """Add the table, and the wall at the distance that gives the depth ratio; a floor where the table has an edge."""
    rng, view = scene.rng("surroundings"), scene.view
    behind = (
        max(
            (float(vertices[:, 1].max()) for vertices, _ in scene.triangles),
            default=half,
        )
        + 0.02
    )
    near_y = float(view.eye[1])
    edge = behind + rng.uniform(0.03, 0.25) if rng.random() < 0.6 else None
    table_half = half * rng.uniform(1.6, 3.0)

    def sheets(distance: float) -> dict[str, Sheet]:
        y = max(near_y + distance, behind + 0.05)
        width = max(2.0 * view.covered(distance)[0], 2.2 * table_half)
        far = y if edge is None else min(edge, y)
        high = 1.2 * view.covered(distance)[1] + 1.0 + _TABLE_HEIGHT
        corners_and_sides = {
            "table": [
                (-table_half, near_y, 0.0),
                (2 * table_half, 0, 0),
                (0, far - near_y, 0),
            ],
            "wall": [(-width / 2, y, -_TABLE_HEIGHT), (width, 0, 0), (0, 0, high)],
        }
        if edge is not None:
            corners_and_sides["floor"] = [
                (-width / 2, near_y, -_TABLE_HEIGHT),
                (width, 0, 0),
                (0, y - near_y, 0),
            ]
        return {
            name: Sheet(*np.array(vectors))
            for name, vectors in corners_and_sides.items()
        }

    def meshes(distance: float) -> list[Mesh]:
        return [sheet.mesh() for sheet in sheets(distance).values()]

    far = scene.visible_range(meshes(depth_ratio))[0] * depth_ratio
    patterns = {"table": (TOPS, 0.8), "wall": (WALLS, 0.45), "floor": (FLOORS, 0.6)}
    rng = scene.rng("furnish")
    for name, sheet in sheets(scene.backdrop_distance(meshes, far, far)).items():
        kinds, contrast = patterns[name]
        kind, tile = surface_pattern(rng, kinds, scene.plain_surfaces)
        colors = wall_colors(scene.rng(f"{name} colours"), scene.palette, contrast)
        finish = (
            one_of(rng, ["matte", "satin", "satin", "clearcoat"])
            if name == "table"
            else "matte"
        )
        made = surface(scene, scene.rng(name), sheet, kind, colors, tile, finish)
        scene.add(name, sheet.mesh(_THICKNESS if name == "table" else 0.0), made)
