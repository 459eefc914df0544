"""Tiny networks as .onnx files, whose answers are known."""

import pytest

onnx = pytest.importorskip("onnx")
pytest.importorskip("onnxruntime")
from onnx import TensorProto, helper, numpy_helper  # noqa: E402

node = helper.make_node


def save(
    path,
    nodes,
    *,
    inputs=("left", "right"),
    shape=(1, 3, "h", "w"),
    outputs=("out",),
    constants=None,
):
    """Write the model of these nodes and of constants by name."""

    def tensors(names, size):
        return [
            helper.make_tensor_value_info(name, TensorProto.FLOAT, size)
            for name in names
        ]

    initializers = [
        numpy_helper.from_array(array, name)
        for name, array in (constants or {}).items()
    ]
    graph = helper.make_graph(
        nodes, "tiny", tensors(inputs, shape), tensors(outputs, None), initializers
    )
    opset = [helper.make_opsetid("", 18)]
    model = helper.make_model(graph, opset_imports=opset, ir_version=8)
    onnx.save(model, str(path))
    return str(path)
