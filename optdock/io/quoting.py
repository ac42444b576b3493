"""Quoting of values in messages: on one line, printable and short.

Text from files may contain control characters, be very long, or be confidential.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["in_digits", "listed", "printable", "shortened", "shown"]

_LONGEST_VALUE = 60  # characters of a value in a message
_LONGEST_NUMBER = 9  # characters of a number that is written with all its digits
_LONGEST_SENTENCE = 300  # characters of a message of another library
_MAX_FAULTS = 20  # that a message lists


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


def in_digits(value: object) -> str:
    """Return a value as text, in which long numbers have six significant digits, 1e-4 m below 100 m.

    The numbers of lists and mappings are written in the same way; other values as by `str`.

    >>> in_digits(-0.43000000000000016), in_digits(0.25), in_digits([1 / 3, 2]), in_digits({"s": 1e-7 / 3})
    ('-0.43', '0.25', '[0.333333, 2]', '{s: 3.33333e-08}')
    >>> in_digits(1732622400.123)
    '1732622400.123'
    """
    if isinstance(value, float):
        digits = repr(value)
        many = f"{value:.3f}" if 1e5 <= abs(value) < 1e15 else f"{value:.6g}"
        return digits if len(digits) <= _LONGEST_NUMBER else many
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {in_digits(one)}' for key, one in value.items())}}}"
    return f"[{', '.join(map(in_digits, value))}]" if isinstance(value, list | tuple) else str(value)


def listed(source: str, lines: Sequence[str]) -> str:
    """Join the lines of a message; beyond twenty lines, only the number of the remaining lines is given.

    Args:
        source: Name of the file for the last line.
        lines: One line per fault.
    """
    if len(lines) <= _MAX_FAULTS:
        return "\n".join(lines)
    return "\n".join([*lines[:_MAX_FAULTS], f"{source}: and {len(lines) - _MAX_FAULTS} more faults"])
