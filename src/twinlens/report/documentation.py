"""Links from written pages to the documentation, where it is on this machine: in a checkout of the source."""

import html
from pathlib import Path

import twinlens

ROOT = Path(twinlens.__file__).parents[2]
SITE = "docs/site/docs"


def documentation_link(page: str, root: Path = ROOT) -> str:
    """HTML of a page of the documentation, such as "docs/studies.md#intervals" or "docs/course/08_triangulation.py".

    It is a link to the built site or to the file, whichever exists, and otherwise the name alone.
    """
    file, _, anchor = page.partition("#")
    name = f"<code>{html.escape(page)}</code>"
    for path in (_site_page(file, root), root / file):
        if path.is_file():
            address = path.as_uri() + (f"#{anchor}" if anchor else "")
            return f'<a href="{html.escape(address)}">{name}</a>'
    return name


def _site_page(file: str, root: Path) -> Path:
    """The page of the built site; the scripts of the course are in its gallery."""
    relative = Path(file).relative_to("docs")
    if relative.parts[0] == "course":
        relative = Path("gallery", *relative.parts[1:])
    return (root / SITE / relative).with_suffix(".html")
