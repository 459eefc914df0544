"""croissant.json: the dataset described to machine-learning tools, in MLCommons' Croissant 1.0 (JSON-LD on schema.org).

One record set lists the samples of dataset.json. Each kind of file (left images, left disparities, ...) has a record
set of its content and folder: the sample's name, followed by /lens-1 and so on for images of other lenses.

Source: Croissant Format Specification 1.0, https://docs.mlcommons.org/croissant/docs/croissant-spec.html.
"""

import hashlib
import json
import re
from collections.abc import Iterable
from typing import Any

from twinlens.dataset.about import About, about
from twinlens.dataset.dataset import Dataset
from twinlens.dataset.files import read_bytes, write_file
from twinlens.dataset.manifest import NAME as MANIFEST
from twinlens.dataset.manifest import Manifest
from twinlens.dataset.storage import Where

NAME = "croissant.json"
_VERSION = "1.0.0"

# mlcroissant decodes few formats, and returns the bytes of text: hence the second media types.
_PNG, _PFM = ["image/png"], ["image/x-portable-floatmap", "text/plain"]
_EXR, _TEXT, _JSON = ["image/x-exr", "text/plain"], ["text/plain"], ["text/plain", "application/json"]
_KINDS = {
    "im": ("image of view {}", _PNG, "sc:ImageObject"),
    "disp": ("true disparity of view {}: float32 pixels, +inf unknown", _PFM, "sc:ImageObject"),
    "mask": ("view {}: 255 visible in both, 128 occluded or out of frame, 0 unknown", _PNG, "sc:ImageObject"),
    "truth": ("truth of view {}: depth, position, normals, ids, blur circle", _EXR, "sc:Text"),
    "radiance": ("linear image of view {}", _EXR, "sc:Text"),
    "calib": ("calibration of the pair, as Middlebury's calib.txt", _TEXT, "sc:Text"),
    "sample": ("how the sample was made", _JSON, "sc:Text"),
}
_FILE = re.compile(r"(?:.*/)?(([a-z]+)(\d*)[A-Za-z]*)\.[a-z]+$")

_TERMS = (
    *("citeAs", "column", "equivalentProperty", "extract", "field", "fileProperty", "fileObject", "fileSet", "format"),
    *("includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField", "path", "recordSet", "references", "regex"),
    *("repeated", "replace", "samplingRate", "separator", "source", "subField", "transform"),
)
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
    **{term: f"cr:{term}" for term in _TERMS},
}
"""The specification's own @context, appendix 1."""


def write_croissant(dataset: Where | Dataset) -> str:
    """Write croissant.json into a dataset's folder; returns its name. The same dataset gives the same bytes.

    It contains the SHA-256 of dataset.json, so it is written after it. Raises FileError and OutputError.
    """
    dataset = dataset if isinstance(dataset, Dataset) else Dataset(dataset)
    given, manifest = about(dataset)
    listed = read_bytes(dataset.path / MANIFEST) if (dataset.path / MANIFEST).is_file() else None
    files = (row.files for row in manifest.rows) if manifest.rows else _files_of(dataset)
    record = _metadata(given)
    kinds = _kinds(files)
    record["distribution"] = [_file_set(name) for name in kinds]
    record["recordSet"] = [_content_of(name) for name in kinds]
    if listed is not None:
        record["distribution"].insert(0, _manifest_object(listed))
        record["recordSet"].insert(0, _samples(manifest))
    write_file(dataset.path / NAME, (json.dumps(record, indent=1, ensure_ascii=False) + "\n").encode())
    return NAME


def _files_of(dataset: Dataset) -> Iterable[list[str]]:
    names = ("im0.png", "im1.png", "disp0.pfm", "disp1.pfm", "disp0GT.pfm", "disp1GT.pfm", "calib.txt")
    return ([name for name in names if sample.has(name)] for sample in dataset[:1])


def _kinds(files: Iterable[Iterable[str]]) -> list[str]:
    """Known names of files of the samples, without the folders of lenses."""
    names = {name.rpartition("/")[2] for each in files for name in each}
    return sorted(name for name in names if (found := _FILE.match(name)) and found[2] in _KINDS)


def _metadata(given: About) -> dict[str, Any]:
    record: dict[str, Any] = {
        "@context": CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": given.title,
        "description": given.description
        or f"{given.title}: stereo pairs rendered by twinlens, with exact ground truth.",
        "version": _VERSION,
    }
    keys = {"license": "license", "url": "url", "datePublished": "published", "citeAs": "cite_as"}
    record |= {key: value for key, name in keys.items() if (value := getattr(given, name))}
    if given.creator:
        record["creator"] = {"@type": "sc:Person", "name": given.creator}
    return record


def _manifest_object(data: bytes) -> dict[str, Any]:
    return {
        "@type": "cr:FileObject",
        "@id": MANIFEST,
        "name": MANIFEST,
        "description": "The samples, and the SHA-256 of each of their files.",
        "contentUrl": MANIFEST,
        "contentSize": f"{len(data)} B",
        "encodingFormat": "application/json",
        "sha256": hashlib.sha256(data).hexdigest(),
    }


def _samples(manifest: Manifest) -> dict[str, Any]:
    fields = {"name": "the sample's folder"}
    if manifest.rows and all("split" in row.info for row in manifest.rows):
        fields["split"] = "the split of the dataset"
    paths = {"name": "$.samples[*].name", "split": "$.samples[*].info.split"}
    sources = {key: {"fileObject": {"@id": MANIFEST}, "extract": {"jsonPath": paths[key]}} for key in fields}
    entries = [_field(f"samples/{key}", text, "sc:Text", sources[key]) for key, text in fields.items()]
    return {"@type": "cr:RecordSet", "@id": "samples", "name": "samples", "field": entries} | {
        "key": {"@id": "samples/name"}
    }


def _file_set(name: str) -> dict[str, Any]:
    text, encoding, _ = _kind_of(name)
    # The star also matches slashes, so nested samples and images of other lenses are found.
    patterns = {"includes": f"*/{name}", "encodingFormat": encoding}
    return {"@type": "cr:FileSet", "@id": f"{name}-files", "name": f"{name}-files", "description": text} | patterns


def _content_of(name: str) -> dict[str, Any]:
    text, _, kind = _kind_of(name)
    ident = name.replace(".", "-")
    source = {"fileSet": {"@id": f"{name}-files"}}
    folder = source | {
        "extract": {"fileProperty": "fullpath"},
        "transform": {"regex": f"^(.*)/{re.escape(name)}$"},
    }
    fields = [
        _field(
            f"{ident}/folder", "the sample's name, and the folder of the lens if it is not the first", "sc:Text", folder
        ),
        _field(f"{ident}/content", text, kind, source | {"extract": {"fileProperty": "content"}}),
    ]
    return {"@type": "cr:RecordSet", "@id": ident, "name": ident, "description": text, "field": fields}


def _field(ident: str, text: str, kind: str, source: dict[str, Any]) -> dict[str, Any]:
    entry = {"@type": "cr:Field", "@id": ident, "name": ident, "description": text, "dataType": kind}
    return entry | {"source": source}


def _kind_of(name: str) -> tuple[str, list[str], str]:
    """Description, media types and data type of a file name."""
    found = _FILE.match(name)
    text, encoding, kind = _KINDS[found[2] if found else name]
    return text.format(found[3] if found else ""), encoding, kind
