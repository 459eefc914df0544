import pytest

from twinlens.errors import InputError
from twinlens.matching import parse_method


@pytest.mark.parametrize(
    "text",
    [
        "sad:contrast=none",
        "sad:speckle_range=none",
        "sad:uniqueness=abc",
        "sad:uniqueness=100",
        "sad:lr_check=-1",
        "opencv_bm:texture=-1",
        "opencv_bm:uniqueness=abc",
        "opencv_sgbm:uniqueness=1.5",
        "program:command=x,timeout_s=nan",
    ],
)
def test_wrong_options_are_refused_in_one_line(text):
    with pytest.raises(InputError) as refusal:
        parse_method(text)
    assert "\n" not in str(refusal.value)


def test_an_even_block_size_suggests_sizes_that_are_allowed():
    with pytest.raises(InputError, match="must be a whole number >= 5, got 4"):
        parse_method("opencv_bm:block_size=4")
    with pytest.raises(InputError, match="use 5 or 7"):
        parse_method("opencv_bm:block_size=6")


def test_none_switches_an_option_off():
    assert (
        parse_method("sad:uniqueness=none,texture=none").matcher()
        == parse_method("sad").matcher()
    )
