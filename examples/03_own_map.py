"""Plan on an occupancy grid from an array, with its resolution and its origin."""

import numpy as np

import optdock as od

resolution = 0.05
grid = np.zeros((80, 140), dtype=np.int8)  # row 0 has the lowest y; 0 free, 100 occupied, -1 unknown, as in ROS
grid[:2] = grid[-2:] = grid[:, :2] = grid[:, -2:] = 100  # walls
grid[48:56, 40:90] = 100  # a rack
grid[60:78, 100:138] = -1  # unknown

problem = od.DockingProblem.from_grid(
    grid,
    resolution,
    origin=(-1.0, -1.0),
    start=od.Pose2(0.0, 0.0, 0.0),
    dock=od.Dock(od.Pose2(5.0, 0.6, 0.0), final_straight=0.3, approach_speed=0.1, approach_distance=0.3),
    robot=od.Robot(od.Footprint.from_radius(0.25), od.MotionLimits(max_curvature=2.0, max_curvature_rate=8.0)),
    clearance=0.05,
)
print(f"{len(problem.all_obstacles)} convex obstacles from {grid.size} cells")
plan = od.plan_dock(problem, time_budget=1.0)
print(plan)
plan.plot("results/own_map.png")
