"""Sensors: statistics, clocks and faults."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2, Twist2
from optdock.simulation import DockSensor, Odometry, PoseSensor

ORIGIN = Pose2(0.0, 0.0, 0.0)
DOCK = Pose2(2.0, 1.0, 0.7)


def poses(sensor, count=4000, seed=1, period=0.01):
    reader = sensor.reader(seed)
    return np.array([reader.measure(k * period, ORIGIN).as_array() for k in range(count)])


def detections(sensor, path, period=0.02, seed=1):
    """Those of a drive: `path(time)` is the true pose."""
    reader, found, k = sensor.reader(seed), [], 0
    while k * period <= 4.0:
        found.extend((k * period, one) for one in reader.measure(k * period, path(k * period), DOCK))
        k += 1
    return found


def straight(time):
    return Pose2(0.5 * time - 1.0, 0.2, 0.3)


class TestPoseSensor:
    def test_noise_has_the_given_sigmas_and_no_mean(self):
        found = poses(PoseSensor(0.002, 0.01))
        assert np.mean(found, axis=0) == pytest.approx([0.0, 0.0, 0.0], abs=5e-4)
        assert np.std(found, axis=0) == pytest.approx([0.002, 0.002, 0.01], rel=0.05)

    @pytest.mark.parametrize("period", [0.01, 0.1])
    def test_a_walk_spreads_with_the_root_of_time_at_any_period(self, period):
        ends = np.array([poses(PoseSensor(position_walk=0.01, yaw_walk=0.02), 41, s, period)[-1] for s in range(400)])
        root = math.sqrt(40 * period)
        assert np.std(ends, axis=0) == pytest.approx([0.01 * root, 0.01 * root, 0.02 * root], rel=0.1)

    def test_jumps_add_up_and_stay(self):
        reader, found = PoseSensor().reader(), []
        for jump in (ORIGIN, Pose2(0.03, 0.0, 0.0), Pose2(0.0, 0.05, 0.1)):
            reader.jump(jump)
            found += [reader.measure(len(found) + k, ORIGIN).as_array() for k in range(2)]
        assert np.array_equal(found, np.repeat([[0.0, 0.0, 0.0], [0.03, 0.0, 0.0], [0.03, 0.05, 0.1]], 2, axis=0))


class TestOdometry:
    def test_gains_and_noise(self):
        reader = Odometry(1.1, 0.9, 0.01, 0.02).reader(2)
        found = [reader.measure(Twist2(0.3, 0.5), 0.01) for _ in range(4000)]
        linear, angular = np.array([(twist.linear, twist.angular) for twist in found]).T
        assert (np.mean(linear), np.mean(angular)) == pytest.approx((0.33, 0.45), abs=2e-3)
        assert (np.std(linear), np.std(angular)) == pytest.approx((0.01, 0.02), rel=0.05)

    @settings(max_examples=25)
    @given(st.floats(-0.5, 0.5), st.floats(-1.0, 1.0), st.floats(0.01, 0.1))
    def test_ticks_sum_up_to_the_distance(self, v, w, period):
        sensor = Odometry(tick=0.001, track_width=0.4)
        reader = sensor.reader()
        reader.measure(Twist2(v, w), 0.0)
        told = [reader.measure(Twist2(v, w), period) for _ in range(50)]
        assert sum(t.linear for t in told) * period == pytest.approx(50 * v * period, abs=0.0011)
        assert sum(t.angular for t in told) * period == pytest.approx(50 * w * period, abs=0.0011 / 0.2)


class TestDockSensor:
    def test_a_perfect_detector_measures_the_dock_at_the_time_of_the_image(self):
        found = detections(DockSensor(rate=13.0, latency=0.06), straight)
        assert [one.stamp for _, one in found] == pytest.approx(np.arange(len(found)) / 13.0)
        for told, one in found:
            assert one.stamp + 0.06 - 1e-9 <= told < one.stamp + 0.06 + 0.02
            assert (straight(one.stamp) @ one.pose).gap_to(DOCK) < 1e-12

    def test_the_robot_drives_an_arc_between_two_calls(self):
        def circle(time):
            return Pose2(math.sin(time), 1.0 - math.cos(time), time)

        found = detections(DockSensor(rate=17.0), circle, period=0.1)
        assert max((circle(one.stamp) @ one.pose).gap_to(DOCK) for _, one in found) < 1e-12

    @pytest.mark.parametrize("distance", [0.3, 1.0, 3.0])
    def test_noise_grows_with_distance_and_detections_contain_its_sigmas(self, distance):
        sensor = DockSensor(rate=1000.0, position_sigma=0.003, yaw_sigma=0.005, near=1.0, growth=0.5)
        robot = DOCK @ Pose2(-distance, 0.0, 0.4)
        found = [one for _, one in detections(sensor, lambda _: robot)]
        share = 1.0 + 0.5 * max(0.0, distance - 1.0)
        errors = np.array([(one.pose.in_frame_of(DOCK.in_frame_of(robot))).as_array() for one in found])
        assert np.std(errors, axis=0) == pytest.approx([0.003 * share, 0.003 * share, 0.005 * share], rel=0.06)
        assert (found[0].position_sigma, found[0].yaw_sigma) == pytest.approx((0.003 * share, 0.005 * share))

    def test_field_of_view_and_range(self):
        sensor = DockSensor(rate=1.0, camera=Pose2(0.2, 0.0, math.pi), field_of_view=1.0, min_range=0.5, max_range=2.0)

        def sees(x, y):
            robot = DOCK @ Pose2(x, y, 0.0)  # looks backward: the dock lies at -x
            return bool(sensor.reader().measure(0.0, robot, DOCK))

        assert sees(0.8, 0.0)
        assert not sees(-0.8, 0.0)
        assert (sees(0.29, 0.0), sees(0.31, 0.0), sees(1.79, 0.0), sees(1.81, 0.0)) == (False, True, True, False)
        inside, outside = 0.99 * math.tan(0.5), 1.01 * math.tan(0.5)
        assert (sees(0.8, inside), sees(0.8, outside)) == (True, False)

    def test_drop_outs_have_the_given_frequency(self):
        found = detections(DockSensor(rate=1000.0, drop_out=0.3), straight)
        assert len(found) / 4001 == pytest.approx(0.7, abs=0.03)

    def test_faults_do_not_change_other_detections(self):
        sensor = {"rate": 10.0, "position_sigma": 0.01, "yaw_sigma": 0.01}
        whole, broken = DockSensor(**sensor).reader(), DockSensor(**sensor, drop_out=0.2).reader()
        broken.lose(0.35)
        broken.displace_next(Pose2(0.0, 0.3, 0.0))
        expected, found = (
            {one.stamp: one for k in range(30) for one in reader.measure(0.1 * k, ORIGIN, ORIGIN)}
            for reader in (whole, broken)
        )
        assert 10 < len(found) < 26
        first = min(found)
        assert first > 0.35
        assert found[first].pose.y == pytest.approx(expected[first].pose.y + 0.3)
        assert all(found[stamp] == expected[stamp] for stamp in found if stamp != first)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: PoseSensor(-0.1), "pose_sensor.position_sigma: must be finite and >= 0, got -0.1"),
        (lambda: DockSensor(marker=0.1), "dock_sensor.marker: must be a Pose2"),
        (lambda: Odometry(tick=0.01), "odometry.track_width: must be > 0 m"),
        (lambda: DockSensor(rate=0.0), "dock_sensor.rate: must be > 0 Hz"),
        (lambda: DockSensor(drop_out=1.1), "dock_sensor.drop_out: must be a probability"),
        (lambda: DockSensor(min_range=1.0, max_range=0.5), "dock_sensor.max_range: must be > min_range"),
    ],
)
def test_invalid_values_are_errors(build, message):
    with pytest.raises(InvalidValue, match=message):
        build()
