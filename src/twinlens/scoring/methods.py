"""A board's methods by name: `zncc:block_size=21` as an object to call, to send to a process, and to resume by."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from numpy.typing import NDArray

from twinlens.matching import MethodSpec, parse_method


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
        """The method with every option, defaults included: a changed default is another method."""
        method = self._parsed.method
        options = {**method.options, **self._parsed.options}
        return f"{method.name}:" + ",".join(f"{name}={value!r}" for name, value in sorted(options.items()))

    def __call__(self, left: NDArray[Any], right: NDArray[Any], *, ndisp: int) -> NDArray[Any]:
        """Match over `ndisp` disparities, unless the text says another number."""
        return self._parsed(left, right, num_disparities=ndisp)

    def __reduce__(self) -> tuple[type["NamedMethod"], tuple[str]]:
        return NamedMethod, (self.text,)


def named_methods(texts: Iterable[str]) -> list[NamedMethod]:
    """One method for every text.

    >>> [m.name for m in named_methods(["sad", "zncc"])]
    ['sad', 'zncc']
    """
    return [NamedMethod(text) for text in texts]
