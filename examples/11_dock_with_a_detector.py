"""Dock with a detector: the dock differs from its stored pose and is pushed during the approach; draw the run."""

import numpy as np

import optdock as od
from optdock.plotting import save_docking_picture
from optdock.simulation import Actuation, DifferentialDrive, DockSensor, PoseSensor, Sensors, SimulatedRobot

limits = od.MotionLimits(max_curvature=2.0, max_curvature_rate=8.0, max_yaw_rate=1.0, max_yaw_acceleration=2.0)
robot = od.Robot(od.Footprint.rectangle(0.3, 0.3, 0.5), limits)
stored = od.Dock(od.Pose2(2.0, 0.0, 0.0), final_straight=0.1, approach_speed=0.15, approach_distance=0.2)
problem = od.DockingProblem(od.Pose2(0.7, 0.35, -0.3), stored, robot)

# latency, lag and localization noise; the dock is 5 cm aside, its detections are late and noisy
world = SimulatedRobot(
    DifferentialDrive(robot, Actuation(linear_lag=0.1, angular_lag=0.1, latency=0.06)),
    start=problem.start,
    dock_pose=problem.goal @ od.Pose2(0.02, 0.05, 0.05),
    sensors=Sensors(PoseSensor(0.005, 0.009), dock=DockSensor(latency=0.06, position_sigma=0.003, yaw_sigma=0.005)),
    seed=3,
)
executor = od.DockingExecutor(problem, od.ExecutorSettings(navigate_to_staging_pose=False))
step = executor.step(world.measurements)
believed, pushed = [], False
while step.ending is None:  # on a robot: measure, step, send the command, at any rate from 10 to 200 Hz
    if world.time > 1.3 and not pushed:  # the dock is pushed 4 cm aside
        world.dock_pose, pushed = world.dock_pose @ od.Pose2(0.0, 0.04, 0.0), True
    step = executor.step(world.advance(step.command, 0.05))
    believed.append(executor.robot.as_array())
    for event in step.events:
        print(f"{event.stamp:5.2f} s  {event.name} {event.detail}")

error, record = world.error, world.record()
print(f"{1e3 * error.x:+.1f} mm along, {1e3 * error.y:+.1f} mm across, {1e3 * error.yaw:+.1f} mrad at the true dock")
commands = np.column_stack((record.times, record.commands))
save_docking_picture("results/dock_with_a_detector.png", problem, record.measured, np.array(believed), commands)
