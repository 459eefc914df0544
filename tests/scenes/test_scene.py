"""The plain data of a scene checks itself, whoever makes it."""

from typing import Any

import numpy as np
import pytest

from twinlens.errors import InputError
from twinlens.scenes import Mesh

CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
FACE = np.array([[0, 1, 2]], dtype=np.uint32)


def test_a_mesh_holds_float64_and_uint32() -> None:
    mesh = Mesh(
        [[0, 0, 0], [1, 0, 0], [0, 1, 0]],
        [[0, 1, 2]],
        uv=CORNERS[:, :2].astype(np.float32),
    )  # type: ignore[arg-type]
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.uint32
    assert mesh.uv is not None
    assert mesh.uv.dtype == np.float64
    assert Mesh(CORNERS, np.zeros((0, 3), np.int64)).faces.shape == (0, 3)


BROKEN: list[tuple[dict[str, Any], str]] = [
    (
        {"vertices": CORNERS[:, :2]},
        r"vertices must have the shape \(3, 3\), got \(3, 2\)",
    ),
    ({"vertices": CORNERS.ravel()}, "vertices must have the shape"),
    ({"vertices": [[0, 0, 0], [1, 0]]}, "vertices must be numbers"),
    ({"vertices": [["a", "b", "c"]]}, "vertices must be numbers"),
    (
        {"vertices": [[0, 0, 0], [1, np.nan, 0], [0, 1, 0]]},
        "vertices must be finite; row 1 is not",
    ),
    ({"faces": FACE.astype(np.float64)}, "faces must be integers"),
    ({"faces": FACE[0]}, "faces must be integers"),
    ({"faces": [[0, 1, 2, 2]]}, "faces must be integers"),
    ({"faces": [[0, 1, 3]]}, "faces must have vertex numbers 0 to 2, got 0 to 3"),
    ({"faces": [[0, 1, -1]]}, "faces must have vertex numbers 0 to 2, got -1 to 1"),
    ({"normals": CORNERS[:2]}, r"normals must have the shape \(3, 3\), got \(2, 3\)"),
    ({"normals": CORNERS + np.inf}, "normals must be finite"),
    ({"uv": CORNERS}, r"uv must have the shape \(3, 2\), got \(3, 3\)"),
    ({"uv": CORNERS[:1, :2]}, r"uv must have the shape \(3, 2\), got \(1, 2\)"),
]


@pytest.mark.parametrize(("change", "message"), BROKEN, ids=[b[1][:40] for b in BROKEN])
def test_an_invalid_mesh_is_an_error(change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Mesh(**({"vertices": CORNERS, "faces": FACE} | change))
