"""The names of the front door and where they live; `optdock/__init__.py` imports them on first use."""

import checkers.axis
import smoothers

from .config import Scenario as Scenario
from .config import load_scenario as load_scenario
from .controllers.tracking_controller import TrackingController as TrackingController
from .errors import Cancelled as Cancelled
from .errors import CertificationFailed as CertificationFailed
from .errors import FailedToSmoothPath as FailedToSmoothPath
from .errors import FailedToTimePath as FailedToTimePath
from .errors import GoalOccupied as GoalOccupied
from .errors import InvalidFile as InvalidFile
from .errors import InvalidValue as InvalidValue
from .errors import NoMotionExists as NoMotionExists
from .errors import NoValidPathCouldBeFound as NoValidPathCouldBeFound
from .errors import OptdockError as OptdockError
from .errors import PluginError as PluginError
from .errors import StartOccupied as StartOccupied
from .errors import TimedOut as TimedOut
from .executor import DockingExecutor as DockingExecutor
from .executor import EndingKind as EndingKind
from .executor import ExecutorSettings as ExecutorSettings
from .executor import PlanningProcess as PlanningProcess
from .executor import SimpleDock as SimpleDock
from .executor import State as State
from .executor import ThreadPlanning as ThreadPlanning
from .executor.log import LogWriter as LogWriter
from .geometry.footprint import Footprint as Footprint
from .geometry.obstacles import ObstacleSet as ObstacleSet
from .geometry.pose import Pose2 as Pose2
from .geometry.pose import Twist2 as Twist2
from .impossibility import BlockedStraight as BlockedStraight
from .impossibility import ImpossibilityProof as ImpossibilityProof
from .impossibility import check_impossibility as check_impossibility
from .impossibility import prove_impossible as prove_impossible
from .io.maps import load_map as load_map
from .io.plan_file import load_plan as load_plan
from .model.camera import Camera as Camera
from .model.clearance_rule import ClearanceRule as ClearanceRule
from .model.costmap import Costmap as Costmap
from .model.dock import Dock as Dock
from .model.dock import DockTolerances as DockTolerances
from .model.limits import MotionLimits as MotionLimits
from .model.measurements import AtDock as AtDock
from .model.measurements import Detection as Detection
from .model.measurements import Measurements as Measurements
from .model.measurements import OdometryPose as OdometryPose
from .model.path import Path as Path
from .model.problem import DockingProblem as DockingProblem
from .model.robot import Robot as Robot
from .model.robot import TrackingTube as TrackingTube
from .model.segments import TurnSegment as TurnSegment
from .model.trajectory import Trajectory as Trajectory
from .planners.dock_planner import DockPlanner as DockPlanner
from .planners.manoeuvres.manoeuvre_planner import ManoeuvrePlanner as ManoeuvrePlanner
from .planning.pipeline import plan_dock as plan_dock
from .planning.pipeline import warm_up as warm_up
from .planning.plan import DockPlan as DockPlan
from .planning.replanning import DriveState as DriveState
from .planning.replanning import replan as replan
from .planning.replanning import still_holds as still_holds
from .plugins.interfaces import DockType as DockType
from .plugins.lifecycle import PluginContext as PluginContext
from .plugins.outcomes import Contact as Contact
from .plugins.parameters import PluginParameters as PluginParameters
from .timing.near_optimal import NearOptimal as NearOptimal
from .verification import Certificate as Certificate
from .verification import certify_path as certify_path
from .verification import certify_trajectory as certify_trajectory

AxisGoalChecker = checkers.axis.AxisGoalChecker
CasadiSmoother = smoothers.CasadiSmoother

__version__: str
