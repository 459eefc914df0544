"""All methods and their options as data and as a page: the source of `twinlens methods` and of docs/methods.md."""

from collections.abc import Iterable
from typing import Any

from twinlens.matching.methods import METHODS, Method, find_method

INTRODUCTION = """\
# Methods

Every command and function that takes a method reads `[NAME=]METHOD[:OPTION=VALUE,...]`:

    twinlens match im0.png im1.png --method zncc:block_size=15,lr_check=1 -o disparity.pfm
    twinlens benchmark out --methods sad,wide=sad:block_size=21 --methods mine=function:path/to/file.py:name -o board

`NAME` is the method's name on a board. Values are numbers, `true`, `false`, `none` or words; quote a value that has a
comma. All methods search min_disparity <= d < min_disparity + num_disparities, with d = u_left - u_right in pixels.
"""
OUTRO = """\
## Your own method

Functions, programs, networks and objects have the same contract. The input is two rectified images and the search
range. The output is a disparity map (H, W), float32, +inf where unknown.

    def name(left, right, *, num_disparities, min_disparity):
        return disparity

`function:path/to/file.py:name` runs this function. A package may provide functions under the entry point
`twinlens.methods`.
`program:'prog {left} {right} {out} {num_disparities}'` runs a program, `onnx:net.onnx` a network. In Python, any object
with `match(left, right, *, num_disparities, min_disparity)` can be scored; see `matching.Matcher`.

This page is the output of `twinlens methods --markdown`.
"""


def method_reference(names: Iterable[str] = ()) -> list[dict[str, Any]]:
    """Each method with its description and options: {"method", "description", "options": [{"option", "default",
    "meaning"}]}. names: default all methods of twinlens.
    """
    return [_entry(find_method(name)) for name in names or METHODS]


def _entry(method: Method) -> dict[str, Any]:
    meanings = method.meanings
    options = [{"option": name, "default": value, "meaning": meanings[name]} for name, value in method.options.items()]
    return {"method": method.name, "description": method.description, "options": options}


def option_text(value: Any) -> str:
    """A default as a method text writes it: none, true, 1e-4; "" for an option that must be given.

    >>> option_text(None), option_text(True), option_text(2.0)
    ('none', 'true', '2')
    """
    if isinstance(value, bool) or value is None:
        return str(value).lower()
    return f"{value:g}" if isinstance(value, float) else str(value)


def family_defaults(name: str) -> dict[str, str]:
    """The options in whose default a method differs from its matcher class, such as support=cross."""
    return {option: option_text(value) for option, value in find_method(name).defaults.items()}


def method_page() -> str:
    """docs/methods.md."""
    lines = [INTRODUCTION, "| method | description | defaults that differ |", "| --- | --- | --- |"]
    for method in METHODS.values():
        own = ", ".join(f"{option}={text}" for option, text in family_defaults(method.name).items())
        lines.append(f"| `{method.name}` | {method.description} | {own and f'`{own}`'} |")
    for kind in dict.fromkeys(method.matcher for method in METHODS.values()):
        names = [method.name for method in METHODS.values() if method.matcher is kind]
        title = "Methods of twinlens" if len(names) > 1 else f"`{names[0]}`"
        options = _entry(Method(names[0], "", {}, kind))["options"]
        lines += [f"\n## Options: {title}\n", "| option | default | meaning |", "| --- | --- | --- |"]
        lines += [f"| `{row['option']}` | {option_text(row['default'])} | {row['meaning']} |" for row in options]
    return "\n".join([*lines, "", OUTRO])
