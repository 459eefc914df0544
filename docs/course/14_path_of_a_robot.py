r"""
The path of a robot
===================

Semi-global matching of a stereo pair gives the depths of a hall, Z = f B / d, and these give points in metres. Points
above the floor are obstacles on a map with cells of 5 cm. The cheapest path for a robot with a radius of 25 cm follows
from the cost T(i) of reaching cell i, which spreads from the start over the eight neighbours j of each cell:

.. math::

    T(i) = \min_j \left( T(j) + |i - j| \, \frac{w(i) + w(j)}{2} \right)

The weight w is 1 on seen floor and 4 where nothing was seen.

On the map, red cells are obstacles, white ones floor, and grey ones were not seen. The script reads
:download:`hall.toml <../course/hall.toml>` from the current folder.
"""

import matplotlib.pyplot as plt
import numpy as np

import twinlens as tl
from twinlens.reconstruction import view_of_disparity

CELL = 0.05  # metres
X, Y = (-2.0, 2.0), (0.0, 7.0)  # range of the map: world x and y, metres
STEP, HEAD = 0.06, 1.2  # metres: obstacles are points between these heights
RADIUS = 0.25  # radius of the robot, metres
START, GOAL = (0.0, 0.6), (1.2, 6.0)
MIN_POINTS = 3  # points that make a cell an obstacle; fewer may be wrong matches
UNKNOWN_COST = 4.0


def observe(width=480, height=320, spp=16):
    """The left image and its depths by semi-global matching."""
    scene = tl.load_scene("hall.toml")
    rig = tl.Rig.stereo(
        tl.Camera.from_fov(width, height, scene.fov_x_deg),
        scene.baseline,
        scene.world_from_left,
    )
    radiances = tl.render(scene, rig, spp=spp, denoise=True)
    left, right = (
        photo.image
        for photo in tl.Sensor().expose_rig(
            radiances, rig=rig, lens=tl.Pinhole(), seed=1
        )
    )
    count = int(rig.cameras[0].fx * scene.baseline / scene.depth_range[0]) + 1
    disparity = tl.match(
        left, right, method="sgm", num_disparities=count, lr_check=1, speckle_size=60
    )
    return left, view_of_disparity(disparity, rig, image=left)


def cell(place):
    """(row, column) of a position (x, y) in metres."""
    return int((place[1] - Y[0]) / CELL), int((place[0] - X[0]) / CELL)


def count_points(points):
    """The number of points (N, 3) in each cell, row 0 nearest."""
    shape = round((Y[1] - Y[0]) / CELL), round((X[1] - X[0]) / CELL)
    return np.histogram2d(points[:, 1], points[:, 0], bins=shape, range=(Y, X))[0]


def cheapest_path(weights, start, goal):
    """The cells (N, 2) from start to goal; empty if there is no path. Cells of infinite weight are closed."""
    moves = [np.array((dy, dx)) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if dy or dx]
    w = np.pad(weights, 1, constant_values=np.inf)  # so that no move leaves the map
    total = np.full(w.shape, np.inf)
    start, goal = np.add(start, 1), np.add(goal, 1)
    total[tuple(start)] = 0.0

    def through(move):
        """The cost of reaching each cell through the neighbour at `move`."""
        near_total, near_w = (np.roll(grid, -move, axis=(0, 1)) for grid in (total, w))
        return near_total + np.hypot(*move) * 0.5 * (w + near_w)

    while True:
        new = np.min([total, *map(through, moves)], axis=0)
        if np.array_equal(new, total):
            break
        total = new
    if np.isinf(total[tuple(goal)]):
        return np.empty((0, 2))
    costs = np.array([through(move) for move in moves])
    path = [goal]
    while tuple(path[-1]) != tuple(start):
        path.append(path[-1] + moves[costs[(slice(None), *path[-1])].argmin()])
    return np.array(path[::-1]) - 1


def plan(view):
    """Obstacle cells, seen cells, and the path (N, 2) in metres from START to GOAL, empty if there is none."""
    points = view.positions()[view.known]
    height = points[:, 2]
    above = count_points(points[(height > STEP) & (height < HEAD)])
    floor = count_points(points[height <= STEP])
    blocked = (above >= MIN_POINTS) & (above > floor)
    seen = blocked | (floor > 0)

    rows, columns = np.indices(blocked.shape)
    closed = (columns < int(RADIUS / CELL)) | (columns[:, ::-1] < int(RADIUS / CELL))
    for row, column in np.argwhere(blocked):  # the robot's centre stays a radius away
        closed |= np.hypot(rows - row, columns - column) <= RADIUS / CELL
    path = cheapest_path(
        np.where(closed, np.inf, np.where(seen, 1.0, UNKNOWN_COST)),
        cell(START),
        cell(GOAL),
    )
    return blocked, seen, (path[:, ::-1] + 0.5) * CELL + (X[0], Y[0])


# %%
# The path in the left image, where no obstacle hides it, and on the map from above, in metres: obstacles red, floor
# white, unseen grey. It keeps the robot's radius away from obstacles.

left, view = observe()
blocked, seen, path = plan(view)

points = np.column_stack([path, np.full(len(path), 0.01)])  # on the floor
pixels = view.rig.project(0, points)
inside = view.camera.contains(pixels)
u, v = np.rint(pixels[inside]).astype(int).T
depth = ((points - view.world_from_cam[:3, 3]) @ view.world_from_cam[:3, 2])[inside]
visible = depth < 1.1 * view.depth[v, u]

colors = np.where(seen[..., None], 255, 170).repeat(3, axis=2)
colors[blocked] = (190, 40, 30)
length = np.linalg.norm(np.diff(path, axis=0), axis=1).sum()

figure, axes = plt.subplots(1, 2, figsize=(5.6, 3.2), width_ratios=(480, 183))
axes[0].imshow(left)
axes[0].plot(u[visible], v[visible], ".", color="gold")
axes[0].set_title("left image")
axes[1].imshow(colors, origin="lower", extent=(*X, *Y))
axes[1].plot(*path.T, color="C0")
axes[1].plot(*START, "o", color="C0")
axes[1].plot(*GOAL, "*", color="C0", markersize=10)
axes[1].set_title(f"path of {length:.1f} m")
axes[0].axis("off")
plt.show()
