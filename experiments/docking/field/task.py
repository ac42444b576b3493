"""Task of the field study."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["FieldTask"]


class FieldTask(NamedTuple):
    """One docking in the field world, given by names so that any process can run it; `seed` seeds everything."""

    method: str
    world: str
    spread: str
    rate: float
    seed: int
