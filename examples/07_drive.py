"""Drive a plan in closed loop: a controller, a goal checker, and a robot with latency, lag and localization noise."""

from pathlib import Path

import optdock as od
from optdock.simulation import Actuation, SimulationSettings, run_closed_loop

problem = od.load_scenario(Path(__file__).parent / "data" / "bay.yaml").problem
plan = od.plan_dock(problem, time_budget=1.0)

controller = od.TrackingController()
controller.configure(od.PluginContext(problem=problem))  # required for obstacles; plans of other problems are refused
checker = od.AxisGoalChecker(along_path_tolerance=0.02, cross_track_tolerance=0.02, stopped=True)
world = SimulationSettings(
    actuation=Actuation(linear_lag=0.06, angular_lag=0.06, latency=0.04),
    position_noise=0.001,
    yaw_noise=0.001,
    seed=3,
    obstacles=problem.all_obstacles,
)
run = run_closed_loop(plan.trajectory, problem.robot, problem.goal, controller, checker, world)

print("docked" if run.docked else f"not docked: {run.reason}", f"after {run.times[-1]:.2f} s")
error = run.final_error
print(f"at the dock: {1e3 * error.x:+.1f} mm along, {1e3 * error.y:+.1f} mm across, {1e3 * error.yaw:+.1f} mrad")
print(f"smallest clearance on the way: {1e3 * run.min_clearance:.1f} mm")
