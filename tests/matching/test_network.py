"""ONNX models: tiny networks made here, whose answers are known, behind the method `onnx`."""

import sys

import numpy as np
import pytest

import twinlens.matching as tm
from twinlens.errors import FileError, InputError, MissingExtraError
from twinlens.matching.networks import OnnxNetwork

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

GREY = np.random.default_rng(0).integers(0, 256, (10, 14), dtype=np.uint8)
COLOUR = np.random.default_rng(1).integers(0, 256, (10, 14, 3), dtype=np.uint8)
FREE = (1, 3, "h", "w")


def save(
    path, nodes, *, inputs=("left", "right"), shape=FREE, outputs=("out",), constants=()
):
    places = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, shape) for name in inputs
    ]
    ends = [
        helper.make_tensor_value_info(name, TensorProto.FLOAT, None) for name in outputs
    ]
    graph = helper.make_graph(
        nodes,
        "tiny",
        places,
        ends,
        [numpy_helper.from_array(a, n) for n, a in constants],
    )
    model = helper.make_model(
        graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8
    )
    onnx.save(model, str(path))
    return f"onnx:model={path}"


def difference(path, **options):
    """left - right, summed over the channels: (1, 1, H, W)."""
    nodes = [
        helper.make_node("Sub", ["left", "right"], ["gap"]),
        helper.make_node("ReduceSum", ["gap", "axes"], ["out"], keepdims=1),
    ]
    return save(path, nodes, constants=[("axes", np.array([1]))], **options)


def block_matcher(path, count, side):
    """A whole SAD matcher as a network: shift, |.|, box filter, argmin."""
    nodes, costs = [], []
    for d in range(count):
        nodes += [
            helper.make_node("Pad", ["right", f"pads{d}"], [f"moved{d}"], mode="edge"),
            helper.make_node(
                "Slice", [f"moved{d}", "zero", "end", "last"], [f"there{d}"]
            ),
            helper.make_node("Sub", ["left", f"there{d}"], [f"gap{d}"]),
            helper.make_node("Abs", [f"gap{d}"], [f"size{d}"]),
            helper.make_node(
                "AveragePool",
                [f"size{d}"],
                [f"cost{d}"],
                kernel_shape=[side] * 2,
                pads=[side // 2] * 4,
            ),
        ]
        costs.append(f"cost{d}")
    nodes += [
        helper.make_node("Concat", costs, ["costs"], axis=1),
        helper.make_node("ArgMin", ["costs"], ["best"], axis=1, keepdims=0),
        helper.make_node("Cast", ["best"], ["out"], to=TensorProto.FLOAT),
    ]
    constants = [(f"pads{d}", np.array([0, 0, 0, d, 0, 0, 0, 0])) for d in range(count)]
    constants += [
        ("zero", np.array([0])),
        ("end", np.array([64])),
        ("last", np.array([3])),
    ]
    return save(path, nodes, shape=(1, 1, 32, 64), constants=constants)


def test_a_matcher_made_of_layers_finds_the_shift(tmp_path):
    texture = np.random.default_rng(2).integers(0, 256, (30, 66), dtype=np.uint8)
    left, right = texture[:, :60], texture[:, 5:65]
    found = tm.match(left, right, block_matcher(tmp_path / "sad.onnx", 8, 5))
    assert found.shape == left.shape
    assert found.dtype == np.float32
    assert np.mean(found[4:-4, 12:-8] == 5) > 0.99


@pytest.mark.parametrize(("scale", "unit"), [(1.0, 1 / 255), (255.0, 1.0)])
@pytest.mark.parametrize("bits", [8, 16])
def test_the_network_sees_the_images_left_first_in_its_units(
    tmp_path, scale, unit, bits
):
    left, right = (
        image if bits == 8 else image.astype(np.uint16) * 257
        for image in (COLOUR, COLOUR[::-1])
    )
    found = tm.match(
        left, right, f"{difference(tmp_path / 'net.onnx')},scale={scale},multiple=8"
    )
    wanted = (COLOUR.astype(float) - COLOUR[::-1]).sum(axis=2) * unit
    np.testing.assert_allclose(found, wanted, atol=1e-4 * scale)


def test_grey_images_fill_three_channels_and_colour_becomes_luma_for_one(tmp_path):
    three, one = (
        difference(tmp_path / "3.onnx"),
        difference(tmp_path / "1.onnx", shape=(1, 1, "h", "w")),
    )
    flat = GREY.astype(float) - GREY[::-1]
    np.testing.assert_allclose(
        tm.match(GREY, GREY[::-1], three), 3 * flat / 255, atol=1e-4
    )
    np.testing.assert_allclose(tm.match(GREY, GREY[::-1], one), flat / 255, atol=1e-4)
    luma = COLOUR @ np.array([0.299, 0.587, 0.114]) / 255
    np.testing.assert_allclose(
        tm.match(COLOUR, COLOUR[::-1], one), luma - luma[::-1], atol=1e-4
    )


@pytest.mark.parametrize("axes", [(), (0,), (0, 1)])
def test_every_layout_of_the_answer_comes_back_the_same(tmp_path, axes):
    nodes = [helper.make_node("ReduceSum", ["left", "one"], ["flat"], keepdims=1)]
    constants = [("one", np.array([1]))]
    if axes:
        nodes.append(helper.make_node("Squeeze", ["flat", "axes"], ["out"]))
        constants.append(("axes", np.array(axes)))
    else:
        nodes.append(helper.make_node("Identity", ["flat"], ["out"]))
    found = tm.match(
        COLOUR, COLOUR, save(tmp_path / "net.onnx", nodes, constants=constants)
    )
    np.testing.assert_allclose(found, COLOUR.sum(axis=2) / 255, atol=1e-5)


def test_the_output_and_its_sign_are_chosen(tmp_path):
    nodes = [
        helper.make_node("ReduceSum", ["left", "one"], ["first"], keepdims=1),
        helper.make_node("ReduceSum", ["right", "one"], ["last"], keepdims=1),
    ]
    path = tmp_path / "net.onnx"
    text = save(
        path, nodes, outputs=("first", "last"), constants=[("one", np.array([1]))]
    )
    first, last = COLOUR.sum(axis=2) / 255, COLOUR[::-1].sum(axis=2) / 255
    np.testing.assert_allclose(tm.match(COLOUR, COLOUR[::-1], text), last, atol=1e-5)
    np.testing.assert_allclose(
        tm.match(COLOUR, COLOUR[::-1], f"{text},output=0"), first, atol=1e-5
    )
    np.testing.assert_allclose(
        tm.match(COLOUR, COLOUR[::-1], f"{text},sign=-1"), -last, atol=1e-5
    )
    assert tm.match_with_confidence(COLOUR, COLOUR[::-1], text)[1] is None
    disparity, confidence = tm.match_with_confidence(
        COLOUR, COLOUR[::-1], f"{text},confidence=0,sign=-1"
    )
    np.testing.assert_allclose(disparity, -last, atol=1e-5)
    np.testing.assert_allclose(confidence, first, atol=1e-5)
    with pytest.raises(InputError, match="2 outputs; confidence is 2"):
        tm.match_with_confidence(COLOUR, COLOUR, f"{text},confidence=2")
    with pytest.raises(InputError, match="2 outputs; output is 2"):
        tm.match(COLOUR, COLOUR, f"{text},output=2")


def test_a_network_of_fixed_size_takes_what_fits(tmp_path):
    text = difference(tmp_path / "net.onnx", shape=(1, 3, 16, 16))
    assert tm.match(COLOUR, COLOUR, text).shape == (10, 14)
    wide = np.zeros((10, 17, 3), np.uint8)
    with pytest.raises(InputError, match="up to 16 pixels a side; this one has 17"):
        tm.match(wide, wide, text)


def test_another_file_of_the_same_name_is_read_anew(tmp_path):
    path = tmp_path / "net.onnx"
    before = tm.match(COLOUR, COLOUR[::-1], difference(path))
    save(
        path,
        [helper.make_node("ReduceSum", ["right", "one"], ["out"])],
        constants=[("one", np.array([1]))],
    )
    assert not np.allclose(tm.match(COLOUR, COLOUR[::-1], f"onnx:model={path}"), before)


def test_a_network_consists_of_its_file_and_the_data_beside_it(tmp_path):
    path, seen = tmp_path / "net.onnx", set()
    network = OnnxNetwork(str(path))
    for data in (b"a", b"bb"):
        path.write_bytes(data)
        seen.add(network.content)
    (tmp_path / "net.onnx.data").write_bytes(b"weights")
    seen.add(network.content)
    (tmp_path / "other.onnx").write_bytes(b"another's")
    assert len(seen) == 3
    assert network.content in seen
    assert OnnxNetwork(str(tmp_path / "none.onnx")).content == "none.onnx=absent"


def constant_output(path, value, shape):
    nodes = [
        helper.make_node("Add", ["left", "right"], ["unused"]),
        helper.make_node("Identity", ["answer"], ["out"]),
    ]
    return save(path, nodes, constants=[("answer", np.full(shape, value, np.float32))])


@pytest.mark.parametrize(
    ("value", "shape", "message"),
    [
        (np.nan, (1, 1, 32, 32), "returned nan at"),
        (-np.inf, (1, 32, 32), "returned -inf at"),
        (
            1.0,
            (1, 1, 16, 16),
            r"returned shape \(16, 16\); the left image has \(32, 32\)",
        ),
        (1.0, (1, 2, 32, 32), r"expected \(1, 1, H, W\)"),
        (1.0, (32,), r"expected \(1, 1, H, W\)"),
    ],
)
def test_a_wrong_answer_is_refused(tmp_path, value, shape, message):
    with pytest.raises(InputError, match=message):
        tm.match(COLOUR, COLOUR, constant_output(tmp_path / "net.onnx", value, shape))


def test_an_unknown_disparity_is_infinite(tmp_path):
    found = tm.match(
        COLOUR, COLOUR, constant_output(tmp_path / "net.onnx", np.inf, (32, 32))
    )
    assert np.isposinf(found).all()


def test_models_that_are_no_stereo_networks_are_refused(tmp_path):
    one = save(
        tmp_path / "one.onnx",
        [helper.make_node("Identity", ["left"], ["out"])],
        inputs=("left",),
    )
    with pytest.raises(
        InputError,
        match=r"has 1 inputs; a stereo model has two, left and right; .* sgm:cost=onnx:",
    ):
        tm.match(COLOUR, COLOUR, one)
    with pytest.raises(InputError, match="has 4 channels; images have 1 or 3"):
        tm.match(
            COLOUR, COLOUR, difference(tmp_path / "four.onnx", shape=(1, 4, "h", "w"))
        )
    with pytest.raises(InputError, match=r"expected float \(1, C, H, W\)"):
        tm.match(
            COLOUR,
            COLOUR,
            save(
                tmp_path / "flat.onnx",
                [helper.make_node("Add", ["left", "right"], ["out"])],
                shape=("h", "w"),
            ),
        )


def test_files_that_are_no_models_are_named(tmp_path):
    (tmp_path / "bad.onnx").write_bytes(b"hello")
    with pytest.raises(FileError, match=r"bad\.onnx: not an ONNX model"):
        tm.match(COLOUR, COLOUR, f"onnx:model={tmp_path / 'bad.onnx'}")
    for method in (
        f"onnx:model={tmp_path / 'bad.onnx'}",
        f"sgm:cost=onnx:{tmp_path / 'bad.onnx'}",
    ):
        with pytest.raises(FileError, match=r"bad\.onnx: not an ONNX model"):
            tm.parse_method(method).check_parts()  # before a benchmark starts
    with pytest.raises(FileError, match=r"none\.onnx: No such file"):
        tm.match(COLOUR, COLOUR, f"onnx:model={tmp_path / 'none.onnx'}")


def test_without_onnxruntime_the_extra_is_named(tmp_path, monkeypatch):
    text = difference(tmp_path / "net.onnx")
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    with pytest.raises(MissingExtraError, match=r"twinlens\[onnx\]"):
        tm.match(COLOUR, COLOUR, text)
