"""MkDocs hook that generates parts of pages from the code, so that they are up to date.

A line `<!-- made: NAME ARGUMENT -->` in a page is replaced by the output of generator `NAME`.
"""

from __future__ import annotations

import ast
import contextlib
import dataclasses
import functools
import html
import importlib
import inspect
import itertools
import json
import re
import sys
from pathlib import Path, PurePath
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads hooks by their paths
from sources import ROOT, link_to_source

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files

    from optdock.config import KeyReference

__all__ = ["MARKER", "ROOT", "modules_of", "on_files", "on_page_markdown", "public_names"]

MARKER = re.compile(r"^<!-- made: (?P<name>\w+) ?(?P<argument>[^\n]*?) ?-->$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: object) -> str:
    """MkDocs hook: replace the markers by generated text."""
    return MARKER.sub(lambda found: _MAKERS[found["name"]](found["argument"]), markdown)


# The map: modules with the first line of their docstring.


def modules_of(package: str) -> list[Path]:
    """Return the modules directly in a folder, `__init__` first, relative to the root."""
    found = sorted((ROOT / package).glob("*.py"), key=lambda path: (path.name != "__init__.py", path.name))
    return [path.relative_to(ROOT) for path in found]


def _map(package: str) -> str:
    rows = [row for path in modules_of(package) for row in _map_row(path)]
    return '<div class="tree" markdown="0"><dl>\n' + "\n".join(rows) + "\n</dl></div>"


def _map_row(path: Path) -> Iterator[str]:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    description = (ast.get_docstring(tree) or "").split("\n\n")[0].replace("\n", " ")
    if path.name == "__init__.py" and len(tree.body) <= 1 and not description:
        return
    where = path.as_posix()
    names = [] if path.name == "__init__.py" else public_names(tree)
    linked = (f'<a href="{link_to_source(where, name, "map.html")}">{name}</a>' for name in names)
    listed = f' <span class="names">{", ".join(linked)}</span>' if names else ""
    head = f'<dt id="{where.replace("/", "-")}"><a href="{link_to_source(where, "", "map.html")}">{where}</a></dt>'
    yield f"{head}<dd>{_inline(description)}{listed}</dd>"


def public_names(tree: ast.Module) -> list[str]:
    """Return the public names of a module: its `__all__`."""
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return [str(name) for name in ast.literal_eval(node.value)]
    return []


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text, quote=False))


# Keys of scenario files, and parameters of plugins.


def _scenario(prefix: str) -> str:
    """Return a table of the keys of a section of scenario files, or of the top level."""
    from optdock.config import scenario_reference

    rows = scenario_reference()
    if prefix:
        return _table(
            [row._replace(key=row.key[len(prefix) + 1 :]) for row in rows if row.key.startswith(f"{prefix}.")]
        )
    return _table([row for row in rows if "." not in row.key])


def _table(rows: Sequence[KeyReference]) -> str:
    head = "| key | description | type and rule | unit | if absent |\n|---|---|---|---|---|\n"
    return head + "\n".join(map(_row, rows))


def _row(row: KeyReference) -> str:
    rule = f"{row.type}, {row.rule}" if row.rule else row.type
    absent = "**required**" if row.required else _absent(row)
    cells = (f"`{row.key}`", row.description, rule, row.unit, absent)
    return "| " + " | ".join(cell.replace("|", "\\|").replace("\n", " ") for cell in cells) + " |"


def _absent(row: KeyReference) -> str:
    if not row.default or row.default in row.absent:
        return row.absent
    return f"`{row.default}`" if row.absent in ("", row.default) else f"`{row.default}`: {row.absent}"


def _limits(_argument: str) -> str:
    """Return a table of the motion limits, with the limited quantity and the certificate of each."""
    from optdock.model.limits import LIMITS, LimitKind

    head = "| quantity | bounded is | unit | by | proven of | for |\n|---|---|---|---|---|---|\n"
    rows = (
        (
            limit.quantity.replace("_", " "),
            f"`{limit.formula}`",
            limit.unit,
            f"`{limit.name}`",
            "the path" if limit.kind is LimitKind.PATH else "the trajectory",
            "steered wheels" if limit.steered else "every drive",
        )
        for limit in LIMITS.values()
    )
    return head + "\n".join("| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows)


def _plugins(kind: str) -> str:
    from optdock.plugins.registry import available_plugins

    return "\n\n".join(_plugin(kind, info.name) for info in available_plugins() if info.kind == kind)


def _plugin(kind: str, name: str) -> str:
    from optdock.config import plugin_reference
    from optdock.plugins.registry import INTERFACES, load_plugin

    cls, rows = load_plugin(INTERFACES[kind], name), plugin_reference(kind, name)
    description = inspect.cleandoc(cls.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    where = Path(inspect.getfile(cls)).relative_to(ROOT).as_posix()
    parameters = _table(rows) if rows else "It has no parameters."
    return f"### {name}\n\n{description} (`{where}`: `{cls.__name__}`)\n\n{parameters}\n"


def _settings(dotted: str) -> str:
    """Return a table of the parameters of a model that is not a plugin."""
    from optdock.config.reference import _reference

    module, _, name = dotted.rpartition(".")
    return _table(_reference(getattr(importlib.import_module(module), name)))


# The ROS 2 package: its modules cannot be imported without rclpy, so the parameter models are read from the source.

_ROS = ROOT / "ros" / "optdock_ros" / "optdock_ros"


@functools.cache
def ros_models(module: str) -> dict[str, Any]:
    """Return the parameter models of a module of the ROS 2 package by name, executed from its source.

    Only literals, parameter classes and the imports that succeed are executed; methods of the models (validators and
    converters) are omitted.
    """
    known: dict[str, Any] = {"__name__": f"optdock_ros.{module}"}
    for node in ast.parse((_ROS / f"{module}.py").read_text(encoding="utf-8")).body:
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("optdock_ros."):
            known |= ros_models(str(node.module).partition(".")[2])
        elif isinstance(node, ast.Import | ast.ImportFrom) and getattr(node, "module", "") != "__future__":
            with contextlib.suppress(ImportError):
                _execute(node, known)
        elif isinstance(node, ast.ClassDef) and any(_is_model(known.get(ast.unparse(base))) for base in node.bases):
            node.body = [part for part in node.body if not isinstance(part, ast.FunctionDef)]
            _execute(node, known)
        elif isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None:
            with contextlib.suppress(ValueError):
                ast.literal_eval(node.value)
                _execute(node, known)
    return known


def _is_model(value: object) -> bool:
    from pydantic import BaseModel

    return inspect.isclass(value) and issubclass(value, BaseModel)


def _execute(node: ast.stmt, known: dict[str, Any]) -> None:
    # trusted source of this repository
    exec(compile(ast.Module([node], []), known["__name__"], "exec", dont_inherit=True), known)


def _ros(dotted: str) -> str:
    """Return a table of the parameters of a model of the ROS 2 package."""
    from optdock.config.reference import _reference

    module, _, name = dotted.partition(".")
    return _table(_reference(ros_models(module)[name]))


def _ros_defaults(names: str) -> str:
    """Format mappings of names to defaults."""
    found = [(ros_models(module)[name]) for module, _, name in (dotted.partition(".") for dotted in names.split())]
    return "; ".join(", ".join(f"`{key}: {value:g}`" for key, value in one.items()) for one in found) + "."


def _ros_table(dotted: str) -> str:
    """Return a table from a mapping of names to default and description."""
    module, _, name = dotted.partition(".")
    rows = [_ros_row(key, default, description) for key, (default, description) in ros_models(module)[name].items()]
    return "| parameter | description | unit | default |\n|---|---|---|---|\n" + "\n".join(rows)


def _nav2_parameters(_argument: str) -> str:
    """Return a table of the parameters of Nav2's servers, by distribution, with their use here."""
    from optdock.nav2.declared_parameters import DECLARED

    head = "| place | parameter | distributions | use | meaning |\n|---|---|---|---|---|\n"
    groups = itertools.groupby(DECLARED.values(), lambda row: row._replace(name=""))
    rows = []
    for group, members in groups:
        names = ", ".join(f"`{row.name}`" for row in members)
        cells = group.block.value, names, ", ".join(group.distributions) or "none", group.use.value, group.words
        rows.append("| " + " | ".join(cells) + " |")
    return head + "\n".join(rows)


def _ros_row(key: str, default: object, description: str) -> str:
    from optdock.config.reference import _UNIT

    unit = _UNIT.search(description)
    words = (description[: unit.start()] + description[unit.end() :]).strip(" ;") if unit else description
    return f"| `{key}` | {words} | {unit[1] if unit else ''} | `{json.dumps(default)}` |"


# The library: signatures and docstrings.

_SECTION = re.compile(r"^(Args|Attributes|Returns|Raises|Yields):$", re.MULTILINE)
_ENTRY = re.compile(r"^(?P<name>[^\n:]+):(?P<text>(?: [^\n]*)?(?:\n[ ]+[^\n]*|\n(?=\n[ ]+))*)", re.MULTILINE)


def _api(names: str) -> str:
    """Document names of the front door, interfaces, or dotted names of other importable objects."""
    return "\n\n".join(_described(name) for name in names.split())


def _described(dotted: str) -> str:
    import optdock
    from optdock.plugins import interfaces

    module, _, name = dotted.rpartition(".")
    home = importlib.import_module(module) if module else optdock if hasattr(optdock, dotted) else interfaces
    value = getattr(home, name)
    where = Path(inspect.getfile(inspect.unwrap(value))).relative_to(ROOT).as_posix()
    where = f"`{where}`: `{value.__name__}`"
    imported = "" if home is optdock else f"`from {home.__name__} import {name}`\n\n"
    head = f"### {name}\n\n{imported}{_signature(name, value)}\n\n{_docstring(value)}\n\n<small>{where}</small>"
    members = [_member(key, member) for key, member in vars(value).items() if not key.startswith("_")]
    listed = "\n".join(filter(None, members)) if inspect.isclass(value) else ""
    return f"{head}\n\n{listed}" if listed else head


def _signature(name: str, value: Any) -> str:
    if inspect.isclass(value) and issubclass(value, Exception):
        base = value.__mro__[1].__name__
        article = "an" if base[0] in "AEIOU" else "a"
        return f"```python\n{name}: code {value.code}, {article} {base}\n```"  # type: ignore[attr-defined]
    plugin = hasattr(value, "Parameters") or inspect.isabstract(value)
    parameters = [] if plugin else list(inspect.signature(value).parameters.values())
    made = {one.name: one for one in dataclasses.fields(value)} if dataclasses.is_dataclass(value) else {}
    shown = [
        str(one.replace(annotation=_short(one.annotation), default=_default(one, made)))
        for one in parameters
        if one.name != "self"
    ]
    if any(one.kind is one.KEYWORD_ONLY for one in parameters):
        shown.insert([one.kind is one.KEYWORD_ONLY for one in parameters].index(True), "*")
    line = f"{name}({'**parameters' if plugin else ', '.join(shown)})"
    broken = f"{name}(\n    " + ",\n    ".join(shown) + ",\n)"
    return f"```python\n{line if len(line) < 84 else broken}\n```"


def _short(annotation: object) -> object:
    text = annotation if isinstance(annotation, str) else getattr(annotation, "__name__", "")
    return inspect.Parameter.empty if not text or text == "_empty" else _Bare(text)


def _default(parameter: inspect.Parameter, made: dict[str, Any]) -> object:
    """Format a default: a function by its name, a factory value as its call, a path as text."""
    value = parameter.default
    if parameter.name in made and made[parameter.name].default_factory is not dataclasses.MISSING:
        return _Bare(f"{made[parameter.name].default_factory.__name__}()")
    if isinstance(value, PurePath):
        return str(value)
    return _Bare(value.__name__) if inspect.isfunction(value) else value


class _Bare(str):
    """A string whose repr has no quotes, for signatures."""

    __slots__ = ()

    def __repr__(self) -> str:
        return str(self)


def _docstring(value: object) -> str:
    """Convert a Google style docstring to Markdown."""
    parts = _SECTION.split(inspect.cleandoc(value.__doc__ or ""))
    sections = [f"**{title}**\n\n{_entries(body)}" for title, body in zip(parts[1::2], parts[2::2], strict=True)]
    return "\n\n".join([_with_doctests(parts[0].strip()), *sections])


def _with_doctests(text: str) -> str:
    blocks = [f"```python\n{block}\n```" if block.startswith(">>>") else block for block in text.split("\n\n")]
    return "\n\n".join(blocks)


def _entries(body: str) -> str:
    entries, rest = inspect.cleandoc(body).split("\n\n", 1) if "\n\n" in body.strip() else (inspect.cleandoc(body), "")
    found = list(_ENTRY.finditer(entries))
    listed = "\n".join(f"- `{one['name'].strip()}`: {' '.join(one['text'].split())}" for one in found)
    return f"{listed or entries}\n\n{_with_doctests(inspect.cleandoc(rest))}".strip()


def _member(name: str, member: Any) -> str:
    """Return one line about a method or property."""
    call = getattr(member, "__func__", getattr(member, "fget", getattr(member, "func", member)))
    if not inspect.isfunction(call) or not call.__doc__:
        return ""
    names = [one for one in inspect.signature(call).parameters.values() if one.name not in ("self", "cls")]
    spelled = (
        f"{name}({', '.join(str(one.replace(annotation=one.empty, default=_default(one, {}))) for one in names)})"
        if call is not getattr(member, "fget", getattr(member, "func", None))
        else name
    )
    description = inspect.cleandoc(call.__doc__).split("\n\n")[0].replace("\n", " ")
    return f"- `{spelled}`: {description}"


# Commands.


def _commands(_: str) -> str:
    import typer

    from optdock.cli import app

    return "\n\n".join(_command(name, command) for name, command in _leaves(typer.main.get_command(app)))


def _exit_statuses(_: str) -> str:
    """Return a table of the exit statuses."""
    from optdock.cli.exit_status import EXIT_STATUSES

    rows = (f"| {status:d} | {meaning} |" for status, meaning in EXIT_STATUSES.items())
    return "| exit status | meaning |\n|---|---|\n" + "\n".join(rows)


def _leaves(group: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """Yield every command with its full name; command groups are omitted."""
    for name in group.list_commands(None):
        command = group.commands[name]
        if hasattr(command, "commands"):
            yield from _leaves(command, f"{above}{name} ")
        else:
            yield f"{above}{name}", command


def _command(name: str, command: Any) -> str:
    rows = [_option(parameter) for parameter in command.params if parameter.name != "help"]
    head = "| option | meaning | default |\n|---|---|---|\n"
    return f"## optdock {name}\n\n{inspect.cleandoc(command.help or '')}\n\n{head}" + "\n".join(rows)


def _option(parameter: Any) -> str:
    spelled = ", ".join(parameter.opts) if parameter.param_type_name == "option" else str(parameter.name).upper()
    takes = getattr(parameter, "metavar", None) if parameter.param_type_name == "option" else None
    spelled = f"{spelled} {takes}" if takes else spelled
    default = "" if parameter.default is None or callable(parameter.default) else str(parameter.default)
    words = re.sub(r"\\\[", "[", getattr(parameter, "help", "") or "")
    default = (
        "**required**" if parameter.required else f"`{default}`" if default not in ("", "False", "[]", "()") else ""
    )
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in (f"`{spelled}`", words, default)) + " |"


def _about(_: str) -> str:
    """Return version, Python and licence, from the metadata of the distribution."""
    from importlib.metadata import metadata

    about = metadata("optdock")
    name = ", ".join(line.strip() for line in (ROOT / "LICENSE").read_text(encoding="utf-8").strip().splitlines()[:2])
    python = about["Requires-Python"].removeprefix(">=")
    return f"optdock {about['Version']}, for Python {python} or newer. Licence: {name}."


_MAKERS: dict[str, Callable[[str], str]] = {
    "about": _about,
    "api": _api,
    "commands": _commands,
    "exit_statuses": _exit_statuses,
    "limits": _limits,
    "map": _map,
    "plugins": _plugins,
    "ros": _ros,
    "ros_defaults": _ros_defaults,
    "ros_table": _ros_table,
    "nav2_parameters": _nav2_parameters,
    "scenario": _scenario,
    "settings": _settings,
}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs hook: add the schema of scenario files to the site."""
    from mkdocs.structure.files import File

    from optdock.config import scenario_schema

    text = json.dumps(scenario_schema(), indent=1, allow_nan=False)
    files.append(File.generated(config, "scenario.schema.json", content=text))
    return files
