"""Plan from a scenario file with a map, and read the certificates."""

from pathlib import Path

import optdock as od

scenario = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml")
plan = od.plan_dock(scenario.problem, time_budget=scenario.time_budget)
print(plan)

proof = plan.certificate
print(f"closest {proof.min_clearance:.3f} m to {proof.nearest}, {proof.required_clearance:.3f} m required there")
print(f"curvature at most {proof.max_curvature:.2f} 1/m of {scenario.problem.robot.limits.max_curvature:.2f} 1/m")

print("used of each motion limit:")
for name, ratio in plan.trajectory_certificate.ratios.items():
    print(f"  {name:22} {100 * ratio:5.1f} %")

plan.save("results/bay.json")
again = od.DockPlan.load("results/bay.json", scenario.problem)  # certified again; the claims in the file are ignored
print("read back and proven again:", again.certificate.certified and again.trajectory_certificate.certified)
