"""What a merged dataset says of licences, authors and source files, from what its sources say. Nothing is lost.

Texts on which the sources agree stay. Where licences differ, all of them apply: they are joined by AND, as in SPDX
expressions. If one source states none, the licence of the whole is unknown, and none is stated.

Source: SPDX Specification 2.3, annex D.4.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from twinlens.dataset.dataset import Manifest
from twinlens.dataset.metadata import KEY, About, Credit, stated
from twinlens.dataset.storage import Place

Source = tuple[str, Manifest, Place]
"""The name of a source in the merged dataset, its dataset.json, and the path of this file, for messages."""


def merged_about(sources: Sequence[Source]) -> dict[str, Any]:
    """`about`, `sources` and `bundled` of the `info` of a dataset.json. Raises FileError for a damaged source.

    In a merge of several, names of source files begin with the name of the dataset, since two may use the same.
    """
    texts = [stated(manifest, path) for _, manifest, path in sources]
    names = [name for name, _, _ in sources]
    about = {**_merged(texts), "credits": _credits(names, texts)}
    info: dict[str, Any] = {KEY: {key: value for key, value in about.items() if value}}
    files: dict[str, str] = {}
    bundled: list[str] = []
    for name, manifest, _ in sources:
        start = f"{name}/" if len(sources) > 1 else ""
        listed = manifest.info.get("sources")
        for file, digest in listed.items() if isinstance(listed, Mapping) else ():
            files[f"{start}{file}"] = digest
        bundled += [f"{start}{file}" for file in manifest.info.get("bundled", ())]
    return info | {"sources": files, "bundled": bundled}


def _merged(texts: Sequence[About]) -> dict[str, str]:
    """The texts but the credits: those that all sources share, and licences, authors and citations of all."""
    shared = {}
    for key in ("name", "description", "url", "published"):
        values = {getattr(text, key) for text in texts}
        shared[key] = values.pop() if len(values) == 1 else ""
    licences = _distinct([text.license for text in texts])
    are_stated = all(text.license for text in texts)
    return {
        **shared,
        "license": _joined(licences) if are_stated else "",
        "creator": ", ".join(_distinct([text.creator for text in texts])),
        "cite_as": "\n".join(_distinct([text.cite_as for text in texts])),
    }


def _joined(licences: Sequence[str]) -> str:
    """All licences as one expression of SPDX, in which AND binds closer than OR."""
    if len(licences) == 1:
        return licences[0]
    return " AND ".join(f"({text})" if " OR " in text else text for text in licences)


def _distinct(values: Sequence[str]) -> list[str]:
    """The different texts that are not empty, in order."""
    return [value for value in dict.fromkeys(values) if value]


def _credits(names: Sequence[str], texts: Sequence[About]) -> list[dict[str, Any]]:
    """The credits of all sources, whose patterns begin with the name of the source if there are several."""
    credits: list[Credit] = []
    for name, text in zip(names, texts, strict=True):
        for credit in text.credits:
            pattern = credit.files.removeprefix("./")
            files = f"{name}/{pattern}" if len(names) > 1 else credit.files
            credits.append(credit.model_copy(update={"files": files}))
    return [credit.model_dump(exclude_defaults=True) for credit in credits]
