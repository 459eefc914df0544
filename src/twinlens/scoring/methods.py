"""A board's methods by name: matchers of `matching.parse_method`, and programs by their command."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from numpy.typing import NDArray

import twinlens
from twinlens.matching import MethodSpec, Program, parse_method, split_methods


@dataclass(frozen=True)
class NamedMethod:
    """A matcher given as text, see `matching.parse_method`. Picklable.

    Raises
    ------
    InputError
        Unknown matcher or option.

    >>> NamedMethod("sad:block_size=7").name
    'sad:block_size=7'
    """

    text: str

    def __post_init__(self) -> None:
        parse_method(self.text)

    @cached_property
    def _parsed(self) -> MethodSpec:
        return parse_method(self.text)

    @property
    def name(self) -> str:
        """Name on the board."""
        return self._parsed.name

    @property
    def spec(self) -> str:
        """All options including defaults, twinlens's version, and the hashes of the method's files."""
        method = self._parsed.method
        options = {**method.options, **self._parsed.options}
        text = ",".join(f"{name}={value!r}" for name, value in sorted(options.items()))
        return _with_content(f"twinlens {twinlens.__version__} {method.name}:{text}", self._parsed.content)

    @property
    def runs_user_code(self) -> bool:
        """Whether it runs user code in this process: see `MethodSpec.runs_user_code`."""
        return self._parsed.runs_user_code

    def check_parts(self) -> None:
        """InputError or FileError if a file or function that the method needs is missing."""
        self._parsed.check_parts()

    def match(
        self, left: NDArray[Any], right: NDArray[Any], *, num_disparities: int, min_disparity: int = 0
    ) -> NDArray[Any]:
        """Match; a range in the text takes precedence over the arguments."""
        return self._parsed.match(left, right, num_disparities=num_disparities, min_disparity=min_disparity)

    def __reduce__(self) -> tuple[type["NamedMethod"], tuple[str]]:
        return NamedMethod, (self.text,)


@dataclass(frozen=True)
class NamedProgram:
    """A program as a board's method; see `matching.Program` for the command.

    name: name on the board. time_limit: seconds per match, after which the program is killed.

    Raises
    ------
    InputError
        The command lacks {left}, {right} or {out}.
    """

    name: str
    command: str
    time_limit: float | None = None
    grace_s: ClassVar[float] = 5.0

    def __post_init__(self) -> None:
        self._program(1)

    @property
    def spec(self) -> str:
        """The command and the hashes of the files it names; the time limit does not change results."""
        return _with_content(f"program:command={self.command!r}", self._program(1).content)

    def check_parts(self) -> None:
        """InputError if the program does not exist."""
        self._program(1).check_parts()

    def _program(self, num_disparities: int, min_disparity: int = 0) -> Program:
        program = Program(self.command, num_disparities=num_disparities, min_disparity=min_disparity)
        return program if self.time_limit is None else replace(program, timeout_s=self.time_limit)

    def match(
        self, left: NDArray[Any], right: NDArray[Any], *, num_disparities: int, min_disparity: int = 0
    ) -> NDArray[Any]:
        """Run the program on two files."""
        return self._program(num_disparities, min_disparity).match(left, right)


def _with_content(options: str, content: str) -> str:
    return f"{options} [{content}]" if content else options


def named_program(text: str, time_limit: float | None = None) -> NamedProgram:
    """The program in `name=command`, or in a command alone, which is named after its executable.

    >>> named_program("mine=./prog --fast {left} {right} {out}").name
    'mine'
    >>> named_program("bin/prog {left} {right} {out}").name
    'prog'
    """
    named = re.fullmatch(r"([\w.-]+)=(.*)", text.strip(), re.DOTALL)
    if named:
        return NamedProgram(named[1], named[2].strip(), time_limit)
    words = text.split()
    return NamedProgram(words[0].rsplit("/", 1)[-1].strip("'\"") if words else "program", text.strip(), time_limit)


def named_methods(texts: Iterable[str]) -> list[NamedMethod]:
    """The methods in comma-separated lists; a comma within a method's options or quotes does not separate methods.

    >>> [m.name for m in named_methods(["sad,zncc:block_size=15,lr_check=1,ssd"])]
    ['sad', 'zncc:block_size=15,lr_check=1', 'ssd']
    """
    return [NamedMethod(text) for text in split_methods(texts)]
