"""Separating planes, their rows and covering discs against shapely and finite differences."""

import dataclasses

import numpy as np
import pytest
import shapely

from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.footprint import Footprint
from optdock.geometry.obstacles import ObstacleSet
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.clearance_rule import ClearanceRule
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from smoothers.scp.basis import basis_for
from smoothers.scp.collision.broad_phase import broad_phase
from smoothers.scp.collision.collision_scene import body_at_nodes, covering_discs, scene_around
from smoothers.scp.collision.linearization import covering_disc_rows, separating_plane_rows
from smoothers.scp.collision.narrow_phase import narrow_phase
from smoothers.scp.rollout import Sensitivity, Variables, roll_out, sensitivity
from smoothers.scp.settings import DEFAULT_SETTINGS

BOX = Footprint.rectangle(0.45, 0.35, 0.6)
L_SHAPE = np.array([[0.5, 0.3], [0.1, 0.3], [0.1, 0.5], [-0.4, 0.5], [-0.4, -0.3], [0.5, -0.3]])
FOOTPRINTS = {"box": BOX, "disc": Footprint.from_radius(0.4), "L": Footprint(L_SHAPE)}


COLLISION = DEFAULT_SETTINGS.collision


def clearance(scene, basis, rollout, signs, reach):
    """Both phases."""
    body = body_at_nodes(scene, rollout.poses)
    return narrow_phase(scene, basis, rollout, signs, body, broad_phase(scene, basis, rollout, body, reach))


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
    basis, variables, start, signs = cases.random_path(seed, shape)
    rollout = roll_out(basis, variables, start, signs)
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
    return basis, variables, problem, scene_around(problem, rollout.poses[:, :2], 1.0, COLLISION), signs


def swept_outlines(basis, rollout, problem, signs, found, k):
    """The footprint part of a pair at 60 poses of its interval, driven from the interval's own left node."""
    interval = found.pairs.interval[k]
    left, step = basis.left[interval], rollout.steps[interval]
    ends = rollout.curvature[left : left + 2]
    sign = int(signs[basis.interval_gear[interval]])
    spline = ClothoidSpline(Pose2.from_sequence(rollout.poses[left]), np.array([0.0, step]), ends, sign)
    body = problem.robot.footprint.bodies[found.pairs.part[k]].vertices
    return shapely.polygons(transform_points(spline.poses_at(np.linspace(0.0, step, 60)), body))


@pytest.mark.parametrize("name", FOOTPRINTS)
@pytest.mark.parametrize("seed", range(2))
def test_no_margin_exceeds_the_true_distance(cases, name, seed):
    basis, variables, problem, scene, signs = random_case(cases, seed, FOOTPRINTS[name])
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    found = clearance(scene, basis, rollout, signs, 0.4)
    assert found.margin.size > 20
    rng = np.random.default_rng(seed)
    for k in rng.choice(found.margin.size, min(60, found.margin.size), replace=False):
        rock = shapely.Polygon(scene.obstacles.vertices[found.pairs.obstacle[k]])
        outlines = swept_outlines(basis, rollout, problem, signs, found, k)
        truth = float(shapely.distance(outlines, rock).min())
        if truth > 0.0:
            assert found.margin[k] <= truth + 1e-6
        else:
            assert found.margin[k] <= 1e-6


@pytest.mark.parametrize("seed", range(2))
def test_the_margin_is_close_to_the_distance_on_short_intervals(cases, seed):
    basis, variables, problem, scene, signs = random_case(cases, seed, shape=((6, 12), (5, 12)))
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    found = clearance(scene, basis, rollout, signs, 0.4)
    shortfalls = []
    for k in np.flatnonzero(found.margin > 0.02)[:80]:
        rock = shapely.Polygon(scene.obstacles.vertices[found.pairs.obstacle[k]])
        truth = float(shapely.distance(swept_outlines(basis, rollout, problem, signs, found, k), rock).min())
        shortfalls.append(truth - found.margin[k])
    assert np.median(shortfalls) < 5e-4
    assert np.max(shortfalls) < 0.02


@pytest.mark.parametrize("name", FOOTPRINTS)
def test_every_close_pair_is_found(cases, name):
    basis, variables, problem, scene, signs = random_case(cases, 7, FOOTPRINTS[name], rocks=4)
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    found = clearance(scene, basis, rollout, signs, 0.1)
    seen = set(zip(found.pairs.interval, found.pairs.part, found.pairs.obstacle, strict=True))
    assert len(seen) == found.margin.size < 150
    for interval in range(basis.num_intervals):
        pose = rollout.poses[basis.left[interval]][None]
        for part, body in enumerate(problem.robot.footprint.bodies):
            outline = shapely.Polygon(transform_points(pose, body.vertices)[0])
            for rock in range(len(scene.obstacles)):
                if outline.distance(shapely.Polygon(scene.obstacles.vertices[rock])) < 0.1 - 1e-9:
                    assert (interval, part, rock) in seen


def test_the_requirement_is_subtracted(cases):
    rule = ClearanceRule(0.07, 0.0, 0.0)
    basis, variables, problem, scene, signs = random_case(cases, 3, rule=rule)
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    with_rule = clearance(scene, basis, rollout, signs, 0.3)
    free = random_case(cases, 3)[3]
    without = clearance(free, basis, rollout, signs, 0.3)
    inner = with_rule.pairs.interval < basis.num_intervals - 1
    assert with_rule.margin[inner] == pytest.approx(without.margin[inner] - 0.07, abs=1e-9)


@pytest.mark.parametrize("seed", range(3))
def test_required_clearance_has_the_right_gradient(cases, seed):
    scene = random_case(cases, seed, rule=ClearanceRule(0.1, 0.02, 0.8))[3]
    scene = type(scene)(scene.obstacles, scene.body, scene.rule, scene.start, scene.goal, 0.01)
    points = np.random.default_rng(seed).uniform(-2.0, 2.0, (40, 2)) + scene.goal
    found = scene.required(points)
    for axis in range(2):
        shift = np.zeros(2)
        shift[axis] = 1e-7
        slope = (scene.required(points + shift).value - scene.required(points - shift).value) / 2e-7
        assert found.gradient[:, axis] == pytest.approx(slope, abs=1e-5)


def test_required_clearance_is_the_problem_s(cases):
    _, _, problem, scene, _ = random_case(cases, 2, rule=ClearanceRule(0.1, 0.02, 0.8))
    scene = type(scene)(scene.obstacles, scene.body, scene.rule, scene.start, scene.goal, 0.03)
    points = np.random.default_rng(2).uniform(-2.0, 2.0, (200, 2)) + scene.goal
    from_goal, from_start = (np.hypot(*(points - end).T) for end in (scene.goal, scene.start))
    wanted = problem.clearance.required_at(from_goal, from_start, 0.03)
    assert scene.required(points).value == pytest.approx(wanted, abs=1e-12)


def margins(found):
    """Margin of every pair by (interval, part, obstacle)."""
    return dict(zip(zip(*found.pairs, strict=True), found.margin, strict=True))


@pytest.mark.parametrize("seed", range(2))
def test_the_lowest_row_predicts_the_margin(cases, seed):
    """After a small step the margin is the smallest of the pair's rows, but for the second order and the dip."""
    basis, variables, problem, scene, signs = random_case(cases, seed, shape=((6, 8), (5, 8)), rocks=3)
    start = problem.start.as_array()
    rollout = roll_out(basis, variables, start, signs)
    found = clearance(scene, basis, rollout, signs, 0.3)
    step = 1e-4 * np.random.default_rng(seed).uniform(-1.0, 1.0, basis.size)
    moved = np.concatenate(variables) + step
    moved = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
    after = margins(clearance(scene, basis, roll_out(basis, moved, start, signs), signs, 0.4))
    by = sensitivity(basis, variables, rollout)
    errors, changes = [], []
    for pair, key in enumerate(zip(*found.pairs, strict=True)):
        rows = separating_plane_rows(basis, rollout, by, found, np.array([pair]), COLLISION)
        gap, margin = float(rows.gap.min()), float(found.margin[pair])
        if 0.0 < margin > gap - 2e-3:
            errors.append(abs(after[key] - margin - float((rows.gap + rows.gradient @ step).min()) + gap))
            changes.append(abs(after[key] - margin))
    assert len(errors) > 0.4 * np.sum(found.margin > 0.0)
    assert np.median(errors) < 0.05 * np.median(changes)


def test_discs_lie_inside_a_rectangle():
    centres, radius = covering_discs(BOX.vertices, COLLISION.most_discs)
    outline = shapely.Polygon(BOX.vertices)
    for centre in centres:
        assert outline.buffer(1e-9).contains(shapely.Point(centre).buffer(radius))


def test_discs_of_a_needle_are_few():
    centres, radius = covering_discs(Footprint.rectangle(1.5, 1.5, 2e-4).vertices, 32)
    assert len(centres) <= 32
    assert radius == pytest.approx(1e-4)
    assert np.abs(centres[:, 0]).max() <= 1.5


@pytest.mark.parametrize("seed", range(2))
def test_disc_rows_are_exact_to_first_order(cases, seed):
    basis, variables, problem, scene, signs = random_case(cases, seed)
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    found = clearance(scene, basis, rollout, signs, 0.2)
    chosen = np.flatnonzero(found.margin < 0.0)
    assert chosen.size
    rows = covering_disc_rows(scene, basis, rollout, sensitivity(basis, variables, rollout), found, chosen)
    step = 1e-6 * np.random.default_rng(seed).uniform(-1.0, 1.0, basis.size)
    moved = np.concatenate(variables) + step
    after = roll_out(
        basis, Variables(moved[: basis.num_knots], moved[basis.num_knots :]), problem.start.as_array(), signs
    )
    again = covering_disc_rows(scene, basis, after, sensitivity(basis, variables, after), found, chosen)
    error = np.abs(again.gap - rows.gap - rows.gradient @ step)
    assert np.quantile(error, 0.9) < 1e-9


def test_a_disc_inside_an_obstacle_is_pushed_through_its_nearest_side():
    """The gradient of a row by the position of its node leads from the disc's centre straight to the nearest side."""
    basis = basis_for(((8, 3),))
    variables = Variables(np.zeros(basis.num_knots), np.array([2.0]))
    start, signs = np.zeros(3), np.array([1.0])
    rollout = roll_out(basis, variables, start, signs)
    outline = shapely.box(0.7, -0.2, 1.3, 0.6)  # the lower side is the nearest one of the middle line
    obstacles = ObstacleSet.from_polygons([np.array(outline.exterior.coords)[-2::-1]])
    robot = Robot(BOX, MotionLimits())
    problem = DockingProblem(Pose2(0.0, 0.0, 0.0), Dock(Pose2(2.0, 0.0, 0.0)), robot, obstacles, ClearanceRule(0, 0, 0))
    scene = scene_around(problem, rollout.poses[:, :2], 1.0, COLLISION)
    found = clearance(scene, basis, rollout, signs, 0.2)
    moved = np.tile(np.eye(2), (basis.num_nodes, 1, 1))
    by_position = Sensitivity(moved[:, 0], moved[:, 1], np.zeros((basis.num_nodes, 2)))
    rows = covering_disc_rows(scene, basis, rollout, by_position, found, np.arange(found.margin.size))
    centres, radius = covering_discs(BOX.vertices, COLLISION.most_discs)
    inside = np.flatnonzero(rows.gap < -radius - 1e-9)
    assert inside.size > 5
    for row in inside:
        depth = -rows.gap[row] - radius
        middles = [shapely.Point(middle) for middle in rollout.poses[rows.node[row], :2] + centres]
        to_side = [outline.exterior.distance(middle) if outline.contains(middle) else -1.0 for middle in middles]
        of_row = [k for k, away in enumerate(to_side) if abs(away - depth) < 1e-9]
        exits = rollout.poses[rows.node[row], :2] + centres[of_row] + depth * rows.gradient[row]
        assert min(outline.exterior.distance(shapely.Point(point)) for point in exits) < 1e-9
    deepest = inside[np.argmin(rows.gap[inside])]
    assert rows.gradient[deepest] == pytest.approx([0.0, -1.0], abs=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_of_many_edges_those_that_face_the_obstacle_separate_as_far_as_all_do(cases, seed):
    oval = np.linspace(0.0, 2.0 * np.pi, 49)[:-1]
    footprint = Footprint(np.column_stack((0.5 * np.cos(oval), 0.3 * np.sin(oval))))
    every = dataclasses.replace(COLLISION, facing_edges=len(oval))
    basis, variables, problem, _, signs = random_case(cases, seed, footprint)
    rollout = roll_out(basis, variables, problem.start.as_array(), signs)
    few, all_of_them = (
        clearance(scene_around(problem, rollout.poses[:, :2], 1.0, chosen), basis, rollout, signs, 0.5).margin
        for chosen in (COLLISION, every)
    )
    apart = all_of_them > 0.0
    assert apart.any()
    assert np.all(few[apart] >= all_of_them[apart] - 1e-4)
    assert np.all(few[~apart] >= all_of_them[~apart] - 0.05)  # nothing separates what overlaps
