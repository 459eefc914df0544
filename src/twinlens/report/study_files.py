"""A study that was run, as files: table.csv, study.json, figures, pictures, and one page that says what was found."""

import base64
import html
import math
import os
from collections.abc import Mapping
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset.codecs import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.record import encode_json
from twinlens.report.plots import draw, encode
from twinlens.studies import Picture, Result, Stands, from_csv, to_csv

_GAP = 6
_VERDICTS = {True: "holds", False: "does not hold"}


def write_study(folder: str | os.PathLike[str], result: Result) -> Path:
    """Write the study's files into `folder`, each whole or not at all, and return the page's path.

    table.csv, study.json (protocol and findings), figures/NAME.png and .svg, pictures/NAME.png, index.html. The figures
    are drawn of the text of table.csv, read back.
    """
    target = Path(folder)
    text = to_csv(result.table)
    write_file(target / "table.csv", text.encode())
    write_file(
        target / "study.json", encode_json({**result.protocol, "findings": [_plain(f) for f in result.findings]})
    )
    table = from_csv(text, result.study.all_columns)
    images: dict[str, bytes] = {}
    for figure in result.study.figures:
        sheet = draw(figure, table)
        images[f"figures/{figure.name}.png"] = encode(sheet, "png")
        write_file(target / f"figures/{figure.name}.svg", encode(sheet, "svg"))
    for picture in result.pictures:
        images[f"pictures/{picture.name}.png"] = encode_png(tiles(picture))
    for name, data in images.items():
        write_file(target / name, data)
    page = target / "index.html"
    write_file(page, _page(result, images).encode())
    return page


def tiles(picture: Picture) -> NDArray[np.uint8]:
    """The images side by side on white, uint8 (H, W, 3), `columns` in a row, each in a cell of the largest size."""
    colour = [image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2) for image in picture.images]
    height, width = max(i.shape[0] for i in colour) + _GAP, max(i.shape[1] for i in colour) + _GAP
    columns = min(picture.columns, len(colour))
    lines = math.ceil(len(colour) / columns)
    sheet = np.full((lines * height - _GAP, columns * width - _GAP, 3), 255, np.uint8)
    for k, image in enumerate(colour):
        line, column = divmod(k, columns)
        place = sheet[line * height :, column * width :]
        place[: image.shape[0], : image.shape[1]] = image
    return sheet


def _plain(stands: Stands) -> dict[str, Any]:
    finding = stands.finding
    return {
        "text": finding.text,
        "measured": _number(finding.measured.value),
        "interval": [_number(finding.measured.low), _number(finding.measured.high)],
        "unit": finding.unit,
        "expected": None if finding.expected is None else _number(finding.expected),
        "tolerance": finding.tolerance,
        "holds": bool(finding.holds),
        "seeds_alone": [stands.seeds, stands.of],
    }


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if math.isfinite(value) else None


def _page(result: Result, images: Mapping[str, bytes]) -> str:
    study = result.study
    parts = [f"<h1>{html.escape(study.name)}</h1><p class=lead>{html.escape(study.question)}</p>"]
    parts.append("<h2>What was found</h2>" + "".join(_finding(stands) for stands in result.findings))
    if study.figures:
        parts.append("<h2>Figures</h2>")
    for figure in study.figures:
        name = f"figures/{figure.name}"
        parts.append(_image(f"{name}.png", images[f"{name}.png"], figure.title, f"{name}.svg"))
    if result.pictures:
        parts.append("<h2>Pictures</h2>")
    for picture in result.pictures:
        name = f"pictures/{picture.name}.png"
        captions = " · ".join(html.escape(caption) for caption in picture.captions)
        parts.append(_image(name, images[name], picture.title) + f"<p class=note>Row by row: {captions}</p>")
    parts.append("<h2>Protocol</h2>" + _protocol(result))
    skeleton = resources.files("twinlens.report").joinpath("page/study.html").read_text()
    return skeleton.replace("{{title}}", html.escape(f"twinlens study: {study.name}")).replace(
        "{{body}}", "\n".join(parts)
    )


def _finding(stands: Stands) -> str:
    finding = stands.finding
    expected = "" if finding.expected is None else f"; expected {finding.expected:.4g}"
    within = "" if finding.tolerance is None else f" ± {100 * finding.tolerance:.3g}%"
    alone = f"{stands.seeds} of {stands.of} seeds alone"
    shaky = finding.holds and stands.seeds < stands.of
    verdict = _VERDICTS[finding.holds] + (", but not for every seed" if shaky else "")
    kind = "good" if finding.holds and not shaky else ("shaky" if shaky else "bad")
    return (
        f'<div class="finding {kind}"><p>{html.escape(finding.text)}.</p>'
        f"<p class=number>{html.escape(str(finding.measured))} {html.escape(finding.unit)}{expected}{within}</p>"
        f"<p class=note>{verdict}: {alone}</p></div>"
    )


def _image(path: str, data: bytes, title: str, other: str = "") -> str:
    source = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
    link = f' <a href="{html.escape(other)}">SVG</a>' if other else ""
    alt = html.escape(title)
    caption = f'{alt}. <a href="{html.escape(path)}">PNG</a>{link}'
    return f'<figure><img src="{source}" alt="{alt}"><figcaption>{caption}</figcaption></figure>'


def _protocol(result: Result) -> str:
    setup = result.setup
    rows = {
        "scenes": ", ".join(setup.scenes) or "made by the study",
        "matchers": ", ".join(setup.methods) or "none",
        "seeds": ", ".join(str(seed) for seed in setup.seeds),
        "photographs": f"{setup.width}x{setup.height}, {setup.spp} samples a pixel",
        "backend": str(result.protocol.get("backend", "")),
        "intervals": "95%, bootstrap over scenes and seeds",
        "rows": f"{len(result.table)}",
    }
    lines = "".join(f"<tr><th>{name}</th><td>{html.escape(text)}</td></tr>" for name, text in rows.items())
    files = 'All of it: <a href="study.json">study.json</a>; the numbers: <a href="table.csv">table.csv</a>.'
    return f"<table>{lines}</table><p class=note>{files}</p>"
