"""Two images in, one disparity map out. No rendering, and nothing compiled before the first match.

No files either, but for what a stranger's matcher is made of: `program` hands a program its pair, `network` opens a
model, `identity` hashes them.
"""

from twinlens.matching.costs import COSTS
from twinlens.matching.external import PythonFunction
from twinlens.matching.images import grey
from twinlens.matching.matcher import OPTIMISATIONS, StereoMatcher
from twinlens.matching.measures import birchfield_tomasi, census, jaccard, ncc, rank, sad, ssd, zncc, zsad, zssd
from twinlens.matching.methods import METHODS, Method, MethodSpec, find_method, match, parse_method, split_commas
from twinlens.matching.network import OnnxNetwork
from twinlens.matching.opencv import OpenCVBlock, OpenCVSemiGlobal
from twinlens.matching.program import Program, ProgramTimeoutError
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
    "split_commas",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
]
