"""Required clearance as a function of the pose, with a taper at the dock and a relief at the start."""

from __future__ import annotations

import dataclasses
import numbers
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidValue
from optdock.geometry.checked import non_negative, number

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.pose import Pose2

__all__ = ["ClearanceRule"]

# Slope at which the required clearance grows with the distance from a start that violates it: beyond the start or,
# under the weaker rule, beyond `DockingProblem.start_run`.
START_RELIEF_SLOPE = 0.5


# [m]: the weaker rule allows a clearance lower than that of the start by this amount, at most by half, to turn away
# from a wall. With it a robot of 0.9 m leaves a wall at 1 cm without a cusp.
START_SLACK = 0.005


@dataclass(frozen=True)
class ClearanceRule:
    """Required clearance of the footprint from the nearest obstacle, including the station.

    Args:
        required: Clearance away from the goal [m].
        at_dock: Clearance at the goal [m].
        taper: Distance over which the clearance grows linearly from `at_dock` to `required` [m].
        dock_run: Distance from the goal within which `at_dock` suffices [m]; the taper starts at this distance. A dock
            next to an obstacle needs such a distance, because a robot alongside a wall cannot turn away unless its tail
            or nose approaches the wall.
        at_start: Clearance at a start that violates `required`, such as a start in a dock [m]; the required clearance
            grows with the distance in the same way as from `at_dock`. If None, a robot at such a start may approach the
            obstacle by at most `START_SLACK`.

    Raises:
        InvalidValue: If a value is negative or not finite, or at_dock or at_start exceeds required.
    """

    required: float = 0.05
    at_dock: float = 0.0
    taper: float = 0.5
    dock_run: float = 0.0
    at_start: float | None = None

    @classmethod
    def of(cls, value: float | ClearanceRule, name: str = "clearance") -> ClearanceRule:
        """Return a rule unchanged; a number [m] gives the rule that requires it everywhere, including at the dock.

        Raises:
            InvalidValue: If the value is neither a rule nor a finite number >= 0.
        """
        if isinstance(value, cls):
            return value
        if isinstance(value, bool) or not isinstance(value, numbers.Real):
            raise InvalidValue(f"{name}: must be a ClearanceRule or one number [m], got {type(value).__name__}")
        same = number(value, name)
        return cls(same, same)

    def __post_init__(self) -> None:
        for name in ("required", "at_dock", "taper", "dock_run", *(("at_start",) if self.at_start is not None else ())):
            vars(self)[name] = non_negative(getattr(self, name), f"clearance.{name}", "m")
        for name, least in (("at_dock", self.at_dock), ("at_start", self.at_start)):
            if least is not None and least > self.required:
                raise InvalidValue(f"clearance.{name}: must be <= required = {self.required} m, got {least}")

    def required_at(
        self, from_goal: FloatArray, from_start: FloatArray, start_clearance: float, start_relief: float = 0.0
    ) -> FloatArray:
        """Return the required clearance, Shape (n,) [m].

        Args:
            from_goal: Distances of the poses from the goal position, Shape (n,) [m].
            from_start: Distances from the start position, Shape (n,) [m].
            start_clearance: Clearance of the start pose [m].
            start_relief: 0 for the strict rule; otherwise the distance [m] from the start within which the weaker rule
                requires at most the clearance of the start, e.g. for a robot alongside a wall.
        """
        return np.minimum(self.near_goal(from_goal), self.near_start(from_start, start_clearance, start_relief))

    def required_for(
        self, poses: FloatArray, goal: Pose2, start: Pose2, start_clearance: float, start_relief: float = 0.0
    ) -> FloatArray:
        """Return the required clearance of poses, Shape (n,) [m].

        Args:
            poses: Shape (n, 3).
            goal: The goal.
            start: Pose at which the path begins.
            start_clearance: As in `required_at`.
            start_relief: As in `required_at`.
        """
        from_goal, from_start = (np.hypot(poses[:, 0] - end.x, poses[:, 1] - end.y) for end in (goal, start))
        return self.required_at(from_goal, from_start, start_clearance, start_relief)

    def near_goal(self, from_goal: FloatArray) -> FloatArray:
        """Return the required clearance at distances from the goal, regardless of the start, Shape (n,) [m]."""
        return self._tapered(from_goal, self.at_dock)

    def near_start(self, from_start: FloatArray, start_clearance: float, start_relief: float = 0.0) -> FloatArray:
        """Return the clearance required at distances from a start that is too close, Shape (n,) [m]."""
        leaving = self.leaving(from_start, start_clearance, start_relief)
        return np.minimum(leaving, self.undocking(from_start)) if start_relief > 0.0 else leaving

    @staticmethod
    def leaving(from_start: FloatArray, start_clearance: float, start_relief: float = 0.0) -> FloatArray:
        """Return a requirement that grows from the start clearance, or from a lower value beyond `start_relief`."""
        least = ClearanceRule.least_leaving(start_clearance, start_relief)
        return least + START_RELIEF_SLOPE * np.maximum(0.0, from_start - start_relief)

    @staticmethod
    def least_leaving(start_clearance: float, start_relief: float = 0.0) -> float:
        """Return the smallest requirement of `leaving` [m], which is that at the start."""
        kept = max(0.0, start_clearance)
        return kept if start_relief == 0.0 else _relieved(kept)

    def undocking(self, from_start: FloatArray) -> FloatArray:
        """Return the clearance required by `at_start` at distances from the start, Shape (n,) [m]; inf if None."""
        return np.full_like(from_start, np.inf) if self.at_start is None else self._tapered(from_start, self.at_start)

    def _tapered(self, distance: FloatArray, least: float) -> FloatArray:
        beyond = np.maximum(distance - self.dock_run, 0.0)
        share = np.minimum(beyond, self.taper) / self.taper if self.taper > 0.0 else np.where(beyond > 0.0, 1.0, 0.0)
        wanted: FloatArray = least + (self.required - least) * share
        return wanted

    def raised(self, more: float) -> ClearanceRule:
        """Return the rule that requires `more` [m] of additional clearance everywhere, for use with `raised_start`.

        Raises:
            InvalidValue: If the requirement becomes negative.
        """
        least = None if self.at_start is None else self.at_start + more
        return dataclasses.replace(self, required=self.required + more, at_dock=self.at_dock + more, at_start=least)

    @staticmethod
    def raised_start(more: float, start_clearance: float, start_relief: float = 0.0) -> float:
        """Return the start clearance for which `leaving` requires `more` [m] in addition to `start_clearance`."""
        kept = max(0.0, start_clearance)
        if start_relief == 0.0:
            return kept + more
        least = _relieved(kept) + more
        return min(least + START_SLACK, 2.0 * least)  # inverse of `_relieved`

    @property
    def parts(self) -> tuple[float, ...]:
        """Numbers that enter the digest.

        Parameters that were added later enter the digest only if they are set, so digests of earlier versions stay
        valid.
        """
        least = () if self.at_start is None else (self.at_start,)
        return self.required, self.at_dock, self.taper, *((self.dock_run, *least) if self.dock_run or least else ())


def _relieved(kept: float) -> float:
    """Return the clearance that the weaker rule requires near a start with the clearance `kept` [m]."""
    return max(kept - START_SLACK, 0.5 * kept)
