"""Numbers in OBJ files: negative vertex numbers, which count back from the line that has them, made positive."""

from twinlens.errors import InputError

_KINDS = ("v", "vt", "vn")
"""The lines that the numbers v/vt/vn of a corner count."""
_NAMES = {"v": "vertex", "vt": "texture coordinate", "vn": "normal"}


def with_positive_numbers(lines: list[str]) -> list[str]:
    """The lines of an OBJ file with positive numbers in its faces; words are separated by one space.

    -1 is the last vertex before the face. So each object of a file may count by itself, which trimesh misreads. Raises
    InputError for a number that counts back beyond the first one. Other faces stay as they are.

    >>> with_positive_numbers(["v 0 0 0", "v 1 0 0", "v 0 1 0", "f -3 -2 -1", "v 0 0 1"])[3]
    'f 1 2 3'
    """
    counts = dict.fromkeys(_KINDS, 0)
    made = []
    for line in lines:
        keyword = line.partition(" ")[0]
        if keyword in counts:
            counts[keyword] += 1
        elif keyword == "f" and "-" in line:
            line = _positive_face(line, counts)
        made.append(line)
    return made


def _positive_face(face: str, counts: dict[str, int]) -> str:
    """A face with positive numbers; `counts` are those of the lines of each kind before it."""
    corners = []
    for corner in face.split(" ")[1:]:
        numbers = [
            _positive(number, kind, counts[kind], face)
            for number, kind in zip(corner.split("/"), _KINDS, strict=False)
        ]
        corners.append("/".join(numbers))
    return " ".join(["f", *corners])


def _positive(number: str, kind: str, count: int, face: str) -> str:
    if not (number.startswith("-") and number[1:].isdecimal()) or int(number) == 0:
        return number  # what is no number is reported later
    if -int(number) > count:
        raise InputError(
            f"the face {face[:60]!r} refers to {_NAMES[kind]} {number}; the file has {count} before it"
        )
    return str(count + 1 + int(number))
