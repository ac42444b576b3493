"""One goal of dock_robot or undock_robot: which dock is meant, what brings the robot before it, and the drive."""

from __future__ import annotations

import dataclasses
import math
import time
from contextlib import suppress
from typing import TYPE_CHECKING, Literal

import numpy as np
from nav2_msgs.action import DockRobot, UndockRobot

from optdock import ros
from optdock.errors import DockNotValid, InvalidMessage, OptdockError
from optdock.geometry.pose import Pose2
from optdock.model.problem import DockingProblem
from optdock_ros.docking_goals import UNKNOWN, Ended, GoalOutcome, done, failed
from optdock_ros.measuring import Measuring
from optdock_ros.surroundings import nav2_footprint
from optdock_ros.task_drive import LOOK, DockedAt, TaskDrive, measurement_rules

if TYPE_CHECKING:
    from optdock.executor import ExecutorSettings
    from optdock.geometry.footprint import Footprint
    from optdock.nav2.docks import DockEntry
    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.docking_goals import Goal
    from optdock_ros.task_drive import DockingResources

__all__ = ["DockingTask"]

_LOOKS = 15  # detections for a dock that is not seen any more on the way: their median errs by a third of one
_FRESH = 0.5  # [s] at least that a pose is good for before the robot moves
_CURRENT = 2.0  # [s] in which a battery tells that it charges no more: it tells once a second


class DockingTask:
    """The work on one goal, in the thread of the goal.

    Args:
        resources: What goals are worked on with.
        goal: That is worked on.

    Raises of `dock` and `undock`:
        Ended: The goal is to end, or cannot be worked on; with its outcome.
        OptdockError: It cannot be worked on; with Nav2's error code where there is one.
    """

    def __init__(self, resources: DockingResources, goal: Goal) -> None:
        self._resources, self._settings, self._goal = resources, resources.settings, goal

    def dock(self) -> GoalOutcome:
        """The work on a goal of dock_robot."""
        request, own = self._goal.request, self._settings.own
        staging_time = self._limit(request.max_staging_time, "max_staging_time")
        entry, plugin = self._wanted(request)
        dock = self._in_fixed_frame(entry)
        stands_there = [] if plugin.waits_for_charge else [plugin.docked_pose(dock)]  # else the current alone tells
        if plugin.is_charger and self._is_in_dock(plugin, stands_there):
            return done("the robot is docked or charging already")
        stages = bool(request.navigate_to_staging_pose)
        if stages and not own.stage_by_executor:
            self._navigate(entry, plugin, dock, staging_time)
            dock, stages = self._in_fixed_frame(entry), False
        settings = self._settings.executor_settings(
            plugin, navigate_to_staging_pose=stages, max_staging_time=staging_time
        )
        docked = plugin.docked_pose(dock)
        if plugin.parameters.rotate_to_dock and settings.use_detections:
            docked = self._seen_at_rest(plugin, settings)
            settings = settings.model_copy(update={"use_detections": False})
        drive = self._drive(plugin, docked, settings, "dock")
        ending = drive.run()
        if ending.success:
            self._resources.docked = DockedAt(drive.executor.dock, plugin.name)
        return ending

    def undock(self) -> GoalOutcome:
        """The work on a goal of undock_robot."""
        request = self._goal.request
        named = request.dock_type or (self._resources.docked.type_name if self._resources.docked is not None else "")
        plugin = self._resources.docks.plugin(named, "undock_robot: dock_type")
        robot = self._robot_pose()
        known = [plugin.docked_pose(pose) for pose in self._stored(plugin)]
        known += [self._resources.docked.pose] if self._resources.docked is not None else []
        if plugin.is_charger and not self._is_in_dock(plugin, known):
            return done("the robot is in no dock, there is nothing to undock from")
        limit = self._limit(request.max_undocking_time, "max_undocking_time")
        settings = self._settings.executor_settings(
            plugin, use_detections=False, max_undocking_time=limit, timeout=limit
        )
        # As Nav2: the dock is where the robot stands.
        ending = self._drive(plugin, robot, settings, "undock").run()
        if not ending.success:
            return ending
        self._resources.docked = None
        until = time.monotonic() + _CURRENT
        while (
            plugin.is_charging(self._resources.topics.battery, self._resources.now())
            and time.monotonic() < until
            and not self._goal.ending
        ):
            time.sleep(LOOK)
        if plugin.is_charging(self._resources.topics.battery, self._resources.now()):
            return failed(UndockRobot.Result.FAILED_TO_CONTROL, "the battery still charges at the staging pose")
        return ending

    def _limit(self, seconds: float, name: str) -> float:
        """A time limit of a goal [s], one period at least.

        Raises:
            Ended: It is not a number: nothing would ever be later than that.
        """
        if not math.isfinite(seconds):
            raise Ended(failed(UNKNOWN, f"{name}: must be a finite number of seconds, got {seconds}"))
        return max(float(seconds), self._settings.period)

    def _wanted(self, request: DockRobot.Goal) -> tuple[DockEntry, DockPlugin]:
        """The dock that a goal means.

        Raises:
            DockNotInDB: There is none of its name.
            DockNotValid: Its type is unknown, or its pose is none.
        """
        if request.use_dock_id:
            return self._resources.docks.find(request.dock_id)
        try:
            told = ros.pose(request.dock_pose)
        except InvalidMessage as error:
            raise DockNotValid(f"dock_pose: {error}") from error
        return self._resources.docks.at(told.pose, told.frame, request.dock_type)

    def _in_fixed_frame(self, entry: DockEntry) -> Pose2:
        """The dock's pose, as Nav2 writes it.

        Raises:
            DockNotValid: Its frame is unknown.
        """
        fixed = self._settings.own.fixed_frame
        try:
            frame = self._resources.waited(
                self._goal, lambda: self._resources.frames.lookup(fixed, entry.frame).planar()
            )
        except OptdockError as error:
            raise DockNotValid(f"{entry.name}.frame: {error}") from error
        return frame @ entry.pose

    def _robot_pose(self) -> Pose2:
        """Where the robot is in the fixed frame, or will have been a moment later.

        Raises:
            TransformError: There is no transform.
        """
        return self._resources.waited(self._goal, self._located)

    def _located(self) -> Pose2:
        """Where the robot is in the fixed frame.

        Raises:
            TransformError: The newest transform is too old.
        """
        own = self._settings.own
        found = self._resources.frames.lookup(own.fixed_frame, own.base_frame)
        age = self._resources.now() - found.stamp
        if age > max(_FRESH, self._settings.controller.transform_tolerance):
            raise ros.TransformError(f"{own.fixed_frame} <- {own.base_frame}: the last one is {age:.2f} s old")
        return found.planar()

    def _stored(self, plugin: DockPlugin) -> list[Pose2]:
        """The docks of a type whose frames are known, in the fixed frame."""
        found = []
        for entry in self._resources.docks.entries.values():
            if entry.type == plugin.name:
                with suppress(OptdockError):
                    frame = self._resources.frames.lookup(self._settings.own.fixed_frame, entry.frame).planar()
                    found.append(frame @ entry.pose)
        return found

    def _is_charging(self, plugin: DockPlugin) -> bool:
        return plugin.is_charging(self._resources.topics.battery, self._resources.now())

    def _is_in_dock(self, plugin: DockPlugin, docked: list[Pose2]) -> bool:
        """Whether the battery charges, or the robot stands where it would stand docked."""
        if self._is_charging(plugin):
            return True
        try:
            robot = self._located()
        except OptdockError:
            return False
        return any(robot.distance_to(pose) < plugin.parameters.docking_threshold for pose in docked)

    def _navigate(self, entry: DockEntry, plugin: DockPlugin, dock: Pose2, limit: float) -> None:
        """Have the robot navigated to the staging pose, where it is far from it.

        Raises:
            Ended: It did not get there.
        """
        own, staging = self._settings.own, plugin.staging_pose(dock)
        self._resources.reports.pose("staging_pose", staging, self._resources.now())
        gap = self._robot_pose().in_frame_of(staging)
        if math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) < own.dock_prestaging_tolerance:
            return
        assert self._resources.navigator is not None
        pose = ros.pose_message(ros.imported, plugin.staging_pose(entry.pose), entry.frame, self._resources.now())

        def is_over() -> bool:
            self._resources.tidy()
            self._goal.tell_progress(DockRobot.Feedback.NAV_TO_STAGING_POSE)
            self._goal.changed.wait(LOOK)
            self._goal.changed.clear()
            return bool(self._goal.ending)

        fault = self._resources.navigator.go(pose, own.navigator_bt_xml, limit, is_over)
        self._resources.check_end(self._goal)
        if fault:
            raise Ended(failed(DockRobot.Result.FAILED_TO_STAGE, f"navigate_to_pose: {fault}"))

    def _outline(self) -> Footprint:
        """The robot's, from the block `robot`, the topic, or the parameters of Nav2's costmaps.

        Raises:
            Ended: It is not published.
        """
        own, given = self._settings.own, self._settings.robot.footprint
        if given is not None:
            return given
        topic = self._resources.topics.footprint
        if topic is None or own.footprint:
            return nav2_footprint(own.footprint, own.robot_radius, own.footprint_padding)
        try:
            return self._resources.waited(self._goal, lambda: topic.newest()[0])
        except OptdockError as error:
            raise Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _seen_at_rest(self, plugin: DockPlugin, settings: ExecutorSettings) -> Pose2:
        """Where the docked robot would stand, by what is seen before a robot turns its back to the dock.

        Raises:
            Ended: It is not seen.
        """
        own = self._settings.own
        measuring = Measuring(
            measurement_rules(self._settings, plugin),
            self._resources.frames,
            plugin.detection,
            lambda _: None,
        )
        seen: list[Pose2] = []
        with self._resources.topics.detecting(plugin, measuring, lambda: self._resources.check_end(self._goal)):
            until = time.monotonic() + settings.initial_perception_timeout
            enough = max(settings.least_detections, _LOOKS)
            while len(seen) < enough and time.monotonic() < until:
                self._resources.check_end(self._goal)
                self._goal.tell_progress(DockRobot.Feedback.INITIAL_PERCEPTION)
                time.sleep(LOOK)
                for detection in measuring.measurements(self._resources.now()).detections:
                    with suppress(OptdockError):
                        robot = self._resources.frames.lookup(own.fixed_frame, own.base_frame, detection.stamp).planar()
                        seen.append(robot @ detection.pose)
        if len(seen) < settings.least_detections:
            text = f"{len(seen)} detections in {settings.initial_perception_timeout:g} s {measuring.faults or ''}"
            raise Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, text))
        # The medians: some of the detections may be wrong.
        first = seen[0]
        gaps = np.array([pose.in_frame_of(first).as_array() for pose in seen])
        return first @ Pose2(*np.median(gaps, axis=0).tolist())

    def _drive(
        self, plugin: DockPlugin, docked: Pose2, settings: ExecutorSettings, what: Literal["dock", "undock"]
    ) -> TaskDrive:
        """The drive, checked; the robot stands.

        Raises:
            Ended: What the robot must see or know has not come.
        """
        of_server = self._settings
        robot = of_server.robot.robot(self._outline())
        if plugin.parameters.rotate_to_dock:
            robot = dataclasses.replace(robot, turns_in_place=True)
        dock = of_server.dock_parameters[plugin.name].dock(plugin, docked)
        problem = DockingProblem(
            self._robot_pose(), dock, robot, clearance=of_server.clearance, frame=of_server.own.fixed_frame
        )
        return TaskDrive(self._resources, self._goal, plugin, problem, settings, what)
