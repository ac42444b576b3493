"""Invalid measurements: no exception, commands within the limits, an event for each ignored field."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.executor import DockingExecutor, EndingKind, ExecutorSettings
from optdock.executor.checked_inputs import usable
from optdock.executor.dock_estimate import staging_distance
from optdock.geometry.pose import Pose2, Twist2
from optdock.model.measurements import Detection, Measurements, OdometryPose
from tests.optdock.executor.conftest import BEFORE_DOCK, LIMITS, problem_with, run, simulated

SEEN = Detection(0.0, Pose2(0.0, 0.0, 0.0).in_frame_of(BEFORE_DOCK), 0.003, 0.005)


@pytest.mark.parametrize("sigma", [1e200, 1e3, math.inf, math.nan, -1.0])
@pytest.mark.parametrize("which", ["position_sigma", "yaw_sigma"])
def test_detection_with_an_invalid_sigma_is_not_used(which, sigma):
    executor = DockingExecutor(problem_with())
    executor.step(Measurements(0.0, BEFORE_DOCK))
    step = executor.step(Measurements(0.02, BEFORE_DOCK, detections=(SEEN._replace(**{which: sigma}),)))
    assert "detection not used" in [event.name for event in step.events]


@pytest.mark.parametrize(("ahead", "docks"), [(0.2, True), (0.4, False)])
def test_detections_ahead_of_the_clock_are_used_and_reported_once(ahead, docks):
    def before(executor, world, measurements):
        late = tuple(one._replace(stamp=one.stamp + ahead) for one in measurements.detections)
        return measurements._replace(detections=late)

    settings = ExecutorSettings(initial_perception_timeout=1.0, max_retries=0)
    docking = run(simulated(seed=1), settings=settings, before=before)
    assert (docking.ending.kind is EndingKind.DOCKED_BY_DISTANCE) is docks, docking.ending
    assert len(docking.said("detections ahead of the clock")) == docks
    assert bool(docking.said("detection not used")) is not docks
    if docks:
        assert abs(docking.world.error.y) <= 0.006


@pytest.mark.parametrize("twist", [Twist2(5.0, 0.0), Twist2(0.0, -1000.0), Twist2(-1e6, 1e6)])
def test_first_command_keeps_the_limits_for_any_odometry(twist):
    command = DockingExecutor(problem_with()).step(Measurements(0.0, BEFORE_DOCK, twist)).command
    assert -LIMITS.max_reverse_speed <= command.linear <= LIMITS.max_speed
    assert abs(command.angular) <= LIMITS.max_yaw_rate


def test_clock_that_goes_back_by_years_and_stands_still():
    executor = DockingExecutor(problem_with())
    stamps = [0.0, 0.02, 0.0401, -1999994.5197, -1999994.5197, -1999994.4797, -1999994.4797, -5e6, -5e6, -5e6 + 0.02]
    for _ in range(4):
        for stamp in stamps:
            executor.step(Measurements(stamp, BEFORE_DOCK))
        stamps = [stamp * 1.7 + 0.0130001 for stamp in stamps]


STAGING = Pose2(-staging_distance(problem_with()), 0.0, 0.0)
JUNK = st.sampled_from([None, math.nan, -1.0, True, "3", b"x", [], (), {}, object(), Pose2(0.0, 0.0, 0.0), [None]])
ODOMETRY = OdometryPose(0.0, BEFORE_DOCK)
WELL = Measurements(0.0, BEFORE_DOCK, Twist2(), (SEEN,), False, None, ODOMETRY, 0.0, current=0.5)


@settings(max_examples=25)
@given(st.dictionaries(st.sampled_from(WELL._fields), JUNK), st.lists(JUNK, max_size=2), JUNK, JUNK)
def test_usable_measurements_have_valid_types_and_faults_have_names(fields, seen, stamp, pose):
    given_ = WELL._replace(detections=(SEEN, *seen, SEEN._replace(stamp=stamp)))
    given_ = given_._replace(odometry=OdometryPose(stamp, pose))._replace(**fields)
    found, has_twist, faults = usable(given_)
    assert isinstance(found.stamp, int | float)
    assert found.pose is None or isinstance(found.pose, Pose2)
    assert isinstance(found.twist, Twist2)
    assert has_twist is isinstance(given_.twist, Twist2)
    assert all(isinstance(one.pose, Pose2) and math.isfinite(one.stamp) for one in found.detections)
    assert found.odometry is None or math.isfinite(found.odometry.stamp)
    named = {name.removesuffix(" not used") for name, _ in faults}
    for name in ("twist", "contact", "costmap", "odometry", "current"):
        assert (f"{name}" in named) is (getattr(found, name) is not getattr(given_, name))
    assert usable(found._replace(stamp=0.0)).faults == ()


def test_valid_measurements_are_unchanged():
    assert usable(WELL) == (WELL, True, ())


@pytest.mark.parametrize("given_", [None, 3, "x", (), Detection])
def test_any_object_is_accepted_as_measurements(given_):
    executor = DockingExecutor(problem_with())
    executor.step(Measurements(0.0, BEFORE_DOCK))
    step = executor.step(given_)
    assert "measurements not used" in [event.name for event in step.events]


@pytest.mark.parametrize(
    ("broken", "kind", "reason"),
    [
        ({"twist": None}, EndingKind.UNKNOWN, "no odometry for"),
        ({"pose": math.nan}, EndingKind.UNKNOWN, "no pose for"),
        ({"stamp": math.nan, "detections": ()}, EndingKind.FAILED_TO_DETECT_DOCK, "2 detections in 5.0 s"),
        ({"stamp": 7.0, "detections": ()}, EndingKind.FAILED_TO_DETECT_DOCK, "2 detections in 5.0 s"),
    ],
    ids=["no twist", "no pose", "no stamp", "a clock that stands"],
)
def test_missing_measurements_end_the_task_with_a_reason(broken, kind, reason):
    executor = DockingExecutor(
        problem_with(), ExecutorSettings(navigate_to_staging_pose=False, localization_timeout=3.0)
    )
    names, seen = set(), SEEN._replace(pose=Pose2(0.0, 0.0, 0.0).in_frame_of(STAGING))
    for k in range(400):
        well = Measurements(0.05 * k, STAGING, detections=(seen._replace(stamp=0.05 * k),))
        step = executor.step(well if k < 3 else well._replace(**broken))
        names |= {event.name for event in step.events}
        if step.ending is not None:
            break
    assert step.ending is not None
    assert step.ending.kind is kind
    assert reason in step.ending.reason
    assert step.command == Twist2()
    if broken.get("stamp") == 7.0:
        assert "clock stands still" in names


def test_repeated_odometry_pose_stops_the_robot_for_any_twist():
    """As of a driver that hands in a twist of 0 once nothing comes; a dock in view is no odometry."""
    frozen = []

    def before(executor, world, measurements):
        odometry = OdometryPose(measurements.stamp, world.state.pose)
        if world.time < 3.0:
            return measurements._replace(odometry=odometry)
        frozen.append(odometry)
        return measurements._replace(odometry=frozen[0], twist=Twist2(), pose=None)

    settings = ExecutorSettings(localization_timeout=2.0, max_retries=0)
    docking = run(simulated(Pose2(-2.0, 0.1, 0.0), seed=1), settings=settings, before=before, timeout=9.0)
    assert docking.said("no odometry")
    after = [t for t, step in zip(docking.times, docking.steps, strict=True) if abs(step.command.linear) > 1e-3]
    assert max(after) < 3.0 + settings.pose_patience + 1.5
