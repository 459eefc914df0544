"""Plan the path of a robot through a hall from one stereo pair.

    images -> disparity (semi-global matching) -> points in metres -> obstacle grid -> Dijkstra's shortest path

Run: ``python examples/robot.py robot.png``.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw
from scipy.ndimage import binary_dilation
from skimage.graph import MCP_Geometric

import twinlens as tl
from twinlens.reconstruction import DepthView, view_of_disparity

CELL = 0.05  # metres
X, Y = (-2.0, 2.0), (0.0, 7.0)  # range of the map: world x and y, metres
STEP, HEAD = 0.06, 1.2  # metres: obstacles are points between these heights
RADIUS = 0.25  # radius of the robot, metres
START, GOAL = (0.0, 0.6), (-0.9, 5.9)
MIN_POINTS = 3  # points that make a cell an obstacle; fewer may be wrong matches
UNKNOWN_COST = 4.0  # cost of an unseen cell; a floor cell costs 1


@dataclass(frozen=True)
class Map:
    """Obstacle and seen cells, bool (ny, nx), row 0 nearest; `path` (N, 2) in world metres, empty if there is none."""

    blocked: NDArray[np.bool_]
    seen: NDArray[np.bool_]
    path: NDArray[np.float64]


def observe(size: tuple[int, int] = (480, 320), spp: int = 64) -> tuple[NDArray[np.uint8], DepthView]:
    """The left image and its depths by semi-global matching."""
    scene = tl.load_scene(Path(__file__).with_name("hall.toml"))
    camera = tl.Camera.from_fov(*size, scene.fov_x_deg)
    rig = tl.Rig.stereo(camera, scene.baseline, scene.world_from_left)
    sensor = tl.Sensor()
    photos = sensor.expose_rig(tl.render(scene, rig, spp=spp), rig=rig, lens=tl.Pinhole(), seed=1)
    left, right = (photo.image for photo in photos)
    ndisp = int(camera.fx * scene.baseline / scene.depth_range[0]) + 1
    disparity = tl.match(left, right, method="sgm", num_disparities=ndisp, lr_check=1, speckle_size=60)
    return left, view_of_disparity(disparity, rig, image=left)


def plan(view: DepthView) -> Map:
    """The obstacle grid, and the shortest path from START to GOAL with a clearance of RADIUS."""
    points = view.positions()[view.known]
    height = points[:, 2]
    above, floor = _count(points[(height > STEP) & (height < HEAD)]), _count(points[height <= STEP])
    blocked = (above >= MIN_POINTS) & (above > floor)
    seen = blocked | (floor > 0)
    reach = int(np.ceil(RADIUS / CELL))
    y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1]
    closed = binary_dilation(blocked, np.hypot(x, y) <= RADIUS / CELL)
    near = int(RADIUS / CELL)  # clearance from the left and right ends of the map
    closed[:, :near] = closed[:, -near:] = True
    costs = np.where(closed, -1.0, np.where(seen, 1.0, UNKNOWN_COST))
    graph = MCP_Geometric(costs)
    reached, _ = graph.find_costs([_cell(START)], [_cell(GOAL)])
    if not np.isfinite(reached[_cell(GOAL)]):
        return Map(blocked, seen, np.empty((0, 2)))
    cells = np.array(graph.traceback(_cell(GOAL)))
    return Map(blocked, seen, np.stack([X[0] + (cells[:, 1] + 0.5) * CELL, Y[0] + (cells[:, 0] + 0.5) * CELL], axis=1))


def picture(left: NDArray[np.uint8], view: DepthView, found: Map) -> Image.Image:
    """The path in the left image, and the map from above: obstacles red, floor white, unseen cells grey."""
    photo = Image.fromarray(left)
    path = np.column_stack([found.path, np.full(len(found.path), 0.01)])
    pixels = view.rig.project(0, path)
    dots = pixels[_in_view(view, path, pixels)]
    draw, size = ImageDraw.Draw(photo), max(1.5, photo.height / 120)
    for u, v in dots.tolist():
        draw.ellipse((u - size, v - size, u + size, v + size), fill=(255, 220, 0))
    colors = np.where(found.seen[..., None], np.uint8(255), np.uint8(170)).repeat(3, axis=2)
    colors[found.blocked] = (190, 40, 30)
    for x, y in found.path:
        colors[_cell((x, y))] = (30, 90, 200)
    scale = photo.height / colors.shape[0]
    above = Image.fromarray(colors[::-1]).resize(
        (round(colors.shape[1] * scale), photo.height), Image.Resampling.NEAREST
    )
    both = Image.new("RGB", (photo.width + 8 + above.width, photo.height), "white")
    both.paste(photo, (0, 0))
    both.paste(above, (photo.width + 8, 0))
    return both


def _in_view(view: DepthView, points: NDArray[np.float64], pixels: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether points (N, 3) are visible, by the depths of the view."""
    inside = view.camera.contains(pixels)
    u, v = np.floor(np.where(inside[:, None], pixels, 0.0) + 0.5).astype(int).T
    depth = (points - view.world_from_cam[:3, 3]) @ view.world_from_cam[:3, 2]
    return inside & (depth < 1.1 * view.depth[v, u])


def _count(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """The number of points (N, 3) in each cell, (ny, nx)."""
    shape = round((Y[1] - Y[0]) / CELL), round((X[1] - X[0]) / CELL)
    counts, _, _ = np.histogram2d(points[:, 1], points[:, 0], bins=shape, range=(Y, X))
    return counts.astype(np.int64)


def _cell(place: tuple[float, float]) -> tuple[int, int]:
    """(row, column) of a position (x, y) in metres."""
    return int((place[1] - Y[0]) / CELL), int((place[0] - X[0]) / CELL)


def main(path: str) -> None:
    left, view = observe()
    found = plan(view)
    picture(left, view, found).save(path)
    length = np.linalg.norm(np.diff(found.path, axis=0), axis=1).sum()
    print(f"{path}: {found.seen.mean():.0%} of the floor seen, path of {length:.2f} m")


if __name__ == "__main__":
    main(*sys.argv[1:2] or ["robot.png"])
