"""TUM files as other programs write them, and files that are none."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twinlens.calibrations.trajectories import read_trajectory
from twinlens.errors import FileError

HEAD = "# ground truth trajectory\n# timestamp tx ty tz qx qy qz qw\n"
FIRST = "1305031098.6659 1.3563 0.6305 1.6380 0.6132 0.5962 -0.3311 -0.3986\n"
SECOND = "1305031098.6758 1.3543 0.6306 1.6360 0.6129 0.5966 -0.3316 -0.3980\n"


@pytest.fixture
def written(tmp_path):
    def write(text):
        file = tmp_path / "path.tum"
        file.write_bytes(text if isinstance(text, bytes) else text.encode())
        return file

    return write


@pytest.mark.parametrize(
    "text",
    [
        HEAD + FIRST + SECOND,
        FIRST + "\n" + SECOND.rstrip(),
        "\ufeff" + (FIRST + SECOND).replace("\n", "\r\n"),
        (FIRST + SECOND).replace(" ", ", "),
        FIRST.replace("\n", "  # first\n") + SECOND.replace(" ", "\t"),
    ],
)
def test_files_are_read_as_written(written, text):
    """Lines of freiburg1_xyz of the TUM RGB-D benchmark."""
    path = read_trajectory(written(text))
    pose = path.at(1305031098.6659)
    np.testing.assert_allclose(pose[:3, 3], [1.3563, 0.6305, 1.6380], atol=1e-12)
    turn = Rotation.from_quat([0.6132, 0.5962, -0.3311, -0.3986]).as_matrix()
    np.testing.assert_allclose(pose[:3, :3], turn, atol=1e-12)
    assert path.times.tolist() == [1305031098.6659, 1305031098.6758]


LONG = FIRST.replace("-0.3986", "-0.5986")
REFUSED = [
    ("", "needs two poses or more, got 0"),
    (HEAD + FIRST, "needs two poses or more, got 1"),
    (SECOND + FIRST, "1305031098.6659 s, is before the one before, 1305031098.6758 s"),
    (FIRST + FIRST, "repeats the one before"),
    (HEAD + FIRST + "1 2 3\n", "line 4: needs 8 numbers t tx ty tz qx qy qz qw, got 3"),
    (FIRST + SECOND.replace("1.3543", "east"), "line 2: needs 8 numbers"),
    (
        FIRST + SECOND.replace("1.3543", "nan"),
        "line 2: tx must be a finite number, got nan",
    ),
    (FIRST + SECOND.replace("0.6129", "inf"), "line 2: qx must be a finite number"),
    (LONG + SECOND, r"must have the length 1, its length deviates by \+0.09"),
    (b"\xff\xfe\x00\x80", "not a text file"),
]


@pytest.mark.parametrize(("text", "message"), REFUSED)
def test_other_files_are_refused_in_one_line(written, text, message):
    with pytest.raises(FileError, match=message) as error:
        read_trajectory(written(text))
    assert "path.tum" in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileError, match=r"none\.tum: no such file"):
        read_trajectory(tmp_path / "none.tum")
    with pytest.raises(FileError, match="directory"):
        read_trajectory(tmp_path)
