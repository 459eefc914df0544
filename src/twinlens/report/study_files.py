"""The files of a completed study: table.csv, study.json, figures, pictures, and index.html with the findings."""

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

from twinlens.dataset import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.record import encode_json
from twinlens.report.plots import DPI, draw, encode
from twinlens.studies import Picture, Result, SeedSupport, from_csv, to_csv

_GAP = 6


def write_study(folder: str | os.PathLike[str], result: Result) -> Path:
    """Write the study's files into `folder`, each atomically, and return the path of the page.

    table.csv, study.json (protocol and findings), figures/NAME.png and .svg, pictures/NAME.png, index.html. Figures are
    drawn from table.csv, read back.
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
    """The captioned images on white, uint8 (H, W, 3), `columns` in a row."""
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


def _plain(support: SeedSupport) -> dict[str, Any]:
    finding = support.finding
    return {
        "text": finding.sentence,
        "measured": _number(finding.measured.value),
        "interval": [_number(finding.measured.low), _number(finding.measured.high)],
        "interval_units": finding.measured.units,
        "unit": finding.unit,
        "expected": None if finding.expected is None else _number(finding.expected),
        "tolerance": finding.tolerance,
        "holds": bool(finding.holds) if finding.has_verdict else None,
        "seeds_alone": [support.supporting, support.seeds],
    }


def _number(value: float) -> float | None:
    return float(f"{value:.9g}") if math.isfinite(value) else None


def _page(result: Result, images: Mapping[str, bytes]) -> str:
    study = result.study
    parts = [f"<h1>{html.escape(study.name)}</h1><p class=lead>{html.escape(study.question)}</p>"]
    parts.append("<h2>Findings</h2>" + "".join(_finding(support) for support in result.findings))
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


def _finding(support: SeedSupport) -> str:
    finding = support.finding
    before, _, after = (html.escape(part) for part in finding.template.partition("{}"))
    number = f"<b>{html.escape(finding.measured.format(finding.unit))}</b>" if "{}" in finding.template else ""
    kind = "" if not finding.has_verdict else " good" if finding.holds else " bad"
    if kind == " good" and support.supporting < support.seeds:
        kind = " shaky"
    text, verdict = f"{before}{number}{after}", html.escape(support.verdict)
    return f'<div class="finding{kind}"><p>{text}.</p><p class=note>{verdict[0].upper()}{verdict[1:]}.</p></div>\n'


def _image(path: str, data: bytes, title: str, other: str = "", scale: float = 1.0, shown: str = "") -> str:
    source = "data:image/png;base64," + base64.b64encode(data).decode("ascii")
    link = f' <a href="{html.escape(other)}">SVG</a>' if other else ""
    alt, width = html.escape(title), round(scale * int.from_bytes(data[16:20], "big"))
    caption = f'{shown}<a href="{html.escape(path)}">PNG</a>{link}'
    return f'<figure><img src="{source}" width="{width}" alt="{alt}"><figcaption>{caption}</figcaption></figure>'


def _protocol(result: Result) -> str:
    setup = result.setup
    rows = {
        "scenes": ", ".join(setup.scenes) or "synthetic targets",
        "matchers": ", ".join(setup.methods) or "none",
        "seeds": ", ".join(str(seed) for seed in setup.seeds),
        "images": f"{setup.width}x{setup.height}, {setup.spp} samples per pixel",
        "backend": str(result.protocol.get("backend", "")),
        "intervals": "95 % bootstrap over scenes, or over seeds for one scene, in brackets and as bands; the range of "
        "fewer than five scenes or seeds",
        "rows": f"{len(result.table)}",
        **result.remarks,
    }
    lines = "".join(f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>" for name, text in rows.items())
    files = 'Complete protocol: <a href="study.json">study.json</a>; measurements: <a href="table.csv">table.csv</a>.'
    return f"<table>{lines}</table><p class=note>{files}</p>"
