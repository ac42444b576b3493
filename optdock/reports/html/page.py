"""The page of a report: chapters of text, tables and figures as one HTML file that loads nothing.

Text is escaped by the template. Figures are JSON, which BokehJS draws; the identifiers of their models are numbered
anew in every figure, so that equal results give equal pages.
"""

from __future__ import annotations

import functools
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias, TypeVar

from optdock import __version__
from optdock.io.plan_file import finite_or_null
from optdock.reports.html.figures import PALETTE, check_bokeh

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from bokeh import plotting
    from jinja2 import Environment

    from optdock.reports.html.figures import LegendEntry

__all__ = [
    "REPORT_FORMAT",
    "Block",
    "Chapter",
    "Chart",
    "Content",
    "Player",
    "Readout",
    "Table",
    "Text",
    "html_page",
]

REPORT_FORMAT = "optdock-report/1"  # of the figures that the page carries as JSON
# Characters of the contents and of the numbers; with BokehJS (1.3 MB) and the summary the page stays below 5 MB.
_MOST_CONTENT, _MOST_NUMBERS = 2_000_000, 800_000
_MODEL_ID = re.compile(r'"(?P<key>id|root_id)": ?"(?P<id>[^"]+)"')

T = TypeVar("T")


class Chart(NamedTuple):
    """A figure with its texts.

    Attributes:
        title: Title.
        text: Description for readers who do not see the figure.
        figure: The figure.
        legend: Legend below the title.
        ratio: Width divided by height of a scene; 0 for other figures.
        layers: Names of the layers of the figure, of which the page shows one; empty without layers.
    """

    title: str
    text: str
    figure: plotting.figure
    legend: Sequence[LegendEntry] = ()
    ratio: float = 0.0
    layers: Sequence[str] = ()


class Table(NamedTuple):
    """A table; `head` may be empty, and `links` are the anchors of the rows or empty."""

    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    links: Sequence[str] = ()


class Text(NamedTuple):
    """A list of sentences with a title."""

    title: str
    sentences: Sequence[str]


Block: TypeAlias = "Chart | Table | Text"


class Readout(NamedTuple):
    """Values of one quantity, which the page prints at the cursor: name, unit, one number or text for each pose."""

    label: str
    unit: str
    values: Sequence[float | str | None]


class Player(NamedTuple):
    """Poses through which the page moves the robot.

    Attributes:
        clock: Name of the parameter, `time` or `arc length`.
        unit: Its unit.
        at: Values of the parameter, increasing.
        poses: One pose for each value [m, m, rad].
        outline: Corners of the footprint [m]; empty if it is not known.
        readouts: Quantities that are printed.
    """

    clock: str
    unit: str
    at: Sequence[float]
    poses: Sequence[Sequence[float]]
    outline: Sequence[Sequence[float]]
    readouts: Sequence[Readout] = ()


class Content(NamedTuple):
    """Text, tables and figures of a chapter, and the poses along its motion or None."""

    blocks: Sequence[Block]
    player: Player | None = None


@dataclass(frozen=True)
class Chapter:
    """One file of a report.

    Args:
        title: Name of the file.
        kind: Kind of the file, in the plural.
        outcome: Result in one or two words.
        grade: `good`, `bad` or `neutral`.
        summary: Result in one sentence.
        content: Function that makes the content, which is called only if the page has room for it.
        numbers: Numbers of the file, unchanged, for programs that read the page.
        rank: Chapters of lower rank are placed first.
    """

    title: str
    kind: str
    outcome: str
    grade: str
    summary: str
    content: Callable[[], Content]
    numbers: Mapping[str, object] = field(default_factory=dict)
    rank: tuple[float, ...] = ()


class _Item(NamedTuple):
    """A block as the template uses it."""

    kind: str
    block: Block
    key: str
    json: str = ""


class _Entry(NamedTuple):
    """A chapter as the template uses it; figures that follow each other are one group, as are texts and tables."""

    key: str
    chapter: Chapter
    groups: Sequence[Sequence[_Item]]
    player: Player | None
    motion: str


def html_page(title: str, summary: Sequence[Block], chapters: Sequence[Chapter]) -> str:
    """Return the text of the page.

    The content of the first chapters and the numbers of the first files are written, as many as fit into 5 MB.

    Args:
        title: Title of the page.
        summary: Blocks at the beginning.
        chapters: One chapter for each file.

    Raises:
        MissingExtra: If Bokeh is not installed.
    """
    environment = _environment()
    entries = [
        *_while_small((_entry(f"file-{i}", one) for i, one in enumerate(chapters, start=1)), _size_of, _MOST_CONTENT)
    ]
    files = ({"name": one.title, "kind": one.kind, "outcome": one.outcome, **one.numbers} for one in chapters)
    written = _while_small(map(_script_json, map(finite_or_null, files)), len, _MOST_NUMBERS)
    palette = _script_json(dict(PALETTE.values()))
    return environment.get_template("page.html").render(
        title=title,
        version=__version__,
        summary=_groups("summary", summary),
        entries=entries,
        keys=[entry.key for entry in entries],
        left_out=len(chapters) - len(entries),
        numbers=f'{{"format": "{REPORT_FORMAT}", "palette": {palette}, "files": [{", ".join(written)}]}}',
        palette=PALETTE,
        style=_source(environment, "page.css"),
        script=_source(environment, "page.js"),
        bokeh=_bokeh_script(),
    )


def _while_small(parts: Iterable[T], size: Callable[[T], int], most: int) -> Iterator[T]:
    """Generate parts as long as all of them together have at most `most` characters; at least the first one."""
    total = 0
    for i, part in enumerate(parts):
        total += size(part)
        if total > most and i:
            return
        yield part


def _size_of(entry: _Entry) -> int:
    return len(entry.motion) + sum(len(item.json) for group in entry.groups for item in group)


def _entry(key: str, chapter: Chapter) -> _Entry:
    blocks, player = chapter.content()
    motion = "" if player is None else _script_json(finite_or_null(_plain(player)))
    return _Entry(key, chapter, _groups(key, blocks), player, motion)


def _plain(player: Player) -> dict[str, Any]:
    return {**player._asdict(), "readouts": [readout._asdict() for readout in player.readouts]}


def _groups(key: str, blocks: Sequence[Block]) -> list[list[_Item]]:
    items = []
    for i, block in enumerate(blocks, start=1):
        text = _figure_json(block.figure) if isinstance(block, Chart) else ""
        items.append(_Item(type(block).__name__.lower(), block, f"{key}-{i}", text))
    return [[*group] for _, group in itertools.groupby(items, lambda item: item.kind == "chart")]


def _figure_json(figure: plotting.figure) -> str:
    """Return a figure as JSON for BokehJS, whose models are numbered from 1."""
    from bokeh.embed import json_item

    text = _script_json(json_item(figure))
    known: dict[str, str] = {}

    def renamed(found: re.Match[str]) -> str:
        return f'"{found["key"]}": "m{known.setdefault(found["id"], str(len(known) + 1))}"'

    return _MODEL_ID.sub(renamed, text)


def _script_json(value: object) -> str:
    """Return JSON that may stand in a script element."""
    text = json.dumps(value, allow_nan=False, ensure_ascii=False)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


@functools.cache
def _environment() -> Environment:
    check_bokeh()
    from jinja2 import Environment, PackageLoader

    loader = PackageLoader("optdock.reports.html", "templates")
    return Environment(loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True)


def _source(environment: Environment, name: str) -> str:
    assert environment.loader is not None
    return environment.loader.get_source(environment, name)[0]


def _bokeh_script() -> str:
    from bokeh.resources import Resources

    script: str = "\n".join(Resources(mode="inline", components=["bokeh"], minified=True).js_raw)
    return script.replace("</script", "<\\/script")
