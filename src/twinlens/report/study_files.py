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

from twinlens.dataset.codecs.png import encode_png
from twinlens.dataset.files import write_file
from twinlens.dataset.pictures import rgb8
from twinlens.dataset.record import encode_json
from twinlens.report.plots import DPI, draw, encode
from twinlens.studies import Picture, Result, SeedSupport, to_csv

_GAP = 6


def write_study(folder: str | os.PathLike[str], result: Result) -> Path:
    """Write the study's files into `folder`, each atomically, and return the path of the page.

    table.csv, study.json (protocol and findings), figures/NAME.png and .svg, pictures/NAME.png, index.html, in this
    order, so that an error while drawing leaves the measurements. Figures and pictures of an earlier study in `folder`
    are removed.
    """
    target = Path(folder)
    files: dict[str, bytes] = {}
    if (target / "study.json").exists():
        for old in (
            *target.glob("figures/*.png"),
            *target.glob("figures/*.svg"),
            *target.glob("pictures/*.png"),
        ):
            old.unlink()

    def write(name: str, data: bytes) -> None:
        files[name] = data
        write_file(target / name, data)

    write("table.csv", to_csv(result.table).encode())
    findings = [_plain(support) for support in result.findings]
    write("study.json", encode_json({**result.protocol, "findings": findings}))
    for figure in result.study.figures:
        sheet = draw(figure, result.table)
        for kind in ("png", "svg"):
            write(f"figures/{figure.name}.{kind}", encode(sheet, kind))
    for picture in result.pictures:
        write(f"pictures/{picture.name}.png", encode_png(tiles(picture)))
    write("index.html", _page(result, files).encode())
    return target / "index.html"


def tiles(picture: Picture) -> NDArray[np.uint8]:
    """The captioned images on white, uint8 (H, W, 3), `columns` in a row."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    colour = [rgb8(image) for image in picture.images]
    tallest, widest = (
        max(image.shape[0] for image in colour),
        max(image.shape[1] for image in colour),
    )
    columns = min(picture.columns, len(colour))
    size = int(np.clip(widest // 14, 10, 16))
    height, width = tallest + _GAP + 2 * size, widest + _GAP
    sheet = Image.new(
        "RGB",
        (columns * width - _GAP, math.ceil(len(colour) / columns) * height - _GAP),
        "white",
    )
    pen, font = (
        ImageDraw.Draw(sheet),
        ImageFont.truetype(font_manager.findfont("DejaVu Sans"), size),
    )
    for k, (image, caption) in enumerate(zip(colour, picture.captions, strict=True)):
        x, y = k % columns * width, k // columns * height
        pen.text((x + 1, y + size // 3), caption, fill="black", font=font)
        sheet.paste(Image.fromarray(image), (x, y + 2 * size))
    return np.asarray(sheet)


def _plain(support: SeedSupport) -> dict[str, Any]:
    finding, mean = support.finding, support.finding.measured
    value, low, high, expected = (
        float(f"{number:.9g}") if number is not None and math.isfinite(number) else None
        for number in (mean.value, mean.low, mean.high, finding.expected)
    )
    return {
        "text": finding.sentence,
        "measured": value,
        "interval": [low, high],
        "interval_units": mean.units,
        "unit": finding.unit,
        "expected": expected,
        "tolerance": finding.tolerance,
        "holds": bool(finding.holds) if finding.has_verdict else None,
        "seeds_alone": [support.supporting, support.seeds],
    }


def _page(result: Result, files: Mapping[str, bytes]) -> str:
    study = result.study
    parts = [
        f"<h1>{html.escape(study.name)}</h1><p class=lead>{html.escape(study.question)}</p>"
    ]
    parts.append(
        "<h2>Findings</h2>" + "".join(_finding(support) for support in result.findings)
    )
    parts += ["<h2>Figures</h2>"] if study.figures else []
    for figure in study.figures:
        name = html.escape(f"figures/{figure.name}")
        links = f'<a href="{name}.png">PNG</a> <a href="{name}.svg">SVG</a>'
        parts.append(
            _image(files[f"figures/{figure.name}.png"], figure.title, links, 96 / DPI)
        )
    parts += ["<h2>Pictures</h2>"] if result.pictures else []
    for picture in result.pictures:
        name = f"pictures/{picture.name}.png"
        links = f'{html.escape(picture.title)}. <a href="{html.escape(name)}">PNG</a>'
        parts.append(_image(files[name], picture.title, links))
    rows = {
        "scenes": ", ".join(result.setup.scenes) or "synthetic targets",
        "matchers": ", ".join(result.setup.methods) or "none",
        "seeds": ", ".join(str(seed) for seed in result.setup.seeds),
        "images": f"{result.setup.width}x{result.setup.height}, {result.setup.spp} samples per pixel",
        "backend": str(result.protocol.get("backend", "")),
        "intervals": "95 % bootstrap over scenes, or over seeds for one scene, in brackets and as bands; the range of "
        "fewer than five scenes or seeds",
        "rows": f"{len(result.table)}",
        **result.remarks,
    }
    lines = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in rows.items()
    )
    links = 'Complete protocol: <a href="study.json">study.json</a>; measurements: <a href="table.csv">table.csv</a>.'
    parts.append(f"<h2>Protocol</h2><table>{lines}</table><p class=note>{links}</p>")
    skeleton = (
        resources.files("twinlens.report").joinpath("page/study.html").read_text()
    )
    title = html.escape(f"twinlens study: {study.name}")
    return skeleton.replace("{{title}}", title).replace("{{body}}", "\n".join(parts))


def _finding(support: SeedSupport) -> str:
    finding = support.finding
    before, _, after = (html.escape(part) for part in finding.template.partition("{}"))
    number = (
        f"<b>{html.escape(finding.measured.format(finding.unit))}</b>"
        if "{}" in finding.template
        else ""
    )
    good = " good" if support.supporting >= support.seeds else " shaky"
    kind = "" if not finding.has_verdict else good if finding.holds else " bad"
    text, verdict = f"{before}{number}{after}", html.escape(support.verdict)
    return f'<div class="finding{kind}"><p>{text}.</p><p class=note>{verdict[0].upper()}{verdict[1:]}.</p></div>\n'


def _image(png: bytes, title: str, caption: str, scale: float = 1.0) -> str:
    source = "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    alt, width = html.escape(title), round(scale * int.from_bytes(png[16:20], "big"))
    return f'<figure><img src="{source}" width="{width}" alt="{alt}"><figcaption>{caption}</figcaption></figure>'
