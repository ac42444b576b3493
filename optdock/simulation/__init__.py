"""A closed loop in simulation: plant, noise, latency, run."""

from optdock.simulation.closed_loop import RemainingPath, SimulationSettings, run_closed_loop
from optdock.simulation.plant import Actuation, DifferentialDrive, Plant, PlantState, Slip, StuckWheel, Wheel, Wheels
from optdock.simulation.run import Run, executed_clearance, pose_errors

__all__ = [
    "Actuation",
    "DifferentialDrive",
    "Plant",
    "PlantState",
    "RemainingPath",
    "Run",
    "SimulationSettings",
    "Slip",
    "StuckWheel",
    "Wheel",
    "Wheels",
    "executed_clearance",
    "pose_errors",
    "run_closed_loop",
]
