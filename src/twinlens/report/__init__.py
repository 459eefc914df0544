"""report: numbers into figures and one self-contained page. Never recomputes a score, never renders, never matches."""

from twinlens.report.colormaps import COLORMAPS, NO_ESTIMATE, NO_TRUTH, colourise
from twinlens.report.page import Maps, page_html, write_page

__all__ = ["COLORMAPS", "NO_ESTIMATE", "NO_TRUTH", "Maps", "colourise", "page_html", "write_page"]
