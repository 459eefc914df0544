"""The matchers by name, and the one line of text that names one with its options: `zncc:block_size=21,lr_check=1`."""

import dataclasses
import importlib.metadata
import re
import types
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from twinlens.errors import InputError, unknown
from twinlens.matching.costs import COSTS
from twinlens.matching.external import PythonFunction
from twinlens.matching.images import Disparity
from twinlens.matching.matcher import StereoMatcher
from twinlens.matching.network import OnnxNetwork
from twinlens.matching.opencv import OpenCVBlock, OpenCVSemiGlobal
from twinlens.matching.program import Program

ENTRY_POINTS = "twinlens.methods"


@dataclass(frozen=True)
class Method:
    """A matcher that can be called by name: what it is, and what its options are unless told otherwise."""

    name: str
    description: str
    defaults: Mapping[str, Any] = field(default_factory=dict)
    matcher: type[Any] = StereoMatcher

    @property
    def options(self) -> dict[str, Any]:
        """Every option with its default."""
        fields = {item.name: item.default for item in dataclasses.fields(self.matcher)}
        return {**fields, **self.defaults}

    def make(self, **options: Any) -> Any:
        """The matcher with these options: an object with match(left, right)."""
        known = self.options
        for name in options:
            if name not in known:
                raise unknown(f"option of {self.name}", name, known)
        return self.matcher(**{**self.defaults, **options})


def _of_cost(name: str) -> Method:
    return Method(name, COSTS[name].description, {"cost": name})


METHODS: dict[str, Method] = {
    **{name: _of_cost(name) for name in COSTS},
    "shiftable": Method(
        "shiftable", "SAD, the best of all windows around a pixel", {"cost": "sad", "support": "shiftable"}
    ),
    "adaptive": Method(
        "adaptive",
        "ZNCC, windows that grow where texture lacks and bend around edges",
        {"cost": "zncc", "support": "adaptive", "block_size": 21},
    ),
    "cross": Method(
        "cross",
        "census over cross-shaped regions of like pixels",
        {"cost": "census", "support": "cross", "block_size": 35},
    ),
    "weighted": Method(
        "weighted",
        "census with weights of likeness and nearness; slow",
        {"cost": "census", "support": "weighted", "block_size": 15},
    ),
    "guided": Method(
        "guided", "census volume smoothed by a guided filter", {"cost": "census", "support": "guided", "block_size": 19}
    ),
    "sgm": Method(
        "sgm", "census and semi-global matching, 8 paths", {"cost": "census", "block_size": 1, "optimisation": "sgm8"}
    ),
    "opencv_bm": Method("opencv_bm", "OpenCV's StereoBM (extra opencv)", {}, OpenCVBlock),
    "opencv_sgbm": Method("opencv_sgbm", "OpenCV's StereoSGBM (extra opencv)", {}, OpenCVSemiGlobal),
    "onnx": Method("onnx", "any ONNX model, left, right -> disparity (extra onnx): model=net.onnx", {}, OnnxNetwork),
    "program": Method("program", "any program: command='prog {left} {right} {out}'", {}, Program),
    "function": Method("function", "any Python function: function=module:name", {}, PythonFunction),
    "sgm4": Method(
        "sgm4", "census and semi-global matching, 4 paths", {"cost": "census", "block_size": 1, "optimisation": "sgm4"}
    ),
}


@dataclass(frozen=True)
class MethodSpec:
    """A method and the options someone chose for it; `text` is how they wrote it, and its name on a board."""

    text: str
    method: Method
    options: Mapping[str, Any]

    def matcher(self, **defaults: Any) -> Any:
        """The matcher; `defaults` fill what the options leave open, such as a data set's num_disparities."""
        known = {name: value for name, value in defaults.items() if name in self.method.options}
        return self.method.make(**{**known, **self.options})

    @property
    def content(self) -> str:
        """The hashes of the files that the matcher consists of: a network's, a program's; none of twinlens's own."""
        return str(getattr(self.matcher(), "content", ""))

    def check_parts(self) -> None:
        """Refuse a matcher made of files or functions that are not there; twinlens's own are made of none."""
        check = getattr(self.matcher(), "check_parts", None)
        if check is not None:
            check()

    @property
    def is_foreign(self) -> bool:
        """Whether code runs in this process that is not twinlens's nor OpenCV's, and that may take it down."""
        return self.method.matcher in (PythonFunction, OnnxNetwork)

    def __call__(self, left: Any, right: Any, **defaults: Any) -> Disparity:
        """The left image's disparity, (H, W) float32, +inf where unknown."""
        result: Disparity = self.matcher(**defaults).match(left, right)
        return result


def find_method(name: str) -> Method:
    """The method of this name, of twinlens or of an installed package, or an InputError with the nearest one.

    A package offers function(left, right, num_disparities, min_disparity) under the entry point `twinlens.methods`.

    >>> find_method("znc")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    twinlens.errors.InputError: unknown method 'znc'; did you mean 'zncc'? (known: ...
    """
    if name in METHODS:
        return METHODS[name]
    found = {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if name in found:
        return Method(name, f"{found[name].value}", {"function": found[name].value}, PythonFunction)
    raise unknown("method", name, [*METHODS, *found])


def split_commas(text: str) -> list[str]:
    """The pieces of a text between its commas, stripped; a comma inside '...' or "..." divides nothing.

    >>> split_commas("sad, program:command='prog --sizes 3,4',zncc")
    ['sad', "program:command='prog --sizes 3,4'", 'zncc']
    """
    pieces = re.findall(r"""(?:'[^']*'|"[^"]*"|[^,])+""", text)
    return [piece.strip() for piece in pieces if piece.strip()]


def parse_method(text: str) -> MethodSpec:
    """Read `name` or `name:option=value,option=value`; values are numbers, true, false, none, or words.

    A value that holds a comma stands in quotes: `program:command='prog --sizes 3,4 {left} {right} {out}'`.

    >>> parse_method("zncc:block_size=21,lr_check=1").options
    mappingproxy({'block_size': 21, 'lr_check': 1})
    """
    name, _, tail = text.strip().partition(":")
    method = find_method(name.strip())
    options = dict(_option(part, text, method) for part in split_commas(tail))
    spec = MethodSpec(text.strip(), method, types.MappingProxyType(options))
    spec.matcher()
    return spec


def _option(part: str, text: str, method: Method) -> tuple[str, Any]:
    name, equals, value = (piece.strip() for piece in part.partition("="))
    if not equals:
        raise InputError(f"{name!r} in {text!r} is not an option; write option=value")
    is_word = isinstance(method.options.get(name), str)
    return name, _unquoted(value) if is_word else _value(value)


def _unquoted(text: str) -> str:
    """The text without the quotes around all of it; `'a b' 'c d'` has none such."""
    around = re.fullmatch(r"""'([^']*)'|"([^"]*)\"""", text)
    return text if around is None else (around[1] or around[2] or "")


def _value(text: str) -> Any:
    words = {"true": True, "false": False, "none": None}
    if text.lower() in words:
        return words[text.lower()]
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text


def match(left: Any, right: Any, method: str = "zncc", **options: Any) -> Disparity:
    """Match two rectified images: the left one's disparity, u_left - u_right.

    left, right: (H, W) or (H, W, 3) of one size and dtype, uint8, uint16 or float32; colour becomes luma (`grey`).
    method: a name of `METHODS`, with or without options of its own ("sad:block_size=7"); options: block_size,
    num_disparities, min_disparity and the others of `StereoMatcher` or of the method.
    Returns (H, W) float32 in pixels, +inf where unknown. Raises InputError for what cannot be matched.

    >>> import numpy as np
    >>> right = np.random.default_rng(0).integers(0, 256, (20, 40), dtype=np.uint8)
    >>> disparity = match(np.roll(right, 3, axis=1), right, method="sad", block_size=5, num_disparities=8)
    >>> round(float(disparity[10, 20]))
    3
    """
    spec = parse_method(method)
    for name in options:
        if name not in spec.method.options:
            raise unknown(f"option of {spec.method.name}", name, spec.method.options)
    return spec(left, right, **options)
