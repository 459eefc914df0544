"""Houses seen from outside: a block with a facade, windows, a door and a gabled roof. Lengths are in metres.

The frame of a facade has x along it, y into the house and z up; its origin is at the left end of its foot.
"""

import numpy as np

from twinlens.families.composition import Composition
from twinlens.families.draws import Rng, one_of
from twinlens.families.furniture import board
from twinlens.families.materials import furniture_material
from twinlens.families.surfaces import Sheet
from twinlens.families.things.sweeps import copies
from twinlens.geometry import Float
from twinlens.scenes import shapes
from twinlens.scenes.materials import Material
from twinlens.scenes.placement import translation
from twinlens.scenes.scene import Mesh

_FINE_PIXEL = 0.02  # metres: where pixels are larger, windows are plain boards
_EAVES = 0.25  # metres of a roof before and behind the walls


def add_house(
    scene: Composition, rng: Rng, name: str, sheet: Sheet, deep: float
) -> None:
    """Add a block behind a facade as one object: walls, windows, and to a house that is not far, a door and a roof."""
    wide, tall = sheet.lengths
    pose = np.eye(4)
    pose[:3, :3] = np.column_stack([sheet.u / wide, -sheet.normal, [0, 0, 1]])
    pose[:3, 3] = sheet.corner
    pixel = scene.pixel_at(_nearest_point(scene, sheet), 2.0)
    number = len(scene.objects)
    surfaces: list[tuple[str, Mesh, Material]] = []

    def add(label: str, mesh: Mesh, word: str) -> None:
        look = furniture_material(scene, (name, label, number), word, pixel, number)
        surfaces.append((label, mesh, look))

    block = board((wide, deep, tall), (wide / 2, deep / 2, tall / 2))
    add("facade", block, one_of(rng, ["facade", "facade", "masonry"]))
    windows = _windows(rng, wide, tall, pixel > _FINE_PIXEL)
    if windows is not None:
        add("frames", windows[0], one_of(rng, ["white", "wood", "paint"]))
        add("panes", windows[1], "pane")
    if name == "house":
        high = min(2.1, tall - 0.3)
        door = board((1.0, 0.08, high), (wide - 0.9, -0.03, high / 2))
        add("door", door, "paint")
        rise = float(rng.uniform(1.2, 3.0))
        if rng.random() < 0.5:
            gable = _roof(wide, deep, rise)
            add("roof", shapes.transformed(gable, translation([0, 0, tall])), "roof")
    scene.add_surfaces(name, surfaces, [pose])


def _nearest_point(scene: Composition, sheet: Sheet) -> Float:
    """The point of a facade's foot that is nearest to the camera and in front of it."""
    points = sheet.corner + np.linspace(0, 1, 30)[:, None] * sheet.u
    depth = scene.view.depth(points)
    return np.asarray(points[np.argmin(np.where(depth > 1.0, depth, np.inf))])


def _windows(
    rng: Rng, wide: float, tall: float, is_far: bool
) -> tuple[Mesh, Mesh] | None:
    """Frames and panes of windows in rows and columns, all of one form; None where the facade is too small."""
    width, height = float(rng.uniform(0.7, 1.5)), float(rng.uniform(0.9, 1.6))
    if is_far:  # few and large ones
        width, height = max(width, 0.03 * wide), max(height, 0.1 * tall)
    column, storey = width + rng.uniform(0.6, 1.8), max(2.6, 1.4 * height)
    columns, rows = int((wide - 2.2) / column), int((tall - 0.4) / storey)
    if columns < 1 or rows < 1:
        return None
    pane = board((width, 0.02, height), (0, -0.01, 0))
    frame = _window_frame(width, height)
    if is_far:
        pane = board((width, 0.02, height), (0, -0.06, 0))
        frame = board((width + 0.14, 0.06, height + 0.14), (0, -0.02, 0))
    places = []
    for row in range(rows):
        z = storey * row + 0.9 + height / 2
        places += [
            translation([0.6 + (k + 0.5) * column, 0, z]) for k in range(columns)
        ]
    return copies(frame, np.array(places)), copies(pane, np.array(places))


def _window_frame(width: float, height: float) -> Mesh:
    """Four sides, a bar in the middle and a sill."""
    bars = [board((0.04, 0.05, height), (0, -0.025, 0))]
    for sign in (-1, 1):
        x, z = sign * width / 2, sign * height / 2
        bars.append(board((0.07, 0.09, height), (x, -0.04, 0)))
        bars.append(board((width + 0.07, 0.09, 0.07), (0, -0.04, z)))
    sill = board((width + 0.3, 0.2, 0.05), (0, -0.1, -height / 2 - 0.06))
    return shapes.merged([*bars, sill])


def _roof(wide: float, deep: float, rise: float) -> Mesh:
    """A gabled roof over a block, closed; its foot is at z = 0."""
    low, back = -_EAVES, deep + _EAVES
    corners = np.array(
        [
            [0, low, 0], [wide, low, 0], [wide, back, 0], [0, back, 0],
            [0, deep / 2, rise], [wide, deep / 2, rise],
        ]
    )  # fmt: skip
    faces = np.array(
        [
            (0, 1, 5), (0, 5, 4), (2, 3, 4), (2, 4, 5), (1, 2, 5), (3, 0, 4), (0, 3, 2), (0, 2, 1),
        ]
    )  # fmt: skip
    vertices = corners[faces].reshape(-1, 3)
    index = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
    cross = shapes.face_cross(vertices, index)
    normals = np.repeat(cross / np.linalg.norm(cross, axis=1, keepdims=True), 3, axis=0)
    uv = np.column_stack([vertices[:, 0], np.hypot(vertices[:, 1], vertices[:, 2])])
    return Mesh(vertices, index, normals, uv)
