"""A board's methods by name: `zncc:block_size=21` as an object to call, to send to a process, and to resume by."""

import re
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, ClassVar

from numpy.typing import NDArray

import twinlens
from twinlens.matching import MethodSpec, Program, parse_method


@dataclass(frozen=True)
class NamedMethod:
    """One of twinlens's own matchers, named by the text that `matching.parse_method` reads.

    Raises
    ------
    InputError
        The text names no matcher, or options that it does not have.

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
        """What the board calls it."""
        return self._parsed.text

    @property
    def spec(self) -> str:
        """The method with every option, defaults included, twinlens's version, and the hashes of the files it is made
        of (`MethodSpec.content`): changed, it is another method."""
        method = self._parsed.method
        options = {**method.options, **self._parsed.options}
        text = ",".join(f"{name}={value!r}" for name, value in sorted(options.items()))
        return _joined(f"twinlens {twinlens.__version__} {method.name}:{text}", self._parsed.content)

    @property
    def is_foreign(self) -> bool:
        """Whether it runs a stranger's code in this process: see `MethodSpec.is_foreign`."""
        return self._parsed.is_foreign

    def check_parts(self) -> None:
        """Raises InputError or FileError where what it is made of is not there: a network's file, a function."""
        self._parsed.check_parts()

    def __call__(self, left: NDArray[Any], right: NDArray[Any], *, ndisp: int, min_disparity: int = 0) -> NDArray[Any]:
        """Match over `ndisp` disparities from `min_disparity`, unless the text says other numbers."""
        return self._parsed(left, right, num_disparities=ndisp, min_disparity=min_disparity)

    def __reduce__(self) -> tuple[type["NamedMethod"], tuple[str]]:
        return NamedMethod, (self.text,)


@dataclass(frozen=True)
class NamedProgram:
    """Any program as a board's method; see `matching.Program` for its command.

    name: what the board calls it. time_limit: seconds a call may take, after which the program is ended.

    Raises
    ------
    InputError
        The command does not name {left}, {right} and {out}.
    """

    name: str
    command: str
    time_limit: float | None = None
    grace_s: ClassVar[float] = 5.0

    def __post_init__(self) -> None:
        self._program(1)

    @property
    def spec(self) -> str:
        """The command and the hashes of the files it names; how long it may take does not change what it answers."""
        return _joined(f"program:command={self.command!r}", self._program(1).content)

    def check_parts(self) -> None:
        """Raises InputError where there is no such program."""
        self._program(1).check_parts()

    def _program(self, ndisp: int, min_disparity: int = 0) -> Program:
        program = Program(self.command, num_disparities=ndisp, min_disparity=min_disparity)
        return program if self.time_limit is None else replace(program, timeout_s=self.time_limit)

    def __call__(self, left: NDArray[Any], right: NDArray[Any], *, ndisp: int, min_disparity: int = 0) -> NDArray[Any]:
        """Run it on two files; {num_disparities} in the command becomes `ndisp`, {min_disparity} itself."""
        return self._program(ndisp, min_disparity).match(left, right)


def _joined(options: str, content: str) -> str:
    return f"{options} [{content}]" if content else options


def named_program(text: str, time_limit: float | None = None) -> NamedProgram:
    """The program of `name=command`, or of a command alone, which is then named by its program's file.

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
    """One method for every text.

    >>> [m.name for m in named_methods(["sad", "zncc"])]
    ['sad', 'zncc']
    """
    return [NamedMethod(text) for text in texts]
