"""The small languages of options: a size `640x480`, a lens `thin:20@1.5`."""

import math

from twinlens.camera import BareAperture, Lens, Pinhole, ThinLens
from twinlens.errors import InputError

LENS_HELP = (
    "pinhole | thin:DIAMETER_MM[@FOCUS_M] | f/N[@FOCUS_M] | hole:DIAMETER_MM@FILM_MM; may be given several times. "
    "Focus is the middle of the scene's disparities unless said."
)


def parse_size(text: str) -> tuple[int, int]:
    """(width, height) of `640x480`.

    >>> parse_size("640x480")
    (640, 480)
    """
    width, cross, height = text.lower().partition("x")
    if not (cross and width.isdecimal() and height.isdecimal()):
        raise InputError(f"--size must read WIDTHxHEIGHT, as 640x480, got {text!r}")
    return int(width), int(height)


def parse_lens(text: str, focus: float | None, film_distance: float) -> Lens:
    """The lens that `text` names, by the grammar of LENS_HELP; `focus` (m) where it names none, None: it must.

    >>> parse_lens("thin:20@1.5", focus=2.0, film_distance=0.004)
    ThinLens(aperture_diameter=0.02, focus_distance=1.5, aperture=Disk())
    """
    kind, _, rest = text.partition(":") if not text.startswith("f/") else ("f", "", text[2:])
    amount, at, place = rest.partition("@")
    if text == "pinhole":
        return Pinhole()
    if kind in ("thin", "f") and amount:
        if not at and focus is None:
            raise InputError(f"--lens {text!r}: this scene does not say its depths; say where to focus, as {text}@2.5")
        distance = _number(place, text) if at else float(focus or math.inf)
        if kind == "thin":
            return ThinLens(1e-3 * _number(amount, text), distance)
        return ThinLens.from_f_number(_number(amount, text), distance, film_distance)
    if kind == "hole" and at:
        return BareAperture(1e-3 * _number(amount, text), 1e-3 * _number(place, text))
    raise InputError(f"--lens {text!r} is not one of {LENS_HELP.split(';')[0]}")


def middle_focus(depth_range: tuple[float, float]) -> float:
    """The depth at the middle of a scene's disparities: the harmonic mean of near and far, metres."""
    near, far = depth_range
    return 2.0 / (1.0 / near + 1.0 / far)


def _number(text: str, whole: str) -> float:
    try:
        value = float(text)
    except ValueError:
        raise InputError(f"{text!r} in {whole!r} is not a number") from None
    if math.isnan(value):
        raise InputError(f"{text!r} in {whole!r} is not a number")
    return value
