"""The view of the dock in the smoother: its margins and rows, what it mends, and what it refuses."""

import dataclasses
import itertools
import math
import shutil

import numpy as np
import pytest

import optdock as od
from optdock.deadline import Deadline
from optdock.errors import FailedToSmoothPath
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.kernels import kernels_in_use, using_kernels
from optdock.model.camera import Camera
from optdock.model.dock import DockDirection
from optdock.model.path import ClothoidSegment, Direction, Path, TurnSegment
from optdock.plugins.interfaces import never_cancelled
from optdock.verification import certify_path
from optdock.verification.visibility import prove_view
from smoothers import CasadiSmoother
from smoothers.scp.loop import additions, evaluated
from smoothers.scp.qp_step import ProgramPool
from smoothers.scp.rollout import Variables, roll_out
from smoothers.scp.search import Solver
from smoothers.scp.visibility_constraint import ViewBound, linearized_view, view_along

NARROW = Camera(Pose2(0.4, 0.0, 0.0), math.radians(60.0))


def seen_problem(cases, goal, camera=NARROW, *, visible=1.5, blind=0.0, marker=(0.6, 0.0), **others):
    task = cases.open_problem(goal, **others)
    robot = dataclasses.replace(task.robot, camera=camera)
    dock = dataclasses.replace(task.dock, marker=marker, visible_distance=visible, blind_distance=blind)
    return dataclasses.replace(task, robot=robot, dock=dock)


CAMERAS = {
    "narrow": Camera(Pose2(0.3, 0.1, 0.2), 0.8, 0.3, 1.5),
    "half a turn": Camera(Pose2(0.3, 0.1, 0.2), math.pi),
    "wide": Camera(Pose2(-0.2, 0.0, 2.0), 4.5, 0.2, 2.0),
    "all around": Camera(Pose2(0.1, 0.0, 0.0), 2.0 * math.pi, 0.4, 1.8),
}


@pytest.fixture(params=CAMERAS)
def driven(cases, request):
    """A roll-out of two gears and what must be seen along it, in a stretch that begins and ends between nodes."""
    basis, variables, start, signs = cases.random_path(3)
    rollout = roll_out(basis, variables, start, signs)
    # What must be seen lies ahead of the middle of the path, and on it at some distance.
    goal = Pose2.from_sequence(rollout.poses[-1])
    task = seen_problem(cases, goal, CAMERAS[request.param], visible=1.71, blind=0.33, marker=(0.2, 0.4))
    return basis, variables, start, signs, ViewBound(task.required_view, task, signs, 0.1, 0.35)


def margins(basis, variables, start, signs, bound):
    return view_along(bound, basis, variables, roll_out(basis, variables, start, signs))


def test_margins_are_those_of_the_camera_and_only_of_the_stretch(driven):
    basis, variables, _, _, bound = driven
    found = margins(*driven)
    left = (
        variables.lengths.sum()
        + bound.after
        - np.array(
            [
                variables.lengths[: basis.node_gear[k]].sum()
                + basis.fraction[k] * variables.lengths[basis.node_gear[k]]
                for k in found.node
            ]
        )
        - found.ahead
    )
    assert left.min() == pytest.approx(bound.view.blind_distance)
    assert left.max() == pytest.approx(bound.view.visible_distance)
    assert np.sum(found.ahead > 0.0) == 2
    truth = bound.view.margins(found.poses).smallest
    assert np.all(found.margin.min(axis=0) <= truth + 1e-12)
    assert np.median(truth - found.margin.min(axis=0)) < 0.01


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("name", CAMERAS)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize(("visible", "blind"), [(1.71, 0.33), (100.0, 0.0), (0.9, 0.1), (0.2, 0.15), (100.0, 99.0)])
def test_the_kernel_is_equal_to_numpy(cases, name, seed, visible, blind):
    """Stretches that begin and end between nodes, contain the whole path, an end alone, or nothing."""
    basis, variables, start, signs = cases.random_path(seed, ((6, 2), (5, 3)))
    rollout = roll_out(basis, variables, start, signs)
    goal = Pose2.from_sequence(rollout.poses[-1])
    task = seen_problem(cases, goal, CAMERAS[name], visible=visible, blind=blind, marker=(0.2, 0.4))
    bound = ViewBound(task.required_view, task, signs, (0.1, 0.0)[seed % 2], 0.35)
    if seed == 3:  # the stretch ends exactly at a cusp
        bound = dataclasses.replace(bound, view=bound.view._replace(blind_distance=float(variables.lengths[-1])))
    found = []
    for lane in ("twin", "native"):
        with using_kernels(lane):
            found.append(view_along(bound, basis, variables, rollout))
            assert "NumPy for" not in kernels_in_use()
    assert np.array_equal(found[0].node, found[1].node)
    for one, other in zip(*found, strict=True):
        assert one.shape == other.shape
        assert other == pytest.approx(one, rel=1e-12, abs=1e-12)


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("name", CAMERAS)
def test_the_kernel_is_equal_to_numpy_far_from_the_origin_at_the_camera_and_without_numbers(cases, name):
    basis, variables, start, signs = cases.random_path(1, ((6, 2), (5, 3)))
    curvature = variables.curvature.copy()
    curvature[3] = math.nan
    mount = CAMERAS[name].mount
    for at, chosen in (
        ((5e5, 6e6), variables),
        ((0.0, 0.0), variables),
        ((0.0, 0.0), Variables(curvature, variables.lengths)),
    ):
        begin = start + np.array([*at, 0.0])
        rollout = roll_out(basis, chosen, begin, signs)
        goal = Pose2.from_sequence(roll_out(basis, variables, begin, signs).poses[-1])
        task = seen_problem(cases, goal, CAMERAS[name], visible=1.71, blind=0.33, marker=(mount.x, mount.y))
        bound, found = ViewBound(task.required_view, task, signs, 0.1, 0.35), []
        for lane in ("twin", "native"):
            with using_kernels(lane):
                found.append(view_along(bound, basis, chosen, rollout))
                assert "NumPy for" not in kernels_in_use()
        for one, other in zip(*found, strict=True):
            assert other == pytest.approx(one, rel=1e-12, abs=1e-12, nan_ok=True)


def test_rows_are_the_derivatives_of_the_margins(driven):
    basis, variables, start, signs, bound = driven
    rollout = roll_out(basis, variables, start, signs)
    found = view_along(bound, basis, variables, rollout)
    # Without what is lost between nodes, and without the limit of reach: every margin by itself.
    edges = bound.view.camera.margins(bound.view.camera.points_seen(found.poses, bound.view.marker))
    bare = found._replace(margin=np.minimum(found.margin, 0.0))
    rows = linearized_view(bound, basis, variables, rollout, bare)
    assert np.isfinite(edges.smallest).all()
    flat, step = np.concatenate(variables), 1e-6
    columns = []
    for i in range(basis.size):
        both = []
        for sign in (1.0, -1.0):
            moved = flat.copy()
            moved[i] += sign * step
            other = Variables(moved[: basis.num_knots], moved[basis.num_knots :])
            there = view_along(bound, basis, other, roll_out(basis, other, start, signs))
            assert np.array_equal(there.node, found.node)
            # The fixed edge that counted: its normal turned with the robot stays where it is in the robot's frame.
            both.append(np.sum(found.normals * (there.seen - found.seen), axis=2))
        columns.append((both[0] - both[1]) / (2.0 * step))
    truth = np.stack(columns, axis=-1).reshape(-1, basis.size)
    truth = truth[np.abs(truth).max(axis=1) > 1e-9]
    # Places ahead of a node are driven there on an arc of the node's own curvature.
    assert rows.gradient == pytest.approx(truth, abs=2e-5)


def test_the_result_keeps_the_view_that_without_the_bound_it_loses(cases):
    task = seen_problem(cases, Pose2(2.5, 1.0, 0.0))
    free = dataclasses.replace(task, dock=dataclasses.replace(task.dock, visible_distance=0.0, blind_distance=0.0))
    guess = cases.kinked((0.0, 0.0), (1.0, 0.0), (1.5, 1.0), (2.5, 1.0))
    alone = CasadiSmoother().smooth(guess, 2.0, problem=free).path
    assert not prove_view(alone, task)
    result = CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert result.report.certificate.certified
    assert result.report.certificate.view_margin >= -1e-6
    assert certify_path(result.path, task).certified
    assert result.path.length >= alone.length - 1e-3


def test_where_the_view_costs_nothing_the_result_is_the_same(cases):
    wide = seen_problem(cases, Pose2(2.5, 0.3, 0.0), Camera(Pose2(0.4, 0.0, 0.0), math.radians(170.0)))
    free = dataclasses.replace(wide, dock=dataclasses.replace(wide.dock, visible_distance=0.0, blind_distance=0.0))
    guess = cases.kinked((0.0, 0.0), (1.2, 0.0), (1.8, 0.3), (2.5, 0.3))
    with_view, without = (CasadiSmoother().smooth(guess, 2.0, problem=task).path for task in (wide, free))
    assert with_view.length == pytest.approx(without.length, abs=1e-9)
    assert np.allclose(with_view.sample(0.1).poses, without.sample(0.1).poses, atol=1e-9)


@pytest.mark.parametrize(
    "camera", [Camera(Pose2(0.4, 0.0, 0.0), 2.0 * math.pi), Camera(Pose2(0.4, 0.0, 0.0), 2.0 * math.pi, 0.1, 3.0)]
)
def test_a_camera_with_full_field_of_view_has_range_rows_only(cases, camera):
    task = seen_problem(cases, Pose2(2.5, 0.3, 0.0), camera)
    guess = cases.kinked((0.0, 0.0), (1.2, 0.0), (1.8, 0.3), (2.5, 0.3))
    assert CasadiSmoother().smooth(guess, 2.0, problem=task).report.certificate.certified


def test_a_robot_with_a_front_camera_turns_and_docks_in_reverse(cases):
    task = seen_problem(cases, Pose2(0.0, 0.0, 0.0), start=Pose2(2.8, 0.2, math.pi), visible=1.7, blind=1.3,
                        marker=(-0.6, 0.0), max_yaw_rate=1.0, max_yaw_acceleration=1.0)  # fmt: skip
    robot = dataclasses.replace(task.robot, turns_in_place=True)
    task = dataclasses.replace(task, robot=robot, dock=dataclasses.replace(task.dock, direction=DockDirection.BACKWARD))
    here = Pose2(1.2, 0.0, math.pi)
    facing = cases.kinked((2.8, 0.2), (2.0, 0.1), (1.2, 0.0)).segments
    back = ClothoidSpline(Pose2(1.2, 0.0, 0.0), [0.0, 1.2], [0.0, 0.0], -1)
    guess = Path((*facing, TurnSegment(here, -math.pi), ClothoidSegment(back)))
    result = CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert result.report.certificate.certified
    seen = task.required_view.stretch(result.path)
    # Begin and end of what must see: 0.4 m of the way there, and nothing of the turn.
    assert math.isfinite(result.report.certificate.view_margin)
    assert seen[1] - seen[0] == pytest.approx(0.4, abs=1e-6)


def test_in_reverse_gear_a_camera_at_the_back_sees(cases):
    behind = Camera(Pose2(-0.4, 0.0, math.pi), math.radians(60.0))
    task = seen_problem(cases, Pose2(-2.5, -1.0, 0.0), behind, marker=(-0.6, 0.0))
    task = dataclasses.replace(task, dock=dataclasses.replace(task.dock, direction=DockDirection.BACKWARD))
    points = [(0.0, 0.0), (-1.0, 0.0), (-1.5, -1.0), (-2.5, -1.0)]
    guess = Path.from_poses([[x, y, 0.0] for a, b in itertools.pairwise(points) for x, y in np.linspace(a, b, 8)])
    result = CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert result.report.certificate.certified
    ahead = dataclasses.replace(task, robot=dataclasses.replace(task.robot, camera=NARROW))
    with pytest.raises(FailedToSmoothPath, match="approach_unseen: the dock is not in the camera's view") as caught:
        CasadiSmoother().smooth(guess, 2.0, problem=ahead)
    assert caught.value.where["reason"] == "approach_unseen"


@pytest.mark.parametrize(("straight", "direction"), [(0.0, "forward"), (0.3, "auto"), (0.3, "forward")])
def test_an_unseen_approach_is_the_reason_for_every_path_only_on_a_straight_in_a_given_gear(cases, straight, direction):
    """At the goal the dock is in view: a path that comes from the other side sees it all along."""
    task = seen_problem(cases, Pose2(2.5, 0.0, 0.0), Camera(Pose2(0.0, 0.0, 0.0), 1.0, 0.0, 2.0), marker=(2.0, 0.0))
    dock = dataclasses.replace(task.dock, final_straight=straight, direction=DockDirection(direction))
    task = dataclasses.replace(task, dock=dock)
    with pytest.raises(FailedToSmoothPath, match="approach_unseen") as caught:
        CasadiSmoother().smooth(cases.kinked((0.0, 0.0), (2.5, 0.0)), 2.0, problem=task)
    assert caught.value.where["every_path"] is (straight > 0.0 and direction == "forward")
    task = dataclasses.replace(task, dock=dataclasses.replace(dock, visible_distance=0.2, direction="auto"))
    assert od.plan_dock(task, time_budget=30.0).path.segments[-1].direction is Direction.REVERSE


def test_pieces_between_turns_in_place_see_as_well(cases):
    task = seen_problem(cases, Pose2(2.5, 1.0, 0.0), max_yaw_rate=1.0, max_yaw_acceleration=1.0)
    task = dataclasses.replace(task, robot=dataclasses.replace(task.robot, turns_in_place=True))
    turned = TurnSegment(Pose2(0.0, 0.0, 0.0), 0.9)
    first = ClothoidSpline(turned.end, [0.0, 0.4], [0.0, 0.0])
    rest = cases.kinked((first.end.x, first.end.y), (1.0, 0.8), (1.5, 1.0), (2.5, 1.0)).segments
    guess = Path((turned, ClothoidSegment(first), TurnSegment(first.end, -0.5), *rest))
    result = CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert result.report.certificate.certified
    assert math.isfinite(result.report.certificate.view_margin)


@pytest.mark.parametrize("straight", [0.0, 0.3])
def test_a_dock_within_the_minimum_range_is_refused_before_any_search(cases, straight):
    near = dataclasses.replace(NARROW, min_range=0.3)
    task = seen_problem(cases, Pose2(2.5, 0.0, 0.0), near)
    task = dataclasses.replace(task, dock=dataclasses.replace(task.dock, final_straight=straight))
    guess = cases.kinked((0.0, 0.0), (2.5, 0.0))
    with pytest.raises(FailedToSmoothPath, match=r"at the goal: distance 0\.200 m, at least 0\.300 m") as caught:
        CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert caught.value.where["s"] == pytest.approx(2.5)
    blind = dataclasses.replace(task, dock=dataclasses.replace(task.dock, blind_distance=0.1))
    assert CasadiSmoother().smooth(guess, 2.0, problem=blind).report.certificate.certified


def test_a_search_in_vain_names_the_view_and_the_place(cases):
    # The marker stands beside the dock's axis, and the camera sees next to nothing: no path has it in view for 2 m.
    blinkered = Camera(Pose2(0.4, 0.0, 0.0), math.radians(8.0))
    task = seen_problem(cases, Pose2(2.5, 0.8, 0.0), blinkered, visible=2.4)
    guess = cases.kinked((0.0, 0.0), (1.0, 0.0), (1.5, 0.8), (2.5, 0.8))
    with pytest.raises(
        FailedToSmoothPath, match=r"view: .*leaves the camera's view at s = .* at most 4\.0 degrees"
    ) as caught:
        CasadiSmoother().smooth(guess, 2.0, problem=task)
    assert caught.value.where["reason"] == "view"
    assert caught.value.where["quantity"] == "bearing"
    assert caught.value.partial.path is not None


def test_the_rows_of_the_view_are_added_to_the_step(cases):
    problem = seen_problem(cases, Pose2(4.0, 1.0, 0.0))
    smoother, raw = CasadiSmoother(), cases.kinked((0.0, 0.0), (0.8, 0.0), (1.8, 1.0), (4.0, 1.0))
    solver = Solver(ProgramPool(), Deadline(60.0), never_cancelled, smoother.settings)
    nlp, guesses = solver.prepared(smoother.call_for(raw, problem))
    iterate = evaluated(nlp, np.concatenate(guesses.first.variables))
    added = additions(iterate, 0.0)
    wanted = linearized_view(nlp.view, nlp.basis, iterate.variables, iterate.rollout, iterate.view)
    assert wanted.gap.size > 0
    assert np.array_equal(added.rows, np.column_stack((wanted.gap, wanted.gradient)))
