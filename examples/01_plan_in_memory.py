"""Plan one docking from values in memory: robot, dock, obstacles; print it, save it, draw it, replan from elsewhere."""

import optdock as od

robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
dock = od.Dock(od.Pose2(4.0, 1.0, 0.0), final_straight=0.3, approach_speed=0.1, approach_distance=0.3)
pallet = [(1, 2), (3, 2), (3, 2.4), (1, 2.4)]
problem = od.DockingProblem(od.Pose2(1.0, 0.2, 0.4), dock, robot, obstacles=[pallet], clearance=0.05)

try:
    plan = od.plan_dock(problem, time_budget=1.0)
except od.OptdockError as why:
    raise SystemExit(f"{type(why).__name__} {why.code}: {why}\n{why.where}") from why

print(plan)
plan.save("results/plan.json")
plan.plot("results/plan.png")

times, poses, twists = plan.trajectory.sampled(0.02)  # (n,) s, (n, 3) m and rad, (n, 2) m/s and rad/s
print(f"{len(times)} samples, from {poses[0].round(2)} to {poses[-1].round(2)}, at most {twists[:, 0].max():.2f} m/s")
