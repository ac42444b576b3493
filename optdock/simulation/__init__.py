"""Simulation: plant models, sensors, a simulated robot, and closed-loop runs."""

from optdock.geometry.pose import pose_errors
from optdock.simulation.bicycle import Bicycle, Steering, SteeringAtRest, plant_of
from optdock.simulation.closed_loop import RemainingPath, Run, SimulationSettings, beyond_proof, run_closed_loop
from optdock.simulation.plant import Actuation, DifferentialDrive, Plant, PlantState, Slip, StuckWheel, Wheel, Wheels
from optdock.simulation.sensors import DockSensor, Odometry, PoseSensor
from optdock.simulation.world import Record, Sensors, SimulatedRobot, Station, executed_clearance

__all__ = [
    "Actuation",
    "Bicycle",
    "DifferentialDrive",
    "DockSensor",
    "Odometry",
    "Plant",
    "PlantState",
    "PoseSensor",
    "Record",
    "RemainingPath",
    "Run",
    "Sensors",
    "SimulatedRobot",
    "SimulationSettings",
    "Slip",
    "Station",
    "Steering",
    "SteeringAtRest",
    "StuckWheel",
    "Wheel",
    "Wheels",
    "beyond_proof",
    "executed_clearance",
    "plant_of",
    "pose_errors",
    "run_closed_loop",
]
