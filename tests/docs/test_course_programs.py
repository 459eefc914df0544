"""The programs of docs/course: the path of a robot and the inserted object."""

import runpy
from pathlib import Path
from types import SimpleNamespace

import matplotlib as mpl
import numpy as np
import pytest
from skimage.graph import MCP_Geometric

COURSE = Path(__file__).parents[2] / "docs" / "course"
pytestmark = pytest.mark.skipif(
    not COURSE.is_dir(), reason="docs/ is not next to tests/"
)


def run(name):
    """The names of a script of the course after its run."""
    import matplotlib.pyplot as plt

    with mpl.rc_context({"backend": "agg"}), pytest.MonkeyPatch.context() as patch:
        patch.setattr(plt, "show", lambda: None)
        patch.chdir(COURSE)
        names = SimpleNamespace(**runpy.run_path(str(COURSE / f"{name}.py")))
        plt.close("all")
    return names


def clearance(path, inside):
    """The smallest distance, metres, from a path (N, 2) to the points of the floor that are `inside` an obstacle."""
    x, y = np.meshgrid(np.arange(-2, 2, 0.02), np.arange(1, 5.6, 0.02))
    solid = np.stack([x, y], axis=-1)[inside(x, y)]
    return np.linalg.norm(path[:, None] - solid[None], axis=2).min()


def box(centre, size, degrees):
    a = np.radians(degrees)

    def inside(x, y):
        u = (x - centre[0]) * np.cos(a) + (y - centre[1]) * np.sin(a)
        v = -(x - centre[0]) * np.sin(a) + (y - centre[1]) * np.cos(a)
        return (np.abs(u) < size[0] / 2) & (np.abs(v) < size[1] / 2)

    return inside


@pytest.fixture(scope="module")
def robot():
    return run("14_path_of_a_robot")


def test_the_path_reaches_the_goal_with_clearance_from_the_true_obstacles(robot):
    path = robot.path
    assert np.allclose(path[0], robot.START, atol=robot.CELL)
    assert np.allclose(path[-1], robot.GOAL, atol=robot.CELL)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    assert steps.max() < 1.5 * robot.CELL
    assert steps.sum() < 1.7 * np.linalg.norm(np.subtract(robot.GOAL, robot.START))
    for body in (
        box((-0.1, 2.4), (0.6, 0.5), 15),
        box((-1.3, 3.2), (0.6, 0.6), -20),
        box((0.35, 4.4), (0.7, 0.6), 35),
        lambda x, y: np.hypot(x - 1.15, y - 3.1) < 0.2,
    ):
        assert clearance(path, body) > robot.RADIUS - 2 * robot.CELL
    assert robot.visible.sum() > 50  # points of the path in the image


def test_the_path_is_the_cheapest(robot):
    """Its cost equals that of scikit-image's Dijkstra."""
    weights = np.random.default_rng(0).uniform(1, 5, (30, 20))
    weights[10, 2:] = weights[20, :-2] = np.inf
    path = robot.cheapest_path(weights, (1, 15), (28, 3))
    middle = 0.5 * (weights[tuple(path[1:].T)] + weights[tuple(path[:-1].T)])
    graph = MCP_Geometric(np.where(np.isinf(weights), -1, weights))
    costs, _ = graph.find_costs([(1, 15)], [(28, 3)])
    assert (path[0].tolist(), path[-1].tolist()) == ([1, 15], [28, 3])
    assert (
        middle * np.linalg.norm(np.diff(path, axis=0), axis=1)
    ).sum() == pytest.approx(costs[28, 3])
