"""A guess of arcs that cannot be smoothed is driven as it is, with a stop wherever its curvature jumps."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import optdock as od
from optdock.errors import FailedToSmoothPath, OptdockError, SmootherTimedOut
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.model.segments import ClothoidSegment, Direction, PolylineSegment, TurnSegment
from optdock.planners.manoeuvres.arcs import Arcs
from optdock.planning.guess_edits import stopping_at_bends
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import GlobalPlanner, Smoother, never_cancelled
from optdock.plugins.outcomes import Guess
from optdock.verification import certify_motion

CAR = Robot(
    Footprint.rectangle(3.76, 0.929, 1.942),
    MotionLimits(max_curvature=0.33, max_curvature_rate=0.36, wheelbase=2.8, max_steering_rate=0.5),
    "ackermann",
)
START = np.array([[1.0, -2.0, 0.4]])
BENDS = Arcs(START, np.array([[0.5, 0.8, -0.7, -0.4, 1.2]]), np.array([[0.33, -0.33, -0.33, 0.0, 0.2]]))


def path_of(arcs, spacing=0.075):
    return arcs.path(spacing, arcs.joints()[0, -1], "map")


def problem(arcs=BENDS, **more):
    ends = [Pose2(*pose) for pose in arcs.joints()[0, [0, -1]].tolist()]
    return DockingProblem(ends[0], Dock(ends[1], **more), CAR)


class Offers(GlobalPlanner):
    """Offers paths."""

    def __init__(self, *paths):
        super().__init__()
        self.paths = paths

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        return self.paths[0]

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        yield from (Guess(path, "arcs") for path in self.paths)


class Fails(Smoother):
    """Cannot smooth anything."""

    def __init__(self, error=None):
        super().__init__()
        self.error = error or FailedToSmoothPath("no")

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=never_cancelled):
        raise self.error


def test_curvature_jumps_at_stops_and_the_way_stays():
    raw = path_of(BENDS)
    found = stopping_at_bends(raw)
    assert [int(one.direction) for one in found.segments] == [1, 1, -1, -1, 1]
    assert [one.length for one in found.segments] == pytest.approx(np.abs(BENDS.lengths[0]))
    assert [float(one.curvature_at(0.0)[0] * int(one.direction)) for one in found.segments] == pytest.approx(
        BENDS.curvatures[0], abs=1e-9
    )
    assert np.abs(found.poses_at(raw.segment_starts) - raw.poses_at(raw.segment_starts)).max() < 1e-9
    assert od.certify_path(found, problem())


@settings(max_examples=30)
@given(
    st.lists(
        st.tuples(st.floats(0.01, 3.0), st.sampled_from([-1.0, 1.0]), st.sampled_from([-0.33, 0.0, 0.1, 0.33])),
        min_size=1,
        max_size=8,
    )
)
def test_any_arcs_end_where_they_ended_and_keep_their_curvature(found):
    lengths, gears, bends = np.array(found).T
    arcs = Arcs(START, (lengths * gears)[None], bends[None])
    path = path_of(arcs, spacing=0.005)
    stopping = stopping_at_bends(path)
    assert stopping.length == pytest.approx(path.length)
    assert stopping.end.distance_to(path.end) < 1e-8
    assert len(stopping.segments) <= len(found)
    certificate = od.certify_path(stopping, problem(arcs))
    assert certificate.certified, certificate.reason


def test_path_that_bends_all_the_way_is_no_sequence_of_arcs():
    s = np.linspace(0.0, 3.0, 40)
    swaying = np.column_stack((s, 0.2 * np.sin(2.0 * s), np.arctan(0.4 * np.cos(2.0 * s))))
    assert stopping_at_bends(Path.from_poses(swaying)) is None


def test_turns_in_place_and_clothoids_stay_as_they_are():
    turn = TurnSegment(Pose2(0.0, 0.0, 0.0), 0.5)
    line = PolylineSegment([(0.0, 0.0, 0.5), (math.cos(0.5), math.sin(0.5), 0.5)], Direction.FORWARD)
    found = stopping_at_bends(Path((turn, line)))
    assert found.segments[0] is turn
    assert isinstance(found.segments[1], ClothoidSegment)
    assert stopping_at_bends(found).segments == found.segments


@pytest.mark.parametrize("error", [FailedToSmoothPath("no"), SmootherTimedOut("late")])
def test_guess_that_cannot_be_smoothed_is_driven_with_stops(error):
    plan = plan_dock(problem(), time_budget=5.0, planner=Offers(path_of(BENDS)), smoother=Fails(error))
    assert len(plan.path.segments) == 5
    assert [attempt.stage for attempt in plan.tried if not attempt.reason] == ["arcs, stopping at bends"]
    assert type(error).__name__ in plan.tried[0].reason
    assert plan.completed is isinstance(error, FailedToSmoothPath)
    assert certify_motion(plan.trajectory, problem())
    # The wheels turn by atan(2.8 * 0.33) twice over at the first bend: so long the car stands there.
    law, bend = plan.trajectory.time_law, plan.path.cusps[0]
    at_bend = np.abs(law.states[:, 0] - bend) < 1e-6
    rested = np.ptp(law.times[at_bend])
    assert rested >= 2.0 * math.atan(2.8 * 0.33) / 0.5 * (1.0 - 1e-6)


def test_a_plan_with_stops_refutes_that_no_path_exists():
    """A smoother may claim of a later guess what holds for that guess alone."""

    class Claims(Fails):
        def smooth(self, path, max_time, **options):
            raise FailedToSmoothPath("no", where={"every_path": path.length > 5.0})

    detour = Arcs(START, np.array([[-2.0, 2.0, *BENDS.lengths[0]]]), np.array([[0.0, 0.0, *BENDS.curvatures[0]]]))
    plan = plan_dock(problem(), time_budget=5.0, planner=Offers(path_of(BENDS), path_of(detour)), smoother=Claims())
    assert len(plan.path.segments) == 5


def test_colliding_guess_is_not_driven_with_stops():
    on_the_way = path_of(BENDS).poses_at(0.6)[0]
    x, y = on_the_way[:2] + 1.2 * np.array([-math.sin(on_the_way[2]), math.cos(on_the_way[2])])
    rock = [[x - 0.3, y - 0.3], [x + 0.3, y - 0.3], [x + 0.3, y + 0.3], [x - 0.3, y + 0.3]]
    walled = DockingProblem(problem().start, problem().dock, CAR, [rock])
    with pytest.raises(OptdockError):
        plan_dock(walled, time_budget=5.0, planner=Offers(path_of(BENDS)), smoother=Fails())


def test_smoothed_plan_is_preferred_and_a_given_path_is_never_driven_with_stops():
    smooth = Arcs(START, np.array([[2.0, 2.0]]), np.array([[0.0, 0.1]]))
    plan = plan_dock(problem(smooth), time_budget=10.0, planner=Offers(path_of(smooth)))
    assert [attempt.stage for attempt in plan.tried] == ["arcs"]
    with pytest.raises(OptdockError):
        plan_dock(problem(), guesses=[path_of(BENDS)], planner=Offers(path_of(BENDS).piece(0.3)), smoother=Fails())


def test_cheapest_of_several_is_kept():
    there_and_back = [-2.0, 2.0], [0.0, 0.0]
    detour = Arcs(
        START,
        np.array([[*there_and_back[0], *BENDS.lengths[0]]]),
        np.array([[*there_and_back[1], *BENDS.curvatures[0]]]),
    )
    for order in ((detour, BENDS), (BENDS, detour)):
        plan = plan_dock(problem(), time_budget=5.0, planner=Offers(*map(path_of, order)), smoother=Fails())
        assert len(plan.path.segments) == 5


@pytest.mark.parametrize("length", [5e-324, 1e-310, 1e-9])
def test_a_turn_almost_in_place_is_no_arc(length):
    path = Path.from_poses([[0.0, 0.0, 0.0], [length, 0.0, 0.3], [1.0, 0.3, 0.3]])
    assert stopping_at_bends(path) is None
