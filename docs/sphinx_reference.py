"""Sphinx extension: writes the reference pages of the site, and adapts docstrings and signatures for them.

The pages are docs/reference/*, which git ignores: the public names by package, the commands, and the JSON Schemas.
"""

import ast
import functools
import inspect
import json
import re
import sys
import textwrap
import zlib
from pathlib import Path
from types import ModuleType
from typing import Any

import click
import pydantic

import twinlens
from twinlens.cli import COMMANDS, cli

DOCS = Path(__file__).parent
PAGES = DOCS / "reference"
FIELD = re.compile(r"(\w+(?:, \w+)*) : ")
CODE = re.compile(r"``.+?``|`[^`]+`")
NAME = re.compile(r"[A-Za-z_][\w.]*")


def setup(app: Any) -> dict[str, Any]:
    app.connect("builder-inited", lambda app: write_pages())
    app.connect("source-read", add_children)
    app.connect(
        "autodoc-process-docstring", rewrite_docstring, priority=100
    )  # before napoleon
    app.connect("autodoc-process-signature", written_signature)
    return {
        "parallel_read_safe": True,
        "env_version": zlib.crc32(Path(__file__).read_bytes()),
    }  # a change rereads all


def write_pages() -> None:
    """Write docs/reference/*, leaving unchanged files alone."""
    pages = {f"{name}.rst": room_page(name) for name in rooms()}
    schemas = sorted((DOCS / "schemas").glob("*.json"))
    pages |= {f"schema-{path.stem}.md": schema_page(path) for path in schemas}
    pages["commands.md"] = commands_page()
    pages["names.rst"] = names_page()
    pages["schemas.md"] = (
        "# JSON Schemas\n\n```{toctree}\n"
        + "".join(f"schema-{p.stem}\n" for p in schemas)
        + "```\n"
    )
    PAGES.mkdir(exist_ok=True)
    for path in PAGES.iterdir():
        if path.name not in pages:
            path.unlink()
    for name, text in pages.items():
        if not (PAGES / name).exists() or (PAGES / name).read_text() != text:
            (PAGES / name).write_text(text)


def add_children(app: Any, page: str, content: list[str]) -> None:
    """List the pages of a folder below its README, which has no toctree, so that GitHub shows it as it is."""
    if page in ("docs/decisions/README", "benchmarks/README"):
        hidden = ":hidden:\n" if page.startswith("benchmarks") else ""
        content[0] += f"\n```{{toctree}}\n{hidden}:glob:\n\n*\n```\n"


@functools.cache
def rooms() -> dict[str, ModuleType]:
    """The packages by name."""
    return {
        name: value
        for name in twinlens.__all__
        if inspect.ismodule(value := getattr(twinlens, name))
    }


@functools.cache
def public_objects() -> dict[Any, str]:
    """Public classes and functions, and the names that users write: `twinlens.Camera`, `twinlens.camera.Lens`."""
    found = {}
    for room in rooms().values():
        for name, value in vars(room).items():
            here = getattr(value, "__module__", "").startswith(room.__name__)
            usable = inspect.isclass(value) or (
                inspect.isroutine(value) and room is not twinlens.errors
            )
            if here and usable and not name.startswith("_"):
                found[value] = f"{room.__name__}.{name}"
    values = {
        name: getattr(twinlens, name)
        for name in twinlens.__all__
        if name not in rooms()
    }
    return found | {value: f"twinlens.{name}" for name, value in values.items()}


def room_page(name: str) -> str:
    """The public classes and functions of one package; first those that ``import twinlens`` gives too."""
    lines = [heading(f"twinlens.{name}"), f".. automodule:: twinlens.{name}\n"]
    for value, full in sorted(
        public_objects().items(), key=lambda item: (item[1].count("."), item[1].lower())
    ):
        if not f"{value.__module__}.".startswith(f"twinlens.{name}."):
            continue
        if not inspect.isclass(value):
            lines.append(f".. autofunction:: {full}\n")
        elif issubclass(value, BaseException):
            lines.append(f".. autoexception:: {full}\n")
        else:
            lines.append(
                f".. autoclass:: {full}\n   :members:\n   :exclude-members: model_config\n"
            )
    return "\n".join(lines)


def names_page() -> str:
    """The names of ``import twinlens as tl``, each with the first sentence of its docstring, and all packages."""
    lines = [
        heading("Public names"),
        "``import twinlens as tl`` gives these names and the packages below.\n",
    ]
    lines += [".. list-table::", "   :widths: 35 65", ""]
    for name in sorted(set(twinlens.__all__) - set(rooms()), key=str.lower):
        first = (
            (inspect.getdoc(getattr(twinlens, name)) or "").split("\n\n")[0].split("\n")
        )
        lines += [
            f"   * - :py:obj:`tl.{name} <twinlens.{name}>`",
            f"     - {inline(' '.join(first))}",
        ]
    return "\n".join(
        [
            *lines,
            "\n.. toctree::",
            "   :caption: Packages",
            "",
            *(f"   {room}" for room in rooms()),
            "",
        ]
    )


def commands_page() -> str:
    """The help of every command, as ``--help`` prints it."""
    parts = ["# Commands\n"]
    for name in COMMANDS:
        command = cli.get_command(click.Context(cli), name)
        context = click.Context(
            command,
            info_name=f"twinlens {name}",
            terminal_width=100,
            max_content_width=100,
        )
        parts.append(f"## {name}\n\n```text\n{command.get_help(context)}\n```\n")
        for sub in getattr(command, "commands", {}).values():
            inner = click.Context(
                sub,
                info_name=f"twinlens {name} {sub.name}",
                terminal_width=100,
                max_content_width=100,
            )
            parts.append(
                f"### {name} {sub.name}\n\n```text\n{sub.get_help(inner)}\n```\n"
            )
    return "\n".join(parts)


def schema_page(path: Path) -> str:
    """The tables of one JSON Schema: key, type, default, description."""
    schema = json.loads(path.read_text())
    parts = [
        f"# {path.stem}\n",
        f"[{path.name}](../schemas/{path.name})\n",
        *schema_tables("", schema),
    ]
    for name, table in sorted(schema.get("$defs", {}).items()):
        parts += [f"## {name}\n", *schema_tables(name, table)]
    return "\n".join(parts)


def schema_tables(name: str, node: dict[str, Any]) -> list[str]:
    parts = [cell(node["description"]) + "\n"] if "description" in node else []
    if "properties" not in node:
        return [*parts, cell(schema_type(node)) + "\n"]
    parts += ["| key | type | default | |", "| --- | --- | --- | --- |"]
    for key, value in node["properties"].items():
        default = "required" if key in node.get("required", []) else ""
        default = (
            f"`{json.dumps(value['default'])}`"
            if "default" in value and len(str(value["default"])) < 60
            else default
        )
        parts.append(
            f"| `{key}` | {cell(schema_type(value))} | {cell(default)} | {cell(value.get('description', ''))} |"
        )
    return [*parts, ""]


def schema_type(node: Any) -> str:
    """The type of a schema in words, with links to the tables of the page."""
    if "$ref" in node:
        name = node["$ref"].rpartition("/")[2]
        return f"[{name}](#{name.lower()})"
    if "const" in node:
        return f"`{json.dumps(node['const'])}`"
    if "enum" in node:
        return ", ".join(f"`{json.dumps(each)}`" for each in node["enum"])
    for key in ("anyOf", "oneOf"):
        if key in node:
            return " or ".join(dict.fromkeys(schema_type(each) for each in node[key]))
    kind = node.get("type", "any")
    if kind == "array":
        entries = node.get("prefixItems")
        return (
            f"[{', '.join(map(schema_type, entries))}]"
            if entries
            else f"array of {schema_type(node.get('items', {}))}"
        )
    if kind == "object" and isinstance(node.get("additionalProperties"), dict):
        return f"table of {schema_type(node['additionalProperties'])}"
    bounds = {
        "minimum": ">=",
        "exclusiveMinimum": ">",
        "maximum": "<=",
        "exclusiveMaximum": "<",
    }
    return " ".join(
        [kind, *(f"{sign} {node[key]}" for key, sign in bounds.items() if key in node)]
    )


def cell(text: str) -> str:
    """Text in a Markdown table."""
    return re.sub(r"\s+", " ", text).replace("|", "\\|")


def heading(title: str) -> str:
    return f"{title}\n{'=' * len(title)}\n"


def rewrite_docstring(
    app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]
) -> None:
    """Docstrings of plain text with `code`, formulas, and lines ``name : text``, as reStructuredText."""
    text = "\n".join(lines).strip("\n")
    numpydoc = re.search(r"^\s*-{4,}$", text, re.M) is not None
    blocks = re.split(r"\n\s*\n", text)
    found: list[str] = []
    in_list = in_sections = False
    for block in blocks:
        rows = block.split("\n")
        indented = rows[0].startswith(" ")
        if rows[0].lstrip().startswith(">>>"):
            found += rows
        elif numpydoc:
            is_section = rows[1:2] == ["-" * len(rows[0])]
            if in_sections and not indented and not is_section:
                found += [
                    "Notes",
                    "-----",
                ]  # else napoleon takes the text for a part of the section before it
            found += [inline(row) for row in rows]
            in_sections = in_sections or is_section
        elif indented and not in_list:
            opened = "".join(found).endswith("::")
            found += [
                *([] if opened else ["::", ""]),
                *(f"    {row}" for row in textwrap.dedent(block).split("\n")),
            ]
        else:
            found += (
                list_items(rows)
                if FIELD.match(rows[0])
                else [inline(row) for row in paragraph(rows, in_list)]
            )
            in_list = (in_list and indented) or rows[0].startswith("- ")
        found.append("")
    lines[:] = found


def paragraph(rows: list[str], in_list: bool) -> list[str]:
    """Lines without the indentation that reStructuredText would take for a quotation."""
    return (
        rows if in_list or rows[0].startswith("- ") else [row.strip() for row in rows]
    )


def list_items(rows: list[str]) -> list[str]:
    """Lines ``name : text``, and those that continue them, as list items."""
    items = []
    for row in rows:
        match = FIELD.match(row)
        items.append(
            f"- **{inline(match[1])}**: {inline(row[match.end() :])}"
            if match
            else f"  {inline(row.strip())}"
        )
    return items


def inline(line: str) -> str:
    """A line whose `names` are links or code, and whose other characters stand for themselves."""
    found, end = [], 0
    for match in CODE.finditer(line):
        code = match[0].strip("`")
        found.append(escaped(line[end : match.start()]))
        found.append(f":py:obj:`{code}`" if NAME.fullmatch(code) else f"``{code}``")
        end = match.end()
        if end < len(line) and line[end].isalnum():
            found.append("\\ ")
    return "".join([*found, escaped(line[end:])])


def escaped(text: str) -> str:
    """Plain text, in which the pages of docs/ are links."""
    parts = re.split(r"\b(docs/\w+)\.md\b", text)
    plain = (re.sub(r"([*|\\_])", r"\\\1", part) for part in parts[::2])
    links = [f":doc:`{page}.md </{page}>`" for page in parts[1::2]]
    return "".join(text + link for text, link in zip(plain, [*links, ""], strict=True))


class Annotation(ast.NodeTransformer):
    """Annotations with the names of public classes that users write, without quotes and the metadata of Annotated."""

    def __init__(self, names: dict[str, Any]) -> None:
        self.names = names

    def visit_Name(self, node: ast.Name) -> ast.expr:
        value = self.names.get(node.id)
        known = inspect.isclass(value) and public_objects().get(value)
        return ast.Name(known) if known else node

    def visit_Subscript(self, node: ast.Subscript) -> ast.AST:
        kind = ast.unparse(node.value)
        if kind == "Annotated" and isinstance(node.slice, ast.Tuple):
            return self.visit(node.slice.elts[0])
        return node if kind == "Literal" else self.generic_visit(node)

    def visit_Constant(self, node: ast.Constant) -> Any:
        return (
            self.visit(ast.parse(node.value, mode="eval").body)
            if isinstance(node.value, str)
            else node
        )


def written_signature(
    app: Any, what: str, name: str, obj: Any, options: Any, args: Any, returns: Any
) -> Any:
    """The signature as its author wrote it: NDArray[np.float32], not what NumPy makes of it."""
    if inspect.isclass(obj):
        return (class_signature(obj), None) if has_fields(obj) else None
    function = inspect.unwrap(getattr(obj, "__func__", obj))
    try:
        node = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    except (OSError, TypeError, SyntaxError):
        return None
    if not isinstance(node, ast.FunctionDef):
        return None
    if what == "method" and "staticmethod" not in map(ast.unparse, node.decorator_list):
        del node.args.args[:1]
    written = Annotation(function.__globals__)
    for each in ast.walk(node.args):
        if isinstance(each, ast.arg) and each.annotation:
            each.annotation = written.visit(each.annotation)
    return f"({ast.unparse(node.args)})", ast.unparse(
        written.visit(node.returns)
    ) if node.returns else None


def has_fields(cls: type) -> bool:
    """Whether a class is a dataclass or a pydantic model."""
    return "__dataclass_fields__" in vars(cls) or (
        issubclass(cls, pydantic.BaseModel) and "twinlens" in cls.__module__
    )


def class_signature(cls: type) -> str:
    """The fields of a dataclass or pydantic model as its author wrote them."""
    fields = {}
    for base in filter(has_fields, reversed(cls.__mro__)):
        written = Annotation(vars(sys.modules[base.__module__]))
        for node in ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body:
            if not isinstance(node, ast.AnnAssign) or re.search(
                r"ClassVar\[|init=False", ast.unparse(node)
            ):
                continue
            if ast.unparse(node.annotation) == "KW_ONLY":
                fields["_"] = "*"
            else:
                default = f" = {ast.unparse(node.value)}" if node.value else ""
                fields[node.target.id] = (
                    f"{node.target.id}: {ast.unparse(written.visit(node.annotation))}{default}"
                )
    return f"({', '.join(fields.values())})"
