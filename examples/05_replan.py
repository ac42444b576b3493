"""Replan in motion: from where the robot is now, at its speed and curvature, with the earlier plan as a warm start."""

from pathlib import Path

import optdock as od

problem = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml").problem
plan = od.plan_dock(problem, time_budget=1.0)
print("first: ", plan)

now = plan.trajectory.at(4.0)  # what localization and odometry would say
here = problem.starting_at(now.pose, speed=now.twist.linear, curvature=plan.path.curvature_at(now.s)[0])
again = od.plan_dock(here, time_budget=1.0, warm_start=plan)
print("again: ", again)
print(
    f"left of the first plan: {plan.trajectory.duration - 4.0:.2f} s, of the new one: {again.trajectory.duration:.2f} s"
)
