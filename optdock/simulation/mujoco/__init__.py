"""Docking with masses, tyres and contact forces, in MuJoCo; needs the extra `sim`."""

from optdock.simulation.mujoco.model import Chassis, docking_model
from optdock.simulation.mujoco.plant import MujocoDrive, MujocoPhysics
from optdock.simulation.mujoco.stations import VShape, flat_station

__all__ = ["Chassis", "MujocoDrive", "MujocoPhysics", "VShape", "docking_model", "flat_station"]
