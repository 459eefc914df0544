"""Damaged files of every form are read, or refused in one line: no traceback, no hang, no flood of memory."""

import pytest

from tests.dataset.test_fuzz import in_process  # noqa: F401
from tests.scenes.damaged_files import KINDS_OF_FILES, outcomes

CASES = {"usda": 300, "usdc": 150, "usdz": 100}
"""Others: 2000."""


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS_OF_FILES)
def test_damaged_files_are_read_or_refused_in_one_line(kind, tmp_path, in_process):  # noqa: F811
    in_process(check, kind, tmp_path, CASES.get(kind, 2000))


def check(kind, folder, cases):
    counts, faults, _ = outcomes(kind, folder, cases)
    assert not faults
    assert counts["read"] + counts["refused"] == cases
    assert counts["refused"] > cases / 20
