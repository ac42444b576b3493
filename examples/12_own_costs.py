"""Add your own constraint and cost to the smoother, as CasADi expressions of a point of the path."""

import casadi

import optdock as od
from smoothers import CasadiSmoother, HardTerm, SoftTerm

robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
dock = od.Dock(od.Pose2(4.0, 1.0, 0.0), final_straight=0.3)
problem = od.DockingProblem(od.Pose2(0.0, 0.0, 0.0), dock, robot)
free = od.plan_dock(problem, time_budget=1.0)


def below(p):
    """Return the distance to a line that must not be crossed."""
    return p.offset + 0.25 * p.x - p.y


def bent(p):
    """Return the curvature within 1 m of a point, where the robot should drive straight."""
    return p.curvature * casadi.fmax(0, 1 - casadi.sqrt((p.x - 2) ** 2 + (p.y - 0.5) ** 2 + 1e-6))


terms = [HardTerm("below the line", below, offset=0.15), SoftTerm("straight there", bent, weight=2.0)]
plan = od.plan_dock(problem, smoother=CasadiSmoother(terms=terms), time_budget=1.0)
for name, path in (("without", free.path), ("with", plan.path)):
    x, y = path.sample(0.01).x, path.sample(0.01).y
    print(f"{name} terms: at least {float((0.15 + 0.25 * x - y).min()):.3f} m below the line")
print(plan.smoothing_report.sampled[0])  # sampled, not proven
