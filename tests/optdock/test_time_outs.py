"""Why there is no plan: a time-out wherever more time might have found one, the bound in the way where none could.

The plug-ins here say themselves that their time is up, so that no test looks at a clock.
"""

import itertools
import math

import pytest

from optdock.errors import (
    FailedToSmoothPath,
    FailedToTimePath,
    NoValidPathCouldBeFound,
    OptdockError,
    PlannerTimedOut,
    SmootherTimedOut,
    TimedOut,
    TimingTimedOut,
)
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock, DockDirection
from optdock.model.limits import MotionLimits
from optdock.model.path import Direction, Path, PolylineSegment
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planning import pipeline
from optdock.planning.pipeline import plan_dock
from optdock.plugins.interfaces import GlobalPlanner, Smoother, TimeParameterizer, never_cancelled
from optdock.plugins.outcomes import Guess, TimingResult, TimingStatus

START, GOAL = Pose2(0.0, 0.0, 0.0), Pose2(2.0, 0.0, 0.0)
ROBOT = Robot(Footprint.rectangle(0.3, 0.3, 0.4), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))


def swaying(begin, end, gear=Direction.FORWARD):
    """A line whose heading sways at every pose: without a smoother nothing follows it."""
    return PolylineSegment([(begin + (end - begin) * k / 20, 0.0, 0.01 * (k % 2)) for k in range(21)], gear)


AHEAD = Path((swaying(0.0, 2.0),))
AROUND = Path((swaying(0.0, 3.0), swaying(3.0, 2.0, Direction.REVERSE)))
BUDGET = 37.0  # [s]: far more than any of this takes, so that no clock decides


class Offers(GlobalPlanner):
    """Offers paths, and ends as it is told."""

    def __init__(self, *paths, end=None):
        super().__init__()
        self.paths, self.end = paths, end

    def create_plan(self, start, goal, cancel_checker=never_cancelled):
        return self.paths[0]

    def create_plans(self, start, goal, cancel_checker=never_cancelled, better_than=lambda: math.inf):
        for i, path in enumerate(self.paths):
            yield Guess(path, f"offer {i}")
        if self.end is not None:
            raise self.end


class Says(Smoother):
    """Raises one error after the other, the last one for ever."""

    def __init__(self, *errors):
        super().__init__()
        self.errors = itertools.chain(errors, itertools.repeat(errors[-1] if errors else late()))

    def smooth(self, path, max_time, *, problem=None, warm_start=None, cancel_checker=never_cancelled):
        raise next(self.errors)


class TimedLate(TimeParameterizer):
    """Never has a time law in time."""

    def parameterize(self, path, limits, zone, **rest):
        return TimingResult(TimingStatus.TIMED_OUT, None, reason="27.1 ms were too little")


def late():
    return SmootherTimedOut("nothing within 27.1 ms", where={"iterations": 3})


def blocked():
    return FailedToSmoothPath("approach_blocked: on the final straight", where={"reason": "approach_blocked"})


def shut():
    return FailedToSmoothPath("clearance: 0.01 m from a rock", where={"reason": "clearance"})


def refusal(planner, smoother, direction=DockDirection.AUTO, timing="Windowed", budget=BUDGET):
    problem = DockingProblem(START, Dock(GOAL, direction=direction), ROBOT)
    with pytest.raises(OptdockError) as caught:
        plan_dock(problem, time_budget=budget, planner=planner, smoother=smoother, timing=timing)
    if isinstance(caught.value, TimedOut):
        assert "raise time_budget, which is 37 s" in str(caught.value) or budget != BUDGET
    for said in (str(caught.value), *(attempt.reason for attempt in caught.value.partial.tried)):
        assert not any(word in said for word in ("27.1", " ms", "share", "kept back"))
    return caught.value


def test_planner_that_ran_out_of_time_makes_it_a_time_out_whatever_the_guesses_failed_for():
    found = refusal(Offers(AHEAD, end=PlannerTimedOut("after 27.1 ms")), Says(blocked()))
    assert type(found) is PlannerTimedOut
    assert str(found) == (
        "Offers ran out of time; raise time_budget, which is 37 s (2 attempts failed; it is not proven that no motion "
        "exists); best attempt: FailedToSmoothPath: approach_blocked: on the final straight"
    )
    assert found.partial.raw_path.digest == AHEAD.digest


def test_planner_that_gave_up_says_nothing_about_time():
    found = refusal((Offers(AHEAD), Offers(end=NoValidPathCouldBeFound("nothing"))), Says(shut()))
    assert type(found) is FailedToSmoothPath
    assert found.where["reason"] == "clearance"


def test_guesses_that_all_ended_for_good_are_refused_by_the_bound_in_the_way():
    found = refusal(Offers(AHEAD, AHEAD), Says(shut()))
    assert type(found) is FailedToSmoothPath
    assert str(found) == ("clearance: 0.01 m from a rock (2 attempts failed; it is not proven that no motion exists)")


def test_one_guess_that_ran_out_of_time_makes_it_a_time_out():
    found = refusal(Offers(AHEAD, AROUND), Says(late(), shut(), late()))
    assert type(found) is SmootherTimedOut
    assert str(found).startswith("Says ran out of time; raise time_budget, which is 37 s (2 attempts failed")
    assert str(found).endswith("best attempt: FailedToSmoothPath: clearance: 0.01 m from a rock")
    assert found.where == {"iterations": 3}
    assert [attempt.stage for attempt in found.partial.tried] == ["offer 0", "offer 1", "offer 0"]


def test_guess_that_was_cut_short_and_ended_for_good_when_it_was_tried_again_is_none():
    found = refusal(Offers(AHEAD, AROUND), Says(late(), shut(), blocked()))
    assert type(found) is FailedToSmoothPath
    assert "2 attempts failed" in str(found)


def test_time_law_that_was_not_found_in_time_makes_it_a_time_out():
    found = refusal(Offers(AHEAD), "CasadiSmoother", timing=TimedLate())
    assert type(found) is TimingTimedOut
    assert str(found) == "TimedLate ran out of time; raise time_budget, which is 37 s"
    assert found.partial.certificate.certified
    other = refusal(Offers(AHEAD, end=NoValidPathCouldBeFound("no more")), "CasadiSmoother", timing=TimedLate())
    assert isinstance(other, FailedToTimePath)
    assert isinstance(other, TimedOut)


@pytest.mark.parametrize(
    ("direction", "paths", "kind"),
    [
        (DockDirection.FORWARD, [AHEAD], FailedToSmoothPath),
        (DockDirection.BACKWARD, [AHEAD], PlannerTimedOut),
        (DockDirection.BACKWARD, [AROUND], FailedToSmoothPath),
        (DockDirection.AUTO, [AHEAD], PlannerTimedOut),
        (DockDirection.AUTO, [AROUND], PlannerTimedOut),
        (DockDirection.AUTO, [AHEAD, AROUND], FailedToSmoothPath),
    ],
)
def test_blocked_approach_is_no_time_out(direction, paths, kind):
    found = refusal(Offers(*paths, end=PlannerTimedOut("late")), Says(blocked()), direction)
    assert type(found) is kind


def test_start_curvature_beyond_the_limit_is_no_time_out():
    sharp = FailedToSmoothPath("start_curvature: 3 1/m", where={"reason": "start_curvature", "every_path": True})
    assert type(refusal(Offers(AHEAD, end=PlannerTimedOut("late")), Says(sharp))) is FailedToSmoothPath


class Slow(Says):
    """Takes longer than there is."""

    def smooth(self, path, max_time, **rest):
        until = self.context.clock() + 1.1 * max_time
        while self.context.clock() < until:
            pass
        return super().smooth(path, max_time, **rest)


def test_guesses_not_made_in_time_give_a_time_out():
    found = refusal((Offers(AHEAD), Offers(AROUND)), Slow(shut()), budget=0.05)
    assert isinstance(found, TimedOut)
    assert "the search for other guesses ran out of time; raise time_budget, which is 0.05 s" in str(found)
    assert str(found).endswith("best attempt: FailedToSmoothPath: clearance: 0.01 m from a rock")


def test_planner_whose_share_is_used_up_between_two_guesses_ran_out_of_time(monkeypatch):
    monkeypatch.setattr(pipeline, "_LAST_PROOF", 1.0)  # nothing is left for the last of several
    found = refusal((Offers(AHEAD), Offers(AROUND)), Says(shut()))
    assert type(found) is PlannerTimedOut
    assert [attempt.stage for attempt in found.partial.tried] == ["offer 0", "Offers"]


class Odd(FailedToSmoothPath):
    """Is made in a way of its own."""

    def __init__(self, one, two):
        super().__init__(f"{one} and {two}")


def test_error_of_a_class_of_the_smoothers_own_comes_out_as_it_is():
    found = refusal(Offers(AHEAD, AROUND), Says(Odd("this", "that")))
    assert type(found) is Odd
    assert str(found) == "this and that (2 attempts failed; it is not proven that no motion exists)"
