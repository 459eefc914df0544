"""A sample made again from nothing but its sample.json."""

import copy
import json

import numpy as np
import pytest

import twinlens as tl
from tests.factory_recipes import RECIPE, SCENE, write_recipe
from twinlens.camera import BrownConrady, MaskAperture, Polygon
from twinlens.dataset.sample_files import sample_files
from twinlens.errors import InputError
from twinlens.factory import Shoot, default_rig, make, make_sample, read_recipe, remake
from twinlens.sensor import Exposure, Mismatch, Sensor

CODE = np.random.default_rng(3).integers(0, 256, (5, 7), dtype=np.uint8)
SHAPED = (
    tl.ThinLens(0.04, np.inf, MaskAperture(CODE)),
    tl.BareAperture(0.002, 0.05, Polygon(5, rotation_deg=10.0, roundness=0.25)),
)
SENSOR = Sensor.preset(
    "phone",
    filters="rgb",
    bits=16,
    output="gamma",
    serial=4,
    mismatch=Mismatch(gain=1.1, time=1.05, black_level=2.0),
)


@pytest.fixture(scope="module")
def scene():
    return tl.load_scene("cards")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """A scene of a user's own, whose kernels are compiled quickly."""
    folder = tmp_path_factory.mktemp("scenes") / "tiny"
    folder.mkdir()
    (folder / "scene.toml").write_text(SCENE)
    return tl.load_scene(folder)


def shaped(scene):
    plain = default_rig(scene, 40, 30).cameras[0]
    left = plain.replace(fy=45.0, cx=18.25, pixel_pitch_um=1000.0)
    left = left.replace(distortion=BrownConrady(k1=-0.1))
    right = left.replace(cx=21.0)
    return make_sample(
        scene,
        tl.Rig.stereo(left, 0.07, scene.world_from_left, right=right),
        SHAPED,
        Shoot(
            spp=3,
            seed=11,
            sensor=SENSOR,
            exposure=Exposure(0.01, 2.0),
            sky_disparity=True,
            keep_radiance=True,
            keep_models=True,
            sampler="independent",
        ),
    )


def diffracted(scene):
    lenses = (tl.Pinhole(), tl.ThinLens(2e-4, 1.2))
    return make_sample(
        scene,
        default_rig(scene, 40, 30),
        lenses,
        Shoot(spp=3, denoise=True, sensor=SENSOR, diffraction=True),
    )


@pytest.mark.parametrize(
    "made", [shaped, pytest.param(diffracted, marks=pytest.mark.slow)]
)
def test_the_record_gives_the_same_bytes(made, tiny):
    files = sample_files(made(tiny))
    assert any(name.startswith("models/") for name in files) == (made is shaped)
    assert sample_files(remake(json.loads(files["sample.json"]), tiny)) == files


@pytest.fixture(scope="module")
def files(scene):
    sample = make_sample(
        scene, default_rig(scene, 8, 6), [tl.ThinLens(0.01, 1.2)], Shoot(spp=1)
    )
    return sample_files(sample)


@pytest.fixture(scope="module")
def record(files):
    return json.loads(files["sample.json"])


def test_a_sample_of_a_bundled_scene_needs_its_record_alone(files, record):
    assert sample_files(remake(record)) == files


def test_a_scene_of_ones_own_has_to_be_given(scene, tmp_path):
    mine = tmp_path / "mine"
    mine.mkdir()
    (mine / "scene.toml").write_text(SCENE)
    made = make_sample(
        tl.load_scene(mine), default_rig(scene, 8, 6), [tl.Pinhole()], Shoot(spp=1)
    )
    files = sample_files(made)
    made_record = json.loads(files["sample.json"])
    with pytest.raises(InputError, match="'mine' is not bundled; load it"):
        remake(made_record)
    assert sample_files(remake(made_record, tl.load_scene(mine))) == files
    (mine / "scene.toml").write_text((mine / "scene.toml").read_text() + "\n")
    with pytest.raises(InputError, match="files have changed"):
        remake(made_record, tl.load_scene(mine))


@pytest.mark.parametrize(
    ("path", "value", "says"),
    [
        ("record", None, "record: must be a table"),
        ("record.scene", "spheres", "not the one that the record names"),
        ("record.sensor.full_wel", 3, "did you mean 'full_well'"),
        ("record.exposure", {"time": 0}, "exposure.time: must be a number of seconds"),
        ("shots", [{}], "lens: must be a table"),
    ],
)
def test_a_record_that_is_none_is_refused_in_one_line(record, path, value, says):
    broken = copy.deepcopy(record)
    *tables, key = path.split(".")
    part = broken
    for table in tables:
        part = part[table]
    part[key] = value
    with pytest.raises(InputError, match=says) as error:
        remake(broken)
    assert "\n" not in str(error.value)


def test_a_level_of_mismatch_is_drawn_for_each_sample_and_recorded(tmp_path):
    """The left image, truth and calibration are those without mismatch; values in the recipe replace drawn ones."""
    mismatch = 'mismatch = {{ level = "LEVEL", blur_px = 0.25, distortion_px = 0 }}'
    text = RECIPE.replace("[sensor]", f"[sensor]\n{mismatch}")
    text = text.replace("{{ choice = [0, 2, 8] }}", "0") + "[exposure]\ntime = 0.02\n"

    def files(level, index):
        path = write_recipe(tmp_path / level, text.replace("LEVEL", level))
        return sample_files(make(read_recipe(path), index))

    typical, other, plain = files("typical", 1), files("typical", 2), files("none", 1)
    record = json.loads(typical["sample.json"])
    drawn = Mismatch.draw("typical", record["record"]["spec"]["seed"])
    recorded = Mismatch(**record["record"]["sensor"]["mismatch"])
    assert recorded == drawn.replace(blur_px=0.25, distortion_px=0.0)
    second = json.loads(other["sample.json"])["record"]["sensor"]["mismatch"]
    assert second["gain"] != drawn.gain
    for name in ("im0.png", "disp0.pfm", "calib.txt", "truth0.exr", "truth1.exr"):
        assert plain[name] == typical[name]
    assert typical["im1.png"] != plain["im1.png"]
    scene = tl.load_scene(tmp_path / "typical" / "tiny")
    assert sample_files(remake(record, scene)) == typical


def test_warped_pictures_cannot_be_photographed_again(record):
    warped = copy.deepcopy(record)
    warped["record"]["rectified_from"] = {"pictures": "maps"}
    with pytest.raises(InputError, match="rectify that sample again"):
        remake(warped)


@pytest.mark.parametrize("argument", ["out/cards", tl.Dataset, None], ids=str)
def test_what_is_no_record_is_refused_with_where_to_find_one(argument):
    with pytest.raises(InputError, match=r"^record must be a sample's, such as"):
        remake(argument)
