"""MuJoCo plant: contact satisfies the balances of mechanics, and free driving equals the kinematic plant."""

import dataclasses
import math
import sys
from importlib.util import find_spec
from xml.etree import ElementTree

import numpy as np
import pytest
from PIL import Image

from experiments.mujoco import Chassis, MujocoDrive, VShape, docking_model, flat_station
from experiments.mujoco.animation import save_mujoco_animation
from optdock.errors import InvalidValue, MissingExtra
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.robot import Drive, Robot
from optdock.simulation import Actuation, DifferentialDrive, PoseSensor, Sensors, SimulatedRobot, executed_clearance

needs_mujoco = pytest.mark.skipif(find_spec("mujoco") is None, reason="needs the extra sim")

ORIGIN = Pose2(0.0, 0.0, 0.0)
BOX = Robot(Footprint.rectangle(0.3, 0.25, 0.5), MotionLimits(max_speed=0.5))
V = VShape()
NOSED = Robot(V.with_nose(0.3, 0.3, 0.5), BOX.limits)
PLATE, WINGS = Dock(ORIGIN, flat_station(BOX.footprint)), Dock(ORIGIN, V.station(NOSED.footprint))


def driven(drive, state, command, seconds, period=0.05):
    states = [state]
    for _ in range(round(seconds / period)):
        states.append(drive.step(states[-1], command, period))
    return states


def forces(states):
    return np.concatenate([state.physics.force for state in states])


class TestStations:
    @pytest.mark.parametrize("gear", [1.0, -1.0])
    @pytest.mark.parametrize("kind", ["flat", "V"])
    def test_docked_robot_touches_the_station(self, kind, gear):
        direction = DockDirection.FORWARD if gear > 0.0 else DockDirection.BACKWARD
        v = VShape(direction=direction)
        robot = BOX.footprint if kind == "flat" else v.with_nose(0.3, 0.2, 0.5)
        outline = flat_station(robot, direction=direction) if kind == "flat" else v.station(robot)
        station = ObstacleSet.from_polygons([outline.vertices])
        poses = [np.array([[gear * x, 0.0, 0.0]]) for x in (-0.01, 0.0, 0.01)]
        found = [executed_clearance(robot, pose, station) for pose in poses]
        assert found[0] > 0.005
        assert found[1] == pytest.approx(0.0, abs=1e-12)
        assert found[2] < -0.005

    def test_invalid_stations_are_refused(self):
        with pytest.raises(InvalidValue, match="station.width: must be > 0 m"):
            flat_station(BOX.footprint, width=0.0)
        with pytest.raises(InvalidValue, match="station.half_angle"):
            VShape(half_angle=2.0).station(NOSED.footprint)
        with pytest.raises(InvalidValue, match="nose of 0.32 m is wider than the robot"):
            V.with_nose(0.3, 0.3, 0.3)
        with pytest.raises(InvalidValue, match="must be forward or backward, got auto"):
            flat_station(BOX.footprint, direction=DockDirection.AUTO)


class TestModel:
    def test_model_contains_outline_and_station(self):
        root = ElementTree.fromstring(docking_model(NOSED, WINGS))
        for name, footprint in (("robot", NOSED.footprint), ("station", WINGS.footprint)):
            geoms = root.findall(f".//body[@name='{name}']/geom")
            meshes = {mesh.get("name"): mesh.get("vertex") for mesh in root.findall("asset/mesh")}
            assert len(geoms) == len(footprint.bodies)
            for geom, body in zip(geoms, footprint.bodies, strict=True):
                corners = np.array(meshes[geom.get("mesh")].split(), dtype=float).reshape(-1, 3)
                assert np.array_equal(corners[: len(body.vertices), :2], body.vertices)

    def test_invalid_chassis_is_refused(self):
        for wrong in ({"mass": 0.0}, {"tyre_friction": -1.0}, {"restitution": 0.1}, {"bumper": (0.2, 0.1)}):
            with pytest.raises(InvalidValue, match=f"chassis.{next(iter(wrong))}: must be"):
                Chassis(**wrong)
        with pytest.raises(InvalidValue, match="drive is ackermann"):
            docking_model(Robot(BOX.footprint, BOX.limits, Drive.ACKERMANN), PLATE)
        with pytest.raises(InvalidValue, match="6 cm before and behind its axle"):
            docking_model(Robot(Footprint.rectangle(0.5, 0.0, 0.5), BOX.limits), PLATE)

    def test_without_mujoco_the_extra_is_named(self, monkeypatch):
        monkeypatch.setitem(sys.modules, "mujoco", None)
        with pytest.raises(MissingExtra, match=r"pip install mujoco, Python >= 3.11"):
            MujocoDrive(BOX, PLATE)


@needs_mujoco
class TestDriving:
    @pytest.mark.parametrize(
        "twist",
        [Twist2(0.2), Twist2(0.2, 0.3), Twist2(0.0, -0.5), Twist2(-0.15, 0.4)],
        ids=["straight", "arc", "turn", "back"],
    )
    def test_free_driving_equals_the_kinematic_plant(self, twist):
        """Within half a percent of the distance and 1.5 % of the turn (resistance of the casters), and the servos' 10
        ms.
        """
        start, late = Pose2(-5.0, 2.0, 3.0), Actuation(linear_lag=0.1, angular_lag=0.05, latency=0.07)
        found = [
            driven(drive, drive.at_rest(start), twist, 3.0)
            for drive in (MujocoDrive(BOX, PLATE, actuation=late), DifferentialDrive(BOX, late))
        ]
        ours, kinematic = (states[-1] for states in found)
        error = ours.pose.in_frame_of(kinematic.pose)
        way, turn = 3.0 * abs(twist.linear), 3.0 * abs(twist.angular)
        late_by = 0.011 / 3.0
        assert abs(error.yaw) <= (0.015 + late_by) * turn + 1e-9
        assert math.hypot(error.x, error.y) <= (0.005 + late_by) * way + 0.5 * abs(error.yaw) * way + 3e-4
        assert np.max(np.abs(np.concatenate([state.physics.slip for state in found[0]]))) < 1e-3
        for name in ("twist", "encoders"):
            found = getattr(ours, name)
            assert found.linear == pytest.approx(twist.linear, abs=0.002)
            assert found.angular == pytest.approx(twist.angular, abs=0.005)

    def test_equal_states_and_commands_give_equal_states_in_any_order(self):
        drive = MujocoDrive(BOX, PLATE)
        first = driven(drive, drive.at_rest(Pose2(-0.02, 0.01, 0.05)), Twist2(0.1, 0.1), 0.4)
        driven(drive, first[3], Twist2(-0.2), 0.2)
        again = driven(drive, first[0], Twist2(0.1, 0.1), 0.4)
        assert first[-1].pose == again[-1].pose
        assert np.array_equal(forces(first), forces(again))
        assert np.any(forces(first))

    def test_steps_of_any_duration_are_one_motion(self):
        drive = MujocoDrive(BOX, PLATE, actuation=Actuation(latency=0.03))
        start = drive.at_rest(Pose2(-1.0, 0.0, 0.0))
        whole = drive.step(drive.step(start, Twist2(0.2), 0.1), Twist2(0.1, 0.2), 0.1)
        state = start
        for i, command in enumerate([Twist2(0.2)] * 3 + [Twist2(0.1, 0.2)] * 3):
            state = drive.step(state, command, (0.0333, 0.0411, 0.0256)[i % 3])
        assert state.pose.gap_to(whole.pose) < 1e-9

    def test_simulated_robot_with_the_plant(self):
        robot = SimulatedRobot(
            MujocoDrive(BOX, PLATE), Pose2(-0.01, 0.0, 0.0), ORIGIN, Sensors(PoseSensor(0.002, 0.002))
        )
        found = [robot.measurements, *(robot.advance(Twist2(0.1), 0.05) for _ in range(8))]
        assert (found[0].contact, found[-1].contact) == (False, True)
        assert robot.record().contact[-1]


@needs_mujoco
class TestContact:
    @pytest.mark.parametrize(("mass", "speed", "restitution"), [(None, 0.05, 0.3), (80.0, 0.2, 0.6)])
    def test_impulse_of_an_impact(self, mass, speed, restitution):
        """Momentum with wheels and rotors, 1.1 times the robot's; weak motors, casters without resistance."""
        chassis = Chassis(mass=mass, restitution=restitution, wheel_torque=1e-3, caster_friction=0.0)
        drive = MujocoDrive(BOX, PLATE, chassis)
        start = drive.moving(Pose2(-0.3 * speed, 0.0, 0.0), Twist2(speed))
        found = forces(driven(drive, start, Twist2(speed), 0.6))
        mass = 1.1 * (chassis.mass_of(BOX) + 1.4)
        assert -found[:, 0].sum() * drive.timestep == pytest.approx(mass * speed * (1.0 + restitution), rel=0.03)
        undamped = speed * math.sqrt(mass * chassis.bumper_stiffness)
        assert 0.7 * undamped < -found[:, 0].min() < 1.4 * undamped
        assert np.abs(found[:, 1]).max() < 1e-4

    @pytest.mark.parametrize(("friction", "torque", "expected"), [(0.8, 2.0, 2.0 * 2.0 / 0.075), (0.3, 8.0, None)])
    def test_static_pushing_force(self, friction, torque, expected):
        drive = MujocoDrive(BOX, PLATE, Chassis(tyre_friction=friction, wheel_torque=torque, caster_friction=0.0))
        end = driven(drive, drive.moving(Pose2(-0.01, 0.0, 0.0), Twist2(0.05)), Twist2(0.05), 2.0)[-1]
        if expected is None:  # the tyres slip
            drive.show(end)
            expected = friction * load_on_tyres(drive)
            assert np.min(end.physics.slip) > 0.02
        assert np.mean(end.physics.force[:, 0]) == pytest.approx(-expected, rel=0.03)
        assert end.contact

    def test_v_centres_the_nose(self):
        """The wings push the nose to the apex; the tyres hold the axle, so a lateral error becomes a yaw error."""
        drive = MujocoDrive(NOSED, WINGS)
        end = driven(drive, drive.moving(Pose2(-0.1, 0.03, 0.0), Twist2(0.1)), Twist2(0.1), 4.0)[-1]
        nose = end.pose @ Pose2(0.46, 0.0, 0.0)
        assert abs(nose.y) < 0.012
        assert end.pose.y > 0.02
        assert end.pose.yaw == pytest.approx(-end.pose.y / 0.35, rel=0.1)

    def test_dock_pose_and_backward_docking(self):
        """The same motion in the frame of the dock; backward it is mirrored."""
        place, found = Pose2(2.0, -1.0, 2.0), []
        symmetric = dataclasses.replace(BOX, footprint=Footprint.rectangle(0.3, 0.3, 0.5))
        for pose, gear, direction in ((ORIGIN, 1.0, "FORWARD"), (place, 1.0, "FORWARD"), (ORIGIN, -1.0, "BACKWARD")):
            dock = Dock(pose, flat_station(symmetric.footprint, direction=DockDirection[direction]))
            drive = MujocoDrive(symmetric, dock)
            start = drive.moving(pose @ Pose2(-0.01 * gear, 0.01, 0.05 * gear), Twist2(0.1 * gear))
            states = driven(drive, start, Twist2(0.1 * gear), 0.5)
            end = states[-1].pose.in_frame_of(pose)
            found.append((Pose2(gear * end.x, end.y, gear * end.yaw), forces(states).sum(axis=0) * (gear, 1.0)))
        for pose, force in found[1:]:
            assert pose.gap_to(found[0][0]) < 2e-4
            assert force == pytest.approx(found[0][1], rel=0.02)


def load_on_tyres(drive):
    import mujoco

    total, force = 0.0, np.zeros(6)
    for i, contact in enumerate(drive.data.contact):
        if "tyre" in drive.model.geom(contact.geom2).name:
            mujoco.mj_contactForce(drive.model, drive.data, i, force)
            total += force[0]
    return total


@needs_mujoco
class TestAnimation:
    def test_animation_shows_the_robot_at_its_dock(self, tmp_path):
        drive = MujocoDrive(BOX, PLATE)
        states = driven(drive, drive.moving(Pose2(-0.05, 0.0, 0.0), Twist2(0.2)), Twist2(0.2), 0.3)
        try:
            save_mujoco_animation(tmp_path / "drive.gif", drive, states)
        except MissingExtra as error:
            pytest.skip(str(error))
        with Image.open(tmp_path / "drive.gif") as picture:
            assert picture.n_frames == 3
            picture.seek(2)
            pixels = np.array(picture.convert("RGB")).astype(int)
        red, _, blue = np.moveaxis(pixels, 2, 0)
        robot, station = blue - red > 80, red - blue > 40
        assert robot.sum() > 5 * station.sum() > 10_000

    def test_missing_renderer_is_reported(self, tmp_path, monkeypatch):
        drive = MujocoDrive(BOX, PLATE)
        states = driven(drive, drive.at_rest(Pose2(-0.05, 0.0, 0.0)), Twist2(0.2), 0.1)
        for kind in ("egl", "osmesa", "glfw"):
            monkeypatch.setitem(sys.modules, f"mujoco.{kind}", None)
        with pytest.raises(MissingExtra, match="install EGL or OSMesa"):
            save_mujoco_animation(tmp_path / "drive.gif", drive, states)
        assert list(tmp_path.iterdir()) == []
