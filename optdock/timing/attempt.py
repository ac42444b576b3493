"""One attempt at a gear: the reference under some bounds, and the motion made of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from optdock.deadline import never_late
from optdock.timing.allowance import look
from optdock.timing.arcs import launch_arc, stop_arc
from optdock.timing.grid import acceleration_profile, grid_of
from optdock.timing.guess import initial_guess
from optdock.timing.motion import Phases, State
from optdock.timing.pace import expected_duration
from optdock.timing.reference import solve_reference
from optdock.timing.smooth import cell_phases
from optdock.timing.split import nodes_of, split_into_moves

if TYPE_CHECKING:
    from collections.abc import Callable

    from optdock.timing.bounds import Bounds

__all__ = ["Attempt", "Settings", "attempt"]


# A reference so many times slower than the caps and the drive ask for was not solved: where no spline keeps the limits
# the iterations end anywhere, and samples of a motion of weeks fill any memory. Solved ones stay below 4 (benchmark).
_HOPELESS = 10.0
_RIPPLE, _SMOOTH_RIPPLE = 0.002, 0.1  # [s]: a little saves a sixth of the moves for 0.01 % of time


class Settings(NamedTuple):
    """How references are made.

    Args:
        step: Knot spacing [s].
        smooth: Whether the reference itself is the motion.
    """

    step: float = 0.08
    smooth: bool = False


class Attempt(NamedTuple):
    """A motion over a gear.

    Args:
        phases: The motion.
        bad: Stretches [m] whose moves break a limit, with the stretch of time that would cure it.
        moves: Number of moves.
        iterations: Of the interior-point method.
    """

    phases: Phases
    bad: tuple[tuple[float, float, float], ...]
    moves: int
    iterations: int

    @property
    def sound(self) -> bool:
        """Whether every move was found within the checked limits; where the reference is the motion, nobody looked."""
        return self.moves > 0 and not self.bad


def attempt(
    bounds: Bounds, start: State, settings: Settings, is_late: Callable[[], bool] = never_late
) -> Attempt | None:
    """The motion under `bounds` from `start`.

    None where launch and stop leave no room for a reference, and where no spline keeps the limits: see `_HOPELESS`.

    Raises:
        OutOfTime: `is_late` said so.
    """
    look(is_late)
    profile = acceleration_profile(bounds, start)
    launch, stop = launch_arc(bounds, start), stop_arc(bounds)
    if stop.state.s - launch.state.s < 0.1 * bounds.course.length:
        return None
    grid = grid_of(bounds, profile, launch.state, stop.state, settings.step)
    guess = initial_guess(grid, bounds, profile, launch.state, stop.state)
    ripple = _SMOOTH_RIPPLE if settings.smooth else _RIPPLE
    reference = solve_reference(grid, bounds, guess, (launch.state, stop.state), ripple, is_late)
    if reference.duration > _HOPELESS * max(expected_duration(bounds.course), float(profile.time[-1])):
        return None
    if settings.smooth:
        return Attempt(
            launch.phases + cell_phases(reference.s, reference.v, reference.a) + stop.phases,
            (),
            0,
            reference.iterations,
        )
    arcs = (sum(time for time, _jerk in launch.phases), sum(time for time, _jerk in stop.phases))
    nodes = nodes_of(reference, start, State(bounds.course.length), arcs, grid.zone)
    split = split_into_moves(nodes, bounds, is_late)
    bad = tuple(
        (nodes.s[piece.first], nodes.s[piece.last], piece.excess) for piece in split.pieces if piece.excess > 1.0
    )
    return Attempt(split.phases, bad, len(split.pieces), reference.iterations)
