"""Files that appear whole or not at all."""

from __future__ import annotations

import os
import secrets
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.errors import InvalidFile

if TYPE_CHECKING:
    from collections.abc import Iterator

__all__ = ["replacing", "write_text"]


@contextmanager
def replacing(target: Path) -> Iterator[Path]:
    """A temporary path beside `target` that takes its place when the block ends without an exception.

    A reader of `target` sees the old file or the new one, never a part. Missing folders are made. The temporary name
    keeps the suffix of the target, because writers of pictures choose their format by it.

    Raises:
        InvalidFile: The folder cannot be made or written to.
    """
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, target)  # noqa: PTH105 - the atomic replacement, by its well-known name
    except OSError as error:
        raise InvalidFile(f"{target}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_text(target: Path, text: str) -> None:
    """Write `text` as UTF-8, whole or not at all.

    Raises:
        InvalidFile: The folder cannot be made or written to.
    """
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
