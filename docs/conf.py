"""Sphinx settings of the documentation site: `make docs`.

The source folder is the repository, so that relative links are the same on the site and on GitHub. Nothing is fetched.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import twinlens

project = "twinlens"
author = "twinlens contributors"
release = version = twinlens.__version__
root_doc = "docs/index"
include_patterns = ["docs/**.md", "docs/**.rst", "benchmarks/**.md", "examples/**.md", "*.md"]
exclude_patterns = [".*", "docs/site", "src", "tests", "scenes", "benchmarks/frozen/about.md"]

extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_reference"]
myst_heading_anchors = 4  # the anchors of headings are those of GitHub
highlight_language = "text"
default_role = "py:obj"
python_use_unqualified_type_names = True
maximum_signature_line_length = 100
napoleon_google_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"

html_theme = "furo"
html_title = f"twinlens {release}"
html_extra_path = ["redirect"]  # index.html of the site
html_static_path = ["static"]
html_css_files = ["phone.css"]
html_copy_source = False
html_show_copyright = False
