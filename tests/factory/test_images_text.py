"""The line that `render` and `generate` print first says which defaults a recipe changes."""

import pytest

from twinlens.factory.images_text import images_of_recipe

EQUAL = ("cameras that differ (mismatch typical)", "equal cameras (mismatch none)")
DEFAULT = "images: sensor machine_vision, cameras that differ (mismatch typical), 8 samples per pixel, denoised"


@pytest.mark.parametrize(
    ("written", "line"),
    [
        ({}, DEFAULT),
        ({"denoise": False}, DEFAULT.replace("denoised", "not denoised")),
        ({"rig": {"layout": "light_field"}}, DEFAULT.replace(*EQUAL)),
        ({"spp": 64}, DEFAULT.replace("8 samples", "64 samples")),
        (
            {"sensor": {"preset": "phone", "mismatch": "none"}},
            DEFAULT.replace("machine_vision", "phone").replace(*EQUAL),
        ),
        (
            {"sensor": {"preset": "ideal"}},
            DEFAULT.replace("machine_vision", "ideal").replace(*EQUAL),
        ),
        ({"sensor": {"mismatch": {"level": {"choice": ["typical", "consumer"]}}}}, DEFAULT.replace("typical", "drawn")),
        ({"sensor": {"mismatch": {"gain": 1.1}}}, DEFAULT.replace("typical", "as set")),
        ({"sensor": {"mismatch": ["typical", "consumer"]}}, DEFAULT.replace("typical", "typical, consumer")),
        ({"sensor": {"preset": {"choice": ["ideal", "phone"]}}}, DEFAULT.replace("machine_vision", "drawn")),
    ],
)  # fmt: skip
def test_a_recipe_in_one_line(written, line):
    assert images_of_recipe(written) == line
