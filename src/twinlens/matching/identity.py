"""What a matcher consists of beside its options: the contents of the files that it is made of, as one short text.

A board goes by it: another network under the same name is another method, and its old scores no longer hold. The
matchers of twinlens itself consist of no files; a matcher that does has a property `content`.
"""

import functools
import hashlib
from collections.abc import Iterable
from pathlib import Path

SHORT = 16
"""Hexadecimal digits of a SHA-256 that are kept: 64 bits, which no two files meet by chance."""


def content_of(paths: Iterable[Path]) -> str:
    """`name=hash` of every file, by name; a file that cannot be read is `absent`, which is a state like any other.

    >>> content_of([Path("no-such-file")]), content_of([])
    ('no-such-file=absent', '')
    """
    return ",".join(f"{path.name}={_hash(path)}" for path in sorted(set(paths)))


def _hash(path: Path) -> str:
    try:
        state = path.stat()
        return _hash_of_state(path, state.st_mtime_ns, state.st_size)
    except OSError:
        return "absent"


@functools.lru_cache(maxsize=256)
def _hash_of_state(path: Path, _written_ns: int, _size: int) -> str:
    """Read once for each state of the file: a board asks for every sample, and a network is large."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:SHORT]
