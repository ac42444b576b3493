import functools
import math

import numpy as np
import pytest

from experiments.dense_check import clearance_at, dense_check
from experiments.families import FAMILIES, FEASIBLE_FAMILIES, INFEASIBLE_FAMILIES, instance
from optdock.errors import InvalidValue
from optdock.geometry.pose import transform_points

SEEDS = range(2)


def test_number_of_families():
    assert len(FEASIBLE_FAMILIES) == 15
    assert len(INFEASIBLE_FAMILIES) == 4


@pytest.mark.parametrize("family", FEASIBLE_FAMILIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_witness_satisfies_every_bound(family, seed):
    drawn = instance(family, seed)
    assert drawn.feasible
    assert drawn.expected_reason is None
    report = dense_check(drawn.witness, drawn.problem, step=0.01)
    assert report.faults == ()


@functools.cache
def raw_report(family, seed):
    drawn = instance(family, seed)
    return dense_check(drawn.raw_path, drawn.problem, step=0.01)


@pytest.mark.parametrize("family", FAMILIES)
@pytest.mark.parametrize("seed", SEEDS)
def test_raw_path_violates_only_interior_bounds(family, seed):
    broken = raw_report(family, seed).broken
    assert "curvature" in broken
    assert not {"start", "goal", "joint", "direction"} & set(broken)


@pytest.mark.parametrize("family", FEASIBLE_FAMILIES)
def test_raw_path_and_witness_have_the_same_gears(family):
    drawn = instance(family, 1)
    assert [s.direction for s in drawn.raw_path.segments] == [s.direction for s in drawn.witness.segments]
    for raw, driven in zip(drawn.raw_path.segments, drawn.witness.segments, strict=True):
        assert raw.poses[0] == pytest.approx(driven.poses_at(0.0)[0])
        assert raw.length < 1.1 * driven.length


@pytest.mark.parametrize("family", INFEASIBLE_FAMILIES)
def test_infeasible_instance_has_a_reason_and_no_witness(family):
    drawn = instance(family, 0)
    assert drawn.feasible is False
    assert drawn.witness is None
    assert drawn.expected_reason in {"goal_unreachable", "clearance", "approach_blocked", "start_in_collision"}


@pytest.mark.parametrize("family", FAMILIES)
def test_instances_are_deterministic(family):
    first, second = instance(family, 2), instance(family, 2)
    assert first.problem.start == second.problem.start
    assert (first.problem.all_obstacles.vertices == second.problem.all_obstacles.vertices).all()
    assert (first.raw_path.segments[0].poses == second.raw_path.segments[0].poses).all()
    assert instance(family, 3).problem.start != first.problem.start


@pytest.mark.parametrize(
    ("family", "start", "pieces"),
    [
        ("open_s", (-5.719801048, 2.951016164, 0.051243742), 1),
        ("parallel", (1.776028535, -1.454986773, 3.093436734), 3),
        ("clutter", (0.863507175, -0.012977007, -1.920272204), 122),
        ("car_bay", (7.939696325, 2.672895068, 1.399663979), 3),
        ("too_close", (-1.488795289, -1.028887471, 0.090659433), 3),
    ],
)
def test_instances_are_the_same_on_every_machine(family, start, pieces):
    problem = instance(family, 7).problem
    assert problem.start.as_array() == pytest.approx(start, abs=1e-8)
    assert len(problem.all_obstacles) == pieces


def test_some_raw_paths_collide():
    colliding = {f for f in FEASIBLE_FAMILIES for s in SEEDS if raw_report(f, s).min_clearance < 0.0}
    assert "collision" in colliding
    assert len(colliding) >= 4


@pytest.mark.parametrize("seed", range(8))
def test_too_close_is_unreachable_with_the_turning_radius(seed):
    problem = instance("too_close", seed).problem
    start = problem.start.in_frame_of(problem.goal)
    radius = 1.0 / problem.robot.limits.max_curvature
    along = -start.x - problem.dock.final_straight
    assert 0.0 < along < 2.0 * radius
    assert start.yaw == pytest.approx(0.0, abs=1e-9)
    reachable = 2.0 * radius * (1.0 - math.sqrt(1.0 - (along / (2.0 * radius)) ** 2))
    assert abs(start.y) > reachable + 0.05
    assert across_free(problem) - 2.0 * problem.robot.footprint.inscribed_radius < 2.0 * radius


def across_free(problem):
    """Width of the room across the goal's heading."""
    c, s = math.cos(problem.goal.yaw), math.sin(problem.goal.yaw)
    across = -s * problem.obstacles.vertices[..., 0] + c * problem.obstacles.vertices[..., 1]
    low, high = sorted(zip(across.min(axis=1), across.max(axis=1), strict=True))
    return high[0] - low[1]


@pytest.mark.parametrize("seed", range(8))
def test_blocked_gap_is_too_narrow_and_the_only_entrance(seed):
    import shapely

    problem = instance("gap_blocked", seed).problem
    walls = shapely.union_all(shapely.polygons(problem.all_obstacles.vertices))
    closed = walls.buffer(0.29)  # a door of less than 0.58 m disappears
    free = shapely.envelope(closed.buffer(5.0)).difference(closed)
    rooms = shapely.get_parts(free)
    inside = [room.contains(shapely.Point(problem.goal.x, problem.goal.y)) for room in rooms]
    outside = [room.contains(shapely.Point(problem.start.x, problem.start.y)) for room in rooms]
    assert sum(inside) == sum(outside) == 1
    assert inside != outside
    assert problem.robot.footprint.width == pytest.approx(0.6)


@pytest.mark.parametrize("seed", range(8))
def test_blocked_approach_hits_its_post(seed):
    problem = instance("approach_blocked", seed).problem
    back = np.linspace(0.0, problem.dock.final_straight, 31)
    body = np.column_stack((-back, np.zeros(31)))
    on_the_straight = transform_points(problem.goal.as_array()[None], body)[0]
    poses = [type(problem.goal)(x, y, problem.goal.yaw) for x, y in on_the_straight]
    clearances = [clearance_at(pose, problem) for pose in poses]
    assert clearances[0] > 0.0
    assert min(clearances) < -0.01


@pytest.mark.parametrize("seed", range(8))
def test_start_collision_overlaps_at_the_start(seed):
    problem = instance("start_collision", seed).problem
    assert clearance_at(problem.start, problem) < -0.02
    assert clearance_at(problem.goal, problem) > 0.0


def test_unknown_families_and_seeds_are_refused():
    with pytest.raises(InvalidValue, match="did you mean alcove"):
        instance("alcoves", 0)
    with pytest.raises(InvalidValue, match=">= 0"):
        instance("alcove", -1)
