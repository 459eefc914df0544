"""Submissions: accepted layouts, and unsafe zip files."""

import stat
import struct
import zipfile
import zlib

import numpy as np
import pytest

import twinlens as tl
from tests.scoring import scoring_loops as naive
from tests.scoring.scoring_methods import pair
from twinlens.dataset import Calibration, write_pfm
from twinlens.dataset.codecs.pfm import encode_pfm
from twinlens.dataset.codecs.png import encode_png
from twinlens.errors import FileError
from twinlens.scoring import Pair, open_submission, run_benchmark

CALIBRATION = Calibration(
    (90.0, 80.0, 5.5, 4.0), (90.0, 80.0, 5.5, 4.0), 0.2, 32, 40, 0.0
)
DISP = np.array([[1.5, np.inf, 3.25], [4.0, 5.0, 6.0]], np.float32)
SHAPE = (2, 3)


def zipped(path, files, edit=None):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files:
            info = zipfile.ZipInfo(name)
            info.compress_type = zipfile.ZIP_DEFLATED
            if edit:
                edit(info)
            archive.writestr(info, data)
    return open_submission(path)


def submitted(place, files, packed):
    """The submission of these files, name -> bytes, in a zip or in a folder."""
    if packed:
        return zipped(place.with_suffix(".zip"), files.items())
    for name, data in files.items():
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        (place / name).write_bytes(data)
    return open_submission(place)


def png(disp):
    """As KITTI writes it."""
    return encode_png(np.where(np.isfinite(disp), disp * 256, 0).astype(np.uint16))


PFM, PNG = encode_pfm(DISP), png(DISP)


@pytest.mark.parametrize("packed", [True, False])
def test_every_layout_is_found(tmp_path, packed):
    layouts = "s.png s.pfm s/disp0.pfm s/disp0METHOD.pfm s/some-method-1f.pfm all/s.pfm all/s/x.pfm s/lens-0.pfm"
    for k, name in enumerate(layouts.split()):
        files = {name: PNG if name == "s.png" else PFM}
        submission = submitted(tmp_path / f"my{k}", files, packed)
        assert submission.name == f"my{k}"
        np.testing.assert_array_equal(submission.map_of("s", SHAPE), DISP)


@pytest.mark.parametrize("packed", [True, False])
def test_hidden_files_and_macosx_folders_are_ignored(tmp_path, packed):
    hidden = "__MACOSX/all/._s.pfm", "all/.DS_Store", ".DS_Store"
    files = {"all/s.pfm": PFM} | dict.fromkeys(hidden, b"x")
    submission = submitted(tmp_path / "my", files, packed)
    assert list(submission.files) == ["all/s.pfm"]
    np.testing.assert_array_equal(submission.map_of("s", SHAPE), DISP)


def test_pfm_comes_before_png_and_disp0_before_others(tmp_path):
    files = {"s.png": PNG, "s.pfm": PFM, "t/disp0.pfm": PFM, "t/disp1.pfm": PFM}
    submission = submitted(tmp_path, files, packed=False)
    assert submission.find("s") == "s.pfm"
    assert submission.find("t") == "t/disp0.pfm"
    ambiguous = {"u/a.pfm": PFM, "u/b.pfm": PFM}
    submission = submitted(tmp_path / "two", ambiguous, packed=False)
    with pytest.raises(FileError, match="no map of 'u'"):
        submission.map_of("u", SHAPE)


def scored(folder, samples, **options):
    """The entries of a submission's folder on a board."""
    submission = open_submission(folder, "mine")
    return run_benchmark(samples, [submission], **options).entries


@pytest.mark.parametrize("name", ["s.pfm", "s/method.pfm"])
def test_a_confidence_beside_the_map_is_scored(tmp_path, name):
    sample = pair("s")
    disp = np.random.default_rng(0).choice(np.float32([6, 9]), (40, 30))
    trust = np.abs(disp - 8)
    write_pfm(tmp_path / name, disp)
    plain = open_submission(tmp_path, "mine").spec
    path = tmp_path / name.replace(".pfm", "-confidence.pfm")
    write_pfm(path, trust)
    submission = open_submission(tmp_path, "mine")
    assert submission.spec != plain
    assert submission.unmatched_files({"s": ()}) == ()
    (entry,) = scored(tmp_path, [sample])
    expected = tl.evaluate(disp, sample.disp0, ndisp=sample.ndisp, confidence=trust)
    area = expected.all["auc2.0"]
    assert entry.regions["all"]["auc2.0"] == pytest.approx(area)
    damaged = encode_pfm(trust)[:-4] + np.float32(np.nan).tobytes()
    for wrong in (encode_pfm(trust[:20, :15]), damaged):
        path.write_bytes(wrong)
        (entry,) = scored(tmp_path, [sample])
        assert entry.failure.kind == "refused"
        assert "-confidence.pfm: " in entry.failure.message


def test_a_submission_is_scored_like_a_method_without_a_time(tmp_path):
    for name, width in (("s", 30), ("t", 31)):
        write_pfm(tmp_path / f"{name}.pfm", np.full((40, width), 6, np.float32))
    samples = [pair("s"), pair("t"), pair("u")]
    right, wrong, absent = scored(tmp_path, samples, protocol="eth3d")
    assert right.regions["all"]["avgerr"] == 2
    assert right.seconds is None
    assert wrong.failure.kind == "refused"
    assert "t.pfm: is 31 x 40; the truth is 30 x 40" in wrong.failure.message
    assert absent.failure.kind == "missing"


@pytest.mark.parametrize("scale", [2, 4])
def test_a_smaller_map_is_scored_as_a_single_one(tmp_path, scale):
    """By protocols that scale it up; the others refuse it. The map passed on has the truth's size."""
    rng = np.random.default_rng(scale)
    gt = rng.uniform(0, 15, (40, 32)).astype(np.float32)
    image = np.zeros(gt.shape, np.uint8)
    sample = Pair("s", image, image, gt, None, 16, CALIBRATION.replace(isint=True))
    small = rng.uniform(0, 20 / scale, (40 // scale, 32 // scale)).astype(np.float32)
    small[1, 1] = np.inf
    write_pfm(tmp_path / "s.pfm", small)
    kept = []
    entry, refused = scored(
        tmp_path,
        [sample],
        protocol=["middlebury-v3", "eth3d"],
        on_map=lambda *result: kept.append(result[2]),
    )
    pixels = np.ones(gt.shape, bool)
    rules = 16 / scale, True, scale
    expected = naive.middlebury(small.tolist(), gt.tolist(), pixels, *rules)
    assert dict(entry.regions["all"]) == pytest.approx(expected)
    assert refused.failure.kind == "refused"
    assert "ETH3D two-view expects (40, 32)" in refused.failure.message
    enlarged = np.kron(scale * small, np.ones((scale, scale)))
    np.testing.assert_array_equal(kept[0], enlarged)


def test_other_maps_are_another_method(tmp_path):
    specs = set()
    for value in (1, 2):
        write_pfm(tmp_path / "s.pfm", DISP + value)
        specs.add(open_submission(tmp_path).spec)
        specs.add(
            zipped(tmp_path / "z.zip", [("s.pfm", encode_pfm(DISP + value))]).spec
        )
        (tmp_path / "z.zip").unlink()
    assert len(specs) == 4
    before = open_submission(tmp_path).spec
    (tmp_path / "notes.txt").write_text("not a map")
    assert open_submission(tmp_path).spec == before


@pytest.mark.parametrize(
    ("one", "other"),
    [("s.pfm", "S.pfm"), ("a/s.pfm", "A/s.pfm"), ("\u00e9.pfm", "e\u0301.pfm")],
)
def test_names_that_some_systems_treat_as_one_are_refused(tmp_path, one, other):
    with pytest.raises(FileError, match="same name on some systems") as error:
        submitted(tmp_path / "evil", {one: PFM, other: PFM}, packed=True)
    assert one in str(error.value)
    assert other in str(error.value)


LENSES = {
    "s · pinhole": ("s/lens-0", "s-lens-0", "s"),
    "s · wide": ("s/lens-1", "s-lens-1"),
}


def test_every_lens_of_a_sample_has_a_plain_name(tmp_path):
    """Names as suggested by the sample's own folder: the first lens's images are in it, the others' in lens-1, ..."""
    pairs = [
        ("s.pfm", "s-lens-1.pfm"),
        ("s.png", "s/lens-1.png"),
        ("s/lens-0.pfm", "s/lens-1.pfm"),
        ("s/lens-0/disp0.pfm", "s/lens-1/disp0.pfm"),
        ("s-lens-0.pfm", "s-lens-1.png"),
        ("s/disp0.pfm", "s/lens-1.pfm"),
        ("s · pinhole.pfm", "s · wide.pfm"),
        ("all/s.pfm", "all/s-lens-1.pfm"),
    ]
    encode = {"pfm": encode_pfm, "png": png}
    for number, names in enumerate(pairs):
        files = {name: encode[name[-3:]](DISP + k) for k, name in enumerate(names)}
        submission = submitted(tmp_path / str(number), files, packed=False)
        for k, (sample, aliases) in enumerate(LENSES.items()):
            disparity = submission.map_of(sample, SHAPE, aliases)
            np.testing.assert_array_equal(disparity, DISP + k, err_msg=str(names))


def test_a_map_of_one_lens_is_not_used_for_another(tmp_path):
    submission = submitted(tmp_path / "my", {"s/lens-1.pfm": PFM}, packed=False)
    with pytest.raises(FileError, match=r"no map of 's · pinhole': expected s/lens-0"):
        submission.map_of("s · pinhole", SHAPE, LENSES["s · pinhole"])


def link(info):
    info.external_attr = (stat.S_IFLNK | 0o777) << 16


def test_a_zip_with_names_or_links_that_leave_it_is_refused(tmp_path):
    for name in ("../s.pfm", "a/../../s.pfm", "/etc/s.pfm", "c:/s.pfm"):
        with pytest.raises(FileError, match=f"'{name}', a name that leaves"):
            zipped(tmp_path / "evil.zip", [(name, PFM)])
    with pytest.raises(FileError, match=r"s\.pfm is a link"):
        zipped(tmp_path / "evil.zip", [("s.pfm", PFM)], link)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_a_duplicate_name_is_refused(tmp_path):
    with pytest.raises(FileError, match="occurs twice"):
        zipped(tmp_path / "evil.zip", [("s.pfm", PFM), ("s.pfm", PFM)])


def test_an_encrypted_member_is_refused(tmp_path):
    zipped(tmp_path / "good.zip", [("s.pfm", PFM)])
    data = bytearray((tmp_path / "good.zip").read_bytes())
    data[data.index(b"PK\x01\x02") + 8] |= 1
    (tmp_path / "evil.zip").write_bytes(data)
    with pytest.raises(FileError, match="is encrypted"):
        open_submission(tmp_path / "evil.zip")


def test_a_zip_of_too_many_files_is_refused(tmp_path, monkeypatch):
    files = [(f"{k}.pfm", b"") for k in range(3)]
    assert len(zipped(tmp_path / "many.zip", files).files) == 3
    monkeypatch.setattr("twinlens.scoring.submission.MAX_FILES", 2)
    with pytest.raises(FileError, match=r"many\.zip: contains 3 files, more than 2$"):
        open_submission(tmp_path / "many.zip")


BOMB = b"Pf\n3 2\n-1\n" + bytes(50_000_000)


@pytest.mark.parametrize("compression", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_a_compression_that_unpacks_whole_is_refused(tmp_path, compression):
    """zipfile decompresses a bz2 or LZMA member whole, even if fewer bytes are requested."""
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", compression) as archive:
        archive.writestr("s.pfm", BOMB)
    with pytest.raises(
        FileError, match=r"bomb\.zip: s\.pfm uses a compression other than deflate"
    ):
        open_submission(tmp_path / "bomb.zip")


def test_a_bomb_with_a_false_size_is_not_unpacked(tmp_path, monkeypatch):
    """One that states its true size is refused as well."""
    with pytest.raises(FileError, match=r"s\.pfm: more than 65560 bytes"):
        zipped(tmp_path / "bomb.zip", [("s.pfm", BOMB)]).map_of("s", SHAPE)
    data = bytearray((tmp_path / "bomb.zip").read_bytes())
    stated = data.index(b"PK\x01\x02") + 24
    assert struct.unpack_from("<I", data, stated) == (len(BOMB),)
    struct.pack_into("<I", data, stated, 40)
    (tmp_path / "bomb.zip").write_bytes(data)
    submission = open_submission(tmp_path / "bomb.zip")
    read = []
    original = zipfile.ZipExtFile.read
    monkeypatch.setattr(
        zipfile.ZipExtFile,
        "read",
        lambda self, n=-1: read.append(n) or original(self, n),
    )
    with pytest.raises(FileError, match=r"s\.pfm"):
        submission.map_of("s", SHAPE)
    assert max(read) <= 65561
    assert min(read) >= 0


def test_a_small_png_that_claims_a_large_picture_is_refused_by_its_header(tmp_path):
    header = struct.pack(">IIBBBBB", 8000, 8000, 16, 0, 0, 0, 0)
    png = b"\x89PNG\r\n\x1a\n"
    chunks = (b"IHDR", header), (b"IDAT", zlib.compress(bytes(1000))), (b"IEND", b"")
    for kind, data in chunks:
        check = struct.pack(">I", zlib.crc32(kind + data))
        png += struct.pack(">I", len(data)) + kind + data + check
    (tmp_path / "s.png").write_bytes(png)
    with pytest.raises(FileError, match=r"s\.png: is 8000 x 8000; the truth is 3 x 2"):
        open_submission(tmp_path).map_of("s", SHAPE)


def test_a_bad_map_is_refused_by_its_name(tmp_path):
    four, nan = np.float32(4).tobytes(), np.float32(np.nan).tobytes()
    bad = [
        ("s.pfm", PFM[:-4], "damaged"),
        ("s.pfm", PFM.replace(four, nan), "NaN"),
        ("s.pfm", encode_pfm(np.zeros((2, 3, 3), np.float32)), "colour channels"),
        ("s.pfm", encode_pfm(DISP.T), "is 2 x 3; the truth is 3 x 2"),
        ("s.png", b"not a png", "not a PNG"),
        ("s.png", encode_png(np.zeros(SHAPE, np.uint8)), "16-bit grey"),
    ]
    for k, (name, data, message) in enumerate(bad):
        submission = submitted(tmp_path / str(k), {name: data}, packed=k % 2)
        with pytest.raises(FileError, match=message) as error:
            submission.map_of("s", SHAPE)
        assert name in str(error.value)
        assert "\n" not in str(error.value)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        open_submission(tmp_path / "none.zip")
    (tmp_path / "x.zip").write_bytes(b"PK nothing")
    with pytest.raises(FileError, match="neither a folder nor a readable zip"):
        open_submission(tmp_path / "x.zip")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "s.pfm").symlink_to("/etc/hostname")
    with pytest.raises(FileError, match="link that leaves"):
        open_submission(tmp_path / "folder")


def test_a_damaged_zip_is_read_or_refused(tmp_path):
    zipped(tmp_path / "good.zip", [("s.pfm", PFM)])
    good = (tmp_path / "good.zip").read_bytes()
    rng = np.random.default_rng(0)
    kept = 0
    for _ in range(200):
        data = bytearray(good)
        for place in rng.integers(0, len(data), rng.integers(1, 4)):
            data[place] = rng.integers(256)
        (tmp_path / "d.zip").write_bytes(data)
        try:
            assert open_submission(tmp_path / "d.zip").map_of("s", SHAPE).shape == SHAPE
            kept += 1
        except FileError as error:
            assert str(tmp_path) in str(error)  # noqa: PT017  either outcome is right, another exception is not
    assert 0 < kept < 200


@pytest.mark.parametrize(("packed", "top"), [(True, ""), (False, "all/")])
def test_unmatched_maps_are_listed(tmp_path, packed, top):
    """Other names and lenses that do not exist; not further files of a sample, and not images."""
    ours = ["s/lens-0.pfm", "s/lens-1.pfm", "s/disp1.pfm", "s.png", "t/mine.pfm"]
    strange = [
        "S2.pfm",
        "s-lens-2.pfm",
        "s/lens-2.pfm",
        "s/lens-3/disp0.pfm",
        "t-.png",
        "u/disp0.pfm",
    ]
    pixels = {".pfm": PFM, ".png": PNG}
    files = {f"{top}{name}": pixels[name[-4:]] for name in ours + strange}
    files[f"{top}u/preview.png"] = encode_png(np.zeros((2, 3), np.uint8))
    files |= {f"{top}notes.txt": b"hi", f"{top}cut.png": PNG[:20]}
    submission = submitted(tmp_path / "my", files, packed)
    assert submission.unmatched_files(LENSES | {"t": ()}) == tuple(
        f"{top}{name}" for name in sorted(strange)
    )


def test_a_single_sample_folder_is_not_a_top_folder(tmp_path):
    names = "s/disp0.pfm", "s/old.pfm", "s/lens-2.pfm"
    submission = submitted(tmp_path / "my", dict.fromkeys(names, PFM), packed=False)
    assert submission.unmatched_files({"s": (), "t": ()}) == ("s/lens-2.pfm",)


def test_a_zip_deleted_meanwhile_is_still_read(tmp_path):
    submission = zipped(tmp_path / "my.zip", [("no.png", PNG)])
    (tmp_path / "my.zip").unlink()
    assert submission.unmatched_files({"s": ()}) == ("no.png",)
    np.testing.assert_array_equal(submission.map_of("no", SHAPE), DISP)
