"""The executor: a robot is docked and undocked step by step, without ROS.

settings        how: times, distances, sensors
outcomes        what it says of itself: states, events, endings, with Nav2's codes
docking         `DockingExecutor`: the clock, and one control cycle after the other
procedure       the story of a docking and of an undocking, told from top to bottom
approach        how far the robot can still be moved sideways, and what is left of an error at the dock
perception      robot and dock, brought up to date by every set of measurements
dock_filter     the dock in the frame of the odometry, from late detections
command_limits  every command within the limits, jerk included
planning        jobs beside the control loop: at once, in a thread, out of a log
planning_process  the process to which a thread may hand them
"""

from optdock.executor.docking import DockingExecutor
from optdock.executor.outcomes import Ending, EndingKind, Event, Feedback, FeedbackState, State, Step
from optdock.executor.planning import InlinePlanning, Planning, ThreadPlanning
from optdock.executor.planning_process import PlanningProcess
from optdock.executor.settings import ExecutorSettings

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
    "State",
    "Step",
    "ThreadPlanning",
]
