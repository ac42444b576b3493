"""Calibration: known truths lie inside the intervals, and unknown quantities have a reason."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from typer.testing import CliRunner

from optdock.calibration import as_text, as_yaml, calibrate, read_recording, save_calibration_picture, written_values
from optdock.calibration.conformal_tube import conformal_rank, conformal_tube
from optdock.calibration.detections import detection_quantities
from optdock.calibration.drive_response import DriveResponse, answered, drive_response
from optdock.calibration.localization import localization_errors, stored_dock
from optdock.calibration.motion_smoother import smoothed
from optdock.calibration.odometry import odometry_quantities
from optdock.calibration.statistics import fit, mean_of, poisson_rate, share_of
from optdock.cli import app
from optdock.errors import InvalidFile, InvalidValue
from optdock.executor import ExecutorSettings
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, Twist2, displacement
from optdock.ros.bag import BagMessage, bag_types, write_bag
from optdock.ros.motion import odometry_message, pose_message, twist_message

from .conftest import DOCK, ROBOT, drive


@pytest.fixture(scope="module")
def found(drives):
    return calibrate(drives[0], [(0.01, 0.02)] * 4, coverage=0.8)


def contains(quantity, truth, slack=0.0):
    assert quantity.reason == ""
    assert quantity.low - slack <= truth <= quantity.high + slack, (quantity, truth)


# Statistics.


def test_no_event_in_a_time_bounds_the_rate_by_the_exponential_law():
    assert poisson_rate(0, 10.0) == pytest.approx((0.0, 0.0, -math.log(0.025) / 10.0))


def test_a_share_of_none_or_all_is_bounded_by_the_binomial_law():
    assert share_of(0, 20) == pytest.approx((0.0, 0.0, 1.0 - 0.025 ** (1 / 20)))
    low, high = share_of(20, 20)[1:]
    assert (low, high) == pytest.approx((0.025 ** (1 / 20), 1.0))


def test_the_interval_of_a_mean_of_two_is_that_of_the_cauchy_distribution():
    mean, low, high = mean_of(np.array([1.0, 3.0]))
    half = math.tan(0.5 * math.pi * 0.95)  # Student's t with one degree of freedom, times the standard error of 1
    assert (mean, low, high) == pytest.approx((2.0, 2.0 - half, 2.0 + half))


def test_a_fit_leaves_single_wrong_values_alone_and_counts_clusters():
    random = np.random.default_rng(1)
    x = np.linspace(0.0, 1.0, 200)
    y = 2.0 + 3.0 * x + 0.01 * random.standard_normal(200)
    y[::20] += 5.0
    alone = fit(lambda p: p[0] + p[1] * x - y, (0.0, 0.0), np.arange(200), (1.0, 1.0))
    assert alone.values == pytest.approx([2.0, 3.0], abs=0.02)
    twice = np.concatenate((x, x)), np.concatenate((y, y))
    double = fit(lambda p: p[0] + p[1] * twice[0] - twice[1], (0.0, 0.0), np.tile(np.arange(200), 2), (1.0, 1.0))
    # Every value told twice is no more than told once.
    assert double.covariance == pytest.approx(alone.covariance, rel=1e-3)


# The drive.


def test_the_answer_to_a_step_is_the_first_order_one():
    latency, lag, speed = 0.2, 0.15, 0.4
    at = np.linspace(0.0, 2.0, 50)
    way = answered(np.array([0.0]), np.array([speed]), (latency, lag, 1.0, 0.0), at)
    late = np.maximum(at - latency, 0.0)
    assert way == pytest.approx(speed * (late - lag * (1.0 - np.exp(-late / lag))), abs=2e-5)


def test_latency_and_lag_are_found(found, drives):
    for axis in ("linear", "angular"):
        contains(found.quantity(f"command latency, {axis}"), drives[1]["latency"], 1e-3)
        contains(found.quantity(f"drive lag, {axis}"), drives[1]["lag"], 1e-3)
        assert found.quantity(f"command latency, {axis}").half_width < 0.02


def test_dead_bands_are_found_wheel_by_wheel():
    rows = {one.name: one for one in drive_response([drive(duration=6.0, bands=(0.03, 0.05))]).quantities}
    contains(rows["dead band, left wheel"], 0.03)
    contains(rows["dead band, right wheel"], 0.05)
    assert rows["dead band, right wheel"].half_width < 0.01


# Odometry and detections.


@pytest.mark.parametrize(
    ("hidden", "name"),
    [
        ("scale", "scale of the distance"),
        ("drift", "turn per metre"),
        ("turn_scale", "scale of turns"),
        ("late", "detections late by"),
        ("window", "twist window"),
    ],
)
def test_errors_of_the_odometry_are_found(found, drives, hidden, name):
    contains(found.quantity(name), drives[1][hidden])


def test_wheels_follow_from_way_and_turns(found):
    scale, drift, turns = (
        found.quantity(name).value for name in ("scale of the distance", "turn per metre", "scale of turns")
    )
    radii = [found.quantity(f"{side} wheel's radius outside the plausible range").value for side in ("left", "right")]
    assert np.mean(radii) == pytest.approx(scale)
    assert radii[1] - radii[0] == pytest.approx(drift * ROBOT.limits.track_width)
    assert found.quantity("track width outside the plausible range").value == pytest.approx(scale - turns)


def test_the_noise_of_detections_is_found(found, drives):
    contains(found.quantity("detection sigma, position, at range 0"), 0.002, 5e-4)
    contains(found.quantity("detection sigma, position, per range"), 0.004, 5e-4)
    contains(found.quantity("detection sigma, yaw, per range"), 0.006, 1e-3)
    contains(found.quantity("wrong detections"), drives[1]["wrong"])


def test_the_blind_distance_of_a_camera_is_found(found):
    contains(named(detection_quantities(smoothed([drive(seed=5, blind=0.9)])))["blind distance"], 0.9)
    assert found.quantity("blind distance").value == 0.0


def test_the_motion_does_not_depend_on_the_frame_of_the_odometry():
    one = drive(seed=4, duration=5.0)
    c, s = math.cos(1.0), math.sin(1.0)
    turned = one.odometry.copy()
    turned[:, 1:3] = one.odometry[:, 1:3] @ np.array([[c, s], [-s, c]]) + [5.0, -3.0]
    turned[:, 3] += 1.0
    here, there = smoothed([one]), smoothed([one._replace(odometry=turned)])
    assert there.values == pytest.approx(here.values, abs=2e-4)


# Localization and the dock.


def test_the_stored_dock_is_found(found):
    for part, truth in zip(("x", "y", "yaw"), DOCK.as_array().tolist(), strict=True):
        contains(found.quantity(f"stored dock, {part}"), truth)


def test_a_jump_of_the_localization_is_found():
    motion = smoothed([drive(seed=seed, duration=5.0, jump=(3.0, 0.08)) for seed in (1, 2)])
    rows = named(localization_errors(motion).quantities)
    assert rows["size of localization jumps"].value == pytest.approx(0.08, abs=0.01)
    contains(rows["localization jumps"], 2 / 17.0)


# Unknown quantities.


def named(quantities):
    return {one.name: one for one in quantities}


def reasons(quantities):
    return {one.name: one.reason for one in quantities if not one}


def test_a_robot_that_never_turned():
    one = drive(duration=5.0, turning=0.0, seed=3)
    answer, wheels = reasons(drive_response([one]).quantities), reasons(odometry_quantities(smoothed([one]), 0.4))
    assert "no turning commands" in answer["command latency, angular"]
    assert "command latency, linear" not in answer
    assert "turned by" in wheels["scale of turns"]
    assert "scale of the distance" not in wheels


def test_a_robot_that_never_moved():
    found = reasons(calibrate([drive(duration=5.0, speed=0.0, turning=0.0)]).quantities)
    for name in (
        "command latency, linear",
        "drive lag, angular",
        "twist window",
        "scale of the distance",
        "turn per metre",
    ):
        assert re.search("contain no|never|only", found[name])


def test_no_detections_no_track_width_and_no_odometry_pose():
    bare = dataclasses.replace(ROBOT, limits=dataclasses.replace(ROBOT.limits, track_width=0.0))
    one = drive(robot=bare, detections=False)
    one = one._replace(odometry=np.zeros((0, 4)), odometry_twists=np.zeros((0, 2)), odometry_ages=np.zeros(0))
    found = calibrate([one])
    assert found.quantity("scale of the distance").reason == found.quantity("stored dock, x").reason
    assert "not detected" in found.quantity("stored dock, x").reason
    assert "track_width" in found.quantity("dead band, left wheel").reason
    assert "no poses" in found.quantity("twist window").reason
    assert found.quantity("command latency, linear")


def test_one_recording_and_none_that_docked():
    motion = smoothed([drive(duration=5.0)])
    for docked_at, reason in ((5.0, "one docking succeeded"), (None, "no docking succeeded")):
        (one,) = motion.of
        one = one._replace(recording=one.recording._replace(docked_at=docked_at))
        assert all(reason in row.reason for row in stored_dock(motion._replace(of=(one,))))


@pytest.mark.parametrize("cycles", [0, 1, 2, 25, 60])
def test_a_short_recording_is_no_error(cycles):
    one = drive(duration=2.0)
    end = one.times[cycles]
    told = {"odometry": one.odometry[:cycles], "odometry_twists": one.odometry_twists[:cycles]}
    cut = one._replace(
        times=one.times[:cycles], commands=one.commands[:cycles], twists=one.twists[:cycles], **told,
        odometry_ages=one.odometry_ages[:cycles], localization=one.localization[one.localization[:, 0] < end],
        detections=one.detections[one.detections[:, 0] < end], docked_at=None,
    )  # fmt: skip
    found = calibrate([cut])
    for name in ("command latency, linear", "dead band, left wheel", "drive lag, angular", "twist window"):
        assert any(
            part in found.quantity(name).reason
            for part in ("less than 4 s", "no poses", "the recordings contain no", "no command was")
        )
    as_text(found)


def short(**changes):
    return drive(duration=1.0, detections=False, **changes)


def test_robots_and_docks_that_differ_are_refused():
    wide, faster = (
        dataclasses.replace(ROBOT, limits=dataclasses.replace(ROBOT.limits, **change))
        for change in ({"track_width": 0.5}, {"max_wheel_speed": 0.7})
    )
    long = dataclasses.replace(ROBOT, footprint=Footprint.rectangle(0.3, 0.3, 0.6))
    for change, message in (
        ({"robot": wide}, "track width of 0.5 m"),
        ({"robot": long}, "footprint"),
        ({"stored": Pose2(0.0, 0.0, 0.0)}, "one dock at a time"),
    ):
        with pytest.raises(InvalidValue, match=message):
            calibrate([short(), short(seed=1, **change)])
    assert calibrate([short(), short(seed=1, robot=faster)])


def test_no_drive_and_a_drive_that_is_given_twice_are_refused():
    with pytest.raises(InvalidValue, match="at least one recording"):
        calibrate([])
    with pytest.raises(InvalidValue, match=r"copy\.jsonl: contains the same drive as drive-0"):
        calibrate([short(), short()._replace(source="copy.jsonl")])


# The tube.


@settings(max_examples=30)
@given(st.integers(1, 300), st.floats(0.01, 0.99))
def test_the_rank_is_the_smallest_that_covers(count, coverage):
    rank = conformal_rank(count, coverage)
    assert rank / (count + 1) >= coverage - 1e-6
    assert (rank - 1) / (count + 1) < coverage


def test_another_docking_stays_inside_with_the_coverage():
    random = np.random.default_rng(0)
    inside = 0
    for _ in range(400):
        rows = random.exponential(0.01, (20, 2))
        tube = conformal_tube([tuple(row) for row in rows[:19]], 0.4, 0.9).tube
        width = displacement(tube.cross, tube.yaw, 0.4)
        inside += displacement(rows[19, 0], rows[19, 1], 0.4) <= width
    assert 0.86 <= inside / 400 <= 0.95  # 18 of 20 ranks, give or take three standard deviations


def test_the_tube_needs_enough_dockings_and_an_outline():
    found = conformal_tube([(0.01, 0.01)] * 98, 0.4, 0.99)
    assert found.tube is None
    assert "99 are needed" in found.quantities[0].reason
    assert conformal_tube([(0.01, 0.01)] * 99, 0.4, 0.99).tube is not None
    outlineless = conformal_tube([(0.01, 0.01)] * 99, 0.0, 0.99)  # as run files are
    assert outlineless.tube is None
    assert "footprint" in outlineless.quantities[0].reason


# Reports and files.


def test_written_keys_exist(found):
    values = yaml.safe_load(as_yaml(found))
    assert values == written_values(found)
    settings = ExecutorSettings(**values["executor"])
    assert settings.detection_delay_sigma == pytest.approx(0.12, abs=0.02)
    assert values["dock"]["pose"] == pytest.approx(DOCK.as_array().tolist(), abs=0.05)
    assert displacement(*values["robot"]["tracking"].values(), ROBOT.footprint.circumscribed_radius) == pytest.approx(
        displacement(0.01, 0.02, ROBOT.footprint.circumscribed_radius), rel=1e-3
    )


def test_the_report_has_a_line_for_every_quantity(found):
    text = as_text(found)
    assert [one.name for one in found.quantities if one.name not in text] == []


def test_the_picture_is_drawn(found, tmp_path, monkeypatch):
    monkeypatch.setattr("optdock.plotting.canvas.DPI", 50)
    save_calibration_picture(tmp_path / "found.png", found)
    assert (tmp_path / "found.png").stat().st_size > 10_000
    nothing = found._replace(motion=None, localization=None, response=DriveResponse([], []), recordings=())
    save_calibration_picture(tmp_path / "nothing.svg", nothing)
    assert (tmp_path / "nothing.svg").exists()


def run_file(path):
    times = np.arange(0.0, 6.0, 0.02)
    speed = 0.2 * np.sin(times)
    x = 0.2 * (1.0 - np.cos(times))
    zero = np.zeros(len(times))
    columns = {"t": times, "speed": speed, "yaw_rate": zero, "command_speed": speed, "command_yaw_rate": zero}
    for of in ("", "measured_", "planned_"):
        columns |= {f"{of}x": x, f"{of}y": zero, f"{of}yaw": zero}
    columns = {name: column.tolist() for name, column in columns.items()}
    path.write_text(json.dumps({"format": "optdock-run/1", "docked": True, "columns": columns}))
    return path


def test_a_run_file_is_calibrated_by_the_command(tmp_path):
    source = run_file(tmp_path / "run.json")
    target, report = (tmp_path / name for name in ("found.yaml", "found.txt"))
    arguments = ["calibrate", str(source), "--write", str(target), "--report", str(report)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert "command latency, linear" in result.output
    assert "no turning commands" in result.output
    assert all(one.exists() for one in (target, report))
    assert CliRunner().invoke(app, ["calibrate", str(source), "--write", str(source)]).exit_code == 2
    assert CliRunner().invoke(app, ["calibrate", str(source), "--coverage", "100"]).exit_code == 2


@pytest.mark.parametrize("text", ["", "{", "[]", '{"format": "optdock-plan/1"}', '{"format": "optdock-log/1"}\n'])
def test_files_of_other_kinds_are_refused_by_name(tmp_path, text):
    source = tmp_path / "other.jsonl"
    source.write_text(text)
    with pytest.raises(InvalidFile, match=r"other\.jsonl"):
        read_recording(source)
    assert CliRunner().invoke(app, ["calibrate", str(source)]).exit_code == 2


def bag_of(path, recording, base="base_link", without=()):
    """The same drive as a recording of ROS 2."""
    start, messages = 100.0, []
    for (stamp, *pose), (linear, angular) in zip(recording.odometry, recording.odometry_twists, strict=True):
        at = Pose2(*pose), Twist2(linear, angular)
        messages.append(("/odom", stamp, odometry_message(bag_types, *at, "odom", "base_link", start + stamp)))
    for stamp, (linear, angular) in zip(recording.times.tolist(), recording.commands, strict=True):
        messages.append(("/cmd_vel", stamp, twist_message(bag_types, Twist2(linear, angular), stamped=False)))
    for stamp, x, y, yaw, *_ in recording.detections:
        found = pose_message(bag_types, Pose2(x, y, yaw), base, start + stamp)
        messages.append(("/detected_dock_pose", stamp + 0.1, found))
    write_bag(path, [BagMessage(topic, start + at, one) for topic, at, one in messages if topic not in without])
    return path


def test_a_recording_of_ros_contains_the_same_drive(tmp_path):
    one = drive(seed=6, duration=1.5, late=0.1)
    read = read_recording(bag_of(tmp_path / "drive.mcap", one)).recording
    assert read.commands == pytest.approx(one.commands)
    assert read.times == pytest.approx(one.times, abs=1e-6)
    assert read.odometry == pytest.approx(one.odometry, abs=1e-6)
    assert read.odometry_twists == pytest.approx(one.odometry_twists)
    assert read.twists == pytest.approx(one.twists, abs=0.03)  # of this cycle or the next
    assert read.detections[:, :4] == pytest.approx(one.detections[:, :4], abs=1e-6)


def test_incomplete_recordings_are_refused(tmp_path):
    one = drive(seed=6, duration=2.0)
    with pytest.raises(InvalidFile, match="has no commands"):
        read_recording(bag_of(tmp_path / "no.mcap", one, without=("/cmd_vel",)))
    once = one._replace(odometry=one.odometry[:1], odometry_twists=one.odometry_twists[:1])
    with pytest.raises(InvalidFile, match="must have at least two messages, has 1"):
        read_recording(bag_of(tmp_path / "once.mcap", once))
    with pytest.raises(InvalidFile, match="must be in frame base_link, is in map"):
        read_recording(bag_of(tmp_path / "other.mcap", one, base="map"))


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(InvalidFile):
        read_recording(tmp_path / "nothing.jsonl")
