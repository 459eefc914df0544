import pytest

from twinlens.camera import BareAperture, Pinhole, ThinLens
from twinlens.cli.benchmark import split_methods
from twinlens.cli.specs import middle_focus, parse_lens, parse_size
from twinlens.errors import InputError


@pytest.mark.parametrize(
    ("text", "lens"),
    [
        ("pinhole", Pinhole()),
        ("thin:20", ThinLens(0.02, 3.0)),
        ("thin:20@1.5", ThinLens(0.02, 1.5)),
        ("f/2@inf", ThinLens(0.0025, float("inf"))),
        ("hole:0.35@50", BareAperture(0.35e-3, 0.05)),
    ],
)
def test_lenses(text, lens):
    assert parse_lens(text, focus=3.0, film_distance=0.005) == lens


@pytest.mark.parametrize("text", ["", "thick:2", "thin:", "thin:x", "thin:nan", "thin:-2", "f/0", "hole:1", "thin:2@0"])
def test_lenses_that_cannot_be(text):
    with pytest.raises(InputError):
        parse_lens(text, focus=3.0, film_distance=0.005)


@pytest.mark.parametrize("text", ["640", "640x", "x480", "-1x4", "640x480x3", "6.4x480"])
def test_sizes_that_cannot_be(text):
    with pytest.raises(InputError, match="WIDTHxHEIGHT"):
        parse_size(text)


def test_the_middle_focus_lies_midway_in_disparity():
    near, far = 1.0, 4.0
    assert 1 / near - 1 / middle_focus((near, far)) == pytest.approx(1 / middle_focus((near, far)) - 1 / far)


def test_options_stay_with_their_method():
    assert split_methods(["sad:block_size=5,lr_check=1,zncc", "ssd"]) == ["sad:block_size=5,lr_check=1", "zncc", "ssd"]
