"""Damaged files, as broken downloads, full disks and flipped bits make them."""

from hypothesis import strategies as st


@st.composite
def damaged(draw, good):
    """`good` truncated, extended, with changed bytes, or with bytes removed."""
    kind = draw(st.sampled_from(["cut", "change", "extend", "remove", "header"]))
    place = draw(st.integers(0, len(good) - 1))
    if kind == "cut":
        return good[:place]
    if kind == "extend":
        return good + draw(st.binary(min_size=1, max_size=8))
    if kind == "remove":
        return good[:place] + good[place + draw(st.integers(1, 16)) :]
    data = bytearray(good)
    for _ in range(draw(st.integers(1, 4))):
        limit = min(len(good), 200) if kind == "header" else len(good)
        data[draw(st.integers(0, limit - 1))] = draw(st.integers(0, 255))
    return bytes(data)
