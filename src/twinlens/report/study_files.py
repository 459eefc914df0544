"""A study that was run, as files: table.csv, study.json, figures, pictures, and one page that says what was found."""

import base64
import html
import math
import os
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twinlens.dataset import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.record import encode_json
from twinlens.report.plots import DPI, draw, encode
from twinlens.studies import Picture, Result, Stands, from_csv, to_csv
from twinlens.studies.bootstrap import brief

_GAP = 6
_VERDICTS = {True: "Holds", False: "Does not hold"}


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
    """The images side by side on white, uint8 (H, W, 3), `columns` in a row, each below its caption."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    colour = [image if image.ndim == 3 else np.repeat(image[..., None], 3, axis=2) for image in picture.images]
    tallest, widest = max(image.shape[0] for image in colour), max(image.shape[1] for image in colour)
    columns = min(picture.columns, len(colour))
    size = int(np.clip(widest // 14, 10, 16))
    height, width = tallest + _GAP + 2 * size, widest + _GAP
    sheet = Image.new("RGB", (columns * width - _GAP, math.ceil(len(colour) / columns) * height - _GAP), "white")
    pen, font = ImageDraw.Draw(sheet), ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size)
    for k, (image, caption) in enumerate(zip(colour, picture.captions, strict=True)):
        x, y = k % columns * width, k // columns * height
        pen.text((x + 1, y + size // 3), caption, fill="black", font=font)
        sheet.paste(Image.fromarray(image), (x, y + 2 * size))
    return np.asarray(sheet)


def _plain(stands: Stands) -> dict[str, Any]:
    finding = stands.finding
    return {
        "text": finding.sentence,
        "measured": _number(finding.measured.value),
        "interval": [_number(finding.measured.low), _number(finding.measured.high)],
        "interval_units": finding.measured.units,
        "unit": finding.unit,
        "expected": None if finding.expected is None else _number(finding.expected),
        "tolerance": finding.tolerance,
        "holds": bool(finding.holds) if finding.has_verdict else None,
        "seeds_alone": [stands.seeds, stands.of],
    }


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if math.isfinite(value) else None


def _page(result: Result, images: Mapping[str, bytes]) -> str:
    study = result.study
    parts = [f"<h1>{html.escape(study.name)}</h1><p class=lead>{html.escape(study.question)}</p>"]
    parts.append("<h2>What was found</h2>" + "".join(_finding(stands) for stands in result.findings))
    parts.append(_unsettled(result.findings))
    if study.figures:
        parts.append("<h2>Figures</h2>")
    for figure in study.figures:
        name = f"figures/{figure.name}"
        parts.append(_image(f"{name}.png", images[f"{name}.png"], figure.title, f"{name}.svg", 96 / DPI))
    if result.pictures:
        parts.append("<h2>Pictures</h2>")
    for picture in result.pictures:
        name = f"pictures/{picture.name}.png"
        parts.append(_image(name, images[name], picture.title, shown=f"{html.escape(picture.title)}. "))
    parts.append("<h2>Protocol</h2>" + _protocol(result))
    skeleton = resources.files("twinlens.report").joinpath("page/study.html").read_text()
    title = html.escape(f"twinlens study: {study.name}")
    return skeleton.replace("{{title}}", title).replace("{{body}}", "\n".join(parts))


def _finding(stands: Stands) -> str:
    finding = stands.finding
    before, _, after = (html.escape(part) for part in finding.text.partition("{}"))
    number = f"<b>{html.escape(finding.measured.said(finding.unit))}</b>" if "{}" in finding.text else ""
    if not finding.has_verdict:
        why = "nothing was measured for it" if math.isnan(finding.measured.value) else "what was run does not decide it"
        return f'<div class="finding"><p>{before}{number}{after}.</p><p class=note>No verdict: {why}</p></div>\n'
    notes = [_VERDICTS[finding.holds] + (", but not for every seed" if _is_shaky(stands) else "")]
    if finding.expected is not None:
        within = "" if finding.tolerance is None else f", and within {100 * finding.tolerance:.3g} % of it is asked"
        notes.append(f"theory says {brief(finding.expected)} {finding.unit}".strip() + within)
    notes.append(f"borne out by {stands.seeds} of {stands.of} seeds alone")
    kind = "shaky" if _is_shaky(stands) else ("good" if finding.holds else "bad")
    said = html.escape("; ".join(notes))
    return f'<div class="finding {kind}"><p>{before}{number}{after}.</p><p class=note>{said}</p></div>\n'


def _is_shaky(stands: Stands) -> bool:
    return stands.finding.holds and stands.seeds < stands.of


def _unsettled(findings: Sequence[Stands]) -> str:
    """A sentence on what other seeds would change."""
    shaky = sum(_is_shaky(stands) for stands in findings)
    failed = sum(stands.finding.has_verdict and not stands.finding.holds for stands in findings)
    seeds = findings[0].of if findings else 0
    if seeds < 2:
        text = "One seed was run: whether the findings stand with another is not known."
    elif shaky:
        text = f"{shaky} of {len(findings)} findings hold for all seeds together but not for each alone."
    else:
        text = "Every finding that holds does so for each seed alone."
    if failed:
        text += f" {failed} of {len(findings)} do not hold."
    return f"<p class=note>{text}</p>"


def _image(path: str, data: bytes, title: str, other: str = "", scale: float = 1.0, shown: str = "") -> str:
    source = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
    link = f' <a href="{html.escape(other)}">SVG</a>' if other else ""
    alt, width = html.escape(title), round(scale * int.from_bytes(data[16:20], "big"))
    caption = f'{shown}<a href="{html.escape(path)}">PNG</a>{link}'
    return f'<figure><img src="{source}" width="{width}" alt="{alt}"><figcaption>{caption}</figcaption></figure>'


def _protocol(result: Result) -> str:
    setup = result.setup
    rows = {
        "scenes": ", ".join(setup.scenes) or "made by the study",
        "matchers": ", ".join(setup.methods) or "none",
        "seeds": ", ".join(str(seed) for seed in setup.seeds),
        "photographs": f"{setup.width}x{setup.height}, {setup.spp} samples a pixel",
        "backend": str(result.protocol.get("backend", "")),
        "intervals": "bootstrap over scenes, over seeds where one scene is all, in brackets and as bands: 95 %; of two "
        "to four scenes or seeds no more than their range can be said, and is",
        "rows": f"{len(result.table)}",
        **result.remarks,
    }
    lines = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in rows.items())
    files = 'All of it: <a href="study.json">study.json</a>; the numbers: <a href="table.csv">table.csv</a>.'
    return f"<table>{lines}</table><p class=note>{files}</p>"
