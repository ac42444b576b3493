"""Atomic writing of files."""

from __future__ import annotations

import errno
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
def replacing(target: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the folder of `target`; the file replaces `target` if the block raises no exception.

    Missing folders are created and links are followed. For a device or a pipe, such as /dev/stdout, the path is
    `target` itself. The temporary path has the suffix of the target, because the suffix selects the format of pictures.

    Raises:
        InvalidFile: If the target is a folder, or its folder cannot be created or written to.
    """
    target = Path(target)
    try:
        if target.exists() and not (target.is_file() or target.is_dir()):
            yield target
            return
        with _beside(Path(os.path.realpath(target))) as temporary:
            yield temporary
    except OSError as error:
        raise InvalidFile(f"{target}: cannot be written: {error.strerror or error}") from error


@contextmanager
def _beside(target: Path) -> Iterator[Path]:
    """Yield the temporary path of a regular file."""
    if target.is_dir():
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
    if target.parent.exists() and not target.parent.is_dir():
        raise NotADirectoryError(errno.ENOTDIR, f"{target.parent.name} is a file, not a folder")
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}{target.suffix}")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        os.replace(temporary, target)  # noqa: PTH105 - the atomic replacement
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_text(target: str | Path, text: str) -> None:
    """Write `text` as UTF-8 atomically.

    Raises:
        InvalidFile: If the folder cannot be created or written to.
    """
    with replacing(target) as temporary:
        temporary.write_text(text, encoding="utf-8")
