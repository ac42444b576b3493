"""The finished site loads nothing from elsewhere: a page that would is an error."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from mkdocs.exceptions import PluginError

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig

__all__ = ["on_post_build"]

_LOADED = re.compile(
    r"""<(?:script|img|iframe|source|video|audio|embed)\b[^>]*?\ssrc=["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|<link\b(?=[^>]*rel=["']?(?:stylesheet|preload|preconnect|icon|manifest))[^>]*?href=["']?((?:https?:)?//[^"'\s>]+)"""
    r"""|url\(["']?((?:https?:)?//[^"')]+)|@import\s+["']((?:https?:)?//[^"']+)"""
)


def on_post_build(config: MkDocsConfig, **_: object) -> None:
    """Hook of MkDocs: look through every page and style sheet."""
    site = Path(config.site_dir)
    files = [path for path in sorted(site.rglob("*")) if path.suffix in {".html", ".css"}]
    found = [
        f"{path.relative_to(site)}: {next(filter(None, hit))}"
        for path in files
        for hit in _LOADED.findall(path.read_text(encoding="utf-8"))
    ]
    if found:
        raise PluginError("the site would load from elsewhere:\n  " + "\n  ".join(found))
