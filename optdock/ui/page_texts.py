"""Answers of the planning process as HTML."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from optdock.reports.html.page import Table, Text
    from optdock.ui.drawn_plan import DrawnPlan
    from optdock.ui.driven_plan import DrivenPlan

__all__ = ["answer_html", "drive_text", "status_html"]


# Keys of the scenario file in messages, as fields of the page.
_KEYS_AS_FIELDS = (("raise time_budget, which is", "raise the time budget (under Planning), which is"),)


_SHOWN = ("final error", "driving time")  # values of a drive


def answer_html(drawn: DrawnPlan) -> str:
    """Return certificate or refusal, values and tried guesses of an answer."""
    return "".join((*map(_text_html, drawn.texts), *map(_table_html, drawn.tables)))


def status_html(scene: str, drawn: DrawnPlan | None, doing: str, mend: str = "") -> str:
    """Return the outcome in one line, with the fingerprints of the scene and of the answer that is shown.

    Args:
        scene: Fingerprint of the scene.
        drawn: The answer that is shown, or None.
        doing: `moving` while a part is dragged, `planning` or `driving` until the answer arrives; otherwise empty.
        mend: Change that may end a refusal; otherwise empty.
    """
    shown, outcome, headline = ("", "", "") if drawn is None else (drawn.fingerprint, drawn.outcome, drawn.headline)
    grade = f"{outcome}{' stale' if shown != scene else ''}"
    words = f"{outcome}; {doing}" if outcome and doing else doing or outcome
    if mend and not headline.endswith("."):
        headline += "."
    places = f'data-scene="{escape(scene)}" data-shown="{escape(shown)}" data-doing="{escape(doing)}"'
    return f'<p {places} class="{grade}"><b>{escape(words)}</b> {_escaped(headline)} <em>{escape(mend)}</em></p>'


def _escaped(message: str) -> str:
    for key, words in _KEYS_AS_FIELDS:
        message = message.replace(key, words)
    return escape(message)


def drive_text(drive: DrivenPlan) -> str:
    """Return the outcome of a simulated drive and its main values in one line."""
    outcome = ", ".join(part for part in (drive.outcome, drive.reason) if part)
    return "; ".join(
        (f"simulated drive: {outcome}", *(f"{name} {value}" for name, value in drive.rows if name in _SHOWN))
    )


def _text_html(text: Text) -> str:
    sentences = "".join(f"<li>{_escaped(sentence)}</li>" for sentence in text.sentences)
    return f"<section><h3>{escape(text.title)}</h3><ul>{sentences}</ul></section>"


def _table_html(table: Table) -> str:
    head = "".join(f"<th>{escape(str(cell))}</th>" for cell in table.head)
    rows = "".join(f"<tr>{''.join(f'<td>{_escaped(str(cell))}</td>' for cell in row)}</tr>" for row in table.rows)
    body = f"<table><thead><tr>{head}</tr></thead><tbody>{rows}</tbody></table>"
    return f"<section><h3>{escape(table.title)}</h3>{body}</section>"
