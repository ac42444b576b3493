"""The executor: docks and undocks a robot cycle by cycle, without ROS.

docking            `DockingExecutor`: clock, one control cycle after the other
executor_settings  settings
task_states        states, events, endings with Nav2's codes, exceptions of the procedure
checked_inputs     validation of measurements and of a dock type's return values
simple_dock        the default dock type
pose_filter        dead reckoning and Kalman filter
perception         estimates of robot and dock
dock_estimate      robot relative to the dock, compared with tolerances
planning_scene     obstacles, staging poses, planning problems
control_cycles     present situation; generators for one cycle, a stop, and a wait
procedure          docking and undocking from top to bottom
dock_contact       detection at rest, contact, corrections at the dock
trajectory_drive   driving, monitoring and replanning of one motion
planning           planning jobs: inline, in a thread, from a log
planning_process   planning in a separate process
log, replay        record and replay of a task
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
