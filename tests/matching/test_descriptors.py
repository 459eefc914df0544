"""The cost of descriptor networks: tiny networks made here, whose descriptors are known in closed form."""

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import FileError, InputError
from twinlens.matching.contract import MatcherFailedError

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

SIDE = 5
RANDOM = np.random.default_rng(0)
RIGHT = RANDOM.integers(0, 256, (14, 40), dtype=np.uint8)
LEFT = np.clip(
    np.roll(RIGHT, 4, axis=1) * 0.8 + 20 + RANDOM.normal(0, 8, RIGHT.shape), 0, 255
).astype(np.uint8)
SEARCH = {"num_disparities": 11, "min_disparity": -2}
INSIDE = np.s_[SIDE // 2 : -(SIDE // 2), SIDE // 2 + 8 : -(SIDE // 2) - 2]
"""Pixels whose windows, and those of all candidates, lie inside the image."""


def save(path, nodes, constants=(), channels=1, inputs=("image",)):
    places = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, channels, "h", "w"))
        for name in inputs
    ]
    ends = [helper.make_tensor_value_info("out", TensorProto.FLOAT, None)]
    graph = helper.make_graph(
        nodes,
        "tiny",
        places,
        ends,
        [numpy_helper.from_array(a, n) for n, a in constants],
    )
    onnx.save(
        helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8
        ),
        str(path),
    )
    return f"onnx:{path}"


def patches(path):
    """The pixels of a window without their mean, divided by their length: descriptors whose product is ZNCC."""
    centred = np.eye(SIDE**2, dtype=np.float32) - np.float32(1 / SIDE**2)
    nodes = [
        helper.make_node("Conv", ["image", "weights"], ["raw"], pads=[SIDE // 2] * 4),
        helper.make_node("ReduceL2", ["raw", "axes"], ["length"], keepdims=1),
        helper.make_node("Div", ["raw", "length"], ["out"]),
    ]
    constants = [
        ("weights", centred.reshape(-1, 1, SIDE, SIDE)),
        ("axes", np.array([1])),
    ]
    return save(path, nodes, constants)


def angles(path):
    """The unit vector of a grey level g, (cos g, sin g), whose product is the cosine of the difference."""
    nodes = [helper.make_node(kind, ["image"], [kind]) for kind in ("Cos", "Sin")]
    return save(
        path, [*nodes, helper.make_node("Concat", ["Cos", "Sin"], ["out"], axis=1)]
    )


def test_descriptors_of_centred_windows_give_zncc(tmp_path):
    cost = patches(tmp_path / "net.onnx")
    ours = tm.StereoMatcher(cost=cost, block_size=1, **SEARCH)
    zncc = tm.StereoMatcher(cost="zncc", block_size=SIDE, **SEARCH)
    np.testing.assert_allclose(
        ours.cost_volume(LEFT, RIGHT)[INSIDE],
        zncc.cost_volume(LEFT, RIGHT)[INSIDE],
        atol=2e-6,
    )
    np.testing.assert_allclose(
        ours.match(LEFT, RIGHT)[INSIDE], zncc.match(LEFT, RIGHT)[INSIDE], atol=1e-4
    )


def test_windows_sum_the_costs_of_their_pixels(tmp_path):
    matcher = tm.StereoMatcher(
        cost=angles(tmp_path / "net.onnx"), block_size=3, **SEARCH
    )
    volume = matcher.cost_volume(LEFT, RIGHT)
    for y, u, d in [
        (0, 9, 0),
        (7, 20, 5),
        (13, 39, 8),
        (4, 30, -2),
        (13, 0, 0),
        (5, 37, -2),
    ]:
        pixels = [
            (np.clip(y + i, 0, 13), u + k) for i in (-1, 0, 1) for k in (-1, 0, 1)
        ]
        pairs = [
            (LEFT[v, min(max(x, 0), 39)], RIGHT[v, min(max(x - d, 0), 39)])
            for v, x in pixels
        ]
        expected = sum(1 - np.cos((float(a) - float(b)) / 255) for a, b in pairs)
        assert volume[y, u, d + 2] == pytest.approx(expected, abs=1e-5)
    assert np.isinf(volume[3, 1, 5:]).all()
    assert np.isfinite(volume[3, 1, 0:4]).all()


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize(
    "text",
    [
        "sgm:block_size=1",
        "sad:block_size=1,support=cross",
        "sad:block_size=1,lr_check=1",
    ],
)
def test_all_steps_accept_descriptors(tmp_path, text, threads):
    text = f"{text},cost={patches(tmp_path / 'net.onnx')},num_disparities=9,subpixel=none,threads={threads}"
    found = tm.parse_method(text).match(np.roll(RIGHT, 4, axis=1), RIGHT)
    np.testing.assert_array_equal(found[INSIDE], 4)


def test_a_consistency_check_describes_the_images_as_they_are(tmp_path):
    """A network that looks to one side only would describe mirrored images differently."""
    weights = np.zeros((3, 1, 1, 5), np.float32)
    weights[0, 0, 0, 0], weights[1, 0, 0, 1], weights[2, 0, 0, 2] = 1, 1, 1
    nodes = [
        helper.make_node("Conv", ["image", "weights"], ["raw"], pads=[0, 2, 0, 2]),
        helper.make_node("ReduceL2", ["raw", "axes"], ["length"], keepdims=1),
        helper.make_node("Add", ["length", "small"], ["positive"]),
        helper.make_node("Div", ["raw", "positive"], ["out"]),
    ]
    constants = [
        ("weights", weights),
        ("axes", np.array([1])),
        ("small", np.float32([1e-6])),
    ]
    matcher = tm.StereoMatcher(
        cost=save(tmp_path / "net.onnx", nodes, constants), block_size=1, **SEARCH
    )
    _, one = matcher.search(np.roll(RIGHT, 4, axis=1), RIGHT)._descriptors
    _, other = matcher.search(
        RIGHT[:, ::-1], RIGHT[:, ::-1], mirrored=True
    )._descriptors
    np.testing.assert_array_equal(other[:, ::-1], one)


def test_a_changed_network_changes_the_method(tmp_path):
    spec = tm.parse_method(f"sgm:cost={patches(tmp_path / 'net.onnx')}")
    before = spec.spec
    assert "net.onnx=" in before
    assert spec.runs_user_code
    angles(tmp_path / "net.onnx")
    assert spec.spec != before


def test_errors(tmp_path):
    with pytest.raises(InputError, match=r"cost=onnx:net\.onnx"):
        tm.StereoMatcher(cost="onnx:net.txt")
    absent = tm.StereoMatcher(cost=f"onnx:{tmp_path / 'none.onnx'}")
    for call in (absent.check_parts, lambda: absent.match(LEFT, RIGHT)):
        with pytest.raises(FileError, match=r"none\.onnx"):
            call()
    same = [helper.make_node("Identity", ["image"], ["out"])]
    with pytest.raises(InputError, match="one input"):
        tm.match(LEFT, RIGHT, "sad", cost=save(tmp_path / "rgb.onnx", same, channels=3))
    two = [helper.make_node("Sub", ["image", "other"], ["out"])]
    with pytest.raises(InputError, match="one input"):
        tm.match(
            LEFT,
            RIGHT,
            "sad",
            cost=save(tmp_path / "two.onnx", two, inputs=("image", "other")),
        )
    half = [
        helper.make_node(
            "MaxPool", ["image"], ["out"], kernel_shape=[2, 2], strides=[2, 2]
        )
    ]
    with pytest.raises(
        MatcherFailedError, match=r"\(1, 1, 7, 20\).*expected \(1, C, 14, 40\)"
    ):
        tm.match(LEFT, RIGHT, "sad", cost=save(tmp_path / "half.onnx", half))
    endless = [helper.make_node("Log", ["image"], ["out"])]
    with pytest.raises(MatcherFailedError, match="not finite"):
        tm.match(LEFT * 0, RIGHT, "sad", cost=save(tmp_path / "log.onnx", endless))
