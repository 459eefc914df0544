"""Stereo matching: two rectified images in, one disparity map out. No rendering.

Importing it does not import Numba; the kernels compile at the first match and are cached on disk. Only `external`,
which runs other people's matchers, uses files.
"""

from twinlens.matching.external import Program
from twinlens.matching.images import grey
from twinlens.matching.matcher import StereoMatcher
from twinlens.matching.measures import birchfield_tomasi, census, jaccard, ncc, rank, sad, ssd, zncc, zsad, zssd
from twinlens.matching.methods import (
    METHODS,
    find_method,
    match,
    parse_method,
    parse_methods,
    parse_program,
    split_methods,
)
from twinlens.matching.options import Matcher

__all__ = [
    "METHODS",
    "Matcher",
    "Program",
    "StereoMatcher",
    "birchfield_tomasi",
    "census",
    "find_method",
    "grey",
    "jaccard",
    "match",
    "ncc",
    "parse_method",
    "parse_methods",
    "parse_program",
    "rank",
    "sad",
    "split_methods",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
]
