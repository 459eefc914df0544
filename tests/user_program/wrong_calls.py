"""A user's program with five mistakes that a type checker must report, one a line. It is never run."""

import twinlens as tl

tl.mtach  # noqa: B018
disparity: int = tl.match([[1.0]], [[1.0]])
camera = tl.Camera(width=640)
tl.match([[1.0]], [[1.0]], methd="sad")
tl.study("texture", seed=1)
