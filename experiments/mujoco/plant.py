"""Robot with masses, tyres, motors and a bumper in MuJoCo [Todorov2012]; needs the extra `sim`.

Every step of the physics records the force between robot and station and the slip of the wheels; every step of the
plant returns the true pose and the encoder readings. A state contains the full state of the physics: equal states and
commands give equal states, bit for bit, in any order of the calls.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from experiments.mujoco.model import Chassis, docking_model
from optdock.errors import InvalidValue, MissingExtra
from optdock.geometry.arrays import readonly
from optdock.geometry.pose import Pose2, Twist2, normalize_angle
from optdock.model.robot import admissible
from optdock.simulation.plant import Actuation, PlantState, arrivals, check_duration, first_order

if TYPE_CHECKING:
    from optdock.geometry.arrays import FloatArray
    from optdock.model.dock import Dock
    from optdock.model.robot import Robot

__all__ = ["MujocoDrive", "MujocoPhysics", "load_mujoco"]

_TOUCH = 1.0  # [N]: a switch that closes under a weight of 100 g, even for a millisecond
_SETTLING = 1000  # steps of the physics in which a robot placed on the floor settles on its tyres, 1 s


def load_mujoco() -> Any:  # noqa: ANN401 - MuJoCo is read without its types
    """Return the module `mujoco`.

    Raises:
        MissingExtra: If it is not installed.
    """
    try:
        import mujoco
    except ImportError as error:
        raise MissingExtra("contact physics needs mujoco: pip install mujoco, Python >= 3.11") from error
    return mujoco


class MujocoPhysics(NamedTuple):
    """Physical quantities of a step of the plant, and the state to continue from.

    Attributes:
        force: Force of the station on the robot in every step of the physics, along and across the docked robot's
            heading, Shape (n, 2) [N]: a negative longitudinal force pushes a robot in a forward dock back out.
        slip: Speed of the left and right rim over the floor, in every step of the physics, Shape (n, 2) [m/s].
        snapshot: State of MuJoCo.
    """

    force: FloatArray
    slip: FloatArray
    snapshot: FloatArray


class MujocoDrive:
    """A differential drive and a docking station with masses and contact.

    Commands set wheel speeds, which motors of limited torque follow; tyres and contact determine the motion. It is a
    `Plant`; the `physics` of its states is a `MujocoPhysics`.

    Args:
        robot: A differential drive; its drive limits clip every command.
        dock: Dock with its station.
        chassis: Masses, wheels, bumper; None: the default.
        actuation: Lags, latency, dead band and gains of the motors; the default has none.
        period: Default duration of a step [s].

    Attributes:
        model: MuJoCo's model, for inspection or rendering.
        data: MuJoCo's data, for inspection or rendering; the next `step` overwrites it.
        timestep: Time step of the physics [s].
        track_width: Distance between the wheels [m].

    Raises:
        MissingExtra: If MuJoCo is not installed.
        InvalidValue: If the robot is no differential drive or has no room for casters, or the period is not > 0.
    """

    def __init__(
        self,
        robot: Robot,
        dock: Dock,
        chassis: Chassis | None = None,
        actuation: Actuation | None = None,
        period: float = 0.02,
    ) -> None:
        check_duration(period, "plant.period")
        self.robot, self.dock, self.chassis, self.period = robot, dock, chassis or Chassis(), period
        self.actuation = actuation or Actuation()
        self._mujoco = mujoco = load_mujoco()
        self.model = mujoco.MjModel.from_xml_string(docking_model(robot, dock, self.chassis))
        self.data = mujoco.MjData(self.model)
        self.timestep = float(self.model.opt.timestep)
        self.track_width = self.chassis.track_of(robot)
        self._kind = mujoco.mjtState.mjSTATE_INTEGRATION
        self._size = mujoco.mj_stateSize(self.model, self._kind)
        self._station = self.model.body("station").id
        joints = [self.model.joint(f"{side} wheel") for side in ("left", "right")]
        self._angles = [int(joint.qposadr[0]) for joint in joints]
        self._rates = [int(joint.dofadr[0]) for joint in joints]
        self._settled: FloatArray | None = None

    def at_rest(self, pose: Pose2) -> PlantState:
        """Return the robot at rest at `pose`, without pending commands."""
        return self.moving(pose, Twist2())

    def moving(self, pose: Pose2, twist: Twist2) -> PlantState:
        """Return the robot at `pose` with a steady body velocity, which lasts until the first command arrives."""
        data = self.data
        if self._settled is None:
            self._settled = self._rest_position()
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[:] = self._settled
        data.qpos[:2] = pose.x, pose.y
        half = 0.5 * pose.yaw
        self._mujoco.mju_mulQuat(
            data.qpos[3:7], np.array([math.cos(half), 0.0, 0.0, math.sin(half)]), self._settled[3:7]
        )
        data.qvel[:2] = math.cos(pose.yaw) * twist.linear, math.sin(pose.yaw) * twist.linear
        data.qvel[5] = twist.angular
        data.qvel[self._rates] = data.ctrl[:] = self._wheel_speeds(twist.linear, twist.angular)
        drive = (twist.linear, twist.angular)
        physics = MujocoPhysics(_NOTHING, _NOTHING, self._snapshot())
        return PlantState(pose, twist, twist, 0.0, drive, drive, contact=False, physics=physics)

    def step(self, state: PlantState, command: Twist2, duration: float | None = None) -> PlantState:
        """Return the state after `duration` [s], by default one period, with `command` given now.

        Raises:
            InvalidValue: If the duration is not finite and > 0, or the state is not of a `MujocoDrive`.
        """
        if duration is None:
            duration = self.period
        check_duration(duration, "plant.duration")
        data = self.data
        self._enter(state)
        sent = self.actuation.target(admissible(command, self.robot.limits, self.robot.drive))
        pieces, target, pending = arrivals(state, self.actuation.latency, sent, duration)
        before, time, drive = data.qpos[self._angles], state.time, state.drive
        forces: list[FloatArray] = []
        slips: list[tuple[float, float]] = []
        for seconds, wanted in pieces:
            # On a fixed grid of physics steps, for any duration of a plant step.
            count = round((time + seconds) / self.timestep) - round(time / self.timestep)
            time += seconds
            for _ in range(count):
                drive = self._actuate(drive, wanted)
                self._mujoco.mj_step(self.model, data)
                self._mujoco.mj_rnePostConstraint(self.model, data)
                forces.append(data.cfrc_ext[self._station, 3:5].copy())
                slips.append(self._slip())
        turned = (data.qpos[self._angles] - before) * self.chassis.wheel_radius / duration
        force = self._on_robot(forces)
        physics = MujocoPhysics(force, readonly(np.array(slips).reshape(-1, 2)), self._snapshot())
        return PlantState(
            pose=self._pose(state.pose.yaw),
            twist=self._twist(),
            encoders=Twist2(0.5 * float(turned.sum()), float(turned[1] - turned[0]) / self.track_width),
            time=state.time + duration,
            drive=drive,
            target=target,
            pending=pending,
            contact=bool(np.any(np.hypot(force[:, 0], force[:, 1]) > _TOUCH)),
            physics=physics,
        )

    def stopped(self, state: PlantState, pose: Pose2, *, stalled: bool) -> PlantState:  # noqa: ARG002 - a plant's
        """Refuse: the station of this plant stops the robot physically.

        Raises:
            InvalidValue: Always.
        """
        raise InvalidValue("mujoco: the physics contains the station; the world must have none")

    def show(self, state: PlantState) -> None:
        """Set `data` to a state, for inspection or rendering."""
        self._enter(state)
        self._mujoco.mj_forward(self.model, self.data)

    def _enter(self, state: PlantState) -> None:
        if not (isinstance(state.physics, MujocoPhysics) and len(state.physics.snapshot) == self._size):
            raise InvalidValue("mujoco: the state must be one that a MujocoDrive of the same robot made")
        snapshot = state.physics.snapshot.copy()  # older versions of MuJoCo require a writable array
        self._mujoco.mj_setState(self.model, self.data, snapshot, self._kind)

    def _actuate(self, drive: tuple[float, float], wanted: tuple[float, float]) -> tuple[float, float]:
        """Command the motors with the current velocity on the way to the wanted one, and return it."""
        a, step = self.actuation, self.timestep
        linear = first_order(drive[0], wanted[0], a.linear_lag, step)[1]
        angular = first_order(drive[1], wanted[1], a.angular_lag, step)[1]
        self.data.ctrl[:] = self._wheel_speeds(linear, angular)
        return linear, angular

    def _on_robot(self, forces: list[FloatArray]) -> FloatArray:
        """Return the force on the robot in the docked robot's frame, from contact forces in the world frame."""
        on_station = np.array(forces).reshape(-1, 2)
        c, s = math.cos(self.dock.pose.yaw), math.sin(self.dock.pose.yaw)
        return readonly(-on_station @ np.array([[c, -s], [s, c]]))

    def _rest_position(self) -> FloatArray:
        """Return the joint positions of the robot settled on its tyres, far from the station."""
        data = self.data
        self._mujoco.mj_resetData(self.model, data)
        data.qpos[:2] = self.dock.pose.x - 100.0, self.dock.pose.y
        for _ in range(_SETTLING):
            self._mujoco.mj_step(self.model, data)
        settled = np.array(data.qpos)
        settled[self._angles] = 0.0
        return settled

    def _snapshot(self) -> FloatArray:
        physics = np.empty(self._size)
        self._mujoco.mj_getState(self.model, self.data, physics, self._kind)
        return readonly(physics)

    def _pose(self, yaw_before: float) -> Pose2:
        x, y = self.data.qpos[:2].tolist()
        c, s = self._heading()
        yaw = math.atan2(s, c)
        return Pose2(x, y, yaw_before + normalize_angle(yaw - yaw_before))

    def _twist(self) -> Twist2:
        """Return the velocity of the robot over the floor, independent of the wheels."""
        vx, vy, _, _, _, yaw_rate = self.data.qvel[:6].tolist()
        c, s = self._heading()
        return Twist2(c * vx + s * vy, yaw_rate, c * vy - s * vx)

    def _heading(self) -> tuple[float, float]:
        """Return cosine and sine of the yaw."""
        a, b, c, d = self.data.qpos[3:7].tolist()
        x, y = 1.0 - 2.0 * (c * c + d * d), 2.0 * (a * d + b * c)
        return x / math.hypot(x, y), y / math.hypot(x, y)

    def _wheel_speeds(self, linear: float, angular: float) -> tuple[float, float]:
        """Return the angular speeds of the left and the right wheel [rad/s]."""
        side, radius = 0.5 * self.track_width * angular, self.chassis.wheel_radius
        return (linear - side) / radius, (linear + side) / radius

    def _slip(self) -> tuple[float, float]:
        """Return the speeds of the left and the right rim over the floor [m/s]."""
        vx, vy, _, _, _, yaw_rate = self.data.qvel[:6].tolist()
        left, right = self.data.qvel[self._rates].tolist()
        c, s = self._heading()
        ahead, side, radius = c * vx + s * vy, 0.5 * self.track_width * yaw_rate, self.chassis.wheel_radius
        return radius * left - (ahead - side), radius * right - (ahead + side)


_NOTHING = readonly(np.zeros((0, 2)))
