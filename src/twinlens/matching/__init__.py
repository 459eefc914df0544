"""Two images in, one disparity map out. No files, no rendering, and nothing compiled before the first match."""

from twinlens.matching.costs import COSTS
from twinlens.matching.external import OpenCVBlock, OpenCVSemiGlobal, Program, PythonFunction
from twinlens.matching.images import grey
from twinlens.matching.matcher import OPTIMISATIONS, StereoMatcher
from twinlens.matching.measures import birchfield_tomasi, census, jaccard, ncc, rank, sad, ssd, zncc, zsad, zssd
from twinlens.matching.methods import METHODS, Method, MethodSpec, find_method, match, parse_method, split_commas
from twinlens.matching.network import OnnxNetwork
from twinlens.matching.refine import consistent
from twinlens.matching.supports import SUPPORTS

__all__ = [
    "COSTS",
    "METHODS",
    "OPTIMISATIONS",
    "SUPPORTS",
    "Method",
    "MethodSpec",
    "OnnxNetwork",
    "OpenCVBlock",
    "OpenCVSemiGlobal",
    "Program",
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
    "split_commas",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
]
