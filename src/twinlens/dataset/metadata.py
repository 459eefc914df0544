"""A dataset's metadata: the name, licence and authors that its creator states, and croissant.json.

croissant.json describes the dataset to machine-learning tools, in MLCommons' Croissant 1.0 (JSON-LD on schema.org). One
record set lists the samples of dataset.json. Each kind of file (left images, left disparities, ...) has a record set of
its content and folder: the sample's name, followed by /lens-1 and so on for images of other lenses.

Source: Croissant Format Specification 1.0, https://docs.mlcommons.org/croissant/docs/croissant-spec.html.
"""

import fnmatch
import hashlib
import json
import re
from collections.abc import Iterator
from datetime import date
from typing import Annotated, Any
from urllib.parse import urlsplit

import numpy as np
import pydantic

from twinlens import schema
from twinlens.dataset.channels import DISPARITY, IMAGE, Channel, ViewFile, parse_file
from twinlens.dataset.dataset import MANIFEST, Dataset, Manifest
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.record import read
from twinlens.dataset.storage import Place
from twinlens.errors import FileError

KEY, UNNAMED = "about", "stereo dataset"
CROISSANT = "croissant.json"
_VERSION = "1.0.0"

_TEXT_FILES = {
    "calib.txt": (
        "calibration of the pair, as Middlebury's calib.txt",
        ["text/plain"],
    ),
    "sample.json": ("how the sample was made", ["text/plain", "application/json"]),
}
"""The files of a sample that are not of one view: description and media types."""

_TERMS = """citeAs column equivalentProperty extract field fileProperty fileObject fileSet format includes isLiveDataset
jsonPath key md5 parentField path recordSet references regex repeated replace samplingRate separator source subField
transform"""
CONTEXT: dict[str, Any] = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "dct": "http://purl.org/dc/terms/",
    "conformsTo": "dct:conformsTo",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    **{term: f"cr:{term}" for term in _TERMS.split()},
}
"""The specification's own @context, appendix 1."""


def _is_url(text: str) -> bool:
    parts = urlsplit(text)
    return bool(parts.scheme and parts.netloc) and not re.search(r"\s", text)


def _is_date(text: str) -> bool:
    return date.fromisoformat(text).isoformat() == text


Text = Annotated[
    str, schema.satisfies(str.strip, "must be a text that is not empty, got {}")
]
Url = Annotated[
    str,
    schema.satisfies(
        _is_url, "must be an address such as https://example.org/set, got {}"
    ),
]
Date = Annotated[
    str, schema.satisfies(_is_date, "must be a date such as 2026-01-31, got {}")
]


class Credit(schema.StrictModel):
    """Who made some of the files that a dataset was made from, and under which licence they may be used."""

    files: str = pydantic.Field(
        min_length=1, description="file or folder, or a pattern such as hdris/*.exr"
    )
    license: Text = pydantic.Field(
        default="", description="SPDX name, such as CC0-1.0, or the address of the text"
    )
    creator: Text = pydantic.Field(default="", description="author")
    url: Url = pydantic.Field(default="", description="where it is from")

    def covers(self, name: str) -> bool:
        """Whether a file, by its name relative to the recipe, is one of `files`."""
        pattern = self.files.removeprefix("./").rstrip("/")
        return (
            name == pattern
            or name.startswith(f"{pattern}/")
            or fnmatch.fnmatchcase(name, pattern)
        )


class About(schema.StrictModel):
    """The part of the card and of croissant.json that is not derived from files. Texts that are not given are empty."""

    name: Text = pydantic.Field(
        default="", description="of the dataset; 'stereo dataset' if not given"
    )
    description: Text = pydantic.Field(default="", description="one or more sentences")
    license: Text = pydantic.Field(
        default="",
        description="SPDX name, such as CC-BY-4.0, or the address of the text",
    )
    creator: Text = pydantic.Field(default="", description="who made it")
    url: Url = pydantic.Field(default="", description="where to get it")
    published: Date = pydantic.Field(
        default="", description="date of publication, such as 2026-01-31"
    )
    cite_as: Text = pydantic.Field(default="", description="BibTeX entry")

    credits: list[Credit] = pydantic.Field(
        default_factory=list, description="licences of the files it was made from"
    )

    @classmethod
    def of(cls, values: Any) -> "About":
        """Read plain data. Raises InputError that names the key."""
        return schema.read(cls, values, KEY)

    @property
    def title(self) -> str:
        """The name, or `UNNAMED`, so that a renamed copy of a dataset has the same card."""
        return self.name or UNNAMED

    def plain(self) -> dict[str, Any]:
        """The texts and credits that are given."""
        return self.model_dump(exclude_defaults=True)


def about(dataset: Dataset) -> tuple[About, Manifest]:
    """The recipe's About with the changes in `info`, and the manifest; empty without dataset.json. Raises FileError."""
    path = dataset.path / MANIFEST
    if not path.is_file():
        return About(), Manifest(())
    manifest = dataset.manifest
    return stated(manifest, path), manifest


def stated(manifest: Manifest, path: Place) -> About:
    """The recipe's About with the changes in `info`; `path` is named in messages. Raises FileError."""
    written, changed = (
        read(About, source.get(KEY, {}), path, KEY).plain()
        for source in (manifest.recipe, manifest.info)
    )
    return About.of(written | changed)


def write_croissant(dataset: Dataset, texts: About, manifest: Manifest) -> str:
    """Write croissant.json into a dataset's folder; returns its name. The same dataset gives the same bytes.

    It contains the SHA-256 of dataset.json, so it is written after it. Raises FileError and OutputError.
    """
    paths = set[str]().union(*(row.files for row in manifest.rows))
    if not manifest.rows:
        paths = {name for name in _plain_names() if dataset[0].has(name)}
    # Without the folders of lenses.
    names = sorted({name.rpartition("/")[2] for name in paths})
    described = []
    for name in names:
        description = _description(name, dataset)
        if description is not None:
            described.append(_file_records(name, *description))
    path = dataset.path / MANIFEST
    if path.is_file():
        described.insert(0, _manifest_records(read_bytes(path), manifest))
    record = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        **_stated_entries(texts),
        "distribution": [files for files, _ in described],
        "recordSet": [content for _, content in described],
    }
    text = json.dumps(record, indent=1, ensure_ascii=False)
    write_file(dataset.path / CROISSANT, f"{text}\n".encode())
    return CROISSANT


def _stated_entries(texts: About) -> dict[str, Any]:
    """The entries that the maker of a dataset states."""
    default = (
        f"{texts.title}: stereo pairs rendered by twinlens, with exact ground truth."
    )
    entries: dict[str, Any] = {
        "name": texts.title,
        "description": texts.description or default,
        "version": _VERSION,
    }
    optional = {
        "license": texts.license,
        "url": texts.url,
        "datePublished": texts.published,
        "citeAs": texts.cite_as,
    }
    entries |= {key: value for key, value in optional.items() if value}
    if texts.creator:
        entries["creator"] = {"@type": "sc:Person", "name": texts.creator}
    return entries


def _manifest_records(
    data: bytes, manifest: Manifest
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The FileObject of dataset.json, and the RecordSet of its samples."""
    text = "The samples, and the SHA-256 of each of their files."
    digest = hashlib.sha256(data).hexdigest()
    file = _node(
        "FileObject",
        MANIFEST,
        description=text,
        contentUrl=MANIFEST,
        contentSize=f"{len(data)} B",
    )
    fields = [("name", "the sample's folder", "$.samples[*].name")]
    if manifest.rows and all("split" in row.info for row in manifest.rows):
        fields.append(("split", "the split of the dataset", "$.samples[*].info.split"))
    entries = [
        _field(
            f"samples/{name}",
            text,
            "sc:Text",
            {"fileObject": {"@id": MANIFEST}, "extract": {"jsonPath": path}},
        )
        for name, text, path in fields
    ]
    samples = _node("RecordSet", "samples", field=entries, key={"@id": "samples/name"})
    return file | {"encodingFormat": "application/json", "sha256": digest}, samples


def _plain_names() -> Iterator[str]:
    """The files that a folder without a dataset.json may have."""
    for view in (0, 1):
        yield IMAGE.name(view)
        yield from DISPARITY.names(view)
    yield "calib.txt"


def _description(name: str, dataset: Dataset) -> tuple[str, list[str], str] | None:
    """What a file of a sample holds, its media types, and Croissant's type; None for files that are not described."""
    if name in _TEXT_FILES:
        text, media_types = _TEXT_FILES[name]
        return text, media_types, "sc:Text"
    parsed = parse_file(name)
    if parsed is None:
        return None
    file, view = parsed.file, parsed.view
    text = file.description(view, _channels_in(dataset, file, view))
    return text, list(file.format.media_types), file.format.data_type


def _channels_in(dataset: Dataset, file: ViewFile, view: int) -> list[Channel]:
    """The channels that a file of several holds in some sample, by one sample of each version of twinlens.

    Samples of an earlier version lack some, and those without projectors have empty ones.
    """
    if len(file.channels) == 1:
        return file.channels
    versions: set[str] = set()
    held: set[str] = set()
    for sample in dataset:
        try:
            version = sample.written_by
            if version in versions:
                continue
            arrays = file.read(sample.path(file.name(view)))
        except FileError:
            continue
        versions.add(version)
        held |= {name for name, array in arrays.items() if np.size(array)}
    return [channel for channel in file.channels if channel.name in held]


def _file_records(
    name: str, text: str, encoding: list[str], kind: str
) -> tuple[dict[str, Any], dict[str, Any]]:
    """The FileSet of all files of one name, and the RecordSet of their folders and contents."""
    ident = name.replace(".", "-")
    # The star also matches slashes, so nested samples and images of other lenses are found.
    files = _node(
        "FileSet",
        f"{name}-files",
        description=text,
        includes=f"*/{name}",
        encodingFormat=encoding,
    )
    source = {"fileSet": {"@id": f"{name}-files"}}
    folder = {
        "extract": {"fileProperty": "fullpath"},
        "transform": {"regex": f"^(.*)/{re.escape(name)}$"},
    }
    where = "the sample's name, and the folder of the lens if it is not the first"
    fields = [
        _field(f"{ident}/folder", where, "sc:Text", source | folder),
        _field(
            f"{ident}/content",
            text,
            kind,
            source | {"extract": {"fileProperty": "content"}},
        ),
    ]
    return files, _node("RecordSet", ident, description=text, field=fields)


def _field(ident: str, text: str, kind: str, source: dict[str, Any]) -> dict[str, Any]:
    return _node("Field", ident, description=text, dataType=kind, source=source)


def _node(kind: str, ident: str, **entries: Any) -> dict[str, Any]:
    return {"@type": f"cr:{kind}", "@id": ident, "name": ident, **entries}
