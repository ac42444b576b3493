"""The robot with masses, tyres, motors and a bumper, in MuJoCo [Todorov2012]; needs the extra `sim`.

Every step of the physics gives the force between robot and station and the slip of the wheels; every call of `step`
the true pose and what the wheels' encoders say. A state holds everything that the physics needs to go on from it: equal
states and commands give equal states, bit for bit, in whatever order they are asked for.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.errors import InvalidValue, MissingExtra
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.robot import admissible
from optdock.simulation.mujoco.model import Chassis, docking_model
from optdock.simulation.plant import Actuation

if TYPE_CHECKING:
    from types import ModuleType

    from optdock.dock import Dock
    from optdock.geometry.arrays import FloatArray
    from optdock.robot import Robot

__all__ = ["MujocoDrive", "MujocoState", "load_mujoco"]

_TOUCH = 1.0  # [N]: a switch that closes at the weight of 100 g
_SETTLING = 1000  # steps of the physics in which a robot that was put on the floor sinks into its tyres, 1 s


def load_mujoco() -> ModuleType:
    """The module `mujoco`.

    Raises:
        MissingExtra: It is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtra("contact physics needs mujoco: pip install 'optdock[sim]', Python >= 3.11") from error
    return mujoco


class MujocoState(NamedTuple):
    """The robot at the end of a step, and what happened during it.

    Attributes:
        pose: True pose of the point between the wheels.
        twist: Body velocity by the encoders: the wheels' turn during the step; their slip is not in it.
        pending: Commands that have not taken effect yet, each with the time when it will [s], the oldest first.
        time: Since the first state [s].
        force: Of the station on the robot in every step of the physics, along and across the docked robot's heading,
            Shape (n, 2) [N]: negative along pushes a robot that came forward back out of its dock.
        slip: Speed of the left and right rim over the floor, in every step of the physics, Shape (n, 2) [m/s].
        physics: All that the physics needs to go on.
    """

    pose: Pose2
    twist: Twist2
    pending: tuple[tuple[float, Twist2], ...]
    time: float
    force: FloatArray
    slip: FloatArray
    physics: FloatArray

    @property
    def contact(self) -> bool:
        """Whether robot and station press on each other at the end of the step."""
        return bool(len(self.force)) and math.hypot(*self.force[-1].tolist()) > _TOUCH


class MujocoDrive:
    """A differential drive and a docking station with masses and contact.

    Commands go to the wheels as speeds, which motors of limited torque follow; what becomes of the robot is up to tyres
    and contact.

    Args:
        robot: A differential drive; its drive limits cut every command.
        dock: Where the station stands.
        chassis: Masses, wheels, bumper; the default one if None.
        actuation: Lags, latency, dead band and gains ahead of the motors; its sub-steps mean nothing here.

    Attributes:
        model: MuJoCo's model, for whoever wants to look at or draw it.
        data: MuJoCo's data, likewise; the next `step` overwrites it.
        timestep: Of the physics [s].
        track_width: Distance between the wheels [m].

    Raises:
        MissingExtra: MuJoCo is not installed.
        InvalidValue: The robot is no differential drive, or has no room for casters.
    """

    def __init__(
        self, robot: Robot, dock: Dock, chassis: Chassis | None = None, actuation: Actuation | None = None
    ) -> None:
        self.robot, self.dock, self.chassis = robot, dock, chassis or Chassis()
        self.actuation = actuation or Actuation()
        mujoco = load_mujoco()
        self._mujoco: Any = mujoco
        self.model: Any = mujoco.MjModel.from_xml_string(docking_model(robot, dock, self.chassis))
        self.data: Any = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        self.track_width = self.chassis.track_of(robot)
        self._kind = mujoco.mjtState.mjSTATE_INTEGRATION
        self._size = mujoco.mj_stateSize(self.model, self._kind)
        self._station = self.model.body("station").id
        self._settled: FloatArray | None = None

    def at_rest(self, pose: Pose2) -> MujocoState:
        """The robot standing at `pose`, no command under way."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> MujocoState:
        """The robot rolling at `pose` with a steady body velocity, which the commands under way keep up."""
        data = self.data
        if self._settled is None:
            self._settled = self._rest_position()
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self._settled
        data.qpos[:2] = pose.x, pose.y
        half = 0.5 * pose.yaw
        data.qpos[3:7] = _product((math.cos(half), 0.0, 0.0, math.sin(half)), data.qpos[3:7].tolist())
        c, s = math.cos(pose.yaw), math.sin(pose.yaw)
        data.qvel[:2] = c * twist.linear, s * twist.linear
        data.qvel[5] = twist.angular
        data.qvel[6:8] = data.ctrl[:] = self._wheel_speeds(twist)
        return MujocoState(pose, twist, (), 0.0, _NOTHING, _NOTHING, self._snapshot())

    def step(self, state: MujocoState, command: Twist2, duration: float) -> MujocoState:
        """The state after `duration` [s], `command` being given now.

        Raises:
            InvalidValue: The duration is not > 0.
        """
        if not (math.isfinite(duration) and duration > 0.0):
            raise InvalidValue(f"mujoco: the duration of a step must be finite and > 0 s, got {duration}")
        mujoco, model, data = self._mujoco, self.model, self.data
        mujoco.mj_setState(model, data, state.physics, self._kind)
        end = state.time + duration
        count = round(end / self.timestep) - round(state.time / self.timestep)
        pending = [*state.pending, (state.time + self.actuation.latency, self._effective(command))]
        before = data.qpos[7:9].copy()
        forces, slips = np.zeros((count, 3)), np.zeros((count, 2))
        target = data.ctrl.copy()
        for i in range(count):
            now = state.time + i * self.timestep
            while pending and pending[0][0] <= now + 0.5 * self.timestep:
                target[:] = self._wheel_speeds(pending.pop(0)[1])
            data.ctrl[:] = target
            mujoco.mj_step(model, data)
            mujoco.mj_rnePostConstraint(model, data)
            forces[i] = data.cfrc_ext[self._station, 3:6]
            slips[i] = self._slip()
        turned = (data.qpos[7:9] - before) * self.chassis.wheel_radius / duration
        twist = Twist2(0.5 * float(turned.sum()), float(turned[1] - turned[0]) / self.track_width)
        c, s = math.cos(self.dock.pose.yaw), math.sin(self.dock.pose.yaw)
        along, across = c * forces[:, 0] + s * forces[:, 1], c * forces[:, 1] - s * forces[:, 0]
        return MujocoState(
            self._pose(state.pose.yaw),
            twist,
            tuple(pending),
            end,
            readonly(-np.column_stack((along, across))),
            readonly(slips),
            self._snapshot(),
        )

    def put(self, state: MujocoState) -> None:
        """Bring `data` into a state, for whoever wants to look at or draw it."""
        self._mujoco.mj_setState(self.model, self.data, state.physics, self._kind)
        self._mujoco.mj_forward(self.model, self.data)

    def _rest_position(self) -> FloatArray:
        """Joint positions of the robot settled on its tyres, far from the station."""
        data = self.data
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[:2] = self.dock.pose.x - 100.0, self.dock.pose.y
        for _ in range(_SETTLING):
            self._mujoco.mj_step(self.model, data)
        settled = np.array(data.qpos)
        settled[7:9] = 0.0
        return settled

    def _snapshot(self) -> FloatArray:
        physics = np.empty(self._size)
        self._mujoco.mj_getState(self.model, self.data, physics, self._kind)
        return readonly(physics)

    def _pose(self, yaw_before: float) -> Pose2:
        x, y, _, a, b, c, d = self.data.qpos[:7].tolist()
        yaw = math.atan2(2.0 * (a * d + b * c), 1.0 - 2.0 * (c * c + d * d))
        return Pose2(x, y, yaw_before + normalize_angle(yaw - yaw_before))

    def _wheel_speeds(self, twist: Twist2) -> tuple[float, float]:
        """Of the left and the right wheel [rad/s]."""
        side = 0.5 * self.track_width * twist.angular
        return (twist.linear - side) / self.chassis.wheel_radius, (twist.linear + side) / self.chassis.wheel_radius

    def _slip(self) -> tuple[float, float]:
        """Of the left and the right wheel [m/s]: speed of the rim less that of the axle above it."""
        vx, vy, _, _, _, yaw_rate, left, right = self.data.qvel[:8].tolist()
        a, b, c, d = self.data.qpos[3:7].tolist()
        ahead = vx * (1.0 - 2.0 * (c * c + d * d)) + vy * 2.0 * (a * d + b * c)
        side, radius = 0.5 * self.track_width * yaw_rate, self.chassis.wheel_radius
        return radius * left - (ahead - side), radius * right - (ahead + side)

    def _effective(self, command: Twist2) -> Twist2:
        cut = admissible(command, self.robot.limits, self.robot.drive)
        a = self.actuation
        linear = cut.linear if abs(cut.linear) >= a.linear_dead_band else 0.0
        angular = cut.angular if abs(cut.angular) >= a.angular_dead_band else 0.0
        return Twist2(a.linear_gain * linear, a.angular_gain * angular)


_NOTHING = readonly(np.zeros((0, 2)))


def _product(p: tuple[float, ...], q: list[float]) -> tuple[float, float, float, float]:
    """Of two quaternions."""
    a, b, c, d = p
    e, f, g, h = q
    return (
        a * e - b * f - c * g - d * h,
        a * f + b * e + c * h - d * g,
        a * g - b * h + c * e + d * f,
        a * h + b * g - c * f + d * e,
    )
