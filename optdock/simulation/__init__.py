"""A closed loop in simulation: plant, noise, latency, run."""

from optdock.geometry.pose import pose_errors
from optdock.simulation.closed_loop import RemainingPath, SimulationSettings, run_closed_loop
from optdock.simulation.plant import Actuation, DifferentialDrive, PlantState
from optdock.simulation.run import Run, executed_clearance

__all__ = [
    "Actuation",
    "DifferentialDrive",
    "PlantState",
    "RemainingPath",
    "Run",
    "SimulationSettings",
    "executed_clearance",
    "pose_errors",
    "run_closed_loop",
]
