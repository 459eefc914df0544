"""Sphinx settings of the documentation site: `make docs`.

The source folder is the repository, so that relative links are the same on the site and on GitHub. Nothing is fetched.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

from sphinx.application import Sphinx

import twinlens

project = "twinlens"
author = "twinlens contributors"
release = version = twinlens.__version__
root_doc = "docs/index"
include_patterns = [
    "docs/**.md",
    "docs/**.rst",
    "benchmarks/**.md",
    "examples/**.md",
    "*.md",
]
exclude_patterns = [
    ".*",
    "docs/site",
    "docs/course",
    "src",
    "tests",
    "scenes",
    "benchmarks/*/about.md",
]

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.napoleon",
    "sphinx_gallery.gen_gallery",
    "sphinx_mathml",
    "sphinx_reference",
]
html_math_renderer = "mathml"
myst_heading_anchors = 4  # the anchors of headings are those of GitHub
highlight_language = "text"
default_role = "py:obj"
python_use_unqualified_type_names = True
maximum_signature_line_length = 100
napoleon_google_docstring = False
autodoc_member_order = "bysource"
autodoc_typehints_format = "short"

sphinx_gallery_conf = {  # runs docs/course/*.py; an exception in a script fails the build
    "examples_dirs": "docs/course",  # from the source folder, the repository
    "gallery_dirs": "docs/gallery",
    "filename_pattern": r"/\d\d_\w+\.py$",
    "within_subsection_order": "FileNameSortKey",
    "reset_modules": ("course_style.reset",),
    "reset_modules_order": "both",
    "image_srcset": ["2x"],
    "notebook_extensions": {},
    "download_all_examples": False,
    "capture_repr": (),
    "show_signature": False,
    "write_computation_times": False,
}

html_theme = "furo"
html_title = f"twinlens {release}"
html_extra_path = ["redirect"]  # index.html of the site
html_static_path = ["static"]
html_css_files = ["phone.css", "gallery.css"]
html_copy_source = False
html_show_copyright = False


def _link_gallery(app: Sphinx, page: str, source: list[str]) -> None:
    """Let links to the folder of the course, which GitHub shows, lead to its gallery on the site."""
    source[0] = source[0].replace("](docs/course)", "](docs/gallery/index.rst)")


def setup(app: Sphinx) -> None:
    """Change the sources as they are read."""
    app.connect("source-read", _link_gallery)
