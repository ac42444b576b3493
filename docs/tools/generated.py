"""Pages made from the code: what a reader finds there cannot be stale.

A line `<!-- made: NAME ARGUMENT -->` in a page is replaced by what `NAME` makes.
"""

from __future__ import annotations

import ast
import html
import inspect
import json
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from mkdocs.config.defaults import MkDocsConfig

__all__ = ["MARKER", "ROOT", "modules_of", "on_page_markdown", "on_post_build"]

ROOT = Path(__file__).resolve().parents[2]
MARKER = re.compile(r"^<!-- made: (?P<name>\w+) ?(?P<argument>[^\n]*?) ?-->$", re.MULTILINE)


def on_page_markdown(markdown: str, **_: object) -> str:
    """Hook of MkDocs: fill in what is made."""
    return MARKER.sub(lambda found: _MAKERS[found["name"]](found["argument"]), markdown)


# The map: modules with the first line of their docstring.


def modules_of(package: str) -> list[Path]:
    """The modules directly in a folder, `__init__` first, relative to the root."""
    found = sorted((ROOT / package).glob("*.py"), key=lambda path: (path.name != "__init__.py", path.name))
    return [path.relative_to(ROOT) for path in found]


def _map(package: str) -> str:
    rows = [row for path in modules_of(package) for row in _map_row(path)]
    return '<div class="tree" markdown="0"><dl>\n' + "\n".join(rows) + "\n</dl></div>"


def _map_row(path: Path) -> Iterator[str]:
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    says = (ast.get_docstring(tree) or "").split("\n\n")[0].replace("\n", " ")
    if path.name == "__init__.py" and len(tree.body) <= 1 and not says:
        return
    names = [] if path.name == "__init__.py" else _public_names(tree)
    listed = f' <span class="names">{", ".join(names)}</span>' if names else ""
    yield f'<dt id="{path.as_posix().replace("/", "-")}">{path.as_posix()}</dt><dd>{_inline(says)}{listed}</dd>'


def _public_names(tree: ast.Module) -> list[str]:
    for node in tree.body:
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__":
            return [str(name) for name in ast.literal_eval(node.value)]
    return []


def _inline(text: str) -> str:
    return re.sub(r"`([^`]+)`", r"<code>\1</code>", html.escape(text, quote=False))


# Plugins and their parameters.


def _plugins(kind: str) -> str:
    from optdock.plugins import INTERFACES, available_plugins, load_plugin

    names = [info.name for info in available_plugins() if info.kind == kind]
    return "\n\n".join(_plugin(name, load_plugin(INTERFACES[kind], name)) for name in names)


def _plugin(name: str, cls: type) -> str:
    says = inspect.cleandoc(cls.__doc__ or "").split("\n\n")[0].replace("\n", " ")
    rows = [_parameter(key, field) for key, field in cls.Parameters.model_fields.items()]  # type: ignore[attr-defined]
    table = "| parameter | default | unit | meaning |\n|---|---|---|---|\n" + "\n".join(rows) if rows else "No parameters."
    return f"### {name}\n\n{says}\n\n`{cls.__module__}`\n\n{table}\n"


def _parameter(key: str, field: object) -> str:
    meaning = getattr(field, "description", None) or ""
    unit = re.search(r"\s*\[([^\]]+)\]", meaning)
    rest = meaning.replace(unit[0], "") if unit else meaning
    default = field.get_default(call_default_factory=True)  # type: ignore[attr-defined]
    cells = (f"`{key}`", f"`{_plain(default)}`", unit[1] if unit else "", rest)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"


def _plain(value: object) -> str:
    value = getattr(value, "value", value)
    if isinstance(value, (bool, type(None), str)):
        return json.dumps(value).strip('"')
    return str(value)


_MAKERS: dict[str, Callable[[str], str]] = {"map": _map, "plugins": _plugins}


def on_post_build(config: MkDocsConfig, **_: object) -> None:
    """Hook of MkDocs: nothing is left unmade."""
    for path in Path(config.site_dir).rglob("*.html"):
        if "<!-- made:" in path.read_text(encoding="utf-8"):
            raise ValueError(f"{path}: a mark was left")
