"""What sample would decide the findings that a study left open: its options, and about how long it would take."""

import math
from collections.abc import Iterable

from twinlens.errors import counted
from twinlens.studies.findings import OPEN, SeedSupport, units_to_decide
from twinlens.studies.model import Result, Setup

_ROUND_TO = 4  # pixels, of a recommended size


def advice(result: Result, *, with_time: bool = True) -> list[str]:
    """A sentence for the findings whose sample is too small, and one for those whose interval is too wide.

    with_time: whether they say how long the study would take, in proportion to the time that it took.
    """
    still_open = [support for support in result.findings if support.state == OPEN]
    small = [support for support in still_open if support.lacking]
    wide = [support for support in still_open if not support.lacking]
    sentences = []
    needed: dict[str, int] = {}
    for support in small:
        for shortage in support.lacking:
            needed[shortage.quantity] = max(
                shortage.needed, needed.get(shortage.quantity, 0)
            )
    if needed:
        which = _which(small, result, "{} too small a sample")
        sentences.append(f"{which}; enough: {_options(result, needed, with_time)}.")
    needed = _units(wide)
    if needed:
        which = _which(wide, result, "{} too wide an interval")
        sentences.append(
            f"{which}; probably enough: {_options(result, needed, with_time)}."
        )
    return sentences


def _which(supports: list[SeedSupport], result: Result, what: str) -> str:
    verb = "has" if len(supports) == 1 else "have"
    return f"{len(supports)} of {counted(len(result.findings), 'finding')} {what.format(verb)}"


def _units(supports: Iterable[SeedSupport]) -> dict[str, int]:
    """The largest numbers of seeds and scenes that open findings need, of those that a study can reach."""
    needed: dict[str, int] = {}
    for support in supports:
        units = units_to_decide(support.finding)
        if units is not None:
            name = support.finding.unit_name
            needed[name] = max(units, needed.get(name, 0))
    return needed


def _options(result: Result, needed: dict[str, int], with_time: bool) -> str:
    """The options of the command, and the time, of the numbers needed of "seed", "scene" and "pixel"."""
    setup = result.setup
    parts, factor = [], 1.0
    if "scene" in needed:
        parts.append(_scenes(result, needed["scene"]))
        factor *= needed["scene"] / max(len(setup.scenes), 1)
    if "seed" in needed:
        parts.append(f"--seeds {needed['seed']}")
        factor *= needed["seed"] / len(setup.seeds)
    if "pixel" in needed:
        width, height = _size(setup, result.study.defaults, needed["pixel"])
        parts.append(f"--size {width}x{height}")
        factor *= width * height / (setup.width * setup.height)
    options = " ".join(parts)
    return f"{options} ({_duration(factor * result.seconds)})" if with_time else options


def _scenes(result: Result, count: int) -> str:
    """Options that name this many scenes, or the number if the study has fewer."""
    names = list(dict.fromkeys((*result.setup.scenes, *result.study.defaults.scenes)))
    if len(names) < count:
        return f"{count} scenes"
    return " ".join(f"--scene {name}" for name in names[:count])


def _size(setup: Setup, usual: Setup, pixels: int) -> tuple[int, int]:
    """The smallest size of the same shape with this many pixels, or the study's usual size if that is smaller.

    The share of a region is uncertain in small images; the usual size suffices for the study's claims.
    """
    if setup.width * setup.height < usual.width * usual.height < pixels:
        return usual.width, usual.height
    scale = math.sqrt(pixels / (setup.width * setup.height))
    width, height = (
        _ROUND_TO * math.ceil(scale * length / _ROUND_TO)
        for length in (setup.width, setup.height)
    )
    return width, height


def _duration(seconds: float) -> str:
    """About how long, rounded up to tens of seconds or to minutes.

    >>> _duration(3.0), _duration(84.0), _duration(400.0)
    ('about 10 s', 'about 90 s', 'about 7 min')
    """
    if seconds <= 90:
        return f"about {10 * math.ceil(seconds / 10)} s"
    return f"about {math.ceil(seconds / 60)} min"
