"""ONNX models: tiny networks made here, whose answers are known, behind the method `onnx`."""

import numpy as np
import pytest

import twinlens.matching as tm
from tests.matching.onnx_models import node, save
from twinlens.errors import FileError, InputError
from twinlens.matching.networks import OnnxNetwork

GREY = np.random.default_rng(0).integers(0, 256, (10, 14), dtype=np.uint8)
COLOUR = np.random.default_rng(1).integers(0, 256, (10, 14, 3), dtype=np.uint8)
UPSIDE_DOWN = COLOUR[::-1]
ONE = {"one": np.array([1])}


def sum_of(image, output):
    """The sum over the channels: (1, 1, H, W)."""
    return node("ReduceSum", [image, "one"], [output], keepdims=1)


def difference(path, **options):
    """left - right, summed over the channels."""
    nodes = [node("Sub", ["left", "right"], ["gap"]), sum_of("gap", "out")]
    return "onnx:model=" + save(path, nodes, constants=ONE, **options)


@pytest.mark.parametrize("scale", [1.0, 255.0])
@pytest.mark.parametrize("wider", [1, np.uint16(257)])
def test_the_network_sees_the_images_left_first_in_its_units(tmp_path, scale, wider):
    method = f"{difference(tmp_path / 'net.onnx')},scale={scale},multiple=8"
    disparity = tm.match(COLOUR * wider, UPSIDE_DOWN * wider, method)
    expected = (COLOUR.astype(float) - UPSIDE_DOWN).sum(axis=2) * scale / 255
    np.testing.assert_allclose(disparity, expected, atol=1e-4 * scale)


def test_grey_images_fill_three_channels_and_colour_becomes_luma_for_one(tmp_path):
    three = difference(tmp_path / "3.onnx")
    one = difference(tmp_path / "1.onnx", shape=(1, 1, "h", "w"))
    grey = GREY.astype(float) / 255
    luma = COLOUR @ np.array([0.299, 0.587, 0.114]) / 255
    for images, network, levels in (
        (GREY, three, 3 * grey),
        (GREY, one, grey),
        (COLOUR, one, luma),
    ):
        disparity = tm.match(images, images[::-1], network)
        np.testing.assert_allclose(disparity, levels - levels[::-1], atol=1e-4)


@pytest.mark.parametrize("axes", [(0,), (0, 1)])
def test_every_layout_of_the_answer_comes_back_the_same(tmp_path, axes):
    constants = ONE | {"axes": np.array(axes, np.int64)}
    nodes = [sum_of("left", "flat"), node("Squeeze", ["flat", "axes"], ["out"])]
    model = save(tmp_path / "net.onnx", nodes, constants=constants)
    disparity = tm.match(COLOUR, COLOUR, f"onnx:{model}")
    np.testing.assert_allclose(disparity, COLOUR.sum(axis=2) / 255, atol=1e-5)
    assert disparity.dtype == np.float32


def test_the_outputs_and_the_sign_are_chosen(tmp_path):
    nodes = [sum_of("left", "first"), sum_of("right", "last")]
    model = save(tmp_path / "net.onnx", nodes, outputs=("first", "last"), constants=ONE)
    method = f"onnx:model={model}"
    first, last = COLOUR.sum(axis=2) / 255, UPSIDE_DOWN.sum(axis=2) / 255
    pair = COLOUR, UPSIDE_DOWN
    np.testing.assert_allclose(tm.match(*pair, method), last, atol=1e-5)
    np.testing.assert_allclose(tm.match(*pair, f"{method},output=0"), first, atol=1e-5)
    answer = tm.match_with_confidence(*pair, f"{method},confidence=0,sign=-1")
    np.testing.assert_allclose(answer.disparity, -last, atol=1e-5)
    np.testing.assert_allclose(answer.confidence, first, atol=1e-5)
    with pytest.raises(InputError, match="2 outputs; output is 2"):
        tm.match(*pair, f"{method},output=2")


def test_a_network_of_fixed_size_takes_what_fits(tmp_path):
    method = difference(tmp_path / "net.onnx", shape=(1, 3, 16, 16))
    assert tm.match(COLOUR, COLOUR, method).shape == (10, 14)
    wide = np.zeros((10, 17, 3), np.uint8)
    with pytest.raises(InputError, match="up to 16 pixels a side; this one has 17"):
        tm.match(wide, wide, method)


def test_another_file_of_the_same_name_is_read_again(tmp_path):
    path = tmp_path / "net.onnx"
    method = difference(path)
    before = tm.match(COLOUR, UPSIDE_DOWN, method)
    save(path, [sum_of("right", "out")], constants=ONE)
    assert not np.allclose(tm.match(COLOUR, UPSIDE_DOWN, method), before)


def test_a_network_consists_of_its_file_and_the_data_beside_it(tmp_path):
    path = tmp_path / "net.onnx"
    network, contents = OnnxNetwork(str(path)), []
    for name, data in (
        ("net.onnx", b"a"),
        ("net.onnx", b"bb"),
        ("net.onnx.data", b"weights"),
        ("other.onnx", b"another's"),
    ):
        (tmp_path / name).write_bytes(data)
        contents.append(network.content)
    assert len(set(contents[:3])) == 3
    assert contents[3] == contents[2]
    assert OnnxNetwork(str(tmp_path / "none.onnx")).content == "none.onnx=absent"


@pytest.mark.parametrize(
    ("value", "shape", "message"),
    [
        (np.nan, (1, 1, 32, 32), "returned nan at"),
        (1.0, (1, 1, 16, 16), r"shape \(16, 16\); the left image has \(32, 32\)"),
        (1.0, (32,), r"expected \(1, 1, H, W\)"),
        (np.inf, (32, 32), None),
    ],
)
def test_wrong_answers_are_refused_and_unknown_disparities_are_not(
    tmp_path, value, shape, message
):
    nodes = [
        node("Add", ["left", "right"], ["unused"]),
        node("Identity", ["answer"], ["out"]),
    ]
    constants = {"answer": np.full(shape, value, np.float32)}
    method = "onnx:" + save(tmp_path / "net.onnx", nodes, constants=constants)
    if message is None:
        assert np.isposinf(tm.match(COLOUR, COLOUR, method)).all()
        return
    with pytest.raises(InputError, match=message):
        tm.match(COLOUR, COLOUR, method)


def test_models_that_are_no_stereo_networks_are_refused(tmp_path):
    single = [node("Identity", ["left"], ["out"])]
    flat = [node("Add", ["left", "right"], ["out"])]
    for name, nodes, options, message in (
        ("one", single, {"inputs": ("left",)}, "1 input; .* sgm:cost=onnx:"),
        ("four", flat, {"shape": (1, 4, "h", "w")}, "4 channels; images have 1 or 3"),
        ("flat", flat, {"shape": ("h", "w")}, r"expected float \(1, C, H, W\)"),
    ):
        model = save(tmp_path / f"{name}.onnx", nodes, **options)
        with pytest.raises(InputError, match=message):
            tm.match(COLOUR, COLOUR, f"onnx:{model}")


def test_files_that_are_no_models_are_named(tmp_path):
    bad = tmp_path / "bad.onnx"
    bad.write_bytes(b"hello")
    # Before a benchmark starts.
    with pytest.raises(FileError, match=r"bad\.onnx: not an ONNX model"):
        tm.parse_method(f"sgm:cost=onnx:{bad}").check_parts()
    with pytest.raises(FileError, match=r"none\.onnx: No such file"):
        tm.match(COLOUR, COLOUR, f"onnx:model={tmp_path / 'none.onnx'}")
