"""Docking with masses, tyres and contact forces, in MuJoCo (Python 3.11 or newer)."""

from experiments.mujoco.model import Chassis, docking_model
from experiments.mujoco.plant import MujocoDrive, MujocoPhysics
from experiments.mujoco.stations import VShape, flat_station

__all__ = ["Chassis", "MujocoDrive", "MujocoPhysics", "VShape", "docking_model", "flat_station"]
