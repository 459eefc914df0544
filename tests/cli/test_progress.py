"""Progress without a terminal: a line now and then."""

import pytest

from twinlens.cli import progress


@pytest.mark.parametrize(
    ("seconds", "every", "lines"),
    [
        ([0, 10, 29.9, 30, 45, 59, 60, 61], 30, ["25 %, about 0:01:30", "50 %, about 0:01:00"]),
        ([0, 1, 2], 30, []),
        ([0, 100, 200], 30, ["25 %, about 0:05:00", "50 %, about 0:03:20"]),
    ],
)  # fmt: skip
def test_a_log_gets_a_line_now_and_then(monkeypatch, capsys, seconds, every, lines):
    monkeypatch.setattr(progress, "LOG_EVERY_S", every)
    shares = {30: 0.25, 60: 0.5, 100: 0.25, 200: 0.5}
    moments = iter(seconds)
    now = next(moments)
    monkeypatch.setattr(progress.time, "monotonic", lambda: now)
    with progress.progress_bar("generating") as report:
        for now in moments:
            report(shares.get(now, 0.1), "3/12")
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [f"generating 3/12: {line} left" for line in lines]
