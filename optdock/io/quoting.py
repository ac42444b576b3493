"""Quoting of values in messages: on one line, printable and short.

Text from files may contain control characters, be very long, or be confidential.
"""

from __future__ import annotations

__all__ = ["printable", "shortened", "shown"]

_LONGEST_VALUE = 60  # characters of a value in a message
_LONGEST_SENTENCE = 300  # characters of a message of another library


def printable(text: str) -> str:
    r"""Return the text on one line, with control characters as escapes.

    >>> print(printable("a\x1b[1m\nb"))
    a\x1b[1m\nb
    """
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in text)


def shortened(text: str) -> str:
    """Return a message of another library on one line, truncated after 300 characters."""
    line = printable(text[: _LONGEST_SENTENCE + 1])
    return line if len(text) <= _LONGEST_SENTENCE else f"{line[:_LONGEST_SENTENCE]}..."


def shown(value: object) -> str:
    """Return the `repr` of a value for a message, truncated after 60 characters.

    >>> shown(-1.0), shown("a" * 1000)[-9:]
    ('-1.0', 'aaaaaa...')
    """
    if isinstance(value, str | bytes):
        value = value[: _LONGEST_VALUE + 1]
    try:
        text = printable(repr(value))
    except (ValueError, RecursionError):  # integers of more than 4300 digits
        text = f"a {type(value).__name__} too long to be written"
    return text if len(text) <= _LONGEST_VALUE else f"{text[:_LONGEST_VALUE]}..."
