"""scoring: disparity and truth in, numbers out. Metrics, regions, protocols, and the leaderboard made of them.

Never renders, never matches, never draws; usable where mitsuba cannot be imported.
"""

from twinlens.scoring.evaluate import RegionScores, Scores, evaluate
from twinlens.scoring.kitti import interpolate_background
from twinlens.scoring.protocols import PROTOCOLS, Protocol, find_protocol

__all__ = ["PROTOCOLS", "Protocol", "RegionScores", "Scores", "evaluate", "find_protocol", "interpolate_background"]
