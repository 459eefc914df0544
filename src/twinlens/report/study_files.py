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
from twinlens.errors import counted
from twinlens.report.plots import DPI, draw, encode
from twinlens.studies import (
    FAILS,
    HOLDS,
    OPEN,
    Figure,
    Picture,
    Result,
    SeedSupport,
    Study,
    advice,
    to_csv,
)

_GAP = 6  # pixels between pictures
_CSS_DPI = 96  # pixels per inch in CSS
_CLASSES = {HOLDS: "good", FAILS: "bad", OPEN: "open"}


def write_study(folder: str | os.PathLike[str], result: Result) -> Path:
    """Write the study's files into `folder`, each atomically, and return the path of the page.

    table.csv, study.json (protocol and findings), figures/NAME.png and .svg, pictures/NAME.png, index.html, in this
    order, so that an error while drawing leaves the measurements. Figures and pictures of an earlier study in `folder`
    are removed.
    """
    target = Path(folder)
    if (target / "study.json").exists():
        for pattern in ("figures/*.png", "figures/*.svg", "pictures/*.png"):
            for path in target.glob(pattern):
                path.unlink()
    write_file(target / "table.csv", to_csv(result.table).encode())
    findings = [_plain(support) for support in result.findings]
    record = encode_json({**result.protocol, "findings": findings})
    write_file(target / "study.json", record)
    images: dict[str, bytes] = {}
    for figure in result.study.figures:
        sheet = draw(figure, result.table)
        name = f"figures/{figure.name}"
        images[f"{name}.png"] = encode(sheet, "png")
        write_file(target / f"{name}.png", images[f"{name}.png"])
        write_file(target / f"{name}.svg", encode(sheet, "svg"))
    for picture in result.pictures:
        name = f"pictures/{picture.name}.png"
        images[name] = encode_png(tiles(picture))
        write_file(target / name, images[name])
    write_file(target / "index.html", _page(result, images).encode())
    return target / "index.html"


def tiles(picture: Picture) -> NDArray[np.uint8]:
    """The captioned images on white, uint8 (H, W, 3), `columns` in a row."""
    from matplotlib import font_manager
    from PIL import Image, ImageDraw, ImageFont

    images = [rgb8(image) for image in picture.images]
    tallest = max(image.shape[0] for image in images)
    widest = max(image.shape[1] for image in images)
    font_size = int(np.clip(widest // 14, 10, 16))
    font = ImageFont.truetype(font_manager.findfont("DejaVu Sans"), font_size)
    caption_height = 2 * font_size
    width, height = widest + _GAP, tallest + _GAP + caption_height
    columns = min(picture.columns, len(images))
    lines = math.ceil(len(images) / columns)
    size = columns * width - _GAP, lines * height - _GAP
    sheet = Image.new("RGB", size, "white")
    pen = ImageDraw.Draw(sheet)
    for number, image in enumerate(images):
        line, column = divmod(number, columns)
        x, y = column * width, line * height
        caption = picture.captions[number]
        pen.text((x + 1, y + font_size // 3), caption, fill="black", font=font)
        sheet.paste(Image.fromarray(image), (x, y + caption_height))
    return np.asarray(sheet)


def _plain(support: SeedSupport) -> dict[str, Any]:
    """A finding for study.json."""
    finding = support.finding
    measured = finding.measured
    return {
        "text": finding.sentence,
        "measured": _nine_digits(measured.value),
        "interval": [_nine_digits(measured.low), _nine_digits(measured.high)],
        "interval_units": measured.units,
        "unit": finding.unit,
        "expected": _nine_digits(finding.expected),
        "tolerance": finding.tolerance,
        "holds": None if support.state == OPEN else support.state == HOLDS,
        "verdict": support.verdict,
        "seeds_alone": [support.supporting, support.seeds],
    }


def _nine_digits(number: float | None) -> float | None:
    """The number as in table.csv; None if it is unknown."""
    if number is None or not math.isfinite(number):
        return None
    return float(f"{number:.9g}")


def _page(result: Result, images: Mapping[str, bytes]) -> str:
    study = result.study
    parts = [
        f"<h1>{html.escape(study.name)}</h1><p class=lead>{html.escape(study.question)}</p>",
        _law(study),
        _findings(result),
    ]
    if study.figures:
        parts.append("<h2>Figures</h2>")
    for figure in study.figures:
        name = f"figures/{figure.name}"
        links = f"{_link(f'{name}.png', 'PNG')} {_link(f'{name}.svg', 'SVG')}"
        caption = f"{html.escape(legend(figure, result))} {links}"
        png = images[f"{name}.png"]
        parts.append(_image(png, figure.title, caption, _CSS_DPI / DPI))
    if result.pictures:
        parts.append("<h2>Pictures</h2>")
    for picture in result.pictures:
        name = f"pictures/{picture.name}.png"
        caption = f"{html.escape(picture.title)}. {_link(name, 'PNG')}"
        parts.append(_image(images[name], picture.title, caption))
    parts.append(_protocol(result))
    page = resources.files("twinlens.report").joinpath("page/study.html").read_text()
    title = html.escape(f"twinlens study: {study.name}")
    return page.replace("{{title}}", title).replace("{{body}}", "\n".join(parts))


def _law(study: Study) -> str:
    """The physics that is tested, with the names of the pages that explain it; nothing for a study without a text.

    The page may be sent to others, so it has no link to a file of this machine.
    """
    notes = []
    if study.lesson:
        notes.append(f"Lesson of the course: <code>{html.escape(study.lesson)}</code>.")
    if study.docs:
        notes.append(f"Results at full size: <code>{html.escape(study.docs)}</code>.")
    law = f"<p>{html.escape(study.law)}</p>" if study.law else ""
    note = f"<p class=note>{' '.join(notes)}</p>" if notes else ""
    return f"<h2>The law</h2>{law}{note}" if law or note else ""


def _findings(result: Result) -> str:
    """All findings, how many are in each state, and what would decide the open ones."""
    states = [support.state for support in result.findings]
    counts = ", ".join(
        f"<span class={name}>{state}: {states.count(state)}</span>"
        for state, name in _CLASSES.items()
        if state in states
    )
    summary = f"<p>{counted(len(states), 'finding')}; {counts}.</p>"
    notes = "".join(
        f"<p class=note>{html.escape(sentence)}</p>"
        for sentence in advice(result, with_time=False)
    )
    findings = "".join(_finding(support) for support in result.findings)
    return f"<h2>Findings</h2>{summary}{notes}{findings}"


def legend(figure: Figure, result: Result) -> str:
    """What the marks of a figure are, in sentences."""
    column = result.table.column
    one_each = f", one for each {column(figure.by).text}" if figure.by else ""
    if figure.panel:
        one_each += f", in a panel for each {column(figure.panel).text}"
    if figure.kind == "heatmap":
        return f"Numbers and colours: {column(figure.z).label}, the mean over scenes and seeds{one_each}."
    if figure.kind == "scatter":
        sentences = [
            f"Points: single measurements{one_each.replace('one', 'a colour')}."
        ]
    else:
        sentences = [
            f"Lines: means over scenes and seeds{one_each}.",
            "Bands or bars: 95 % intervals; a single measurement has none.",
        ]
    if figure.also:
        texts = ", ".join(column(name).text for name in figure.also)
        sentences.append(f"Dashed: {texts}.")
    if figure.best:
        sentences.append(f"Rings: the {figure.best} of each line.")
    if figure.marks:
        texts = ", ".join(text for _, text in figure.marks)
        sentences.append(f"Dotted vertical lines: {texts}.")
    if figure.residual_of:
        sentences.append(
            f"The strip below: measured / predicted - 1, predicted by {column(figure.residual_of).text}."
        )
    return " ".join(sentences)


def _protocol(result: Result) -> str:
    """What was run, as a table, with links to the complete record."""
    setup = result.setup
    rows = {
        "scenes": ", ".join(setup.scenes) or "synthetic targets",
        "matchers": ", ".join(setup.methods) or "none",
        "repetitions": f"{counted(len(setup.seeds), 'seed')} ({', '.join(map(str, setup.seeds))})",
        "images": f"{setup.width}x{setup.height}, {setup.spp} samples per pixel",
        "backend": str(result.protocol.get("backend", "")),
        "intervals": "95 % bootstrap over scenes, or over seeds for one scene, in brackets and as bands; the range of "
        "two to four scenes or seeds",
        "rows": f"{len(result.table)}",
        **result.remarks,
    }
    lines = "".join(
        f"<tr><th>{html.escape(name)}</th><td>{html.escape(text)}</td></tr>"
        for name, text in rows.items()
    )
    links = 'Complete protocol: <a href="study.json">study.json</a>; measurements: <a href="table.csv">table.csv</a>.'
    return f"<h2>Protocol</h2><table>{lines}</table><p class=note>{links}</p>"


def _finding(support: SeedSupport) -> str:
    finding = support.finding
    before, number, after = finding.template.partition("{}")
    text = html.escape(before)
    if number:
        text += f"<b>{html.escape(finding.measured.format(finding.unit))}</b>"
    text += html.escape(after)
    state = support.state
    rest = html.escape(support.verdict.removeprefix(state))
    verdict = f"<b>{state.capitalize()}</b>{rest}"
    return (
        f'<div class="finding {_CLASSES[state]}"><p>{text}.</p>'
        f"<p class=note>{verdict}.</p></div>\n"
    )


def _link(path: str, text: str) -> str:
    return f'<a href="{html.escape(path)}">{text}</a>'


def _image(png: bytes, title: str, caption: str, scale: float = 1.0) -> str:
    """A figure that fits the page, and has its full width, with a scroll bar, after a touch, by CSS alone."""
    source = "data:image/png;base64," + base64.b64encode(png).decode("ascii")
    width_px = int.from_bytes(png[16:20], "big")  # of the PNG's header
    width, alt = round(scale * width_px), html.escape(title)
    box = f'<input type="checkbox" aria-label="full width: {alt}">'
    image = f'<img src="{source}" width="{width}" alt="{alt}">'
    return f"<figure><label>{box}{image}</label><figcaption>{caption}</figcaption></figure>"
