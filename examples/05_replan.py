"""Replan in motion: the dock is detected at another pose, and a new plan takes over continuously."""

from pathlib import Path

import optdock as od

problem = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml").problem
plan = od.plan_dock(problem, time_budget=1.0)
print("first:", plan)

now = od.DriveState(time=4.0)  # the controller's `progress`, with the measured pose if available
seen = problem.goal @ od.Pose2(0.01, 0.02, 0.02)  # 1 cm deeper, 2 cm to the left, 1.1 degrees turned
print("the way still holds:", od.still_holds(plan, problem, from_time=now.time).holds)

again = od.replan(plan, seen, now, time_budget=0.2)  # 0.02 by default, for an idle machine
print(f"{again.outcome.value}: {again.plan or again.reason}")

before, after = plan.trajectory.at(again.starts_at), again.trajectory.at(0.0)
print(f"it takes over at {again.starts_at:.2f} s, where both have the same pose, speed and acceleration:")
print(f"  {before.pose} {before.twist.linear:.6f} m/s {before.acceleration:.6f} m/s^2")
print(f"  {after.pose} {after.twist.linear:.6f} m/s {after.acceleration:.6f} m/s^2")
left = plan.trajectory.duration - again.starts_at
print(f"left of the first plan: {left:.2f} s, of the new one: {again.trajectory.duration:.2f} s")
