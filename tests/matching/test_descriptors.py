"""The cost of descriptor networks: tiny networks made here, whose descriptors are known in closed form."""

import numpy as np
import pytest

import twinlens.matching as tm
from tests.matching.matching_reference import window_cost
from tests.matching.onnx_models import node, save
from twinlens.errors import FileError, InputError
from twinlens.matching.contract import MatcherFailedError

SIDE = 5
RANDOM = np.random.default_rng(0)
RIGHT = RANDOM.integers(0, 256, (14, 40), dtype=np.uint8)
SHIFTED = np.roll(RIGHT, 4, axis=1)
LEFT = SHIFTED * 0.8 + 20 + RANDOM.normal(0, 8, RIGHT.shape)
LEFT = np.clip(LEFT, 0, 255).astype(np.uint8)
SEARCH = {"num_disparities": 11, "min_disparity": -2}
INSIDE = np.s_[SIDE // 2 : -(SIDE // 2), SIDE // 2 + 8 : -(SIDE // 2) - 2]
"""Pixels whose windows, and those of all candidates, lie inside the image."""


def network(path, nodes, channels=1, inputs=("image",), **constants):
    """The cost of a network of one grey image."""
    shape = (1, channels, "h", "w")
    return "onnx:" + save(path, nodes, inputs=inputs, shape=shape, constants=constants)


def patches(path):
    """The pixels of a window without their mean, divided by their length: descriptors whose product is ZNCC."""
    centred = np.eye(SIDE**2, dtype=np.float32) - np.float32(1 / SIDE**2)
    nodes = [
        node("Conv", ["image", "weights"], ["raw"], pads=[SIDE // 2] * 4),
        node("ReduceL2", ["raw", "axes"], ["length"], keepdims=1),
        node("Div", ["raw", "length"], ["out"]),
    ]
    weights = centred.reshape(-1, 1, SIDE, SIDE)
    return network(path, nodes, weights=weights, axes=np.array([1]))


def angles(path):
    """The unit vector of a grey level g, (cos g, sin g), whose product is the cosine of the difference."""
    nodes = [node(kind, ["image"], [kind]) for kind in ("Cos", "Sin")]
    return network(path, [*nodes, node("Concat", ["Cos", "Sin"], ["out"], axis=1)])


def test_descriptors_of_centred_windows_give_zncc(tmp_path):
    cost = patches(tmp_path / "net.onnx")
    ours = tm.StereoMatcher(cost=cost, block_size=1, **SEARCH)
    zncc = tm.StereoMatcher(cost="zncc", block_size=SIDE, **SEARCH)
    volumes = [matcher.cost_volume(LEFT, RIGHT)[INSIDE] for matcher in (ours, zncc)]
    maps = [matcher.match(LEFT, RIGHT)[INSIDE] for matcher in (ours, zncc)]
    np.testing.assert_allclose(*volumes, atol=2e-6)
    np.testing.assert_allclose(*maps, atol=1e-4)


def test_windows_sum_the_costs_of_their_pixels(tmp_path):
    cost = angles(tmp_path / "net.onnx")
    matcher = tm.StereoMatcher(cost=cost, block_size=3, **SEARCH)
    volume = matcher.cost_volume(LEFT, RIGHT)
    cosine_cost = window_cost(
        "angles", LEFT, RIGHT, measure=lambda a, b: (1 - np.cos((a - b) / 255)).sum()
    )
    places = [(0, 9, 0), (7, 20, 5), (13, 39, 8), (4, 30, -2), (13, 0, 0), (5, 37, -2)]
    for y, u, d in places:
        expected = pytest.approx(cosine_cost(y, u, d, 3), abs=1e-5)
        assert volume[y, u, d + 2] == expected
    assert np.isinf(volume[3, 1, 5:]).all()
    assert np.isfinite(volume[3, 1, 0:4]).all()


@pytest.mark.parametrize("text", ["sgm", "sad:support=cross", "sad:lr_check=1"])
def test_all_steps_accept_descriptors(tmp_path, text):
    cost = patches(tmp_path / "net.onnx")
    options = {"cost": cost, "block_size": 1, "num_disparities": 9}
    matcher = tm.parse_method(text).matcher(**options, subpixel="none", threads=2)
    np.testing.assert_array_equal(matcher.match(SHIFTED, RIGHT)[INSIDE], 4)


def test_a_consistency_check_describes_the_images_as_they_are(tmp_path):
    """A network that looks to one side only would describe mirrored images differently."""
    weights = np.zeros((3, 1, 1, 5), np.float32)
    weights[range(3), 0, 0, range(3)] = 1
    nodes = [
        node("Conv", ["image", "weights"], ["raw"], pads=[0, 2, 0, 2]),
        node("ReduceL2", ["raw", "axes"], ["length"], keepdims=1),
        node("Add", ["length", "small"], ["positive"]),
        node("Div", ["raw", "positive"], ["out"]),
    ]
    constants = {"axes": np.array([1]), "small": np.float32([1e-6])}
    cost = network(tmp_path / "net.onnx", nodes, weights=weights, **constants)
    matcher = tm.StereoMatcher(cost=cost, block_size=1, **SEARCH)
    mirrored = RIGHT[:, ::-1]
    _, of_right = matcher.search(SHIFTED, RIGHT)._descriptors
    _, of_mirrored = matcher.search(mirrored, mirrored, mirrored=True)._descriptors
    np.testing.assert_array_equal(of_mirrored[:, ::-1], of_right)


def test_a_changed_network_changes_the_method(tmp_path):
    spec = tm.parse_method(f"sgm:cost={patches(tmp_path / 'net.onnx')}")
    before = spec.spec
    assert "net.onnx=" in before
    assert spec.runs_user_code
    angles(tmp_path / "net.onnx")
    assert spec.spec != before


def test_networks_that_describe_no_pixels_are_refused(tmp_path):
    with pytest.raises(FileError, match=r"none\.onnx"):
        tm.StereoMatcher(cost=f"onnx:{tmp_path / 'none.onnx'}").check_parts()
    half = node("MaxPool", ["image"], ["out"], kernel_shape=[2, 2], strides=[2, 2])
    wrong_size = r"\(1, 1, 7, 20\).*expected \(1, C, 14, 40\)"
    cases = [
        (node("Sub", ["a", "b"], ["out"]), 1, ("a", "b"), InputError, "one input"),
        (half, 1, ("image",), MatcherFailedError, wrong_size),
        (node("Log", ["image"], ["out"]), 1, ("image",), MatcherFailedError, "not finite"),
    ]  # fmt: skip
    for number, (layer, channels, inputs, error, message) in enumerate(cases):
        cost = network(tmp_path / f"{number}.onnx", [layer], channels, inputs)
        with pytest.raises(error, match=message):
            tm.match(LEFT * 0, RIGHT, "sad", cost=cost)
