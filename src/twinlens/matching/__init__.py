"""Stereo matching: two rectified images in, one disparity map out; depth from focus and defocus. No rendering.

Importing it does not import Numba; the kernels compile at the first match and are cached on disk. Only `external`,
which runs other people's matchers, uses files.
"""

from twinlens.matching.confidence import (
    CONFIDENCES as CONFIDENCES,
    confidence_map as confidence_map,
)
from twinlens.matching.contract import Answer as Answer, Matcher as Matcher
from twinlens.matching.curves import CostCurve as CostCurve, cost_curve as cost_curve
from twinlens.matching.defocus import (
    ApertureSamples as ApertureSamples,
    all_in_focus as all_in_focus,
    inverse_depth_bound as inverse_depth_bound,
    inverse_depth_from_defocus as inverse_depth_from_defocus,
    inverse_depth_from_focus as inverse_depth_from_focus,
    sharpness as sharpness,
)
from twinlens.matching.external import Program as Program
from twinlens.matching.features import feature_matches as feature_matches
from twinlens.matching.images import grey as grey
from twinlens.matching.matcher import StereoMatcher as StereoMatcher
from twinlens.matching.measures import (
    birchfield_tomasi as birchfield_tomasi,
    census as census,
    jaccard as jaccard,
    ncc as ncc,
    rank as rank,
    sad as sad,
    ssd as ssd,
    zncc as zncc,
    zsad as zsad,
    zssd as zssd,
)
from twinlens.matching.methods import (
    METHODS as METHODS,
    match as match,
    match_with_confidence as match_with_confidence,
    parse_method as parse_method,
    parse_methods as parse_methods,
    parse_program as parse_program,
    split_methods as split_methods,
)
