"""One docking in the field world, by names."""

from __future__ import annotations

from typing import NamedTuple

__all__ = ["FieldTask"]


class FieldTask(NamedTuple):
    """One docking to be driven, by names, so that any process can; `seed` draws everything in it."""

    method: str
    world: str
    spread: str
    rate: float
    seed: int
