"""The small languages of options: a size `640x480`, a lens `thin:20@1.5`, an aperture `polygon:6`.

Those of the camera's inside and of the sensor stand in `twinlens.cli.camera_specs`.
"""

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from twinlens.camera import Annulus, Aperture, BareAperture, Disk, Lens, Pinhole, Polygon, ThinLens
from twinlens.errors import InputError, format_value, unknown

Made = TypeVar("Made")

LENSES = {
    "pinhole": "pinhole",
    "thin": "thin:DIAMETER_MM[@FOCUS_M]",
    "f/": "f/N[@FOCUS_M]",
    "hole": "hole:DIAMETER_MM@FILM_MM",
}
LENS_HELP = (
    " | ".join(LENSES.values()) + "; may be given several times. "
    "Focus is the middle of the scene's disparities unless said."
)
APERTURES = {
    "disk": "disk",
    "polygon": "polygon:BLADES[:ROTATION_DEG[:ROUNDNESS]]",
    "annulus": "annulus:INNER",
    "mask": "mask:FILE",
}
APERTURE_HELP = (
    " | ".join(APERTURES.values()) + ": the shape of every lens and hole, inside its diameter. "
    "ROUNDNESS 0 to 1, INNER a fraction of the radius, FILE a grey picture, white where light passes."
)


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) of `640x480`.

    >>> parse_size("640x480")
    (640, 480)
    """
    sides = re.fullmatch(r"([0-9]{1,9})[xX]([0-9]{1,9})", text)
    if sides is None:
        raise InputError(f"--size must read WIDTHxHEIGHT, as 640x480, got {format_value(text)}")
    return int(sides[1]), int(sides[2])


def parse_lens(text: str, focus: float | None, film_distance: float, aperture: Aperture | None = None) -> Lens:
    """The lens that `text` names, by the grammar of LENS_HELP; `focus` (m) where it names none, None: it must.

    >>> parse_lens("thin:20@1.5", focus=2.0, film_distance=0.004)
    ThinLens(aperture_diameter=0.02, focus_distance=1.5, aperture=Disk())
    """
    where, shape = f"--lens {text!r}", aperture or Disk()
    kind, colon, rest = ("f/", "/", text[2:]) if text.startswith("f/") else text.partition(":")
    if meant := re.fullmatch(r"[fF]/?([0-9.].*)", text if kind != "f/" else ""):
        raise InputError(f"{where}: an f-number reads f/N[@FOCUS_M]; did you mean 'f/{meant[1]}'?")
    if kind not in LENSES:
        raise InputError(f"{where}: {unknown('lens', kind, LENSES)}; a lens reads {' | '.join(LENSES.values())}")
    if kind == "pinhole":
        if colon:
            raise InputError(f"{where}: a pinhole has no numbers; a lens reads {' | '.join(LENSES.values())}")
        return Pinhole()
    amount, at, place = rest.partition("@")
    if not amount or (kind == "hole" and not at) or (at and not place):
        raise InputError(f"{where} lacks a number; it must read {LENSES[kind]}")
    if not at and focus is None:
        raise InputError(f"{where}: this scene does not say its depths; say where to focus, as {text}@2.5")
    size = number(amount, where)
    distance = number(place, where) if at else float(focus or math.inf)
    if kind == "hole":
        return told(where, lambda: BareAperture(1e-3 * size, 1e-3 * distance, shape))
    if kind == "thin":
        return told(where, lambda: ThinLens(1e-3 * size, distance, shape))
    return told(where, lambda: ThinLens.from_f_number(size, distance, film_distance, shape))


def parse_aperture(text: str) -> Aperture:
    """The shape that `text` names, by the grammar of APERTURE_HELP.

    >>> parse_aperture("polygon:6:15")
    Polygon(blades=6, rotation_deg=15.0, roundness=0.0)
    """
    where = f"--aperture {text!r}"
    kind, _, rest = text.partition(":")
    if kind not in APERTURES:
        raise InputError(f"{where}: {unknown('aperture', kind, APERTURES)}")
    if kind == "mask" and rest:
        from twinlens.factory.lenses import read_mask

        return read_mask(Path(rest))
    parts = rest.split(":") if rest else []
    least, most = {"disk": (0, 0), "polygon": (1, 3), "annulus": (1, 1), "mask": (1, 1)}[kind]
    if not least <= len(parts) <= most:
        raise InputError(f"{where} must read {APERTURES[kind]}")
    numbers = [number(part, where) for part in parts]
    if kind == "polygon":
        blades = int(numbers[0]) if numbers[0].is_integer() else numbers[0]
        return told(where, lambda: Polygon(blades, *numbers[1:]))  # type: ignore[arg-type]
    return told(where, lambda: Annulus(numbers[0])) if kind == "annulus" else Disk()


def number(text: str, where: str) -> float:
    """The number that `text` is, or InputError beginning with `where`; inf is one, NaN is none.

    >>> number("1e-3", "--exposure")
    0.001
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if math.isnan(value):
        raise InputError(f"{where}: {text!r} is not a number")
    return value


def told(where: str, make: Callable[[], Made]) -> Made:
    """What `make` answers; what it refuses is told beginning with `where`."""
    try:
        return make()
    except InputError as error:
        raise InputError(f"{where}: {error}") from error
