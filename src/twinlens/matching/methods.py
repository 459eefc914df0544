"""The matchers by name, and the text that selects one with its options: `[NAME=]zncc:block_size=21,lr_check=1`."""

import dataclasses
import importlib.metadata
import itertools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any, TypedDict, Unpack

import numpy as np

import twinlens
from twinlens.errors import InputError, check_known, format_value, located, unknown
from twinlens.matching.contract import (
    DEFAULT_DISPARITIES,
    Answer,
    BaseMatcher,
    Matcher,
    RangeMatcher,
    answer_of,
    checked_answer,
)
from twinlens.matching.costs import COSTS, LEARNED, LEARNED_NAME, descriptor_model
from twinlens.matching.external import Program, PythonFunction
from twinlens.matching.images import Disparity
from twinlens.matching.matcher import StereoMatcher
from twinlens.matching.networks import OnnxNetwork
from twinlens.matching.opencv import OpenCVBlock, OpenCVSemiGlobal
from twinlens.settings import fields_of

ENTRY_POINTS = "twinlens.methods"
PROGRAM_GRACE_S = 5.0
"""Seconds beyond a time limit for a program's matcher, which ends the program itself."""


@dataclass(frozen=True)
class Method:
    """A matcher selected by name, the defaults of its options, and the option that may be given without its name."""

    name: str
    description: str
    defaults: Mapping[str, Any]
    matcher: type[Any]
    positional: str | None = None

    @property
    def options(self) -> dict[str, Any]:
        """Every option with its default."""
        fields = dataclasses.fields(self.matcher)
        return {field.name: field.default for field in fields} | dict(self.defaults)

    def reference(self) -> dict[str, Any]:
        """{"method", "description", "options": [{"option", "default", "meaning"}]}."""
        fields = fields_of(self.matcher)
        options = [
            {"option": name, "default": value, "meaning": fields[name].setting.help}
            for name, value in self.options.items()
        ]
        return {
            "method": self.name,
            "description": self.description,
            "options": options,
        }

    def make(self, **options: Any) -> Any:
        """The matcher with these options. Raises InputError for an unknown option."""
        for name in options:
            check_known(f"option of {self.name}", name, self.options)
        return self.matcher(**{**self.defaults, **options})


def _stereo(name: str, description: str, cost: str, **options: Any) -> Method:
    return Method(name, description, {"cost": cost, **options}, StereoMatcher)


_METHODS = (
    *(_stereo(name, cost.description, name) for name, cost in COSTS.items()),
    _stereo(
        "shiftable",
        "SAD of the best window that contains the pixel",
        "sad",
        support="shiftable",
    ),
    _stereo(
        "adaptive",
        "ZNCC in windows that adapt to texture and edges",
        "zncc",
        support="adaptive",
        block_size=21,
    ),
    _stereo(
        "cross",
        "census over cross-shaped regions of similar pixels",
        "census",
        support="cross",
        block_size=35,
    ),
    _stereo(
        "weighted",
        "census weighted by similarity and proximity; slow",
        "census",
        support="weighted",
        block_size=15,
    ),
    _stereo(
        "guided",
        "census smoothed by a guided filter",
        "census",
        support="guided",
        block_size=19,
    ),
    _stereo(
        LEARNED_NAME, LEARNED.description, LEARNED_NAME, support="guided", block_size=11
    ),
    _stereo(
        "sgm",
        "semi-global matching of census costs, 8 paths",
        "census",
        block_size=1,
        optimisation="sgm8",
    ),
    _stereo(
        "sgm4",
        "semi-global matching of census costs, 4 paths",
        "census",
        block_size=1,
        optimisation="sgm4",
    ),
    _stereo(
        "depth_camera",
        "sgm in windows that contain a dot, with holes where its checks fail",
        "census",
        block_size=11,
        optimisation="sgm8",
        lr_check=1.0,
        speckle_size=200,
    ),
    Method("opencv_bm", "OpenCV's StereoBM (extra opencv)", {}, OpenCVBlock),
    Method("opencv_sgbm", "OpenCV's StereoSGBM (extra opencv)", {}, OpenCVSemiGlobal),
    Method(
        "onnx", "an ONNX model (extra onnx): onnx:net.onnx", {}, OnnxNetwork, "model"
    ),
    Method(
        "program",
        "a program: program:'prog {left} {right} {out}'",
        {},
        Program,
        "command",
    ),
    Method(
        "function",
        "a Python function: function:path/to/file.py:name",
        {},
        PythonFunction,
        "function",
    ),
)
METHODS: dict[str, Method] = {method.name: method for method in _METHODS}


@dataclass(frozen=True)
class MethodSpec(BaseMatcher):
    """A method with options, as `parse_method` reads it; `name` is the text if no name is given.

    A range among its options takes precedence over the arguments of `match`. grace_s: seconds beyond a time limit for a
    method that enforces the limit itself.
    """

    name: str
    method: Method
    options: Mapping[str, Any]
    grace_s: float = 0.0

    def matcher(self, **defaults: Any) -> Any:
        """The `BaseMatcher` of the method's class.

        `defaults`, such as a data set's num_disparities, apply to options that are not given.
        """
        options = {
            name: value
            for name, value in defaults.items()
            if name in self.method.options
        }
        return self.method.make(**{**options, **self.options})

    def searching(
        self, num_disparities: int | None, min_disparity: int | None
    ) -> BaseMatcher:
        search = {"num_disparities": num_disparities, "min_disparity": min_disparity}
        matcher: BaseMatcher = self.matcher(
            **{name: value for name, value in search.items() if value is not None}
        )
        return matcher

    def compute(self, left: Any, right: Any) -> Answer:
        answer: Answer = self.matcher().compute(left, right)
        return answer

    @property
    def content(self) -> str:
        """Hashes of the files that the matcher consists of: those of a network or a program; "" for twinlens's own."""
        return str(self.matcher().content)

    @property
    def spec(self) -> str:
        """Twinlens's version, all options except time limits, and the hashes of the method's files."""
        options = {**self.method.options, **self.options}
        options.pop("timeout_s", None)
        text = ",".join(f"{name}={value!r}" for name, value in sorted(options.items()))
        content = f" [{self.content}]" if self.content else ""
        return f"twinlens {twinlens.__version__} {self.method.name}:{text}{content}"

    def check_parts(self) -> None:
        self.matcher().check_parts()

    @property
    def runs_user_code(self) -> bool:
        """Whether it runs code in this process that belongs neither to twinlens nor to OpenCV, and may crash it."""
        network = descriptor_model(str(self.options.get("cost", ""))) is not None
        return network or self.method.matcher in (PythonFunction, OnnxNetwork)


@dataclass(frozen=True, kw_only=True)
class UserMatcher(RangeMatcher):
    """An object of a user that satisfies `Matcher`, with the range that it is called with."""

    matcher: Matcher

    def compute(self, left: Any, right: Any) -> Answer:
        """The checked answer of the object. Raises MatcherFailedError if it is no disparity map."""
        search = {
            "num_disparities": self.num_disparities,
            "min_disparity": self.min_disparity,
        }
        result = answer_of(self.matcher, left, right, **search)
        return checked_answer(result, np.shape(left)[:2], type(self.matcher).__name__)


def matcher_of_spec(spec: str) -> StereoMatcher | None:
    """The twinlens matcher of a `MethodSpec.spec`, as boards store it; None for other methods and unknown options.

    >>> matcher_of_spec(parse_method("mine=sad:block_size=5").spec).block_size
    5
    """
    match = re.fullmatch(r"twinlens \S+ (\w+:.*)", spec)
    if match is None:
        return None
    try:
        matcher = parse_method(match[1]).matcher()
    except InputError:
        return None
    return matcher if isinstance(matcher, StereoMatcher) else None


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
    entry_points = importlib.metadata.entry_points(group=ENTRY_POINTS)
    functions = {point.name: point.value for point in entry_points}
    if name in functions:
        function = functions[name]
        return Method(name, function, {"function": function}, PythonFunction)
    raise unknown("method", name, [*METHODS, *functions])


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
    for part in itertools.chain.from_iterable(map(split_commas, texts)):
        option = re.match(r"(\w+)\s*=", part)
        if (
            methods
            and option
            and ":" in methods[-1]
            and not _starts_method(part, methods[-1], option[1])
        ):
            methods[-1] += f",{part}"
        else:
            methods.append(part)
    if not methods:
        raise InputError("no method is named")
    return methods


def _starts_method(part: str, before: str, name: str) -> bool:
    """Whether `part`, which is name=..., is a named method and not an option of the method before it."""
    try:
        if name in find_method(_parts(before)[1]).options:
            return False
        find_method(_parts(part)[1])
    except InputError:
        return False
    return True


def _parts(text: str) -> tuple[str, str, str]:
    """(name, method, options) of [NAME=]METHOD[:OPTIONS]; the name is the whole text where none is given."""
    head, _, tail = text.strip().partition(":")
    name, equals, method = (part.strip() for part in head.partition("="))
    if not equals:
        return text.strip(), head.strip(), tail
    if not re.fullmatch(r"[\w.-]+", name):
        raise InputError(
            f"{text.strip()!r}: the name {name!r} must be of letters, digits, '.', '_' and '-'"
        )
    return name, method, tail


def parse_method(text: str) -> MethodSpec:
    """Read [NAME=]METHOD or [NAME=]METHOD:OPTION=VALUE,OPTION=VALUE.

    Values are numbers, true, false, none, or words. A value that holds a comma is quoted:
    `program:'prog --sizes 3,4 {left} {right} {out}'`. Raises InputError for unknown methods and wrong options.

    >>> parse_method("zncc:block_size=21,lr_check=1").options
    {'block_size': 21, 'lr_check': 1.0}
    >>> parse_method("mine=function:path/to/file.py:name").name
    'mine'
    """
    name, head, tail = _parts(text)
    method = find_method(head)
    options = dict(
        _option(part, text.strip(), method, index == 0)
        for index, part in enumerate(split_commas(tail))
    )
    spec = MethodSpec(name, method, options)
    with located(spec.name):
        spec.matcher()
    return spec


def parse_methods(texts: Iterable[str]) -> list[MethodSpec]:
    """The methods in comma-separated lists, see `split_methods`."""
    return [parse_method(text) for text in split_methods(texts)]


def parse_program(text: str, time_limit: float | None = None) -> MethodSpec:
    """The program in `[NAME=]COMMAND`, by default named after its executable; it enforces `time_limit`, in seconds.

    Raises InputError if the command does not contain {left}, {right} and {out}.

    >>> [parse_program(text).name for text in ("mine=prog {left} {right} {out}", "bin/prog {left} {right} {out}")]
    ['mine', 'prog']
    """
    named = re.fullmatch(r"([\w.-]+)=(.*)", text.strip(), re.DOTALL)
    command = (named[2] if named else text).strip()
    executable = (command.split() or ["program"])[0].rsplit("/", 1)[-1].strip("'\"")
    options: dict[str, Any] = {"command": command}
    if time_limit is not None:
        options["timeout_s"] = time_limit
    name = named[1] if named else executable
    program = MethodSpec(name, METHODS["program"], options, PROGRAM_GRACE_S)
    program.matcher()  # checks the command
    return program


def _option(part: str, text: str, method: Method, first: bool) -> tuple[str, Any]:
    """(name, value) of option=value, or of the value alone of a method's positional option, which comes first."""
    name, equals, value = (piece.strip() for piece in part.partition("="))
    if first and method.positional and name not in method.options:
        name, equals, value = method.positional, "=", part
    if not equals:
        raise InputError(f"{name!r} in {text!r} is not an option; write option=value")
    check_known(f"option of {method.name}", name, method.options)
    if isinstance(method.options[name], str):
        # One pair of quotes is removed; 'a b' 'c d' is left unchanged.
        quoted = re.fullmatch(r"""'([^']*)'|"([^"]*)\"""", value)
        return name, value if quoted is None else quoted[1] or quoted[2] or ""
    if value.lower() == "none":  # switches any option off
        return name, None
    return name, fields_of(method.matcher)[name].parse(value)


def option_text(value: Any) -> str:
    """A default as a method text writes it: none, true, 1e-4; "" for an option that must be given."""
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def method_tables() -> str:
    """The tables of docs/methods.md: all methods, and the options of each class of matchers."""
    lines = ["| method | description | defaults that differ |", "| --- | --- | --- |"]
    for method in METHODS.values():
        defaults = ", ".join(
            f"{option}={option_text(value)}"
            for option, value in method.defaults.items()
        )
        cell = f"`{defaults}`" if defaults else ""
        lines.append(f"| `{method.name}` | {method.description} | {cell} |")
    for kind in dict.fromkeys(method.matcher for method in METHODS.values()):
        lines += _option_table(kind)
    return "\n".join([*lines, ""])


def _option_table(kind: type[Any]) -> list[str]:
    """The lines of the table of the options of one class of matchers."""
    names = [method.name for method in METHODS.values() if method.matcher is kind]
    title = "Methods of twinlens" if len(names) > 1 else f"`{names[0]}`"
    lines = [
        f"\n## Options: {title}\n",
        "| option | default | meaning |",
        "| --- | --- | --- |",
    ]
    for row in Method(names[0], "", {}, kind).reference()["options"]:
        default = option_text(row["default"])
        lines.append(f"| `{row['option']}` | {default} | {row['meaning']} |")
    return lines


class Options(TypedDict, total=False):
    """The options of all methods, with the types that `match` accepts."""

    block_size: int
    census_window: int
    command: str
    confidence: str | int | None
    contrast: float
    cost: str
    epsilon: float
    fill: str
    function: Callable[..., Any] | str
    gamma_near: float
    gamma_similar: float
    lr_check: float | None
    median: int
    min_disparity: int
    mode: str
    model: str
    multiple: int
    noise: float
    num_disparities: int
    optimisation: str
    output: int
    p1: float | None
    p2: float | None
    prefilter: str | bool
    scale: float
    sign: int
    speckle_range: float
    speckle_size: int
    subpixel: str
    support: str
    texture: float
    threads: int | None
    timeout_s: float
    uniqueness: float


def match(
    left: Any, right: Any, method: str | Matcher = "zncc", **options: Unpack[Options]
) -> Disparity:
    """Match two rectified images.

    Parameters
    ----------
    left, right : array (H, W) or (H, W, 3)
        Images of one size and dtype: uint8, uint16 or float32. Colour is converted to luma (`matching.grey`).
    method : str or Matcher
        A name of `matching.METHODS`, with or without options: "sad:block_size=7". Or an object with `Matcher.match`,
        which gets num_disparities and min_disparity, by default its attributes of these names, or else 64 and 0.
    **options
        block_size, num_disparities, min_disparity and the other options of the method; see `twinlens methods`.

    Returns
    -------
    array (H, W) float32
        The left image's disparity u_left - u_right in pixels; +inf where unknown. `matching.match_with_confidence`
        also returns the confidence.

    Raises InputError for an unknown method or option, a wrong value, or images that cannot be matched.

    >>> import numpy as np
    >>> right = np.random.default_rng(0).integers(0, 256, (20, 40), dtype=np.uint8)
    >>> disparity = match(np.roll(right, 3, axis=1), right, method="sad", block_size=5, num_disparities=8)
    >>> round(float(disparity[10, 20]))
    3
    """
    return _matcher(method, options).match(left, right)


def match_with_confidence(
    left: Any, right: Any, method: str | Matcher = "zncc", **options: Unpack[Options]
) -> Answer:
    """As `match`, with the confidence (H, W) float32, higher where the disparity is more probably right.

    None from a method that computes none; twinlens's own do with the option `confidence`, of `matching.CONFIDENCES`.

    >>> import numpy as np
    >>> right = np.random.default_rng(0).integers(0, 256, (20, 40), dtype=np.uint8)
    >>> images = np.roll(right, 3, axis=1), right
    >>> disparity, confidence = match_with_confidence(*images, "sad", num_disparities=8, confidence="peak_ratio")
    >>> float(confidence[10, 20])
    1.0
    """
    return _matcher(method, options).match_with_confidence(left, right)


def _matcher(method: str | Matcher, options: Mapping[str, Any]) -> BaseMatcher:
    """The matcher of a text or of an object, with options."""
    if isinstance(method, str):
        spec = parse_method(method)
        allowed = ["method", *spec.method.options]
        for name in options:
            check_known(f"option of {spec.method.name}", name, allowed)
        matcher: BaseMatcher = spec.method.make(**{**options, **spec.options})
        return matcher
    if isinstance(method, type) or not hasattr(method, "match"):
        signature = "match(left, right, *, num_disparities, min_disparity)"
        raise InputError(
            f"method must be a name such as 'zncc', or an object with {signature}, got {format_value(method)}"
        )
    search = {"num_disparities": DEFAULT_DISPARITIES, "min_disparity": 0}
    for name in options:
        check_known("option of a matcher object", name, search)
    if isinstance(method, BaseMatcher):
        return method.searching(
            options.get("num_disparities"), options.get("min_disparity")
        )
    for name, default in search.items():
        search[name] = options.get(name, getattr(method, name, default))
    return UserMatcher(matcher=method, **search)
