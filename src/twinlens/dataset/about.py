"""What only a dataset's maker can say of it: name, licence, authors; kept in dataset.json under ``info.about``."""

import dataclasses
import re
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import date
from typing import Any
from urllib.parse import urlsplit

from twinlens.dataset.dataset import Dataset
from twinlens.dataset.manifest import NAME, Manifest
from twinlens.errors import FileError, InputError, format_value, unknown

KEY = "about"
UNNAMED = "stereo dataset"


@dataclass(frozen=True)
class About:
    """What a card and Croissant metadata say beyond what the files tell; text, empty where it is not said.

    name : of the dataset; "stereo dataset" where empty, so that a copy of it says the same.
    description : one sentence or more.
    license : an SPDX name as ``CC-BY-4.0``, or the address of a licence's text.
    creator : who made it. url : where it can be had. published : the date, ``2026-01-31``. cite_as : a BibTeX entry.

    Raises InputError for a date or an address that is none.
    """

    name: str = ""
    description: str = ""
    license: str = ""
    creator: str = ""
    url: str = ""
    published: str = ""
    cite_as: str = ""

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            if not isinstance(getattr(self, field.name), str):
                raise InputError(f"{KEY}: {field.name} must be text, got {getattr(self, field.name)!r}")
        if self.url and not _is_address(self.url):
            raise InputError(f"{KEY}: url must be an address, as https://example.org/set, got {format_value(self.url)}")
        if self.published and not _is_date(self.published):
            raise InputError(f"{KEY}: published must be a date, as 2026-01-31, got {format_value(self.published)}")

    @classmethod
    def of(cls, values: Any) -> "About":
        """From plain data, or InputError naming the key that is not known, or says nothing."""
        known = [field.name for field in dataclasses.fields(cls)]
        if not isinstance(values, Mapping):
            raise InputError(f"{KEY} must be a table of {', '.join(known)}")
        for key in values:
            if key not in known:
                raise unknown(f"key of {KEY}", str(key), known)
            if isinstance(values[key], str) and not values[key].strip():
                raise InputError(f"{KEY}: {key} is empty; say something, or leave it out")
        return cls(**values)

    @property
    def title(self) -> str:
        """The name, or what stands for it."""
        return self.name or UNNAMED

    def plain(self) -> dict[str, str]:
        """What is said, as a manifest's info holds it."""
        return {name: value for name, value in dataclasses.asdict(self).items() if value}


def _is_address(text: str) -> bool:
    try:
        parts = urlsplit(text)
    except ValueError:  # brackets that are not closed
        return False
    return bool(parts.scheme and parts.netloc) and not re.search(r"\s", text)


def _is_date(text: str) -> bool:
    try:
        return bool(re.fullmatch(r"[0-9]{4}-[0-9]{2}-[0-9]{2}", text) and date.fromisoformat(text))
    except ValueError:
        return False


def about(dataset: Dataset) -> tuple[About, Manifest]:
    """What its maker says of the dataset, in dataset.json or its recipe, and its manifest; empty where there is none.

    Raises FileError for what is said wrongly.
    """
    path = dataset.path / NAME
    if not path.is_file():
        return About(), Manifest(())
    manifest = dataset.manifest
    try:
        return About.of(manifest.info.get(KEY, manifest.recipe.get(KEY, {}))), manifest
    except InputError as error:
        raise FileError(f"{path}: {error}") from None
