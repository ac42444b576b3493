"""Plan from behind the dock: around the station and a rack, with cusps if there is no room to turn."""

import optdock as od

robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
station = od.Footprint([(0.47, -0.4), (0.65, -0.4), (0.65, 0.4), (0.47, 0.4)])  # in the frame of the docked robot
dock = od.Dock(
    od.Pose2(4.0, 1.0, 0.0), station, final_straight=0.3, approach_speed=0.1, approach_distance=0.3, direction="forward"
)
racks = [
    [(2.0, 2.2), (7.0, 2.2), (7.0, 2.6), (2.0, 2.6)],
    [(1.2, -1.2), (4.6, -1.2), (4.6, -0.8), (1.2, -0.8)],
    [(0.6, -1.2), (1.0, -1.2), (1.0, 2.6), (0.6, 2.6)],
]
behind = od.Pose2(6.0, 0.9, 0.2)
problem = od.DockingProblem(behind, dock, robot, obstacles=racks, clearance=od.ClearanceRule(0.05, at_dock=0.0))

plan = od.plan_dock(problem)  # the default budget, 1 s, is for difficult problems; most calls need a fraction of it
print(plan)
print(f"found by: {plan.stage}; {len(plan.path.cusps)} cusps, price {plan.price:.1f} s")
for attempt in plan.tried:  # all guesses with their results
    print(" ", attempt)
plan.plot("results/from_behind_the_dock.png")
