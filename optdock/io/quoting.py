"""How values from files are quoted in messages: on one line, printable, and short.

A file's own words may hold control characters or a million letters, and a file that is read by mistake may hold
secrets.
"""

from __future__ import annotations

__all__ = ["printable", "shortened", "shown"]

_LONGEST_VALUE = 60  # characters of a value in a message
_LONGEST_SENTENCE = 300  # that another library made of what it read


def printable(text: str) -> str:
    r"""The text on one line, with control characters written as escapes.

    >>> print(printable("a\x1b[1m\nb"))
    a\x1b[1m\nb
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """A sentence by others on one line, cut off after 300 characters."""
    line = printable(text[: _LONGEST_SENTENCE + 1])
    return line if len(text) <= _LONGEST_SENTENCE else f"{line[:_LONGEST_SENTENCE]}..."


def shown(value: object) -> str:
    """What a message quotes of a value: `repr` of it, cut off after 60 characters.

    >>> shown(-1.0), shown("a" * 1000)[-9:]
    ('-1.0', 'aaaaaa...')
    """
    if isinstance(value, str | bytes):
        value = value[: _LONGEST_VALUE + 1]
    try:
        text = printable(repr(value))
    except (ValueError, RecursionError):  # Python refuses to write whole numbers of more than 4300 digits
        text = f"a {type(value).__name__} too long to be written"
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
