"""The position part that Simple, Position and Stopped share: a radius with a latch and a hysteresis buffer."""

from __future__ import annotations

from pydantic import Field

from optdock.parameters import PluginParameters

__all__ = ["PositionLatch", "PositionParameters"]


class PositionParameters(PluginParameters):
    """Nav2's parameters of the position check."""

    xy_goal_tolerance: float = Field(default=0.25, ge=0.0, description="accepted distance [m]")
    path_length_tolerance: float = Field(default=1.0, ge=0.0, description="longer remaining paths are not judged [m]")
    stateful: bool = Field(default=True, description="a position once accepted stays accepted until reset")
    xy_goal_tolerance_buffer: float = Field(default=0.0, ge=0.0, description="drift that ends the acceptance [m]")


class PositionLatch:
    """Remembers that the position was accepted."""

    def __init__(self) -> None:
        self._accepted = False

    def reset(self) -> None:
        """Forget it."""
        self._accepted = False

    def accepts(self, distance: float, parameters: PositionParameters) -> bool:
        """Whether the position at `distance` [m] from the goal counts as reached.

        A latched position stays reached until, with a buffer, it drifts beyond tolerance + buffer.
        """
        p = parameters
        if self._accepted and p.stateful:
            drifted = p.xy_goal_tolerance_buffer > 0.0 and distance > p.xy_goal_tolerance + p.xy_goal_tolerance_buffer
            self._accepted = not drifted
            return self._accepted
        inside = distance <= p.xy_goal_tolerance
        self._accepted = inside and p.stateful
        return inside
