"""Figures and self-contained HTML pages of boards and studies; computes no scores."""

from twinlens.dataset.pictures import colourise as colourise
from twinlens.report.page import write_page as write_page
