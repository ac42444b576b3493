"""The executor: a robot is docked and undocked step by step, without ROS.

settings        how: times, distances, sensors
outcomes        what it says of itself: states, events, endings, with Nav2's codes
docking         `DockingExecutor`: the clock, and one control cycle after the other
intake          measurements that can be used, and what is wrong with the others
simple_dock     the kind of dock that most are
checked_dock_type  answers of a dock type, refused where they are none
procedure       the story of a docking and of an undocking, told from top to bottom
situation       questions about robot, dock and surroundings, answered from the measurements
drive           one motion being driven, and replanned
interruptions   what ends a motion, an attempt or a task early
approach        how far the robot can still be moved sideways, and what is left of an error at the dock
perception      robot and dock, brought up to date by every set of measurements
planning        jobs beside the control loop: at once, in a thread, out of a log
planning_process  the process to which a thread may hand them
plan_requests   jobs numbered, their results reported
log, replay     everything taken down, and driven again
"""

from optdock.executor.docking import DockingExecutor
from optdock.executor.executor_settings import ExecutorSettings
from optdock.executor.planning import InlinePlanning, Planning, ThreadPlanning
from optdock.executor.planning_process import PlanningProcess
from optdock.executor.simple_dock import SimpleDock
from optdock.executor.task_states import Ending, EndingKind, Event, Feedback, FeedbackState, State, Step

__all__ = [
    "DockingExecutor",
    "Ending",
    "EndingKind",
    "Event",
    "ExecutorSettings",
    "Feedback",
    "FeedbackState",
    "InlinePlanning",
    "Planning",
    "PlanningProcess",
    "SimpleDock",
    "State",
    "Step",
    "ThreadPlanning",
]
