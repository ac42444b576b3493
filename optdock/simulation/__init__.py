"""A closed loop in simulation: plant, noise, latency, run."""

from optdock.simulation.clearance import executed_clearance
from optdock.simulation.closed_loop import SimulationSettings, run_closed_loop
from optdock.simulation.plant import Actuation, DifferentialDrive, PlantState
from optdock.simulation.remainder import RemainingPath
from optdock.simulation.run import Run, pose_errors

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
