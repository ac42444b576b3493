"""Clothoid splines against quadrature, closed forms and symmetries."""

import shutil

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.special import fresnel

from optdock.errors import InvalidValue
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.kernels import using_kernels

ORIGIN = Pose2(0.0, 0.0, 0.0)


def _area(x, y):
    return float(np.sum(np.diff(x) * (y[:-1] + y[1:]) / 2.0))


def random_spline(seed, sign=1, start=ORIGIN):
    rng = np.random.default_rng(seed)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(0.05, 1.0, 6))))
    return ClothoidSpline(start, knots, rng.uniform(-3.0, 3.0, 7), sign)


def in_both_lanes(run):
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(run())
    return found


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@settings(max_examples=60)
@given(st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 3.0, 60.0]), st.sampled_from([1, -1]))
def test_both_lanes_are_equal(seed, bend, sign):
    """Also for splines with cells that are divided, and beyond both ends."""
    rng = np.random.default_rng(seed)
    knots = np.concatenate(([0.0], np.cumsum(rng.uniform(1e-3, 1.0, rng.integers(1, 30)))))
    start, curvature = Pose2(*rng.uniform(-20.0, 20.0, 3)), bend * rng.uniform(-1.0, 1.0, knots.size)
    twin, native = in_both_lanes(lambda: ClothoidSpline(start, knots, curvature, sign))
    assert np.array_equal(twin.table, native.table)
    s = np.concatenate((knots, rng.uniform(-1.0, knots[-1] + 1.0, 40), [np.nan]))
    twin, native = in_both_lanes(lambda: twin.poses_at(s))
    assert np.array_equal(twin, native, equal_nan=True)


@pytest.mark.parametrize("seed", range(8))
def test_positions_agree_with_adaptive_quadrature(seed):
    spline = random_spline(seed)

    def yaw(s):
        inner = spline.knots[(spline.knots > 0) & (spline.knots < s)]
        points = np.concatenate(([0.0], inner, [s]))
        return _area(points, np.interp(points, spline.knots, spline.curvature)) if s > 0 else 0.0

    s = 0.83 * spline.length
    breaks = list(spline.knots[(spline.knots > 0) & (spline.knots < s)])
    x = quad(lambda u: np.cos(yaw(u)), 0.0, s, points=breaks, epsabs=1e-13, limit=200)[0]
    y = quad(lambda u: np.sin(yaw(u)), 0.0, s, points=breaks, epsabs=1e-13, limit=200)[0]
    assert np.allclose(spline.poses_at(s)[0], [x, y, yaw(s)], atol=1e-12)


def test_a_pure_clothoid_is_the_fresnel_integral():
    spline = ClothoidSpline(ORIGIN, [0.0, 2.0], [0.0, 2.0 * np.pi])
    s = np.linspace(0.0, 2.0, 33)
    sine, cosine = fresnel(s)
    assert np.allclose(spline.poses_at(s)[:, :2], np.column_stack((cosine, sine)), atol=1e-13)


def test_an_arc_is_a_circle():
    spline = ClothoidSpline(ORIGIN, [0.0, 30.0], [2.0, 2.0])
    poses = spline.poses_at(np.linspace(0.0, 30.0, 100))
    assert np.allclose(np.hypot(poses[:, 0], poses[:, 1] - 0.5), 0.5, atol=1e-12)
    assert poses[-1, 2] == pytest.approx(60.0)


def test_a_straight_line_is_exact():
    spline = ClothoidSpline(Pose2(1.0, 2.0, np.pi / 4), [0.0, 3.0], [0.0, 0.0], -1)
    assert np.allclose(spline.poses_at(3.0)[0], [1.0 - 3.0 / np.sqrt(2), 2.0 - 3.0 / np.sqrt(2), np.pi / 4])


@settings(max_examples=25)
@given(st.integers(0, 1000), st.sampled_from([1, -1]))
def test_the_frame_does_not_matter(seed, sign):
    frame = Pose2(3.0, -2.0, 1.1)
    plain, moved = random_spline(seed, sign), random_spline(seed, sign, frame)
    s = np.linspace(0.0, plain.length, 20)
    expected = [(frame @ Pose2.from_sequence(p)).as_array() for p in plain.poses_at(s)]
    assert np.allclose(moved.poses_at(s), expected, atol=1e-11)


@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_negated_curvature_mirrors_the_curve(seed):
    spline = random_spline(seed)
    mirrored = ClothoidSpline(ORIGIN, spline.knots, -spline.curvature)
    s = np.linspace(0.0, spline.length, 20)
    assert np.allclose(mirrored.poses_at(s) * [1.0, -1.0, -1.0], spline.poses_at(s), atol=1e-12)


@settings(max_examples=25)
@given(st.integers(0, 1000))
def test_driving_it_backwards_returns_to_the_start(seed):
    spline = random_spline(seed)
    back = ClothoidSpline(spline.end, spline.length - spline.knots[::-1], -spline.curvature[::-1], -1)
    s = np.linspace(0.0, spline.length, 20)
    assert np.allclose(back.poses_at(spline.length - s), spline.poses_at(s), atol=1e-11)


@settings(max_examples=25)
@given(st.integers(0, 1000), st.floats(0.01, 0.99))
def test_a_knot_more_changes_nothing(seed, where):
    spline = random_spline(seed)
    extra = where * spline.length
    knots = np.sort(np.append(spline.knots, extra))
    refined = ClothoidSpline(ORIGIN, knots, np.interp(knots, spline.knots, spline.curvature))
    s = np.linspace(0.0, spline.length, 20)
    assert np.allclose(refined.poses_at(s), spline.poses_at(s), atol=1e-12)


def test_derivatives_agree_with_finite_differences():
    spline, eps = random_spline(5, -1), 1e-6
    s = np.linspace(0.01, spline.length - 0.01, 50)
    s = s[np.min(np.abs(s[:, None] - spline.knots), axis=1) > 1e-4]
    slope = (spline.poses_at(s + eps) - spline.poses_at(s - eps)) / (2.0 * eps)
    yaw = spline.poses_at(s)[:, 2]
    assert np.allclose(slope[:, 2], spline.curvature_at(s), atol=1e-8)
    assert np.allclose(slope[:, :2], -np.column_stack((np.cos(yaw), np.sin(yaw))), atol=1e-8)
    rate = (spline.curvature_at(s + eps) - spline.curvature_at(s - eps)) / (2.0 * eps)
    assert np.allclose(rate, spline.curvature_rate_at(s), atol=1e-6)


@pytest.mark.parametrize(
    ("knots", "curvature", "sign", "message"),
    [
        ([0.0], [0.0], 1, "needs >= 2 knots"),
        ([0.0, 1.0], [0.0], 1, "needs >= 2 knots"),
        ([0.1, 1.0], [0.0, 0.0], 1, "start at 0"),
        ([0.0, 1.0, 1.0], [0.0, 0.0, 0.0], 1, "increase strictly"),
        ([0.0, np.nan], [0.0, 0.0], 1, "must be finite"),
        ([0.0, 1.0], [0.0, np.inf], 1, "must be finite"),
        ([0.0, 1.0], [0.0, 0.0], 0, "must be 1 or -1"),
        ([0.0, 1.0], [0.0, 1e9], 1, "more than can be evaluated"),
    ],
)
def test_invalid_splines_are_rejected(knots, curvature, sign, message):
    with pytest.raises(InvalidValue, match=message):
        ClothoidSpline(ORIGIN, knots, curvature, sign)


def test_arrays_are_copies_and_read_only():
    knots = np.array([0.0, 1.0])
    spline = ClothoidSpline(ORIGIN, knots, [0.0, 1.0])
    knots[1] = 5.0
    assert spline.length == 1.0
    with pytest.raises(ValueError, match="read-only"):
        spline.curvature[0] = 1.0


def test_a_sign_change_within_a_cell_is_integrated_to_1e_9():
    for width in np.linspace(0.4, 0.5, 11):
        coarse = ClothoidSpline(Pose2(0.0, 0.0, 0.3), [0.0, width], [1.0, -1.0])
        knots = np.linspace(0.0, width, 65)
        fine = ClothoidSpline(coarse.start, knots, 1.0 - 2.0 * knots / width)
        assert coarse.end.distance_to(fine.end) < 1e-9 * width


@pytest.mark.parametrize(
    ("start", "knots", "curvature", "message"),
    [
        (Pose2(0.0, 0.0, 9e5), [0.0, 1.0], [2.5e5, 2.5e5], "clothoid: (yaws must be within|turns by)"),
        (Pose2(9e7, 0.0, 0.0), [0.0, 1e7, 1e8], [0.0, 0.0, 0.0], "clothoid: coordinates must be within"),
        (Pose2(0.0, 0.0, 0.0), [0.0, 1.0, 1.0 + 2.5e-16], [0.0, 0.0, 1e16], "floats cannot resolve"),
        ([0.0, 0.0, 0.0], [0.0, 1.0], [0.0, 0.0], "clothoid.start: must be a Pose2"),
    ],
)
def test_unresolvable_splines_are_rejected(start, knots, curvature, message):
    with pytest.raises(InvalidValue, match=message):
        ClothoidSpline(start, knots, curvature)


@pytest.mark.parametrize("sign", [True, 0, 2, "1", 1.5, np.nan])
def test_a_sign_is_one_or_minus_one(sign):
    with pytest.raises(InvalidValue, match="clothoid.sign"):
        ClothoidSpline(Pose2(0.0, 0.0, 0.0), [0.0, 1.0], [0.0, 0.0], sign)
