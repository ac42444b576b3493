"""MkDocs hook for offline use of the site: a page that would load external content is an error."""

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

_LOST = """<h1>No such page</h1>
<p>Try the <a href="./index.html">start page</a>, the <a href="./map.html">map of the code</a>, or the search.</p>"""


def on_post_build(config: MkDocsConfig, **_: object) -> None:
    """MkDocs hook: fix the links of the 404 page, and check every page and style sheet."""
    site = Path(config.site_dir)
    for nothing in site.glob("sitemap.xml*"):  # a sitemap needs a site address, which does not exist
        nothing.unlink()
    lost = site / "404.html"
    text = lost.read_text(encoding="utf-8")
    text = re.sub(r"""(\b(?:href|src|base)"?[=:] ?"|new URL\(")/""", r"\1./", text)
    lost.write_text(text.replace("<h1>404 - Not found</h1>", _LOST), encoding="utf-8")
    files = [path for path in sorted(site.rglob("*")) if path.suffix in {".html", ".css"}]
    found = [
        f"{path.relative_to(site)}: {next(filter(None, hit))}"
        for path in files
        for hit in _LOADED.findall(path.read_text(encoding="utf-8"))
    ]
    if found:
        raise PluginError("the site would load from elsewhere:\n  " + "\n  ".join(found))
