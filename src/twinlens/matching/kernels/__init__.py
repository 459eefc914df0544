"""Compiled inner loops of the matching room: arrays in, arrays out, no checks. Its modules import Numba.

In the searching kernels the disparity is the innermost dimension: one step handles LANES candidates of a pixel.
"""

LANES = 32
"""Candidates handled at once. The depth of a cost volume in these kernels is a multiple of it."""
