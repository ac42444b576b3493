"""The work on one goal of dock_robot or undock_robot: dock, staging, and the drive."""

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
from optdock.nav2.docks import DockEntry
from optdock_ros.goal_queue import POLL, Ended, GoalOutcome, done, failed
from optdock_ros.measuring import Measuring
from optdock_ros.robot_topics import BATTERY
from optdock_ros.surroundings import nav2_footprint
from optdock_ros.task_drive import DockedAt, TaskDrive, measurement_rules

if TYPE_CHECKING:
    from optdock.executor import ExecutorSettings
    from optdock.geometry.footprint import Footprint
    from optdock_ros.dock_plugins import DockPlugin
    from optdock_ros.goal_queue import Goal
    from optdock_ros.task_drive import DockingResources

__all__ = ["DockingTask"]

_DETECTIONS = (
    15  # detections of a dock that is not detected later: the error of their median is a third of that of a single one
)
_FRESH = 0.5  # [s]: accepted age of a pose of the robot at rest
_DISCHARGE = 2.0  # [s] for the battery state, published once per second, to show the end of the charge


class DockingTask:
    """The work on one goal, in the thread of the goals.

    `dock` and `undock` raise `Ended` with the outcome of a goal that ends early, and `OptdockError`, with Nav2's error
    code if there is one, for a goal that cannot be executed.
    """

    def __init__(self, resources: DockingResources, goal: Goal) -> None:
        self._resources, self._settings, self._goal = resources, resources.settings, goal

    def dock(self) -> GoalOutcome:
        """Dock the robot."""
        request, own = self._goal.request, self._settings.own
        staging_time = self._limit(request.max_staging_time, "max_staging_time")
        entry, plugin = self._wanted(request)
        dock = self._stored_dock(entry)
        # A pose alone does not prove the charge.
        known = [] if plugin.waits_for_charge else [plugin.docked_pose(dock)]
        if plugin.is_charger and self._is_in_dock(plugin, self._robot_pose(), known):
            return done("the robot is docked or charging already")
        stages = bool(request.navigate_to_staging_pose)
        if stages and not own.stage_by_executor:
            self._navigate(entry, plugin, dock, staging_time)
            dock, stages = self._stored_dock(entry), False
        settings = self._settings.executor_settings(
            plugin, navigate_to_staging_pose=stages, max_staging_time=staging_time
        )
        docked = plugin.docked_pose(dock)
        if plugin.parameters.rotate_to_dock and settings.use_detections:
            docked = self._detected_at_rest(plugin, docked, settings)
            settings = settings.model_copy(update={"use_detections": False})
        drive = self._drive(plugin, docked, settings, "dock")
        outcome = drive.run()
        if outcome.success:
            self._resources.docked = DockedAt(drive.executor.dock, plugin.name)
        return outcome

    def undock(self) -> GoalOutcome:
        """Drive the robot out of the dock; as in Nav2 the dock is at the pose of the robot."""
        request, last = self._goal.request, self._resources.docked
        named = request.dock_type or (last.type_name if last is not None else "")
        plugin = self._resources.docks.plugin(named, "undock_robot: dock_type")
        robot = self._robot_pose()
        known = [plugin.docked_pose(pose) for pose in self._stored_docks(plugin)]
        known += [last.pose] if last is not None else []
        if plugin.is_charger and not self._is_in_dock(plugin, robot, known):
            # Nav2 aborts as well, with code 0 and without a message.
            text = f"the robot is in no dock of the type {plugin.name!r}, there is nothing to undock from"
            return failed(UndockRobot.Result.DOCK_NOT_VALID, text)
        limit = self._limit(request.max_undocking_time, "max_undocking_time")
        settings = self._settings.executor_settings(
            plugin, use_detections=False, max_undocking_time=limit, timeout=limit
        )
        outcome = self._drive(plugin, robot, settings, "undock").run()
        if not outcome.success:
            return outcome
        self._resources.docked = None
        until = time.monotonic() + _DISCHARGE
        while self._is_charging(plugin) and time.monotonic() < until and not self._goal.ending:
            time.sleep(POLL)
        if self._is_charging(plugin):
            return failed(UndockRobot.Result.FAILED_TO_CONTROL, "the battery still charges at the staging pose")
        return outcome

    def _limit(self, seconds: float, name: str) -> float:
        """Return a time limit of the goal [s], at least one period; raise `Ended` if it is not finite."""
        if not math.isfinite(seconds):
            raise Ended(failed(DockRobot.Result.UNKNOWN, f"{name}: must be a finite number of seconds, got {seconds}"))
        return max(float(seconds), self._settings.period)

    def _wanted(self, request: DockRobot.Goal) -> tuple[DockEntry, DockPlugin]:
        """Return the dock of a goal; raise `DockNotInDB` or `DockNotValid`."""
        if request.use_dock_id:
            return self._resources.docks.find(request.dock_id)
        try:
            given = ros.pose(request.dock_pose)
        except InvalidMessage as error:
            raise DockNotValid(f"dock_pose: {error}") from error
        plugin = self._resources.docks.plugin(request.dock_type, "dock_type")
        return DockEntry("dock at a pose", plugin.name, given.pose, given.frame), plugin

    def _stored_dock(self, entry: DockEntry) -> Pose2:
        """Return the pose of a dock in the fixed frame; raise `DockNotValid` if its frame is unknown."""
        try:
            frame = self._resources.waited(self._goal, lambda: self._resources.in_fixed_frame(entry.frame))
        except OptdockError as error:
            raise DockNotValid(f"{entry.name}.frame: {error}") from error
        return frame @ entry.pose

    def _stored_docks(self, plugin: DockPlugin) -> list[Pose2]:
        """Return the poses of the docks of a type in the fixed frame, if their frames are known."""
        found = []
        for entry in self._resources.docks.entries.values():
            if entry.type == plugin.name:
                with suppress(OptdockError):
                    found.append(self._resources.in_fixed_frame(entry.frame) @ entry.pose)
        return found

    def _robot_pose(self) -> Pose2:
        """Return the pose of the robot in the fixed frame; wait for a transform that is new enough."""
        own, most = self._settings.own, max(_FRESH, self._settings.controller.transform_tolerance)

        def _located() -> Pose2:
            found = self._resources.frames.lookup(own.fixed_frame, own.base_frame)
            age = self._resources.now() - found.stamp
            if age > most:
                raise ros.TransformError(f"{own.fixed_frame} <- {own.base_frame}: the last one is {age:.2f} s old")
            return found.planar()

        return self._resources.waited(self._goal, _located)

    def _is_charging(self, plugin: DockPlugin) -> bool:
        return plugin.is_charging(self._resources.topics.newest(BATTERY), self._resources.now())

    def _is_in_dock(self, plugin: DockPlugin, robot: Pose2, docked: list[Pose2]) -> bool:
        """Whether the battery is charging or the robot is at one of the docked poses."""
        if plugin.uses_battery:
            self._goal.waits_for(lambda: self._resources.topics.newest(BATTERY), self._resources.started_at)
        return self._is_charging(plugin) or any(
            robot.distance_to(pose) < plugin.parameters.docking_threshold for pose in docked
        )

    def _navigate(self, entry: DockEntry, plugin: DockPlugin, dock: Pose2, limit: float) -> None:
        """Navigate a distant robot to the staging pose; raise `Ended` on failure."""
        own, staging = self._settings.own, plugin.staging_pose(dock)
        self._resources.reports.pose("staging_pose", staging, self._resources.now())
        gap = self._robot_pose().in_frame_of(staging)
        if math.sqrt(gap.x**2 + gap.y**2 + gap.yaw**2) < own.dock_prestaging_tolerance:
            return
        assert self._resources.navigator is not None
        pose = ros.pose_message(ros.imported, plugin.staging_pose(entry.pose), entry.frame, self._resources.now())

        def is_over() -> bool:
            self._goal.publish_progress(DockRobot.Feedback.NAV_TO_STAGING_POSE)
            self._goal.changed.wait(POLL)
            self._goal.changed.clear()
            return bool(self._goal.ending)

        fault = self._resources.navigator.go(pose, own.navigator_bt_xml, limit, is_over)
        self._goal.check_end()
        if fault:
            raise Ended(failed(DockRobot.Result.FAILED_TO_STAGE, f"navigate_to_pose: {fault}"))

    def _outline(self) -> Footprint:
        """Return the outline from the block `robot`, Nav2's parameters or the topic; raise `Ended` if it is missing."""
        own, given, topic = self._settings.own, self._settings.robot.footprint, self._resources.topics.footprint
        if given is not None:
            return given
        if topic is None or own.footprint:
            return nav2_footprint(own.footprint, own.robot_radius, own.footprint_padding)
        try:
            return self._resources.waited(self._goal, lambda: topic.newest()[0])
        except OptdockError as error:
            raise Ended(failed(DockRobot.Result.FAILED_TO_CONTROL, str(error))) from error

    def _detected_at_rest(self, plugin: DockPlugin, stored: Pose2, settings: ExecutorSettings) -> Pose2:
        """Return the docked pose as the median of detections before the robot turns round.

        Raises:
            Ended: If the dock is not detected, or too far from its stored docked pose.
        """
        own, resources, goal = self._settings.own, self._resources, self._goal
        rules = measurement_rules(self._settings, plugin)
        measuring = Measuring(rules, resources.frames, plugin.detection, lambda _: None)
        seen: list[Pose2] = []
        with resources.topics.detecting(plugin, measuring, goal):
            until = time.monotonic() + settings.initial_perception_timeout
            while len(seen) < max(settings.least_detections, _DETECTIONS) and time.monotonic() < until:
                goal.check_end()
                goal.publish_progress(DockRobot.Feedback.INITIAL_PERCEPTION)
                time.sleep(POLL)
                for detection in measuring.measurements(resources.now()).detections:
                    with suppress(OptdockError):
                        robot = resources.frames.lookup(own.fixed_frame, own.base_frame, detection.stamp).planar()
                        seen.append(robot @ detection.pose)
        if len(seen) < settings.least_detections:
            text = f"{len(seen)} detections in {settings.initial_perception_timeout:g} s {measuring.faults or ''}"
            raise Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, text))
        gaps = np.array([pose.in_frame_of(seen[0]).as_array() for pose in seen])
        docked = seen[0] @ Pose2(*np.median(gaps, axis=0).tolist())
        far, most = docked.distance_to(stored), settings.max_detection_offset
        if far > most:
            text = f"the dock is {far:.3f} m from the stored dock, max_detection_offset is {most:.3f} m"
            raise Ended(failed(DockRobot.Result.FAILED_TO_DETECT_DOCK, text))
        return docked

    def _drive(
        self, plugin: DockPlugin, docked: Pose2, settings: ExecutorSettings, what: Literal["dock", "undock"]
    ) -> TaskDrive:
        """Return the drive of a robot at rest; raise `Ended` if its outline is missing."""
        of_server = self._settings
        robot = of_server.robot.robot(self._outline())
        if plugin.parameters.rotate_to_dock:
            robot = dataclasses.replace(robot, turns_in_place=True)
        dock = of_server.dock_parameters[plugin.name].dock(plugin, docked)
        frame = of_server.own.fixed_frame
        problem = DockingProblem(self._robot_pose(), dock, robot, clearance=of_server.clearance, frame=frame)
        return TaskDrive(self._resources, self._goal, plugin, problem, settings, what)
