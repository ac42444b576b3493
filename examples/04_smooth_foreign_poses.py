"""Use only the smoother, on poses from another planner."""

from pathlib import Path

import numpy as np

import optdock as od

data = Path(__file__).parent / "data"
problem = od.load_scenario(data / "bay.yaml").problem
poses = np.loadtxt(data / "waypoints.csv", delimiter=",", skiprows=1)  # x, y, yaw
foreign = od.Path.from_poses(poses, frame="map")

before = od.certify_path(foreign, problem)
print("as it came:", "certified" if before.certified else before.reason)

result = od.CasadiSmoother(max_iterations=40).smooth(foreign, 1.0, problem=problem)
after = od.certify_path(result.path, problem)
print(f"smoothed:   certified {after.certified}, {result.path.length:.2f} m, closest {after.min_clearance:.3f} m")
print(f"            at most {after.max_curvature:.2f} 1/m, {after.max_curvature_rate:.2f} 1/m^2")

samples = result.path.sample(0.1)  # back to poses
print(np.column_stack((samples.s, samples.poses))[:3].round(3))
