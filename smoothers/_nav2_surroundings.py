"""What Nav2's geometric smoothers must not make worse: how their poses clear everything that is known around them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from optdock.errors import InvalidPath
from optdock.path import Path
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from optdock.costmap.costmap import Costmap
    from optdock.geometry.arrays import FloatArray
    from optdock.geometry.footprint import Footprint
    from optdock.lifecycle import PluginContext
    from optdock.obstacles import ObstacleSet
    from optdock.problem import DockingProblem

__all__ = ["Surroundings", "task_of"]

_TOLERANCE = 1e-6  # [m]: as the certificate's
_MARGIN = 0.5  # [m]: how far beside a path its smoothed form may run and still be judged among all obstacles


@dataclass(frozen=True, eq=False)
class Surroundings:
    """What stands around a path.

    Args:
        costmap: The grid whose cells stop a point, or None.
        footprint: The robot's outline; None where nobody said.
        obstacles: Everything near the path that the robot must not touch.
    """

    costmap: Costmap | None
    footprint: Footprint | None
    obstacles: ObstacleSet | None

    def worsened(self, before: FloatArray, after: FloatArray) -> bool:
        """Whether the poses `after` touch something deeper than the poses `before` do; Shape (n, 3) each.

        Judged at the poses, as Nav2's smoother server does with `check_for_collisions`, but with the whole footprint.
        """
        if self.footprint is None or self.obstacles is None:
            return False
        deepest = [
            float(pose_clearances(poses, self.footprint, self.obstacles, within=0.0)[0].min())
            for poses in (before, after)
        ]
        return deepest[1] < deepest[0] - _TOLERANCE


def task_of(path: Path, problem: DockingProblem | None, context: PluginContext) -> tuple[Path, Surroundings]:
    """The path, in the frame of the problem at hand, and what stands around it.

    Raises:
        InvalidPath: It is no path, or one in another frame.
    """
    if not isinstance(path, Path):
        raise InvalidPath(f"path: must be a Path, got {type(path).__name__}")
    wanted = context.problem_at_hand(problem)
    footprint = context.footprint if wanted is None else wanted.robot.footprint
    if footprint is None:
        return path, Surroundings(context.costmap, None, None)
    points = path.sample(0.5).poses[:, :2]
    reach = footprint.circumscribed_radius + 0.5 + _MARGIN
    lower, upper = points.min(axis=0) - reach, points.max(axis=0) + reach
    if wanted is None:
        return path, Surroundings(context.costmap, footprint, context.obstacles_near(lower, upper))
    near = wanted.all_obstacles.in_box(np.asarray(lower), np.asarray(upper))
    return path.with_frame(wanted.frame), Surroundings(wanted.costmap, footprint, near)
