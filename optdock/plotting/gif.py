"""Animated GIFs: how many pictures a drive takes, and how they are written."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from optdock.io.atomic_file import replacing

if TYPE_CHECKING:
    from pathlib import Path

    from PIL.Image import Image

__all__ = ["frame_count", "save_gif"]

_FRAME_TIME = 0.1  # [s]
_MOST_FRAMES = 150
_HOLD = 1500  # [ms] on the last frame


def frame_count(duration: float) -> int:
    """How many pictures show so many seconds: ten a second, fewer where that would be too many."""
    return min(max(math.ceil(duration / _FRAME_TIME), 2), _MOST_FRAMES)


def save_gif(target: str | Path, frames: list[Image], duration: float) -> None:
    """Write pictures of so many seconds, at least ten a second, again and again; the last one stays for a while.

    Raises:
        InvalidFile: The file cannot be written.
    """
    step = int(1e3 * min(duration / len(frames), _FRAME_TIME))
    with replacing(target) as temporary:
        frames[0].save(
            temporary,
            format="GIF",
            save_all=True,
            append_images=frames[1:],
            duration=[step] * (len(frames) - 1) + [_HOLD],
            loop=0,
            disposal=1,
        )
