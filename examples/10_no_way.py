"""Prove that a gap is too narrow, read the bottleneck, and verify the proof with an independent checker."""

import optdock as od

robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
room = [
    [(-0.2, -0.2), (5.4, -0.2), (5.4, 0.0), (-0.2, 0.0)],
    [(-0.2, 3.2), (5.4, 3.2), (5.4, 3.4), (-0.2, 3.4)],
    [(-0.2, 0.0), (0.0, 0.0), (0.0, 3.2), (-0.2, 3.2)],
    [(5.2, 0.0), (5.4, 0.0), (5.4, 3.2), (5.2, 3.2)],
]
gap = 0.65  # 5 cm wider than the robot, but 5 cm are required on either side
wall = [[(2.5, 0.0), (2.7, 0.0), (2.7, 1.3), (2.5, 1.3)], [(2.5, 1.3 + gap), (2.7, 1.3 + gap), (2.7, 3.2), (2.5, 3.2)]]
dock = od.Dock(od.Pose2(4.2, 1.6, 0.0), final_straight=0.3)
problem = od.DockingProblem(od.Pose2(1.0, 1.0, 0.3), dock, robot, obstacles=room + wall, clearance=0.05)

try:
    od.plan_dock(problem, time_budget=5.0)
except od.NoMotionExists as why:
    print(f"{type(why).__name__} (code {why.code}): {why}")
    tight = why.proof.bottleneck
    print(f"missing {tight.missing_width:.3f} m at ({tight.x:.2f}, {tight.y:.2f}); the body fits: {tight.body_fits}")
    verdict = od.check_impossibility(why.proof, problem)  # by independent code
    print(f"the proof holds: {verdict.proven}, judged by {verdict.cells} cells around the goal")
    print(f"found in {why.partial.timing_ms['prove']:.0f} ms, after {len(why.partial.tried)} guesses in vain")
