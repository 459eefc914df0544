"""What the block-size study concludes of a table whose answer is known."""

import pytest

from twinlens.studies import STUDIES, Table, window


def edges(adaptive):
    """Wrong pixels at the discontinuities of three scenes, SSD with a large fixed block having 20 %."""
    wrong = {"ssd:block_size=21": 20.0, "adaptive": adaptive, "sgm": 12.0}
    row = dict.fromkeys((column.name for column in STUDIES["window"].all_columns), float("nan"))
    return Table(
        STUDIES["window"].all_columns,
        tuple(
            {
                **row,
                "scene": scene,
                "seed": 0.0,
                "method": method,
                "region": "discontinuity",
                "totbad2": value + (k if method == "adaptive" else 0.0),
            }
            for scene, k in (("a", 0.0), ("b", 1.0), ("c", 2.0))
            for method, value in wrong.items()
        ),
    )


@pytest.mark.parametrize(
    ("adaptive", "said", "holds"),
    [
        (14.0, "5 percent points (range of 3: 4 to 6)", True),
        (46.8, "27.8 percent points (range of 3: 26.8 to 28.8)", False),
    ],
)
def test_what_is_fewer_and_what_is_more_is_said_without_a_sign(adaptive, said, holds):
    finding = window.conclude(edges(adaptive))[-2]
    way = "fewer" if holds else "more"
    assert finding.sentence.startswith("At discontinuities an adaptive window has fewer wrong pixels than SSD")
    assert finding.sentence.endswith(f": {said} {way}")
    assert "-" not in finding.sentence
    assert finding.holds is holds
