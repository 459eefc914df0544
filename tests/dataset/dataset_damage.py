"""Damaged files: what a broken download, a full disk or a flipped bit make of good bytes."""

from hypothesis import strategies as st


@st.composite
def damaged(draw, good: bytes) -> bytes:
    """`good`, cut short, with bytes changed, doubled, or with a stretch taken out."""
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
