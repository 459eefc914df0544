"""Figures and self-contained HTML pages of boards and studies; computes no scores."""

from twinlens.report.colormaps import COLORMAPS, NO_ESTIMATE, NO_TRUTH, colourise
from twinlens.report.page import Maps, page_html, write_page

__all__ = ["COLORMAPS", "NO_ESTIMATE", "NO_TRUTH", "Maps", "colourise", "page_html", "write_page"]
