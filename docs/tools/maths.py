"""Markdown extension for mathematics: formulas as MathML, numbered equations, citations; rendered at build time.

`$...$` is an inline formula. A block between two lines `$$` is a display formula; `\tag{S1}` numbers it, and a first
line `% path/to/module.py: name` names the implementing code. `(S1)` links to the equation, and `[Piegl1997]` to the
bibliography.
"""

from __future__ import annotations

import posixpath
import re
import sys
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree as etree  # noqa: N813 - the name that Markdown gives it

from latex2mathml.converter import convert as converted
from markdown.blockprocessors import BlockProcessor
from markdown.extensions import Extension
from markdown.inlinepatterns import InlineProcessor
from markdown.util import AtomicString

sys.path.insert(0, str(Path(__file__).parent))  # MkDocs loads hooks by their paths
from sources import link_to_map, link_to_source

if TYPE_CHECKING:
    from markdown import Markdown
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.pages import Page

__all__ = ["EQUATION_PAGES", "Maths", "on_config", "on_page_markdown"]

EQUATION_PAGES = {
    "G": "index",
    "M": "costmap",
    "P": "planner",
    "R": "search",
    "N": "impossibility",
    "S": "smoother",
    "C": "certificate",
    "T": "timing",
    "K": "controller",
}
"""First letter of an equation's number, and the theory page that contains it."""

_BLOCK = re.compile(r"^\$\$\n(?:% *(?P<where>[^\n]+)\n)?(?P<tex>.+?)\n\$\$$", re.DOTALL)
_TAG = re.compile(r"\s*\\tag\{(\w+)\}")


_UNDER = re.compile(r"<msub><mo>(min|max)</mo>(<mrow>.*?</mrow>|<m[in]>.*?</m[in]>)</msub>")
_PRIME = re.compile(r"<msup>((?:(?!<msup>).)*?)<mi>(&#x0203[234];)</mi></msup>")
_FUNCTIONS, _THIN = re.compile(r"<mi>(sin|cos|tan|arctan)</mi>"), '<mspace width="0.12em"/>'
_OPERATORS = {
    "<mi>&#x027FA;</mi>": '<mo lspace="0.6em" rspace="0.6em">&#x027FA;</mo>',  # if and only if, a relation
    "<mi>&#x0007E;</mi>": '<mo lspace="0.28em" rspace="0.28em">&#x0223C;</mo>',
    "<mi>&#x000B1;</mi>": "<mo>&#x000B1;</mo>",
    "<mo>&#x0005E;</mo>": '<mo stretchy="false">&#x002C6;</mo>',  # a hat directly above its letter
}
_CAPITALS = re.compile(r"<mi>(&#x003(?:9|A)[0-9A-F];)</mi>")


def mathml(tex: str, display: str) -> str:
    """Return a formula as MathML with TeX typography: stretched bars, large primes, upright Greek capitals, limits
    below.
    """
    tex = re.sub(
        r"(?<!left)(?<!right)\\([lr])([vV])ert(?![A-Za-z])",
        lambda m: rf"\{'left' if m[1] == 'l' else 'right'}\{m[1]}{m[2]}ert ",
        tex,
    )
    found = _CAPITALS.sub(r'<mi mathvariant="normal">\1</mi>', converted(tex, display=display))
    found = _PRIME.sub(r'<mrow>\1<mo form="postfix" lspace="0" rspace="0.05em">\2</mo></mrow>', found)
    found = _FUNCTIONS.sub(rf"<mrow>{_THIN}<mi>\1</mi>{_THIN}</mrow>", found)
    for plain, better in _OPERATORS.items():
        found = found.replace(plain, better)
    return _UNDER.sub(r"<munder><mo>\1</mo>\2</munder>", found) if display == "block" else found


class _Place:
    """The page that is being rendered, relative to the documents' folder."""

    page = "index.md"


def _relative(target: str) -> str:
    return posixpath.relpath(target, posixpath.dirname(_Place.page) or ".")


class _Blocks(BlockProcessor):
    def test(self, parent: etree.Element, block: str) -> bool:  # noqa: ARG002 - Markdown's form
        return block.startswith("$$\n")

    def run(self, parent: etree.Element, blocks: list[str]) -> bool | None:
        found = _BLOCK.match(blocks[0])
        if found is None:
            raise ValueError(f"{_Place.page}: a formula has no end or an empty line: {blocks[0][:60]!r}")
        blocks.pop(0)
        tex, number = found["tex"], _TAG.search(found["tex"])
        box = etree.SubElement(parent, "div", {"class": "equation"})
        body = etree.SubElement(box, "div", {"class": "formula"})
        # Adjacent formulas may be stacked on narrow screens.
        whole = _TAG.sub("", tex)
        pieces = [whole] if "\\begin" in whole else re.split(r"\s*\\qquad\s*", whole)
        body.text = self.parser.md.htmlStash.store("".join(mathml(piece, "block") for piece in pieces))
        if number:
            box.set("id", number[1])
            link = etree.SubElement(box, "a", {"class": "number", "href": f"#{number[1]}"})
            link.text = AtomicString(f"({number[1]})")
        if found["where"]:
            _place_named(box, found["where"])
        return None


def _place_named(box: etree.Element, where: str) -> None:
    """Render `path: names` below the formula, with the path as a link into the map."""
    path, _, names = (part.strip() for part in where.partition(":"))
    page = f"{_Place.page.removesuffix('.md')}.html"
    line = etree.SubElement(box, "div", {"class": "where"})
    link = etree.SubElement(line, "a", {"href": link_to_map(path, page)})
    link.text = AtomicString(path)
    for name in re.split(r",\s*", names):
        link.tail = AtomicString(" " if link.text == path else ", ")
        link = etree.SubElement(line, "a", {"href": link_to_source(path, name, page)})
        link.text = AtomicString(name)


class _Formula(InlineProcessor):
    """An inline formula; a following punctuation mark is kept on the same line."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[str, int, int]:  # noqa: N802, ARG002 - Markdown's form
        formula = mathml(m[1], "inline")
        kept = f'<span class="kept">{formula}{m[2]}</span>' if m[2] else formula
        return self.md.htmlStash.store(kept), m.start(0), m.end(0)


class _Citation(InlineProcessor):
    """A link to the bibliography; on the bibliography page, the link target."""

    def handleMatch(self, m: re.Match[str], data: str) -> tuple[etree.Element, int, int]:  # noqa: N802, ARG002
        if _Place.page == "bibliography.md":
            element = etree.Element("strong", {"id": m[1].lower()})
        else:
            element = etree.Element("a", {"href": f"{_relative('bibliography.md')}#{m[1].lower()}", "class": "cite"})
        element.text = AtomicString(f"[{m[1]}]")
        return element, m.start(0), m.end(0)


class _EquationLink(InlineProcessor):
    def handleMatch(self, m: re.Match[str], data: str) -> tuple[etree.Element, int, int]:  # noqa: N802, ARG002
        page = f"theory/{EQUATION_PAGES[m[1][0]]}.md"
        target = "" if page == _Place.page else _relative(page)
        element = etree.Element("a", {"href": f"{target}#{m[1]}"})
        element.text = AtomicString(f"({m[1]})")
        return element, m.start(0), m.end(0)


class Maths(Extension):
    """Markdown extension that registers all processors."""

    def extendMarkdown(self, md: Markdown) -> None:  # noqa: N802 - Markdown's form
        """Register the processors: after code spans, before links."""
        md.parser.blockprocessors.register(_Blocks(md.parser), "formula", 75)
        md.inlinePatterns.register(_Formula(r"(?<![\\$])\$([^$\n]+?)\$(?!\d)([.,:;)]?)", md), "formula", 185)
        md.inlinePatterns.register(_Citation(r"\[([A-Z][A-Za-z]+\d{4}[a-z]?)\](?![(\[])", md), "citation", 175)
        letters = "".join(EQUATION_PAGES)
        md.inlinePatterns.register(_EquationLink(rf"\(([{letters}]\d+)\)", md), "equation", 174)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Hook of MkDocs: add the extension."""
    config.markdown_extensions.append(Maths())  # type: ignore[arg-type]  # an instance is as good as a name
    return config


def on_page_markdown(markdown: str, page: Page, **_: object) -> str:
    """MkDocs hook: store the current page."""
    _Place.page = Path(page.file.src_uri).as_posix()
    return markdown
