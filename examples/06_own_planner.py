"""Write a planner plugin: any class with `create_plan`. Smoother, certificate and timing are unchanged."""

import math
from itertools import pairwise
from pathlib import Path

from pydantic import Field

import optdock as od
from optdock.plugins.interfaces import GlobalPlanner
from optdock.plugins.parameters import PluginParameters


class ViaPointsParameters(PluginParameters):
    """Parameters of `ViaPoints`."""

    points: list[tuple[float, float]] = Field([], description="via points, in order [m]")


class ViaPoints(GlobalPlanner):
    """Straight lines from the start through given positions to the goal."""

    Parameters = ViaPointsParameters

    def create_plan(self, start, goal, cancel_checker=lambda: False):
        """Return a raw path; its corners are smoothed by the smoother."""
        corners = [(start.x, start.y), *self.parameters.points, (goal.x, goal.y)]
        lines = [(a, math.atan2(b[1] - a[1], b[0] - a[0])) for a, b in pairwise(corners)]
        return od.Path.from_poses([start, *((*a, heading) for a, heading in lines[1:]), goal])


problem = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml").problem
plan = od.plan_dock(problem, time_budget=1.0, planner=ViaPoints(points=[(2.4, 2.4), (5.0, 2.5), (6.2, 2.25)]))
print(plan)
print(f"raw path {plan.raw_path.length:.2f} m, smoothed {plan.path.length:.2f} m")
