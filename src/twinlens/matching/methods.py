"""The matchers by name, and the text that selects one with its options: `[NAME=]zncc:block_size=21,lr_check=1`."""

import dataclasses
import importlib.metadata
import re
import types
import typing
from collections.abc import Iterable, Mapping
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
    """A matcher that can be selected by name, with the defaults of its options.

    positional: the option that may be given without its name.
    """

    name: str
    description: str
    defaults: Mapping[str, Any] = field(default_factory=dict)
    matcher: type[Any] = StereoMatcher
    positional: str | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Every option with its default."""
        fields = {item.name: item.default for item in dataclasses.fields(self.matcher)}
        return {**fields, **self.defaults}

    @property
    def meanings(self) -> dict[str, str]:
        """Every option with its meaning."""
        hints = typing.get_type_hints(self.matcher, include_extras=True)
        return {name: hints[name].__metadata__[0] for name in self.options}

    def make(self, **options: Any) -> Any:
        """The matcher with these options: an `options.Matcher`. Raises InputError for an unknown option."""
        known = self.options
        for name in options:
            if name not in known:
                raise unknown(f"option of {self.name}", name, known)
        return self.matcher(**{**self.defaults, **options})


METHODS: dict[str, Method] = {
    method.name: method
    for method in (
        *(Method(name, cost.description, {"cost": name}) for name, cost in COSTS.items()),
        Method("shiftable", "SAD of the best window that contains the pixel", {"cost": "sad", "support": "shiftable"}),
        Method(
            "adaptive",
            "ZNCC in windows that grow where texture is weak and follow edges",
            {"cost": "zncc", "support": "adaptive", "block_size": 21},
        ),
        Method(
            "cross",
            "census over cross-shaped regions of similar pixels",
            {"cost": "census", "support": "cross", "block_size": 35},
        ),
        Method(
            "weighted",
            "census weighted by similarity and proximity; slow",
            {"cost": "census", "support": "weighted", "block_size": 15},
        ),
        Method(
            "guided",
            "census smoothed by a guided filter",
            {"cost": "census", "support": "guided", "block_size": 19},
        ),
        Method(
            "sgm",
            "semi-global matching of census costs, 8 paths",
            {"cost": "census", "block_size": 1, "optimisation": "sgm8"},
        ),
        Method(
            "sgm4",
            "semi-global matching of census costs, 4 paths",
            {"cost": "census", "block_size": 1, "optimisation": "sgm4"},
        ),
        Method("opencv_bm", "OpenCV's StereoBM (extra opencv)", {}, OpenCVBlock),
        Method("opencv_sgbm", "OpenCV's StereoSGBM (extra opencv)", {}, OpenCVSemiGlobal),
        Method("onnx", "an ONNX model (extra onnx): onnx:net.onnx", {}, OnnxNetwork, "model"),
        Method("program", "a program: program:'prog {left} {right} {out}'", {}, Program, "command"),
        Method("function", "a Python function: function:path/to/file.py:name", {}, PythonFunction, "function"),
    )
}


@dataclass(frozen=True)
class MethodSpec:
    """A method with options, as `parse_method` reads it.

    name: the given name, or the text without one; boards list methods by it.
    """

    name: str
    method: Method
    options: Mapping[str, Any]

    def matcher(self, **defaults: Any) -> Any:
        """The matcher; `defaults`, such as a data set's num_disparities, apply to options that are not given."""
        known = {name: value for name, value in defaults.items() if name in self.method.options}
        return self.method.make(**{**known, **self.options})

    @property
    def content(self) -> str:
        """Hashes of the files that the matcher consists of: those of a network or a program; "" for twinlens's own."""
        return str(getattr(self.matcher(), "content", ""))

    def check_parts(self) -> None:
        """Raise a TwinlensError if a file, function or package that the matcher needs is missing."""
        check = getattr(self.matcher(), "check_parts", None)
        if check is not None:
            check()

    @property
    def runs_user_code(self) -> bool:
        """Whether it runs code in this process that belongs neither to twinlens nor to OpenCV, and may crash it."""
        return self.method.matcher in (PythonFunction, OnnxNetwork)

    def match(
        self, left: Any, right: Any, *, num_disparities: int | None = None, min_disparity: int | None = None
    ) -> Disparity:
        """See `options.Matcher.match`. A range among the method's options takes precedence over the arguments."""
        given = {"num_disparities": num_disparities, "min_disparity": min_disparity}
        matcher = self.matcher(**{name: value for name, value in given.items() if value is not None})
        result: Disparity = matcher.match(left, right)
        return result


def find_method(name: str) -> Method:
    """The method of this name, of twinlens or of an installed package.

    A package offers function(left, right, *, num_disparities, min_disparity) under the entry point `twinlens.methods`.
    Raises InputError, with the nearest name, if there is none.

    >>> find_method("znc")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    twinlens.errors.InputError: unknown method 'znc'; did you mean 'zncc'? (known: ...
    """
    if name in METHODS:
        return METHODS[name]
    found = {point.name: point for point in importlib.metadata.entry_points(group=ENTRY_POINTS)}
    if name in found:
        return Method(name, found[name].value, {"function": found[name].value}, PythonFunction)
    raise unknown("method", name, [*METHODS, *found])


def split_commas(text: str) -> list[str]:
    """The parts of a text between its commas, stripped; commas inside '...' or "..." do not split.

    >>> split_commas("sad, program:command='prog --sizes 3,4',zncc")
    ['sad', "program:command='prog --sizes 3,4'", 'zncc']
    """
    parts = re.findall(r"""(?:'[^']*'|"[^"]*"|[^,])+""", text)
    return [part.strip() for part in parts if part.strip()]


def split_methods(texts: Iterable[str]) -> list[str]:
    """The methods in texts such as "sad,mine=zncc:block_size=15,lr_check=1".

    An `option=value` belongs to the method before it, if that has such an option.

    >>> split_methods(["sad,mine=zncc:block_size=15,lr_check=1", "sgm:cost=sad"])
    ['sad', 'mine=zncc:block_size=15,lr_check=1', 'sgm:cost=sad']
    """
    methods: list[str] = []
    for part in (part for text in texts for part in split_commas(text)):
        option = re.match(r"(\w+)\s*=", part)
        if methods and option and ":" in methods[-1] and not _starts_method(part, methods[-1], option[1]):
            methods[-1] += f",{part}"
        else:
            methods.append(part)
    if not methods:
        raise InputError("no method is named")
    return methods


def _starts_method(part: str, before: str, name: str) -> bool:
    """Whether `part`, which is name=..., is a named method and not an option of the method before it."""
    try:
        if name in find_method(_named(before)[1].partition(":")[0].strip()).options:
            return False
        find_method(_named(part)[1].partition(":")[0].strip())
    except InputError:
        return False
    return True


def _named(text: str) -> tuple[str, str]:
    """(name, method text) of [NAME=]METHOD[:OPTIONS]; the name is the whole text where none is given."""
    named = re.fullmatch(r"([\w.-]+)\s*=\s*(.+)", text.strip(), re.DOTALL)
    return (named[1], named[2]) if named else (text.strip(), text.strip())


def parse_method(text: str) -> MethodSpec:
    """Read [NAME=]METHOD or [NAME=]METHOD:OPTION=VALUE,OPTION=VALUE.

    Values are numbers, true, false, none, or words. A value that holds a comma is quoted:
    `program:'prog --sizes 3,4 {left} {right} {out}'`. Raises InputError for unknown methods and wrong options.

    >>> parse_method("zncc:block_size=21,lr_check=1").options
    mappingproxy({'block_size': 21, 'lr_check': 1})
    >>> parse_method("mine=function:path/to/file.py:name").name
    'mine'
    """
    name, rest = _named(text)
    head, _, tail = rest.partition(":")
    method = find_method(head.strip())
    parts = split_commas(tail)
    options = dict(_option(part, text.strip(), method, first=index == 0) for index, part in enumerate(parts))
    spec = MethodSpec(name, method, types.MappingProxyType(options))
    spec.matcher()
    return spec


def _option(part: str, text: str, method: Method, first: bool) -> tuple[str, Any]:
    name, equals, value = (piece.strip() for piece in part.partition("="))
    if first and method.positional and name not in method.options:
        return method.positional, _unquoted(part)
    if not equals:
        raise InputError(f"{name!r} in {text!r} is not an option; write option=value")
    is_word = isinstance(method.options.get(name), str)
    return name, _unquoted(value) if is_word else _value(value)


def _unquoted(text: str) -> str:
    """The text without quotes around the whole of it; `'a b' 'c d'` is left unchanged."""
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
    """Match two rectified images.

    Parameters
    ----------
    left, right : array (H, W) or (H, W, 3)
        Images of one size and dtype: uint8, uint16 or float32. Colour is converted to luma (`matching.grey`).
    method : str
        A name of `matching.METHODS`, with or without options: "sad:block_size=7".
    **options
        block_size, num_disparities, min_disparity and the other options of the method; see `twinlens methods`.

    Returns
    -------
    array (H, W) float32
        The left image's disparity u_left - u_right in pixels; +inf where unknown.

    Raises
    ------
    InputError
        An unknown method or option, a wrong value, or images that cannot be matched.

    Examples
    --------
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
    result: Disparity = spec.matcher(**options).match(left, right)
    return result
