"""Add your own constraint and cost to the smoother, as CasADi expressions of a point of the path."""

from pathlib import Path

import casadi

import optdock as od
from smoothers import CasadiSmoother, HardTerm, SoftTerm

problem = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml").problem
free = od.plan_dock(problem, time_budget=1.0)


def below(p):
    """Return the distance to a horizontal line that must not be crossed."""
    return p.line - p.y


def straight_there(p):
    """Return the curvature within 1 m of a point, where the robot should drive straight."""
    return p.curvature * (casadi.sqrt((p.x - 3.5) ** 2 + (p.y - 2.0) ** 2) < 1.0)


highest = float(free.path.sample(0.01).y.max())
smoother = CasadiSmoother(
    terms=[HardTerm("below", below, line=highest - 0.01), SoftTerm("straight", straight_there, weight=2.0)]
)
plan = od.plan_dock(problem, smoother=smoother, time_budget=1.0)
print(plan)
print(f"highest point: {highest:.3f} m, with the terms {float(plan.path.sample(0.01).y.max()):.3f} m")
print(plan.smoothing_report.sampled[0])  # sampled, not proven
