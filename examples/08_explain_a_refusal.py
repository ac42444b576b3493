"""Inspect a refusal and its partial results, and the violations of a path from another source."""

from pathlib import Path

import numpy as np

import optdock as od

data = Path(__file__).parent / "data"
problem = od.load_scenario(data / "bay.yaml").problem
too_near = problem.starting_at(od.Pose2(5.9, 2.6, 0.0))  # 1.1 m before the dock, 0.35 m aside
try:
    print(od.plan_dock(too_near, planner="DockPlanner", time_budget=2.0))
except od.FailedToSmoothPath as why:
    print(f"{type(why).__name__} (code {why.code}): {why}")
    print(f"reason {why.where['reason']}, s = {why.where['s']:.2f} m, off by {why.where['amount']:.2f} m")
    print("what exists:", why.partial)
print("with the search, which goes on where one guess fails:", od.plan_dock(too_near))

poses = np.loadtxt(data / "waypoints.csv", delimiter=",", skiprows=1)
verdict = od.certify_path(od.Path.from_poses(poses, frame="map"), problem)
print("a path from elsewhere is", "certified" if verdict.certified else "refused:")
for broken in verdict.violations:
    print(f"  {broken.kind:14} s = {broken.s:.2f} m  {broken.message}")
