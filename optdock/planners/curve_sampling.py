"""Poses along a NURBS curve, close enough together, and the costmap under them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import NoValidPathCouldBeFound, PlannerCancelled
from optdock.geometry.nurbs import Nurbs
from optdock.path import Direction

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray

__all__ = ["MAX_SAMPLES", "CurveSampler"]

MAX_SAMPLES = 200_000  # of one curve; a path of 1 km at 5 mm
_CHUNK = 5_000  # samples between two looks at the cancel checker, about 2 ms


@dataclass(frozen=True, eq=False)
class CurveSampler:
    """Samples curves through control points.

    Args:
        degree: NURBS degree.
        step: Coarsest step of u.
        resolution: Largest distance of neighbouring poses [m].
        costmap: Where every sample must be free, or None to check nothing.
        cost_threshold: A cost at or above this blocks.
        cancel_checker: Polled while sampling.
    """

    degree: int
    step: float
    resolution: float
    costmap: Costmap | None
    cost_threshold: int
    cancel_checker: Callable[[], bool]

    def poses(self, control_points: FloatArray, direction: Direction, name: str) -> FloatArray:
        """Poses from u = 0 to 1, yaw along the tangent, or against it in reverse.

        Neighbours are at most `resolution` apart: the step of u is `resolution / max |dC/du|`. The source takes the
        mean of |dC/du|, the length, and so spaces poses up to twice too far where the curve is fast. As in the source
        the last pose takes the yaw of the one before it. Samples that are not finite are skipped.

        Args:
            control_points: Shape (n, 2) [m], n > degree; unit weights.
            direction: Gear.
            name: What to call the curve in a message.

        Returns:
            Shape (m, 3) [m, m, rad], m >= 2.

        Raises:
            NoValidPathCouldBeFound: A sample is blocked, too few are finite, or it would take over MAX_SAMPLES.
            PlannerCancelled: The cancel checker returned True.
        """
        curve = Nurbs(control_points, degree=self.degree)
        u = np.linspace(0.0, 1.0, self._count(curve, name) + 1, dtype=np.float64)
        chunks = [self._chunk(curve, u[i : i + _CHUNK], direction, name) for i in range(0, u.size, _CHUNK)]
        found = np.concatenate(chunks)
        if len(found) < 2:
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} is empty: only {len(found)} of {u.size} samples are finite; its control points "
                f"are {control_points.tolist()}",
                where={"step": name, "control_points": control_points.tolist()},
            )
        found[-1, 2] = found[-2, 2]
        return found

    def _count(self, curve: Nurbs, name: str) -> int:
        steps = max(curve.speed_bound / self.resolution, (1.0 - 1e-6) / self.step)
        if not steps <= MAX_SAMPLES:
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} would take {steps:.3g} samples, at most {MAX_SAMPLES}: its control points span "
                f"{np.ptp(curve.control_points, axis=0).max():.6g} m at a resolution of {self.resolution:.6g} m; start "
                "nearer",
                where={"step": name, "samples": steps, "resolution": self.resolution},
            )
        return math.ceil(steps * (1.0 + 1e-9))  # rounding must not lift a spacing above the resolution

    def _chunk(self, curve: Nurbs, u: FloatArray, direction: Direction, name: str) -> FloatArray:
        if self.cancel_checker():
            raise PlannerCancelled(f"dock planner: cancelled while sampling {name}")
        points = curve.points_at(u)
        self._check_free(points, name)
        yaw = curve.tangent_yaw_at(u) + (math.pi if direction is Direction.REVERSE else 0.0)
        poses = np.column_stack((points, yaw))
        return poses[np.all(np.isfinite(poses), axis=1)]

    def _check_free(self, points: FloatArray, name: str) -> None:
        if self.costmap is None:
            return
        costs = self.costmap.cost_at(points)
        blocked = np.flatnonzero(costs >= self.cost_threshold)
        if blocked.size:
            x, y = (float(value) for value in points[blocked[0]])
            cost = int(costs[blocked[0]])
            raise NoValidPathCouldBeFound(
                f"dock planner: {name} is blocked at ({x:.3f}, {y:.3f}): cost {cost} there, must be < cost_threshold "
                f"= {self.cost_threshold}",
                where={"step": name, "x": x, "y": y, "cost": cost, "cost_threshold": self.cost_threshold},
            )
