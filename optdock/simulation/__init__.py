"""A closed loop in simulation: plants, sensors, a simulated robot, runs."""

from optdock.geometry.pose import pose_errors
from optdock.simulation.bicycle import Bicycle, Steering, SteeringAtRest, plant_of
from optdock.simulation.closed_loop import RemainingPath, SimulationSettings, run_closed_loop
from optdock.simulation.plant import Actuation, DifferentialDrive, Plant, PlantState, Slip, StuckWheel, Wheel, Wheels
from optdock.simulation.run import Run, beyond_proof, executed_clearance
from optdock.simulation.sensors import Displaced, DockSensor, Odometry, PoseSensor, Span
from optdock.simulation.world import Record, Sensors, SimulatedRobot, Station

__all__ = [
    "Actuation",
    "Bicycle",
    "DifferentialDrive",
    "Displaced",
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
    "Span",
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
