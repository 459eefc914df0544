"""A board's methods by name: the matchers and programs that a command line names."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

import twinlens
from twinlens.matching import MethodSpec, find_method, parse_method, split_methods

PROGRAM_GRACE_S = 5.0
"""Time beyond its limit that a worker gives to a program's matcher, which ends the program itself."""


@dataclass(frozen=True)
class NamedMethod:
    """A method of `matching.METHODS` with options, under a name. Picklable.

    grace_s: seconds beyond a time limit that the method needs because it enforces the limit itself.
    """

    name: str
    method: str
    options: Mapping[str, Any]
    grace_s: float = 0.0

    @cached_property
    def _method(self) -> MethodSpec:
        return MethodSpec(self.name, find_method(self.method), self.options)

    @property
    def spec(self) -> str:
        """All options except time limits, with defaults, twinlens's version, and the hashes of the method's files."""
        options = {**self._method.method.options, **self.options}
        text = ",".join(f"{name}={value!r}" for name, value in sorted(options.items()) if name != "timeout_s")
        content = f" [{self._method.content}]" if self._method.content else ""
        return f"twinlens {twinlens.__version__} {self.method}:{text}{content}"

    @property
    def runs_user_code(self) -> bool:
        """Whether it runs user code in this process: see `MethodSpec.runs_user_code`."""
        return self._method.runs_user_code

    def check_parts(self) -> None:
        """TwinlensError if a file, function, program or package that the method needs is missing."""
        self._method.check_parts()

    def match(
        self, left: NDArray[Any], right: NDArray[Any], *, num_disparities: int, min_disparity: int = 0
    ) -> NDArray[Any]:
        """Match; a range among the options takes precedence over the arguments."""
        return self._method.match(left, right, num_disparities=num_disparities, min_disparity=min_disparity)

    def __reduce__(self) -> tuple[type["NamedMethod"], tuple[Any, ...]]:
        return NamedMethod, (self.name, self.method, dict(self.options), self.grace_s)


def named_method(text: str) -> NamedMethod:
    """The method in `[NAME=]METHOD[:OPTIONS]`, see `matching.parse_method`; InputError if there is none.

    >>> named_method("mine=sad:block_size=7").name
    'mine'
    """
    parsed = parse_method(text)
    return NamedMethod(parsed.name, parsed.method.name, dict(parsed.options))


def named_methods(texts: Iterable[str]) -> list[NamedMethod]:
    """The methods in comma-separated lists, see `matching.split_methods`.

    >>> [m.name for m in named_methods(["sad,zncc:block_size=15,lr_check=1,ssd"])]
    ['sad', 'zncc:block_size=15,lr_check=1', 'ssd']
    """
    return [named_method(text) for text in split_methods(texts)]


def named_program(text: str, time_limit: float | None = None) -> NamedMethod:
    """The program in `[NAME=]COMMAND`, by default named after its executable; it enforces `time_limit`, in seconds.

    Raises
    ------
    InputError
        The command does not contain {left}, {right} and {out}.

    >>> named_program("mine=./prog --fast {left} {right} {out}").name
    'mine'
    >>> named_program("bin/prog {left} {right} {out}").name
    'prog'
    """
    given = re.fullmatch(r"([\w.-]+)=(.*)", text.strip(), re.DOTALL)
    command = (given[2] if given else text).strip()
    executable = (command.split() or ["program"])[0].rsplit("/", 1)[-1].strip("'\"")
    options = {"command": command} | ({} if time_limit is None else {"timeout_s": time_limit})
    program = NamedMethod(given[1] if given else executable, "program", options, PROGRAM_GRACE_S)
    program._method.matcher()
    return program
