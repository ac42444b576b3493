"""optdock: certified docking trajectories for wheeled robots.

    import optdock as od

    robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5))
    problem = od.DockingProblem(od.Pose2(1.0, 0.2, 0.4), od.Dock(od.Pose2(4.0, 1.0, 0.0)), robot)
    plan = od.plan_dock(problem, time_budget=0.1)

Every name below is imported on its first use, so that `import optdock` stays cheap. Plugins are found by their entry
points, as `plan_dock` finds them: nothing here imports the packages that hold them.
"""

from __future__ import annotations

import logging
from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from checkers.axis import AxisGoalChecker
    from optdock.config import Scenario, load_scenario
    from optdock.controllers.tracking import TrackingController
    from optdock.costmap.costmap import Costmap
    from optdock.errors import (
        Cancelled,
        CertificationFailed,
        FailedToSmoothPath,
        FailedToTimePath,
        GoalOccupied,
        InvalidFile,
        InvalidValue,
        NoMotionExists,
        NoValidPathCouldBeFound,
        OptdockError,
        PluginError,
        StartOccupied,
        TimedOut,
    )
    from optdock.executor import (
        DockingExecutor,
        EndingKind,
        ExecutorSettings,
        PlanningProcess,
        SimpleDock,
        State,
        ThreadPlanning,
    )
    from optdock.executor.log import LogWriter
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.obstacles import ObstacleSet
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.impossibility import BlockedStraight, ImpossibilityProof, check_impossibility, prove_impossible
    from optdock.io.maps import load_map
    from optdock.io.plan_file import load_plan
    from optdock.model.camera import Camera
    from optdock.model.dock import Dock, DockTolerances
    from optdock.model.limits import MotionLimits
    from optdock.model.measurements import AtDock, Detection, Measurements, OdometryPose
    from optdock.model.path import Path
    from optdock.model.problem import ClearanceRule, DockingProblem
    from optdock.model.robot import Robot, TrackingTube
    from optdock.model.segments import TurnSegment
    from optdock.model.trajectory import Trajectory
    from optdock.planners.dock_planner import DockPlanner
    from optdock.planners.manoeuvres.manoeuvre_planner import ManoeuvrePlanner
    from optdock.planning.pipeline import plan_dock, warm_up
    from optdock.planning.plan import DockPlan
    from optdock.planning.replanning import DriveState, replan, still_holds
    from optdock.plugins.interfaces import DockType
    from optdock.plugins.lifecycle import PluginContext
    from optdock.plugins.outcomes import Contact
    from optdock.plugins.parameters import PluginParameters
    from optdock.timing.near_optimal import NearOptimal
    from optdock.verification import Certificate, certify_path, certify_trajectory
    from smoothers import CasadiSmoother

_MODULES = {
    "optdock.model.camera": ("Camera",),
    "optdock.config": ("Scenario", "load_scenario"),
    "optdock.costmap.costmap": ("Costmap",),
    "optdock.model.dock": ("Dock", "DockTolerances"),
    "optdock.errors": (
        "Cancelled",
        "CertificationFailed",
        "FailedToSmoothPath",
        "FailedToTimePath",
        "GoalOccupied",
        "InvalidFile",
        "InvalidValue",
        "NoMotionExists",
        "NoValidPathCouldBeFound",
        "OptdockError",
        "PluginError",
        "StartOccupied",
        "TimedOut",
    ),
    "optdock.executor": (
        "DockingExecutor",
        "EndingKind",
        "ExecutorSettings",
        "PlanningProcess",
        "SimpleDock",
        "State",
        "ThreadPlanning",
    ),
    "optdock.executor.log": ("LogWriter",),
    "optdock.geometry.footprint": ("Footprint",),
    "optdock.geometry.pose": ("Pose2", "Twist2"),
    "optdock.plugins.interfaces": ("DockType",),
    "optdock.io.maps": ("load_map",),
    "optdock.io.plan_file": ("load_plan",),
    "optdock.plugins.lifecycle": ("PluginContext",),
    "optdock.model.limits": ("MotionLimits",),
    "optdock.model.measurements": ("AtDock", "Detection", "Measurements", "OdometryPose"),
    "optdock.geometry.obstacles": ("ObstacleSet",),
    "optdock.plugins.outcomes": ("Contact",),
    "optdock.plugins.parameters": ("PluginParameters",),
    "optdock.model.path": ("Path",),
    "optdock.planning.pipeline": ("plan_dock", "warm_up"),
    "optdock.planning.plan": ("DockPlan",),
    "optdock.model.problem": ("ClearanceRule", "DockingProblem"),
    "optdock.planning.replanning": ("DriveState", "replan", "still_holds"),
    "optdock.model.robot": ("Robot", "TrackingTube"),
    "optdock.model.segments": ("TurnSegment",),
    "optdock.model.trajectory": ("Trajectory",),
    "optdock.impossibility": (
        "BlockedStraight",
        "ImpossibilityProof",
        "check_impossibility",
        "prove_impossible",
    ),
    "optdock.verification": (
        "Certificate",
        "certify_path",
        "certify_trajectory",
    ),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}
_PLUGINS = ("AxisGoalChecker", "CasadiSmoother", "DockPlanner", "ManoeuvrePlanner", "NearOptimal", "TrackingController")

__all__ = [
    "AtDock",
    "AxisGoalChecker",
    "BlockedStraight",
    "Camera",
    "Cancelled",
    "CasadiSmoother",
    "Certificate",
    "CertificationFailed",
    "ClearanceRule",
    "Contact",
    "Costmap",
    "Detection",
    "Dock",
    "DockPlan",
    "DockPlanner",
    "DockTolerances",
    "DockType",
    "DockingExecutor",
    "DockingProblem",
    "DriveState",
    "EndingKind",
    "ExecutorSettings",
    "FailedToSmoothPath",
    "FailedToTimePath",
    "Footprint",
    "GoalOccupied",
    "ImpossibilityProof",
    "InvalidFile",
    "InvalidValue",
    "LogWriter",
    "ManoeuvrePlanner",
    "Measurements",
    "MotionLimits",
    "NearOptimal",
    "NoMotionExists",
    "NoValidPathCouldBeFound",
    "ObstacleSet",
    "OdometryPose",
    "OptdockError",
    "Path",
    "PlanningProcess",
    "PluginContext",
    "PluginError",
    "PluginParameters",
    "Pose2",
    "Robot",
    "Scenario",
    "SimpleDock",
    "StartOccupied",
    "State",
    "ThreadPlanning",
    "TimedOut",
    "TrackingController",
    "TrackingTube",
    "Trajectory",
    "TurnSegment",
    "Twist2",
    "certify_path",
    "certify_trajectory",
    "check_impossibility",
    "load_map",
    "load_plan",
    "load_scenario",
    "plan_dock",
    "prove_impossible",
    "replan",
    "still_holds",
    "warm_up",
]
__version__ = "0.1.0"

logging.getLogger(__name__).addHandler(logging.NullHandler())


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


if not TYPE_CHECKING:  # who reads the types must be told that a misspelt name does not exist

    def __getattr__(name: str) -> object:
        if name in _HOMES:
            found = getattr(import_module(_HOMES[name]), name)
        elif name in _PLUGINS:
            found = import_module("optdock.plugins.registry").plugin_class(name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = found
        return found
