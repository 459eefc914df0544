"""EXT_mesh_gpu_instancing: a node's mesh at many places, against closed forms."""

import numpy as np
import pytest

from tests.scenes.gltf_files import exported, glb, square, with_values
from twinlens.errors import FileError
from twinlens.scenes.assets import SceneContext
from twinlens.scenes.model_files import read_model

MOVES = [[0.0, 0, 0], [2, 0, 0], [0, 3, 1]]
HALF = np.sqrt(0.5)
TURNS = [[0.0, 0, 0, 1], [0, 0, HALF, HALF], [HALF, 0, 0, HALF]]
"""None, a quarter turn about z, a quarter turn about x."""
SIZES = [[1.0, 1, 1], [2, 1, 1], [1, -1, 1]]
CORNERS = np.array([[-0.5, 0, 0], [0.5, 0, 0], [0.5, 1, 0], [-0.5, 1, 0]])
TURNED = [
    CORNERS,
    # (x, y) is scaled to (2 x, y), turned to (-y, 2 x) and moved.
    np.array([[0, -1, 0], [0, 1, 0], [-1, 1, 0], [-1, -1, 0]]) + MOVES[1],
    # (x, y) is mirrored to (x, -y), and turned to (x, 0, -y).
    np.array([[-0.5, 0, 0], [0.5, 0, 0], [0.5, 0, -1], [-0.5, 0, -1]]) + MOVES[2],
]
STORED = {"<f4": 5126, "i1": 5120, "<i2": 5122}


def write_copies(path, attributes, turn_dtype="<f4", pose=None, values=None):
    """A square at many places. `attributes` are arrays (N, C) by name; rotations may be normalized integers."""
    header, binary = exported(square())
    indices = {}
    for name, rows in attributes.items():
        dtype = turn_dtype if name == "ROTATION" else "<f4"
        data = np.asarray(rows, float)
        if dtype != "<f4":
            data = np.round(data * np.iinfo(dtype).max)
        data = data.astype(dtype)
        indices[name] = len(header["accessors"])
        header["bufferViews"].append(
            {"buffer": 0, "byteOffset": len(binary), "byteLength": data.nbytes}
        )
        accessor = {"bufferView": len(header["bufferViews"]) - 1}
        accessor |= {"componentType": STORED[dtype], "count": len(data)}
        accessor |= {"type": f"VEC{data.shape[1]}", "normalized": dtype != "<f4"}
        header["accessors"].append(accessor)
        binary += data.tobytes().ljust(-(-data.nbytes // 4) * 4, b"\0")
    header["buffers"][0]["byteLength"] = len(binary)
    header["scenes"] = [{"nodes": [0]}]
    header = with_values(header, values or {})
    table = {"EXT_mesh_gpu_instancing": {"attributes": indices}}
    header["nodes"] = [
        {**(pose or {}), "children": [1]},
        {"mesh": 0, "extensions": table},
    ]
    path.write_bytes(glb(header, binary))
    return path


def read(path):
    return read_model(path, SceneContext(path.parent)).mesh


@pytest.mark.parametrize("turn_dtype", STORED)
def test_copies_are_scaled_turned_and_moved(tmp_path, turn_dtype):
    table = {"TRANSLATION": MOVES, "ROTATION": TURNS, "SCALE": SIZES}
    used = {"extensionsRequired": ["EXT_mesh_gpu_instancing"]}
    mesh = read(write_copies(tmp_path / "m.glb", table, turn_dtype, used))
    assert len(mesh.faces) == 6
    bound = {"<f4": 1e-6, "i1": 0.02, "<i2": 1e-4}[turn_dtype]
    for number, corners in enumerate(TURNED):
        copy = mesh.faces[2 * number : 2 * number + 2]
        places = mesh.vertices[np.unique(copy)]
        distances = np.linalg.norm(places[:, None] - corners, axis=2)
        assert distances.min(axis=0).max() < bound
        # Faces of the file's front, +z: of the mirrored copy too.
        a, b, c = mesh.vertices[copy[0]]
        normal = np.cross(b - a, c - a)
        front = [[0, 0, 1], [0, 0, 1], [0, -1, 0]][number]
        np.testing.assert_allclose(normal / np.linalg.norm(normal), front, atol=bound)


@pytest.mark.parametrize("name", ["TRANSLATION", "ROTATION", "SCALE"])
def test_attributes_that_are_missing_change_nothing(tmp_path, name):
    table = {"TRANSLATION": MOVES, "ROTATION": TURNS, "SCALE": np.abs(SIZES)}
    mesh = read(write_copies(tmp_path / "m.glb", {name: table[name], "_ID": MOVES}))
    lengths = {"TRANSLATION": [1, 1, 1], "ROTATION": [1, 1, 1], "SCALE": [1, 2, 1]}
    areas = [
        np.linalg.norm(np.cross(b - a, c - a)) / 2
        for a, b, c in mesh.vertices[mesh.faces]
    ]
    np.testing.assert_allclose(areas, np.repeat(lengths[name], 2) / 2, atol=1e-6)


def test_copies_are_below_the_pose_of_their_node(tmp_path):
    path = write_copies(tmp_path / "m.glb", {"TRANSLATION": MOVES})
    up = {"translation": [0, 0, 5]}
    moved = write_copies(tmp_path / "n.glb", {"TRANSLATION": MOVES}, pose=up)
    np.testing.assert_allclose(read(moved).vertices - read(path).vertices, [[0, 0, 5]] * 12, atol=1e-6)  # fmt: skip


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"TRANSLATION": MOVES, "SCALE": SIZES[:2]}, "of one length"),
        ({"TRANSLATION": TURNS}, "of one length"),
        ({"_ID": MOVES}, "of one length"),
        ({"ROTATION": [[0.0, 0, 0, 0]]}, "ROTATION of length 0"),
        ({"SCALE": [[np.nan, 1, 1]]}, "not finite"),
        ({"TRANSLATION": np.zeros((50_001, 3))}, "more than 50000 copies"),
    ],
)
def test_bad_copies_are_refused_in_one_line(tmp_path, table, reason):
    path = write_copies(tmp_path / "m.glb", table)
    with pytest.raises(FileError, match=f"nodes.*{reason}") as caught:
        read(path)
    assert "\n" not in str(caught.value)
