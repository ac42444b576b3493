"""MkDocs hook that adds source pages, and links from code references in pages to the source lines.

`path/to/module.py` in a page links to the map of the code; names that follow, as in `module.py`: `name`, link to the
lines of their definitions. In the map, and for scripts outside the packages, the path links to the source too.
"""

from __future__ import annotations

import ast
import functools
import html
import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

__all__ = [
    "MAPPED",
    "PACKAGES",
    "ROOT",
    "SHOWN",
    "defined_in",
    "link_to_map",
    "link_to_source",
    "on_files",
    "on_page_content",
]

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("optdock", "smoothers", "checkers")
MAPPED = (*PACKAGES, "ros/optdock_ros/optdock_ros")
SHOWN = (*PACKAGES, "examples", "experiments", "ros")
_NAMED = re.compile(
    r'(?<!">)<code>(?P<path>(?:' + "|".join(SHOWN) + r")/[\w/]+\.py)</code>"
    r"(?P<names>(?:: <code>[\w.]+</code>(?:, <code>[\w.]+</code>)*)?)"
)
_NAME = re.compile(r"<code>([\w.]+)</code>")
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width,initial-scale=1">
<title>{path}</title><style>
:root {{ color-scheme: light dark; }}
body {{ margin: 1em; font-family: system-ui, sans-serif; }}
pre {{ counter-reset: line; font: 13px/1.45 ui-monospace, "DejaVu Sans Mono", monospace; overflow-x: auto; }}
pre span::before {{ counter-increment: line; content: counter(line); display: inline-block; width: 3.2em;
  padding-right: 1em; text-align: right; color: GrayText; }}
pre span:target {{ background: color-mix(in srgb, Highlight 25%, transparent); }}
</style></head><body><p><a href="{back}">{label}</a></p><h1>{path}</h1>
<pre>{lines}</pre></body></html>
"""


@functools.cache
def defined_in(path: str) -> dict[str, int]:
    """Return the line of every function, class, method (as `Class.method`) and constant of a module."""
    tree = ast.parse((ROOT / path).read_text(encoding="utf-8"))
    found: dict[str, int] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            found[node.name] = node.lineno
        if isinstance(node, ast.ClassDef):
            inner = (one for one in node.body if isinstance(one, ast.FunctionDef))
            found |= {f"{node.name}.{one.name}": one.lineno for one in inner}
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            every = [one for target in targets for one in ast.walk(target) if isinstance(one, ast.Name)]
            found |= {one.id: node.lineno for one in every}
    return found


def _relative(target: str, page: str) -> str:
    return posixpath.relpath(target, posixpath.dirname(page) or ".")


def _is_in_map(path: str) -> bool:
    return path.startswith(tuple(f"{package}/" for package in MAPPED))


def link_to_map(path: str, page: str) -> str:
    """Return a link from a page such as `theory/timing.html` to a module's entry in the map, or else to its source."""
    if not _is_in_map(path):
        return link_to_source(path, "", page)
    anchor = f"#{path.replace('/', '-')}"
    return anchor if page.startswith("map.") else f"{_relative('map.html', page)}{anchor}"


def link_to_source(path: str, name: str, page: str) -> str:
    """Return a link from a page to the line of a module that defines a name, or to its first line."""
    line = defined_in(path).get(name)
    return _relative(f"source/{path}.html", page) + (f"#L{line}" if line else "")


def on_page_content(html: str, page: Page, **_: object) -> str:
    """MkDocs hook: link code references."""
    return _NAMED.sub(lambda found: _linked(found, page.file.dest_uri), html)


def _linked(found: re.Match[str], page: str) -> str:
    path = found["path"]
    if not (ROOT / path).is_file():
        return found[0]
    names = _NAME.sub(lambda one: f'<a href="{link_to_source(path, one[1], page)}">{one[0]}</a>', found["names"])
    return f'<a href="{link_to_map(path, page)}"><code>{path}</code></a>{names}'


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """MkDocs hook: add the source pages, and pages for DESIGN.md and CHANGELOG.md."""
    from mkdocs.structure.files import File

    for folder in SHOWN:
        for path in sorted((ROOT / folder).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            files.append(File.generated(config, f"source/{name}.html", content=_source_page(name)))
    for book in ("DESIGN", "CHANGELOG"):
        text = (ROOT / f"{book}.md").read_text(encoding="utf-8")
        files.append(File.generated(config, f"{book.lower()}.md", content=text))
    return files


def _source_page(path: str) -> str:
    lines = (ROOT / path).read_text(encoding="utf-8").splitlines()
    shown = "\n".join(f'<span id="L{i}">{html.escape(line, quote=False)}</span>' for i, line in enumerate(lines, 1))
    page = f"source/{path}.html"
    label = "in the map of the code" if _is_in_map(path) else "the documentation"
    back = link_to_map(path, page) if _is_in_map(path) else _relative("index.html", page)
    return _PAGE.format(path=path, back=back, label=label, lines=shown)
