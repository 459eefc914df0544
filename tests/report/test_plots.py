"""Figures show the table's values, and their bytes are reproducible."""

import numpy as np
import pytest

from twinlens.report.plots import PALETTE, draw, encode
from twinlens.studies import Column, Figure, Table

COLUMNS = (
    Column("scene", "", "scene"), Column("seed", "", "seed"), Column("method", "", "matcher"),
    Column("place", "", "place"), Column("z_m", "m", "depth"), Column("error", "%", "wrong"),
    Column("predicted", "%", "theory's"),
)  # fmt: skip


def table():
    return Table(COLUMNS, tuple(
        {"scene": scene, "seed": seed, "method": method, "place": place, "z_m": z, "error": z**2 * k + seed + base,
         "predicted": z**2 * k}
        for base, scene in enumerate("abc") for seed in (0.0, 1.0) for k, method in enumerate(("sad", "ssd"), 1)
        for place in ("near", "far") for z in (1.0, 2.0, 4.0)
    ))  # fmt: skip


LINE = Figure("f", "A title", "z_m", "error", by="method", panel="place")


def test_a_line_is_the_mean_and_its_band_the_scenes():
    axes = draw(LINE, table()).axes[0]
    line = next(line for line in axes.lines if line.get_label() == "ssd")
    assert np.allclose(line.get_ydata(), [2 + 1.5, 8 + 1.5, 32 + 1.5])
    band = axes.collections[1].get_paths()[0].get_extents()
    assert (band.ymin, band.ymax) == (2 + 0.5, 32 + 2.5)


def test_axes_say_quantity_and_unit_and_panels_their_value():
    sheet = draw(LINE, table())
    assert [axes.get_title() for axes in sheet.axes] == ["near", "far"]
    assert {axes.get_xlabel() for axes in sheet.axes} == {"depth (m)"}
    assert {axes.get_ylabel() for axes in sheet.axes} == {"wrong (%)"}
    assert [text.get_text() for text in sheet.legends[0].get_texts()] == ["sad", "ssd"]


def test_the_least_is_ringed():
    axes = draw(
        Figure("f", "t", "z_m", "error", by="method", best="least"), table()
    ).axes[0]
    rings = [line for line in axes.lines if line.get_markersize() == 10]
    assert [float(ring.get_xdata()[0]) for ring in rings] == [1.0, 1.0]


@pytest.mark.parametrize(
    "figure",
    [
        LINE,
        Figure("f", "t", "z_m", "error", by="method", panel="place", residual_of="predicted", log_y=True),
        Figure("f", "t", "z_m", "seed", panel="place", kind="heatmap", z="error"),
    ],
)  # fmt: skip
def test_a_panel_of_which_nothing_was_measured_says_so_and_makes_up_no_scale(figure):
    rows = Table(
        COLUMNS,
        tuple(
            {**row, "error": np.nan} if row["place"] == "near" else row
            for row in table()
        ),
    )
    sheet = draw(figure, rows)
    near = sheet.axes[0]
    assert near.get_title() == "near"
    assert [text.get_text() for text in near.texts] == ["nothing measured"]
    assert not len(near.get_xticks()) + len(near.get_yticks())
    far = next(axes for axes in sheet.axes if axes.get_title() == "far")
    assert len(far.get_yticks())
    assert "nothing measured" not in [text.get_text() for text in far.texts]
    assert encode(sheet, "png")[:4] == b"\x89PNG"


def test_residuals_are_measured_over_predicted():
    rows = Table(
        COLUMNS, tuple({**row, "error": 1.1 * row["predicted"]} for row in table())
    )
    sheet = draw(
        Figure(
            "f",
            "t",
            "z_m",
            "error",
            by="method",
            residual_of="predicted",
            also=("predicted",),
        ),
        rows,
    )
    assert sheet.axes[1].get_ylabel() == "residual (%)"
    assert np.allclose(sheet.axes[1].lines[0].get_ydata(), 10.0)


def test_a_map_has_a_cell_for_each_pair():
    sheet = draw(Figure("f", "t", "z_m", "seed", kind="heatmap", z="error"), table())
    image = sheet.axes[0].images[0].get_array()
    assert image.shape == (2, 3)
    assert image[1, 0] - image[0, 0] == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("look", "kind"), [("line", "png"), ("scatter", "svg"), ("heatmap", "svg")]
)
def test_the_same_table_gives_the_same_bytes(look, kind):
    figure = Figure(
        "f",
        "t",
        "z_m",
        "seed" if look == "heatmap" else "error",
        kind=look,
        z="error",
        log_x=True,
    )
    first, second = (encode(draw(figure, table()), kind) for _ in range(2))
    assert first == second
    assert first[:4] == (b"\x89PNG" if kind == "png" else b"<?xm")


def linear(colour):
    value = np.array([int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5)])
    return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)


# Viénot, Brettel and Mollon, Digital video colourmaps for checking the legibility of displays by dichromats, 1999.
DEUTERANOPE = np.array(
    [[0.29275, 0.70725, 0.0], [0.29275, 0.70725, 0.0], [-0.02234, 0.02234, 1.0]]
)
PROTANOPE = np.array(
    [[0.11238, 0.88762, 0.0], [0.11238, 0.88762, 0.0], [0.00401, -0.00401, 1.0]]
)


@pytest.mark.parametrize(
    "eye", [DEUTERANOPE, PROTANOPE], ids=["deuteranope", "protanope"]
)
def test_the_first_colours_stay_apart_for_the_colour_blind(eye):
    seen = np.clip([eye @ linear(colour) for colour in PALETTE[:6]], 0, 1) ** (1 / 2.4)
    apart = [np.abs(a - b).max() for k, a in enumerate(seen) for b in seen[:k]]
    assert min(apart) > 0.08
