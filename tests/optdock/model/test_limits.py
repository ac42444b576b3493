"""The table of limits contains every field of `MotionLimits`, and every user of the table supports every row."""

import dataclasses
import math
from types import MappingProxyType

import numpy as np
import pytest

from experiments.fuzz.oracle.timing import LIMITED
from optdock.config import scenario_reference
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.constant_jerk import TimeLaw
from optdock.model.limits import DIMENSIONS, LIMITS, LimitKind, MotionLimits, SpeedZone, finite_limits
from optdock.model.path import ClothoidSegment, Path
from optdock.model.robot import Drive, Robot
from optdock.model.trajectory import Trajectory
from optdock.testing.contracts import TimeParameterizerContract
from optdock.verification import certify_trajectory, path_rules

FIELDS = {field.name: field.default for field in dataclasses.fields(MotionLimits)}
BOUNDS = sorted(FIELDS.keys() - DIMENSIONS.keys())
STEERED = {"wheelbase": 0.5, "track_width": 0.4}


def test_every_field_is_described():
    assert FIELDS.keys() == LIMITS.keys() | DIMENSIONS.keys()
    assert isinstance(LIMITS, MappingProxyType)  # what certificates ask nobody can write into
    for name, limit in LIMITS.items():
        assert limit.name == name
        assert limit.finite is math.isfinite(FIELDS[name])
        assert (limit.size is not None) is (limit.kind is LimitKind.TURNING)
        assert all((limit.unit, limit.formula, limit.words))
    quantities = [limit.quantity for limit in LIMITS.values() if limit.name != "max_reverse_speed"]
    assert len(set(quantities)) == len(quantities)


@pytest.mark.parametrize("name", BOUNDS)
def test_every_limit_is_a_key_of_scenario_files_with_its_unit(name):
    rows = {row.key: row for row in scenario_reference()}
    row = rows[f"robot.limits.{name}"]
    assert (row.unit, row.rule.startswith("finite")) == (LIMITS[name].unit, LIMITS[name].finite)


@pytest.mark.parametrize("name", BOUNDS)
def test_every_finite_limit_has_a_ratio_or_belongs_to_the_path_certificate(name):
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0, 2.0], [0.0, 0.5, 0.0])
    ramps = TimeLaw([1.0, 1.0, 3.0, 1.0, 1.0], [0.4, -0.4, 0.0, -0.4, 0.4])
    motion = Trajectory(Path((ClothoidSegment(spline),)), ramps)
    limits = MotionLimits(**STEERED, **{name: min(FIELDS[name], 1.5)})
    certificate = certify_trajectory(motion, limits, SpeedZone())
    assert certificate.certified, certificate.reason
    if LIMITS[name].kind is LimitKind.PATH:
        assert name in path_rules._LIMITED
    else:
        assert 0.0 < certificate.ratios[LIMITS[name].quantity] <= 1.0 + 1e-6


@pytest.mark.parametrize("name", [*BOUNDS, *sorted(DIMENSIONS)])
def test_every_field_counts_in_the_digest_of_a_robot(name):
    outline = Footprint.from_radius(0.3)
    limits = MotionLimits(**STEERED)
    other = dataclasses.replace(limits, **{name: 0.75 * getattr(limits, name) if FIELDS[name] else 0.7})
    if not math.isfinite(getattr(limits, name)):
        other = dataclasses.replace(limits, **{name: 0.3})
    found = [Robot(outline, one, Drive.ACKERMANN).fingerprint.limits for one in (limits, other)]
    assert found[0] != found[1]


def test_unset_limits_do_not_change_digests():
    """These digests are older than the lateral jerk limit."""
    robots = (
        Robot(Footprint.from_radius(0.3), MotionLimits()),
        Robot(Footprint.from_radius(0.3), MotionLimits(wheelbase=2.8, max_steering_rate=0.4), Drive.ACKERMANN),
    )
    assert [robot.fingerprint.limits for robot in robots] == ["cf75a4fdb0d88c6a", "0ea433716e378367"]


def test_finite_limits_are_the_finite_bounds():
    assert finite_limits(MotionLimits(track_width=0.5)).keys() == {name for name in BOUNDS if LIMITS[name].finite}
    assert finite_limits(MotionLimits(max_curvature=2.0))["max_curvature"] == 2.0


@pytest.mark.parametrize("name", BOUNDS)
def test_the_oracle_and_the_timing_contract_cover_every_limit(name):
    assert LIMITS[name].kind is LimitKind.PATH or LIMITS[name].quantity in LIMITED
    _plain, every = TimeParameterizerContract.limits(None)
    assert LIMITS[name].kind is LimitKind.PATH or math.isfinite(getattr(every, name))


def test_quantities_of_curvature_agree_with_finite_differences():
    """Along s(t) = 0.3 t + 0.1 t^2 on a curve of curvature 0.4 + 0.7 s, by differences of a microsecond."""
    drive, h, t = MotionLimits(track_width=0.4, wheelbase=0.5), 1e-6, np.linspace(0.1, 2.0, 20)

    def at(t):
        s, v = 0.3 * t + 0.1 * t * t, 0.3 + 0.2 * t
        return s, v, 0.4 + 0.7 * s

    class Motion:
        _s, v, k = at(t)
        a, r = np.full(t.size, 0.2), np.full(t.size, 0.7)

    def slope(of):
        return np.abs(of(t + h) - of(t - h)) / (2.0 * h)

    expected = {
        "max_yaw_rate": slope(lambda t: 0.4 * at(t)[0] + 0.35 * at(t)[0] ** 2),
        "max_yaw_acceleration": slope(lambda t: at(t)[1] * at(t)[2]),
        "max_lateral_acceleration": Motion.v * slope(lambda t: 0.4 * at(t)[0] + 0.35 * at(t)[0] ** 2),
        "max_lateral_jerk": slope(lambda t: at(t)[1] ** 2 * at(t)[2]),
        "max_wheel_speed": slope(lambda t: at(t)[0] + 0.2 * (0.4 * at(t)[0] + 0.35 * at(t)[0] ** 2)),
        "max_steering_rate": slope(lambda t: np.arctan(0.5 * at(t)[2])),
    }
    assert expected.keys() == {name for name, limit in LIMITS.items() if limit.size}
    for name, values in expected.items():
        np.testing.assert_allclose(LIMITS[name].size(Motion, drive), values, rtol=1e-7)
