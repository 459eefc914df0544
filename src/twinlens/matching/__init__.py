"""Two images in, one disparity map out. No files, no rendering, and nothing compiled before the first match."""

from .costs import COSTS
from .images import grey
from .matcher import StereoMatcher
from .measures import jaccard, ncc, sad, ssd, zncc, zsad, zssd
from .methods import METHODS, Method, MethodSpec, find_method, match, parse_method
from .refine import consistent

__all__ = [
    "COSTS",
    "METHODS",
    "Method",
    "MethodSpec",
    "StereoMatcher",
    "consistent",
    "find_method",
    "grey",
    "jaccard",
    "match",
    "ncc",
    "parse_method",
    "sad",
    "ssd",
    "zncc",
    "zsad",
    "zssd",
]
