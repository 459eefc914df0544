import json
import math
from typing import TypeVar

import numpy as np
import pydantic
import pytest
from hypothesis import given, strategies as st
from numpy.testing import assert_array_equal
from typing_extensions import TypeAliasType

from twinlens import camera, geometry
from twinlens.camera import BareAperture, Camera, Pinhole, Rig, ThinLens
from twinlens.dataset.files import check_relative
from twinlens.dataset.record import (
    LENS,
    RIG,
    annotation_of,
    decode_json,
    encode_json,
    plain,
    read,
    read_json,
)
from twinlens.errors import FileError, InputError


def rig_from_plain(value):
    return read(RIG, value, "sample.json", "rig")


def lens_from_plain(value):
    return read(LENS, value, "sample.json", "lens")


positive = st.floats(1e-3, 1e6)
unit = st.floats(0, 0.99)
apertures = st.one_of(
    st.just(camera.Disk()),
    st.builds(camera.Polygon, st.integers(3, 12), st.floats(-360, 360), unit),
    st.builds(camera.Annulus, unit),
    st.lists(unit, min_size=1, max_size=4).map(
        lambda row: camera.MaskAperture([row, [1.0] * len(row)])
    ),
)
lenses = st.one_of(
    st.just(Pinhole()),
    st.builds(
        ThinLens, st.just(0.0) | positive, positive | st.just(math.inf), apertures
    ),
    st.builds(BareAperture, st.just(0.0) | positive, positive, apertures),
)
cameras = st.builds(
    Camera,
    st.integers(1, 9999),
    st.integers(1, 9999),
    positive,
    positive,
    st.floats(-9, 9),
    positive,
)


def through_text(value):
    return json.loads(encode_json({"it": value}))["it"]


@given(lenses)
def test_lenses_read_back_equal(lens):
    assert lens_from_plain(through_text(lens)) == lens


@given(cameras, st.floats(1e-6, 10))
def test_rigs_read_back_equal(one, baseline):
    rig = Rig.stereo(
        one, baseline, world_from_left=geometry.look_at([1, 2, 3], [0.3, 0.1, 0])
    )
    back = rig_from_plain(through_text(rig))
    assert back.cameras == rig.cameras
    for pose, expected in zip(back.world_from_cams, rig.world_from_cams, strict=True):
        assert_array_equal(pose, expected)


@pytest.mark.parametrize(
    "distortion", [camera.BrownConrady(k1=-0.1, p2=1e-3), camera.KannalaBrandt(k1=0.01)]
)
def test_distortion_reads_back_equal(distortion):
    one = Camera(64, 48, 70.0, 70.0, 31.5, 23.5, distortion=distortion)
    back = rig_from_plain(through_text(Rig([one], [np.eye(4)])))
    assert back.cameras[0] == one


@given(
    st.recursive(
        st.none()
        | st.booleans()
        | st.integers()
        | st.floats(allow_nan=False, allow_infinity=False)
        | st.text(),
        lambda inner: (
            st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3)
        ),
        max_leaves=8,
    )
)
def test_plain_data_goes_through_json_unchanged(value):
    assert through_text(value) == value


def test_numpy_values_become_plain_numbers():
    given_values = {
        "a": np.float32(0.5),
        "b": np.arange(3),
        "c": (np.int64(1), np.bool_(True)),
    }
    assert plain(given_values) == {"a": 0.5, "b": [0, 1, 2], "c": [1, True]}


@pytest.mark.parametrize(
    "value", [math.nan, {1: 2}, object(), {"a": {1, 2}}, b"bytes", np.array([np.nan])]
)
def test_values_that_json_cannot_hold_are_rejected(value):
    with pytest.raises(InputError):
        plain(value)


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"type": "ThinLenz"}, "did you mean 'ThinLens'"),
        (
            {"type": "ThinLens", "aperture_diameter": 0.1, "focus": 1},
            "did you mean 'focus_distance'",
        ),
        ({"type": "ThinLens", "aperture_diameter": 0.1}, "focus_distance"),
        ({"type": "BareAperture", "diameter": 10**400, "film_distance": 1}, "diameter"),
        ({"type": ["Pinhole"]}, "must be one of Pinhole, ThinLens, BareAperture"),
        (7, "lens: must be a table of keys and values, got 7"),
    ],
)
def test_an_invalid_lens_is_rejected(value, message):
    with pytest.raises(InputError, match=message):
        lens_from_plain(value)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[1]",
        '{"format": "other", "version": 1}',
        '{"format": "kind", "version": 2}',
        '{"format": "kind", "version": 1, "x": NaN}',
        '{"format": "kind", "version": 1, "x": ' + "9" * 5000 + "}",
        '{"format": "kind", "version": 1, "x": ' + "[" * 70 + "]" * 70 + "}",
        "[" * 100_000,
        "\xff",
    ],
)
def test_records_of_another_format_are_rejected(tmp_path, text):
    (tmp_path / "r.json").write_bytes(text.encode("latin-1"))
    with pytest.raises(FileError, match=r"r\.json: "):
        read_json(tmp_path / "r.json", "kind", 1)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "../a", "a/../b", "/a", "a//b", "a\\b", "a\0"]
)
def test_names_outside_the_folder_are_rejected(name):
    with pytest.raises(InputError, match="plain relative name"):
        check_relative(name)
    assert check_relative("train/0001") == "train/0001"


def test_a_rig_of_an_earlier_version_is_read():
    rig = Rig.stereo(Camera.from_fov(64, 48, 60), 0.1)
    written = plain(rig)
    written["believed"] = written.pop("calibrated")
    assert rig_from_plain(written).calibrated is None


@pytest.mark.parametrize("text", [b'{"a": NaN}', b"[Infinity]", b"-Infinity"])
def test_json_constants_are_rejected(text):
    message = r'r\.json: .* is not JSON; write null for NaN, "inf" for infinity'
    with pytest.raises(FileError, match=message):
        decode_json(text, "r.json", "kind", 1)


def test_an_alias_of_an_array_type_is_an_array():
    # NumPy 2.5 defines NDArray by a `type` statement.
    scalar = TypeVar("scalar", bound=np.generic)
    alias = TypeAliasType(
        "alias", np.ndarray[tuple[int, ...], np.dtype[scalar]], type_params=(scalar,)
    )
    adapter = pydantic.TypeAdapter(annotation_of(alias[np.float64]))
    assert adapter.validate_python([[1.0, 2.0]]) == [[1.0, 2.0]]
