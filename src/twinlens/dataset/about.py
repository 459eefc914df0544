"""A dataset's name, licence and authors, as its maker states them; kept in dataset.json under ``info.about``."""

import re
from datetime import date
from typing import Annotated, Any
from urllib.parse import urlsplit

import pydantic

from twinlens import schema
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.manifest import NAME, Manifest
from twinlens.dataset.record import read
from twinlens.errors import InputError

KEY = "about"
UNNAMED = "stereo dataset"


def _check_text(text: str) -> str:
    if not text.strip():
        raise InputError("is empty; give a text, or leave the key out")
    return text


def _check_url(text: str) -> str:
    try:
        parts = urlsplit(text)
    except ValueError:  # unbalanced brackets
        parts = urlsplit("")
    if not (parts.scheme and parts.netloc) or re.search(r"\s", text):
        raise InputError(f"must be an address such as https://example.org/set, got {text[:60]!r}")
    return text


def _check_date(text: str) -> str:
    try:
        if re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", text) and date.fromisoformat(text):
            return text
    except ValueError:
        pass
    raise InputError(f"must be a date such as 2026-01-31, got {text[:60]!r}")


Text = Annotated[str, pydantic.AfterValidator(_check_text)]


class About(schema.StrictModel):
    """What the card and the Croissant metadata say beyond the files; a text is empty where it is not given."""

    name: Text = pydantic.Field(default="", description="of the dataset; 'stereo dataset' if not given")
    description: Text = pydantic.Field(default="", description="one or more sentences")
    license: Text = pydantic.Field(
        default="", description="SPDX name, such as CC-BY-4.0, or the address of a licence's text"
    )
    creator: Text = pydantic.Field(default="", description="who made it")
    url: Annotated[Text, pydantic.AfterValidator(_check_url)] = pydantic.Field(
        default="", description="where to get it"
    )
    published: Annotated[Text, pydantic.AfterValidator(_check_date)] = pydantic.Field(
        default="", description="2026-01-31"
    )
    cite_as: Text = pydantic.Field(default="", description="BibTeX entry")

    @classmethod
    def of(cls, values: Any) -> "About":
        """Read plain data. Raises InputError that names the key."""
        return schema.read(cls, values, KEY)

    @property
    def title(self) -> str:
        """The name, or `UNNAMED`, so that a renamed copy of a dataset has the same card."""
        return self.name or UNNAMED

    def plain(self) -> dict[str, str]:
        """The texts that are given."""
        return {name: value for name, value in self.model_dump().items() if value}


def about(dataset: Dataset) -> tuple[About, Manifest]:
    """The About in dataset.json or its recipe, and the manifest; empty ones without dataset.json. Raises FileError."""
    path = dataset.path / NAME
    if not path.is_file():
        return About(), Manifest(())
    manifest = dataset.manifest
    return read(About, manifest.info.get(KEY, manifest.recipe.get(KEY, {})), path, KEY), manifest
