"""Separating lines, witness rows and discs against shapely and finite differences."""

import numpy as np
import pytest
import shapely

from optdock.dock import Dock
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.limits import MotionLimits
from optdock.obstacles import ObstacleSet
from optdock.problem import ClearanceRule, DockingProblem
from optdock.robot import Robot
from smoothers._ck.discs import disc_centres, disc_rows
from smoothers._ck.planes import clearance
from smoothers._ck.rollout import Variables, roll_out, sensitivity
from smoothers._ck.rows import witness_rows
from smoothers._ck.world import world_around

BOX = Footprint.rectangle(0.45, 0.35, 0.6)
L_SHAPE = np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]])
FOOTPRINTS = {"box": BOX, "disc": Footprint.from_radius(0.4), "L": Footprint(L_SHAPE)}


def random_rocks(rng, rollout, count):
    rocks = []
    for _ in range(count):
        middle = rollout.poses[rng.integers(rollout.poses.shape[0]), :2] + rng.uniform(-0.9, 0.9, 2)
        angle = np.sort(rng.uniform(0.0, 2.0 * np.pi, rng.integers(3, 7)))
        if np.diff(np.append(angle, angle[0] + 2.0 * np.pi)).max() > np.pi - 0.2:
            angle = np.linspace(0.0, 2.0 * np.pi, 5)[:-1]
        rocks.append(middle + rng.uniform(0.05, 0.4) * np.column_stack((np.cos(angle), np.sin(angle))))
    return rocks


def random_case(cases, seed, footprint=BOX, shape=((6, 2), (5, 2)), rule=None, rocks=8):
    layout, variables, start, signs = cases.random_path(seed, shape)
    rollout = roll_out(layout, variables, start, signs)
    rng = np.random.default_rng(100 + seed)
    rule = rule or ClearanceRule(0.0, 0.0, 0.0)
    goal = Pose2.from_sequence(rollout.poses[-1])
    problem = DockingProblem(
        Pose2.from_sequence(start),
        Dock(goal),
        Robot(footprint, MotionLimits()),
        ObstacleSet.from_polygons(random_rocks(rng, rollout, rocks)),
        rule,
    )
    return layout, variables, problem, world_around(problem, rollout.poses[:, :2], 1.0), signs


def swept_outlines(layout, rollout, problem, signs, found, k):
    """The footprint part of a pair at 60 poses of its interval, driven from the interval's own left node."""
    interval = found.pairs.interval[k]
    left, step = layout.left[interval], rollout.steps[interval]
    ends = rollout.curvature[left : left + 2]
    sign = int(signs[layout.interval_gear[interval]])
    spline = ClothoidSpline(Pose2.from_sequence(rollout.poses[left]), np.array([0.0, step]), ends, sign)
    body = problem.robot.footprint.bodies[found.pairs.part[k]].vertices
    return shapely.polygons(transform_points(spline.poses_at(np.linspace(0.0, step, 60)), body))


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(4))
def test_no_margin_exceeds_the_true_distance(cases, name, seed):
    layout, variables, problem, world, signs = random_case(cases, seed, FOOTPRINTS[name])
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    found = clearance(world, layout, rollout, signs, 0.4)
    assert found.margin.size > 20
    rng = np.random.default_rng(seed)
    for k in rng.choice(found.margin.size, min(60, found.margin.size), replace=False):
        rock = shapely.Polygon(world.obstacles.vertices[found.pairs.obstacle[k]])
        outlines = swept_outlines(layout, rollout, problem, signs, found, k)
        truth = float(shapely.distance(outlines, rock).min())
        if truth > 0.0:
            assert found.margin[k] <= truth + 1e-6
        else:
            assert found.margin[k] <= 1e-6


@pytest.mark.parametrize("seed", range(4))
def test_the_margin_is_close_to_the_distance_on_short_intervals(cases, seed):
    layout, variables, problem, world, signs = random_case(cases, seed, shape=((6, 12), (5, 12)))
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    found = clearance(world, layout, rollout, signs, 0.4)
    shortfalls = []
    for k in np.flatnonzero(found.margin > 0.02)[:80]:
        rock = shapely.Polygon(world.obstacles.vertices[found.pairs.obstacle[k]])
        truth = float(shapely.distance(swept_outlines(layout, rollout, problem, signs, found, k), rock).min())
        shortfalls.append(truth - found.margin[k])
    assert np.median(shortfalls) < 5e-4
    assert np.max(shortfalls) < 0.02


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_every_close_pair_is_found(cases, name):
    layout, variables, problem, world, signs = random_case(cases, 7, FOOTPRINTS[name], rocks=4)
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    found = clearance(world, layout, rollout, signs, 0.1)
    seen = set(zip(found.pairs.interval, found.pairs.part, found.pairs.obstacle, strict=True))
    assert len(seen) == found.margin.size < 150
    for interval in range(layout.num_intervals):
        pose = rollout.poses[layout.left[interval]][None]
        for part, body in enumerate(problem.robot.footprint.bodies):
            outline = shapely.Polygon(transform_points(pose, body.vertices)[0])
            for rock in range(len(world.obstacles)):
                if outline.distance(shapely.Polygon(world.obstacles.vertices[rock])) < 0.1 - 1e-9:
                    assert (interval, part, rock) in seen


def test_the_requirement_is_subtracted(cases):
    rule = ClearanceRule(0.07, 0.0, 0.0)
    layout, variables, problem, world, signs = random_case(cases, 3, rule=rule)
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    with_rule = clearance(world, layout, rollout, signs, 0.3)
    free = random_case(cases, 3)[3]
    without = clearance(free, layout, rollout, signs, 0.3)
    inner = with_rule.pairs.interval < layout.num_intervals - 1
    assert with_rule.margin[inner] == pytest.approx(without.margin[inner] - 0.07, abs=1e-9)


@pytest.mark.parametrize("seed", range(5))
def test_required_clearance_has_the_right_gradient(cases, seed):
    world = random_case(cases, seed, rule=ClearanceRule(0.1, 0.02, 0.8))[3]
    world = type(world)(world.obstacles, world.body, world.rule, world.start, world.goal, 0.01)
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (40, 2)) + world.goal
    found = world.required(points)
    for axis in range(2):
        shift = np.zeros(2)
        shift[axis] = 1e-7
        slope = (world.required(points + shift).value - world.required(points - shift).value) / 2e-7
        assert found.gradient[:, axis] == pytest.approx(slope, abs=1e-5)


def test_required_clearance_is_the_problem_s(cases):
    _, _, problem, world, _ = random_case(cases, 2, rule=ClearanceRule(0.1, 0.02, 0.8))
    world = type(world)(world.obstacles, world.body, world.rule, world.start, world.goal, 0.03)
    points = np.random.default_rng(2).uniform(-2.0, 2.0, (200, 2)) + world.goal
    from_goal, from_start = (np.hypot(*(points - end).T) for end in (world.goal, world.start))
    wanted = problem.clearance.required_at(from_goal, from_start, 0.03)
    assert world.required(points).value == pytest.approx(wanted, abs=1e-12)


def margins(found):
    """Margin of every pair by (interval, part, obstacle)."""
    return dict(zip(zip(*found.pairs, strict=True), found.margin, strict=True))


@pytest.mark.parametrize("seed", range(4))
def test_the_lowest_row_predicts_the_margin(cases, seed):
    """After a small step the margin is the smallest of the pair's rows, but for the second order and the dip."""
    layout, variables, problem, world, signs = random_case(cases, seed, shape=((6, 8), (5, 8)), rocks=3)
    start = problem.start.as_array()
    rollout = roll_out(layout, variables, start, signs)
    found = clearance(world, layout, rollout, signs, 0.3)
    step = 1e-4 * np.random.default_rng(seed).uniform(-1.0, 1.0, layout.size)
    moved = np.concatenate(variables) + step
    moved = Variables(moved[: layout.num_knots], moved[layout.num_knots :])
    after = margins(clearance(world, layout, roll_out(layout, moved, start, signs), signs, 0.4))
    by = sensitivity(layout, variables, rollout)
    errors, changes = [], []
    for pair, key in enumerate(zip(*found.pairs, strict=True)):
        rows = witness_rows(layout, rollout, by, found, np.array([pair]))
        gap, margin = float(rows.gap.min()), float(found.margin[pair])
        if 0.0 < margin > gap - 2e-3:
            errors.append(abs(after[key] - margin - float((rows.gap + rows.gradient @ step).min()) + gap))
            changes.append(abs(after[key] - margin))
    assert len(errors) > 0.4 * np.sum(found.margin > 0.0)
    assert np.median(errors) < 0.05 * np.median(changes)


def test_discs_lie_inside_a_rectangle():
    centres, radius = disc_centres(BOX.vertices)
    outline = shapely.Polygon(BOX.vertices)
    for centre in centres:
        assert outline.buffer(1e-9).contains(shapely.Point(centre).buffer(radius))


def test_discs_of_a_needle_are_few():
    centres, radius = disc_centres(Footprint.rectangle(1.5, 1.5, 2e-4).vertices)
    assert len(centres) <= 32
    assert radius == pytest.approx(1e-4)
    assert np.abs(centres[:, 0]).max() <= 1.5


@pytest.mark.parametrize("seed", range(4))
def test_disc_rows_are_exact_to_first_order(cases, seed):
    layout, variables, problem, world, signs = random_case(cases, seed)
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    found = clearance(world, layout, rollout, signs, 0.2)
    chosen = np.flatnonzero(found.margin < 0.0)
    assert chosen.size
    rows = disc_rows(world, layout, rollout, sensitivity(layout, variables, rollout), found, chosen)
    step = 1e-6 * np.random.default_rng(seed).uniform(-1.0, 1.0, layout.size)
    moved = np.concatenate(variables) + step
    after = roll_out(
        layout, Variables(moved[: layout.num_knots], moved[layout.num_knots :]), problem.start.as_array(), signs
    )
    again = disc_rows(world, layout, after, sensitivity(layout, variables, after), found, chosen)
    error = np.abs(again.gap - rows.gap - rows.gradient @ step)
    assert np.quantile(error, 0.9) < 1e-9


def test_a_disc_inside_a_rock_is_pushed_to_the_nearest_side(cases):
    layout, variables, problem, world, signs = random_case(cases, 0)
    rollout = roll_out(layout, variables, problem.start.as_array(), signs)
    found = clearance(world, layout, rollout, signs, 0.2)
    deepest = np.array([int(np.argmin(found.margin))])
    rows = disc_rows(world, layout, rollout, sensitivity(layout, variables, rollout), found, deepest)
    assert rows.gap.min() < 0.0
    assert np.isfinite(rows.gradient).all()
