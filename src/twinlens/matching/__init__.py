"""Stereo matching: two rectified images in, one disparity map out. No rendering.

Importing it does not import Numba; the kernels compile at the first match and are cached on disk. Only `external`,
which runs other people's matchers, uses files.
"""

from twinlens.matching.costs import COSTS
from twinlens.matching.external import OnnxNetwork, Program, ProgramTimeoutError, PythonFunction
from twinlens.matching.images import grey
from twinlens.matching.matcher import OPTIMISATIONS, StereoMatcher
from twinlens.matching.measures import birchfield_tomasi, census, jaccard, ncc, rank, sad, ssd, zncc, zsad, zssd
from twinlens.matching.methods import METHODS, Method, MethodSpec, find_method, match, parse_method, split_methods
from twinlens.matching.opencv import OpenCVBlock, OpenCVSemiGlobal
from twinlens.matching.options import Matcher
from twinlens.matching.refine import consistent
from twinlens.matching.supports import SUPPORTS

__all__ = [
    "COSTS",
    "METHODS",
    "OPTIMISATIONS",
    "SUPPORTS",
    "Matcher",
    "Method",
    "MethodSpec",
    "OnnxNetwork",
    "OpenCVBlock",
    "OpenCVSemiGlobal",
    "Program",
    "ProgramTimeoutError",
    "PythonFunction",
    "StereoMatcher",
    "birchfield_tomasi",
    "census",
    "consistent",
    "find_method",
    "grey",
    "jaccard",
    "match",
    "ncc",
    "parse_method",
    "rank",
    "sad",
    "split_methods",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
]
