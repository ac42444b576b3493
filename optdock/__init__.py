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
    from optdock.camera import Camera
    from optdock.config import Scenario, load_scenario
    from optdock.controllers.tracking import TrackingController
    from optdock.costmap.costmap import Costmap
    from optdock.dock import Dock, DockTolerances
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
    from optdock.geometry.pose import Pose2, Twist2
    from optdock.interfaces import DockType
    from optdock.io.maps import load_map
    from optdock.io.plan_file import load_plan
    from optdock.lifecycle import PluginContext
    from optdock.limits import MotionLimits
    from optdock.measurements import AtDock, Detection, Measurements, OdometryPose
    from optdock.obstacles import ObstacleSet
    from optdock.outcomes import Contact
    from optdock.parameters import PluginParameters
    from optdock.path import Path
    from optdock.pipeline import plan_dock, warm_up
    from optdock.plan import DockPlan
    from optdock.planners.dock_planner import DockPlanner
    from optdock.planners.manoeuvres.manoeuvre_planner import ManoeuvrePlanner
    from optdock.problem import ClearanceRule, DockingProblem
    from optdock.replanning import DriveState, replan, still_holds
    from optdock.robot import Robot, TrackingTube
    from optdock.segments import TurnSegment
    from optdock.timing.near_optimal import NearOptimal
    from optdock.trajectory import Trajectory
    from optdock.verification import (
        BlockedStraight,
        Certificate,
        ImpossibilityProof,
        certify_path,
        certify_trajectory,
        check_impossibility,
        prove_impossible,
    )
    from smoothers import CasadiSmoother

_MODULES = {
    "optdock.camera": ("Camera",),
    "optdock.config": ("Scenario", "load_scenario"),
    "optdock.costmap.costmap": ("Costmap",),
    "optdock.dock": ("Dock", "DockTolerances"),
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
    "optdock.interfaces": ("DockType",),
    "optdock.io.maps": ("load_map",),
    "optdock.io.plan_file": ("load_plan",),
    "optdock.lifecycle": ("PluginContext",),
    "optdock.limits": ("MotionLimits",),
    "optdock.measurements": ("AtDock", "Detection", "Measurements", "OdometryPose"),
    "optdock.obstacles": ("ObstacleSet",),
    "optdock.outcomes": ("Contact",),
    "optdock.parameters": ("PluginParameters",),
    "optdock.path": ("Path",),
    "optdock.pipeline": ("plan_dock", "warm_up"),
    "optdock.plan": ("DockPlan",),
    "optdock.problem": ("ClearanceRule", "DockingProblem"),
    "optdock.replanning": ("DriveState", "replan", "still_holds"),
    "optdock.robot": ("Robot", "TrackingTube"),
    "optdock.segments": ("TurnSegment",),
    "optdock.trajectory": ("Trajectory",),
    "optdock.verification": (
        "BlockedStraight",
        "Certificate",
        "ImpossibilityProof",
        "certify_path",
        "certify_trajectory",
        "check_impossibility",
        "prove_impossible",
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
            found = import_module("optdock.plugins").plugin_class(name)
        else:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        globals()[name] = found
        return found
