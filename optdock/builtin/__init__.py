"""The built-in scenario: a hall drawn for this project, a shelf and a pillar in the way, a dock at the far wall."""

from __future__ import annotations

from pathlib import Path

__all__ = ["demo_scenario"]


def demo_scenario() -> Path:
    """The scenario's file; its map lies beside it."""
    return Path(__file__).with_name("hall.yaml")
