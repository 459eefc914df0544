"""A board's methods by name: the matchers and programs that a command line names."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

import twinlens
from twinlens.matching import MethodSpec, find_method, parse_method, split_methods

PROGRAM_GRACE_S = 5.0  # beyond the limit, for a program's matcher, which ends the program itself


@dataclass(frozen=True)
class NamedMethod(MethodSpec):
    """A picklable method. grace_s: seconds beyond the time limit for a method that enforces the limit itself."""

    grace_s: float = 0.0

    @property
    def spec(self) -> str:
        """Twinlens's version, all options except time limits, and the hashes of the method's files."""
        options = {**self.method.options, **self.options}
        text = ",".join(f"{name}={value!r}" for name, value in sorted(options.items()) if name != "timeout_s")
        content = f" [{self.content}]" if self.content else ""
        return f"twinlens {twinlens.__version__} {self.method.name}:{text}{content}"


def named_method(text: str) -> NamedMethod:
    """The method in `[NAME=]METHOD[:OPTIONS]`, see `matching.parse_method`."""
    parsed = parse_method(text)
    return NamedMethod(parsed.name, parsed.method, dict(parsed.options))


def named_methods(texts: Iterable[str]) -> list[NamedMethod]:
    """The methods in comma-separated lists, see `matching.split_methods`."""
    return [named_method(text) for text in split_methods(texts)]


def named_program(text: str, time_limit: float | None = None) -> NamedMethod:
    """The program in `[NAME=]COMMAND`, by default named after its executable; it enforces `time_limit`, in seconds.

    Raises InputError if the command does not contain {left}, {right} and {out}.

    >>> [named_program(text).name for text in ("mine=prog {left} {right} {out}", "bin/prog {left} {right} {out}")]
    ['mine', 'prog']
    """
    given = re.fullmatch(r"([\w.-]+)=(.*)", text.strip(), re.DOTALL)
    command = (given[2] if given else text).strip()
    executable = (command.split() or ["program"])[0].rsplit("/", 1)[-1].strip("'\"")
    options = {"command": command} | ({} if time_limit is None else {"timeout_s": time_limit})
    program = NamedMethod(given[1] if given else executable, find_method("program"), options, PROGRAM_GRACE_S)
    program.matcher()
    return program
