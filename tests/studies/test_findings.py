"""What a finding says where there is nothing that it was measured by."""

import math

import pytest

from twinlens.studies import Finding, Interval

NOTHING = Interval(math.nan, math.nan, math.nan)


def test_a_number_that_no_row_gives_has_no_verdict_and_is_not_printed():
    finding = Finding("Census has {} fewer", NOTHING, holds=True, unit="%")
    assert not finding.has_verdict
    assert finding.sentence == "Census has (not measured) fewer"


@pytest.mark.parametrize(
    ("text", "measured"), [("All is well", NOTHING), ("Least is {}", Interval(1.0, *2 * (math.nan,)))]
)
def test_a_sentence_without_a_number_and_a_number_without_an_interval_have_their_verdict(text, measured):
    finding = Finding(text, measured, holds=True)
    assert finding.has_verdict
    assert finding.holds
