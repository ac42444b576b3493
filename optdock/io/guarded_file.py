"""Reading of regular files of bounded size; all files of the library are read through this module.

Pipes, devices and files of gigabytes raise `InvalidFile` before the read blocks or allocates memory. With the size
limits, reading takes less than one second and 500 MB on an onboard computer; the limits are many times the sizes that
occur in practice.
"""

from __future__ import annotations

import errno
import json
import math
import os
import re
import stat
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path
from typing import TYPE_CHECKING, NoReturn

from optdock.errors import InvalidFile
from optdock.io.quoting import printable, shown

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["MostBytes", "check_json_size", "check_regular", "is_regular", "parse_json", "read_bytes", "read_text"]


class MostBytes(IntEnum):
    """Size limits [bytes] for each kind of file."""

    YAML = 4_000_000  # a Nav2 parameter file with comments has 30 kB; `yaml_lines` bounds the expanded size
    JSON = 32_000_000  # a plan of 50,000 samples has 22 MB, see `plan_file.MAX_SAMPLES`
    CSV = 200_000  # the largest case of the competition has 10 kB
    LOG = 64_000_000  # a docking of a minute has 1 MB, with a costmap in every cycle 10
    OUTCOMES = 2_000_000_000  # a hundred thousand outcomes of 1 kB have 100 MB
    IMAGE = 80_000_000  # a map of `map_image.MAX_PIXELS` as raw grey values of 16 bit has 67 MB
    RECORDING = 1_000_000_000_000  # only the index and the requested topics of a bag are read


# JSON values, counted by separators. A plan of 50,000 samples has 1.1 million numbers; two million take 150 MB. An
# object takes as much memory as ten numbers.
_MOST_JSON_VALUES = 2_000_000
_HALF_CHARACTER = re.compile(r"\\u[dD][89a-fA-F]")
_LONGEST_NAME = 200  # characters of a file's name in a message

_KINDS = (
    (stat.S_ISDIR, "Is a directory"),
    (stat.S_ISFIFO, "is a pipe, not a regular file"),
    (stat.S_ISCHR, "is a device, not a regular file"),
    (stat.S_ISBLK, "is a device, not a regular file"),
    (stat.S_ISSOCK, "is a socket, not a regular file"),
)


def is_regular(path: Path) -> bool:
    """Whether the path is a regular file."""
    try:
        return stat.S_ISREG(path.stat().st_mode)
    except (OSError, ValueError):
        return False


def check_regular(path: Path, most: int) -> None:
    """Check that a file is regular and not too large, for libraries that open files by name.

    Args:
        path: The file.
        most: Largest size [bytes], see `MostBytes`.

    Raises:
        InvalidFile: If the file is missing, not regular, or larger than `most`.
    """
    with _named_errors(path):
        _check(path, path.stat(), most)


def read_bytes(path: Path, most: int) -> bytes:
    """Return the content of a regular file.

    Args:
        path: The file.
        most: Largest size [bytes], see `MostBytes`.

    Raises:
        InvalidFile: If the file cannot be read, is not regular, or is larger than `most`.
    """
    with _named_errors(path):
        # Opening a device may have side effects and opening a pipe blocks, so the path is checked first. The opened
        # file is checked again, because the path may have changed in between.
        _check(path, path.stat(), most)
        with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC | os.O_NOCTTY), "rb") as stream:
            _check(path, os.fstat(stream.fileno()), most)
            content = stream.read(most + 1)  # kernel files report size 0, and other files may grow
        if content is None:  # the file would block
            raise BlockingIOError(errno.EAGAIN, os.strerror(errno.EAGAIN))
        _check_size(path, len(content), most)
        return content


def read_text(path: Path, most: int) -> str:
    """Return the content of a regular UTF-8 text file, without byte order mark.

    Args:
        path: The file.
        most: Largest size [bytes], see `MostBytes`.

    Raises:
        InvalidFile: If the file cannot be read, is not regular, is larger than `most`, or is not UTF-8.
    """
    content = read_bytes(path, most)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        utf16 = "; it looks like UTF-16" if content[:2] in (b"\xff\xfe", b"\xfe\xff") else ""
        where = f"byte {error.start}: {error.reason}{utf16}"
        raise InvalidFile(f"{_name(path)}: cannot be read as UTF-8 text: {where}") from None


def parse_json(text: str) -> object:
    """Return the value of a strict JSON text.

    Raises:
        ValueError: If the text is not JSON (`json.JSONDecodeError`), has a repeated key, an unpaired surrogate escape,
            a number that is not finite or has too many digits, is nested too deeply, or has more than two million
            values.
    """
    check_json_size(text)
    try:
        value = json.loads(
            text, parse_constant=_refuse_constant, parse_float=_finite, object_pairs_hook=_without_repeated_keys
        )
    except RecursionError:
        raise ValueError("is nested too deeply") from None
    if _HALF_CHARACTER.search(text):  # such text cannot be encoded
        try:
            json.dumps(value, ensure_ascii=False).encode()
        except UnicodeEncodeError:
            raise ValueError(
                "contains an unpaired surrogate: an escape \\ud800 to \\udfff without its counterpart"
            ) from None
    return value


def check_json_size(text: str, most: int = _MOST_JSON_VALUES) -> None:
    """Check the number of values of a JSON text before it is parsed.

    Args:
        text: The JSON text.
        most: Largest number of values; a tenth of them may be objects.

    Raises:
        ValueError: If the text has more values or objects.
    """
    begins = text.count(",") + text.count("[") + text.count("{")
    if begins > most or text.count("{") > most // 10:
        raise ValueError(f"holds more than {most} values or {most // 10} objects")


def _without_repeated_keys(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return an object; repeated keys are rejected, because parsers differ in the value that they keep."""
    found: dict[str, object] = {}
    for key, value in pairs:
        if key in found:
            raise ValueError(f"key {shown(key)} is repeated in one object")
        found[key] = value
    return found


def _refuse_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not JSON; numbers must be finite")


def _finite(digits: str) -> float:
    value = float(digits)
    if not math.isfinite(value):
        raise ValueError(f"{digits[:20]} is too large; numbers must be finite")
    return value


@contextmanager
def _named_errors(path: Path) -> Iterator[None]:
    """Convert errors of the operating system to `InvalidFile` with the name of the file."""
    try:
        yield
    except OSError as error:
        raise InvalidFile(f"{_name(path)}: cannot be read: {error.strerror or error}") from None
    except ValueError as error:  # a path with a null byte
        raise InvalidFile(f"{_name(path)}: cannot be read: {error}") from None


def _check(path: Path, found: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        kind = next((words for is_kind, words in _KINDS if is_kind(found.st_mode)), "is not a regular file")
        raise InvalidFile(f"{_name(path)}: cannot be read: {kind}")
    _check_size(path, found.st_size, most)


def _check_size(path: Path, size: int, most: int) -> None:
    if size > most:
        raise InvalidFile(f"{_name(path)}: cannot be read: has more than the {most} bytes that such a file may have")


def _name(path: Path) -> str:
    """Return the name of a file on one line; a long name is reduced to its end."""
    text = printable(str(path))
    return text if len(text) <= _LONGEST_NAME else f"...{text[-_LONGEST_NAME:]}"
