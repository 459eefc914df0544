"""A real pair without truth, by commands alone: what a matcher's user can learn from two images and a calibration.

The images are written by OpenCV. Their disparities are known here and never given to the commands: a plane at 6 px with
a square at 14 px before it, a window without texture, and stripes with a period of 5 px.
"""

import json
import re

import cv2
import numpy as np
import pytest

from tests.docs.pages import blocks, run_block
from tests.docs.test_site import DOCS
from tests.report.test_page import Elements, browse, needs_chromium

WIDTH, HEIGHT = 120, 90
PLANE, SQUARE = 6, 14
CALIB = f"""cam0=[100 0 59.5; 0 100 44.5; 0 0 1]
cam1=[100 0 59.5; 0 100 44.5; 0 0 1]
doffs=0
baseline=100
width={WIDTH}
height={HEIGHT}
ndisp=24
"""
FLAT, STRIPES, FRONT = np.s_[8:28, 30:60], np.s_[8:28, 70:110], np.s_[45:75, 45:85]


def images(seed=0):
    """Left and right, uint8 (HEIGHT, WIDTH, 3), and the true disparity of the left."""
    rng = np.random.default_rng(seed)
    wide = rng.integers(30, 220, (HEIGHT, WIDTH + PLANE, 3)).astype(np.uint8)
    wide = cv2.GaussianBlur(wide, (3, 3), 0.7)
    wide[FLAT] = 120
    columns = np.arange(WIDTH + PLANE)
    stripes = (128 + 80 * np.sin(2 * np.pi * columns / 5)).astype(np.uint8)
    wide[STRIPES] = stripes[None, 70:110, None]
    left, right = wide[:, :WIDTH].copy(), wide[:, PLANE:].copy()
    square = rng.integers(30, 220, (30, 40, 3)).astype(np.uint8)
    left[FRONT], right[45:75, 45 - SQUARE : 85 - SQUARE] = square, square
    truth = np.full((HEIGHT, WIDTH), float(PLANE))
    truth[FRONT] = SQUARE
    noise = rng.integers(0, 3, (2, *left.shape)).astype(np.uint8)
    return left + noise[0], right + noise[1], truth


def write_pair(folder, left, right, calib=CALIB):
    folder.mkdir(parents=True)
    cv2.imwrite(str(folder / "im0.png"), left)
    cv2.imwrite(str(folder / "im1.png"), right)
    if calib is not None:
        (folder / "calib.txt").write_text(calib)


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    folder = tmp_path_factory.mktemp("real")
    write_pair(folder / "pairs" / "desk", *images()[:2])
    return folder


@pytest.fixture(scope="module")
def board(root):
    """The board of the pair, by the command, as a document; and what the command prints."""
    from twinlens.cli import run

    output = root / "board"
    methods = "zncc:block_size=5,sad:block_size=5,sgm"
    command = ("benchmark", root / "pairs", "--methods", methods, "-o", output)
    assert run([str(part) for part in command]) == 0
    return json.loads((output / "board.json").read_text())


def test_the_board_compares_without_scores(root, board, twinlens):
    assert list(board["protocols"]) == ["consistency"]
    metrics = {
        entry["method"]: entry["regions"]["all"]["metrics"]
        for entry in board["entries"]
    }
    assert set(metrics) == {"zncc:block_size=5", "sad:block_size=5", "sgm"}
    truth = images()[2]
    matched = 1 - (PLANE * HEIGHT + (SQUARE - PLANE) * 30) / truth.size
    for name, values in metrics.items():
        assert not [
            key for key in values if key.startswith(("bad", "totbad", "avgerr"))
        ]
        assert 60 < values["confirmed"] <= 100 * matched + 1, name
        assert values["coverage"] == 100
        # Noise of 0, 1 or 2 in both images: the mean of |difference| is 8/9 before rounding, elsewhere more.
        assert 0.3 < values["photo_A50"] < 1.5, name
    assert len(board["disagreements"]) == 3
    assert all(0 <= pair["apart"] < 40 for pair in board["disagreements"])
    command = ("benchmark", root / "pairs", "--methods", "sgm", "-o", root / "again")
    code, out, err = twinlens(*command)
    assert (code, err) == (0, "")
    assert "without truth: 1 of 1 pairs (desk); their maps are compared" in out
    assert "totbad" not in out


def test_a_protocol_or_region_without_data_is_named(root, twinlens):
    """A note for each name that the user gives and that needs the truth; none for those that are scored."""
    protocols = ("--protocol", "middlebury-v3", "--protocol", "consistency")
    names = (*protocols, "--region", "all", "--region", "nonocc")
    command = ("benchmark", root / "pairs", "--methods", "sad", *names)
    code, out, err = twinlens(*command, "-o", root / "noted")
    assert code == 0, err
    notes = [line for line in out.splitlines() if "no pair has the data" in line]
    assert [note.split(":")[0] for note in notes] == [
        "--protocol middlebury-v3",
        "--region nonocc",
    ]


def test_the_page_has_the_figures_of_the_file(root, board):
    page = json.loads(Elements((root / "board" / "index.html").read_text()).data)
    (rules,) = page["protocols"]
    assert (rules["name"], rules["truth"]) == ("consistency", False)
    for shown, stored in zip(page["entries"], board["entries"], strict=True):
        values = shown["regions"]["all"]["v"]
        metrics = stored["regions"]["all"]["metrics"]
        assert values == pytest.approx(
            [metrics[name] for name in rules["metrics"]], rel=1e-5
        )
    assert page["disagreements"] == board["disagreements"]
    pictures = page["samples"][0]["pictures"]
    assert pictures["truth"] is None
    assert (
        set(pictures["differences"])
        == set(pictures["maps"])
        == set(pictures["residuals"])
    )


@pytest.mark.parametrize(
    ("at", "kind"),
    [
        ((45, 18), "texture"),
        ((90, 18), "repetition"),
        ((41, 60), "occluded"),  # of the plane, hidden by the square
        ((64, 60), "none"),
    ],
)
def test_a_pixel_has_its_likely_cause(root, twinlens, at, kind):
    pixel = ",".join(map(str, at))
    code, out, err = twinlens(
        "show", "costs", root / "pairs/desk", "--at", pixel,
        "--methods", "zncc:block_size=5", "--json",
    )  # fmt: skip
    assert (code, err) == (0, "")
    record = json.loads(out)
    (curve,) = record["curves"].values()
    assert curve["reason"]["kind"] == kind, curve["reason"]


def test_a_range_that_is_too_small_is_named(root, twinlens):
    code, out, _ = twinlens(
        "show", "costs", root / "pairs/desk", "--at", "64,60", "--num-disparities", 10,
        "--methods", "sad:block_size=31", "--json",
    )  # fmt: skip
    assert code == 0
    assert len(json.loads(out)["curves"]["sad:block_size=31"]["disparities"]) == 10
    board = root / "narrow"
    command = ("benchmark", root / "pairs", "--methods", "sad", "-o", board)
    code, _, _ = twinlens(*command, "--num-disparities", 10)
    assert code == 0
    assert json.loads((board / "board.json").read_text())["entries"][0]["ndisp"] == 10
    assert twinlens("report", board, root / "pairs", "-o", root / "page.html")[0] == 0
    code, _, err = twinlens(*command)  # another range than the board's
    assert code == 2
    assert "search range differ" in err


def test_statistics_confidence_and_epipolar_lines(root, twinlens):
    pair = root / "pairs" / "desk"
    code, out, err = twinlens("statistics", root / "pairs", "-o", root / "s.png")
    assert (code, err) == (0, "")
    assert re.search(r"^noise +grey +[0-9.]+ ", out, re.M)
    assert re.search(r"^bias +grey +- ", out, re.M)
    assert (
        "without truth: 1 of 1 pairs (desk); these statistics need it: low_sd, bias"
        in out
    )
    code, out, _ = twinlens(
        "show", "confidence", pair, "--method", "zncc", "-o", root / "c.png", "--json"
    )
    assert code == 0
    record = json.loads(out)
    assert record["bad2.0"] is None
    assert set(record["measures"]) >= {"peak_ratio", "curvature"}
    code, out, _ = twinlens("show", "epipolar", pair, "-o", root / "e.png", "--json")
    assert code == 0
    found = json.loads(out)["features"]
    assert found["matches"] > 20
    assert found["off_px"][0] < 0.1  # rows of both images are the same
    for name in ("s.png", "c.png", "e.png"):
        assert cv2.imread(str(root / name)) is not None


def test_a_pair_that_is_not_rectified_is_seen(tmp_path, twinlens):
    left, right, _ = images(3)
    moved = np.roll(right, 3, axis=0)
    write_pair(tmp_path / "tilted", left, moved)
    code, out, _ = twinlens(
        "show", "epipolar", tmp_path / "tilted", "-o", tmp_path / "e.png", "--json"
    )
    assert code == 0
    middle = json.loads(out)["features"]["off_px"][0]
    # Sampson's distance of points 3 px off horizontal lines is 3 / sqrt(2).
    assert middle == pytest.approx(3 / 2**0.5, abs=0.2)


def test_exchanged_images_are_named(tmp_path, twinlens):
    left, right, truth = images()
    write_pair(tmp_path / "pairs" / "desk", right, left)
    code, _, err = twinlens(
        "benchmark", tmp_path / "pairs", "--methods", "zncc,sgm", "-o", tmp_path / "b"
    )
    assert code == 0
    assert err.count("left and right are probably exchanged") == 2
    pair, picture = tmp_path / "pairs" / "desk", tmp_path / "e.png"
    code, out, err = twinlens("show", "epipolar", pair, "-o", picture, "--json")
    assert (code, err.count("left and right are probably exchanged")) == (0, 1)
    low, high = json.loads(out)["features"]["disparity_px"]
    finite = truth[np.isfinite(truth)]
    assert -finite.max() - 1 < low < high < 1 - finite.min()


@pytest.mark.parametrize("form", ["grey", "16 bits", "16-bit grey"])
def test_other_images(tmp_path, twinlens, form):
    views = images()[:2]
    if "grey" in form:
        views = [cv2.cvtColor(view, cv2.COLOR_BGR2GRAY) for view in views]
    if "16" in form:
        views = [view.astype(np.uint16) * 257 for view in views]
    write_pair(tmp_path / "desk", *views)
    code, _, err = twinlens(
        "benchmark", tmp_path / "desk", "--methods", "zncc", "-o", tmp_path / "b"
    )
    assert (code, err) == (0, "")
    board = json.loads((tmp_path / "b/board.json").read_text())
    metrics = board["entries"][0]["regions"]["all"]["metrics"]
    assert 0.3 < metrics["photo_A50"] < 1.5  # 16 bits in the same unit
    assert twinlens("statistics", tmp_path / "desk")[0] == 0
    assert (
        twinlens("show", "epipolar", tmp_path / "desk", "-o", tmp_path / "e.png")[0]
        == 0
    )


def test_pairs_with_and_without_truth(tmp_path, twinlens):
    left, right, truth = images()
    for name in ("with", "without"):
        write_pair(tmp_path / "set" / name, left, right)
    cv2.imwrite(str(tmp_path / "set/with/disp0.pfm"), truth.astype(np.float32))
    code, out, err = twinlens(
        "benchmark", tmp_path / "set", "--methods", "sad,zncc", "-o", tmp_path / "b"
    )
    assert (code, err) == (0, "")
    assert "totbad2.0" in out
    assert "without truth: 1 of 2 pairs (without); their maps are compared" in out
    board = json.loads((tmp_path / "b/board.json").read_text())
    of = {(entry["sample"], entry["protocol"]) for entry in board["entries"]}
    assert of == {("with", "middlebury-v3"), ("without", "consistency")}
    code, out, _ = twinlens("statistics", tmp_path / "set")
    assert code == 0
    assert "without truth: 1 of 2 pairs (without)" in out


def kitti(folder):
    """A sequence as KITTI's odometry has it: three frames, one calibration with four projections."""
    for side, view in zip(("image_2", "image_3"), images()[:2], strict=True):
        (folder / side).mkdir(parents=True)
        for frame in range(3):
            cv2.imwrite(str(folder / side / f"{frame:06d}.png"), view)
    lines = []
    for camera, shift in enumerate((0.0, -54.0, 4.5, -49.5)):
        rows = f"100 0 59.5 {shift} 0 100 44.5 0 0 0 1 0"
        lines.append(f"P{camera}: {rows}\n")
    (folder / "calib.txt").write_text("".join(lines))


def test_the_folders_of_kitti(tmp_path, twinlens):
    kitti(tmp_path / "00")
    command = ("benchmark", tmp_path / "00", "--methods", "sad", "-o", tmp_path / "b")
    code, _, err = twinlens(*command)
    assert code == 0
    assert "searching 0 to 63; set it with --num-disparities" in err
    board = json.loads((tmp_path / "b/board.json").read_text())
    assert [entry["sample"] for entry in board["entries"]] == [
        "000000",
        "000001",
        "000002",
    ]
    code, out, _ = twinlens(
        "show", "epipolar", tmp_path / "00/000001", "-o", tmp_path / "e.png", "--json"
    )
    assert code == 0
    assert json.loads(out)["features"]["off_px"][0] < 0.1
    (tmp_path / "00/image_3/000001.png").unlink()
    code, _, err = twinlens(*command)
    assert code == 2
    assert "image_3/000001.png: no such file" in err


def test_without_a_calibration(tmp_path, twinlens):
    write_pair(tmp_path / "desk", *images()[:2], calib=None)
    pair = tmp_path / "desk"
    command = ("benchmark", pair, "--methods", "sad", "-o", tmp_path / "b")
    code, _, err = twinlens(*command)
    assert code == 0
    assert "searching 0 to 63" in err
    code, _, err = twinlens(*command[:-1], tmp_path / "c", "--ndisp", 24)
    assert (code, err) == (0, "")
    assert twinlens("statistics", pair)[0] == 0
    code, _, err = twinlens("show", "epipolar", pair, "-o", tmp_path / "e.png")
    assert code == 2
    assert "calib.txt: no such file; epipolar lines follow from the calibration" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("command", ["benchmark", "statistics", "costs"])
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("size", "im1 is uint8 (80, 120, 3): expected uint8 or uint16 (90, 120)"),
        ("depth", "im0 is uint8 and im1 is uint16: expected the same bit depth"),
        ("missing", "im1.png: no such file"),
        ("calib", "calib.txt: line 1 must read name=value"),
        ("damaged", "im1.png: "),
        ("other", "calib.txt is of 60x45 pixels, but the images have 120x90"),
    ],
)
def test_bad_input_is_one_line(tmp_path, twinlens, command, fault, message):
    left, right, _ = images()
    calib = CALIB
    if fault == "size":
        right = right[:80]
    if fault == "depth":
        right = right.astype(np.uint16) * 257
    if fault == "calib":
        calib = "fx 100\n"
    if fault == "other":
        calib = CALIB.replace("width=120", "width=60").replace("height=90", "height=45")
    write_pair(tmp_path / "desk", left, right, calib)
    if fault == "missing":
        (tmp_path / "desk/im1.png").unlink()
    if fault == "damaged":
        (tmp_path / "desk/im1.png").write_bytes(b"no image")
    commands = {
        "benchmark": ("benchmark", tmp_path / "desk", "-o", tmp_path / "b"),
        "statistics": ("statistics", tmp_path / "desk"),
        "costs": (
            "show",
            "costs",
            tmp_path / "desk",
            "--at",
            "5,5",
            "-o",
            tmp_path / "c.png",
        ),
    }
    code, out, err = twinlens(*commands[command])
    assert (code, out) == (2, "")
    assert message in err
    assert err.count("\n") == 1
    assert not (tmp_path / "c.png").exists()
    assert not (tmp_path / "b" / "index.html").exists()


@pytest.mark.slow
def test_the_commands_of_the_page_run(tmp_path):
    """docs/real_pairs.md, as printed."""
    write_pair(tmp_path / "pairs" / "desk", *images()[:2])
    for kind, text in blocks(DOCS / "real_pairs.md", "sh"):
        run_block(kind, text, tmp_path)
    for name in ("board/index.html", "costs.png", "epipolar.png", "disparity.pfm"):
        assert (tmp_path / name).is_file()


@needs_chromium
def test_the_legend_names_no_truth_before_a_pixel_is_chosen(root, board, tmp_path):
    page = (root / "board" / "index.html").read_text()
    dom = browse(tmp_path / "page.html", page)
    assert re.search(r'<span id="key-truth"[^>]* hidden=""', dom)
