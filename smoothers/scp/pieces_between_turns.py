"""Smoothing of paths that turn in place: the pieces between the turns are smoothed separately.

Positions and headings of turns are kept, so a piece has fixed poses at both ends and free curvature at turns. The
clearance rules near start and goal of the whole problem apply to every piece, and the certificate covers the whole
path.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple, cast

import numpy as np

from optdock.errors import FailedToSmoothPath, SmootherTimedOut
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.model.dock import Dock, DockDirection
from optdock.model.path import ClothoidSegment, Path, PolylineSegment, TurnSegment, parts_between_turns
from optdock.model.problem import DockingProblem
from optdock.model.segments import SAME_YAW
from optdock.planning.plan import PartialPlan
from optdock.plugins.interfaces import SmoothingStatus
from smoothers.scp.refusals import refuse_turns
from smoothers.scp.search import Call, Incumbent, SearchOutcome, Solver, straight_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from optdock.deadline import Deadline
    from optdock.model.path import Segment
    from smoothers.scp.qp_step import ProgramPool
    from smoothers.scp.settings import AnytimeSettings, Settings

__all__ = ["TurningSolver", "with_turns"]

_STRAIGHT_SAMPLES = 33
_MEANT = 0.5  # [rad]: smaller turns without motion may be part of a coarsely sampled curve
# Share of the remaining time that is reserved for the certificate of the whole, as measured for pieces.
_CERTIFICATE_SHARE = 0.2


class _Joined(NamedTuple):
    """Pieces and turns so far, their cost, and whether a straight piece of the input was kept."""

    segments: list[Segment]
    cost: float
    kept: bool


@dataclass
class TurningSolver:
    """Solver for paths with turns, which smooths the pieces between them; arguments as for `Solver`."""

    pool: ProgramPool
    deadline: Deadline
    cancelled: Callable[[], bool]
    settings: Settings
    outcome: SearchOutcome = field(default_factory=SearchOutcome)

    def follow_strategy(self, call: Call) -> Incumbent:
        """Return a certified path; straight pieces are kept if the whole path can be certified with them.

        Raises:
            FailedToSmoothPath: If a bound cannot be satisfied.
            SmootherTimedOut: If no path is certified in time.
            SmootherCancelled: If `cancelled` returned True.
        """
        refusal = refuse_turns(call.path, call.problem)
        if refusal is not None:
            raise refusal.error()
        found = self._joined(call, keeps_straight=call.terms is None or not call.terms.soft)
        best = self._certified(found, call, is_final=not found.kept)
        if best is None:
            best = self._certified(self._joined(call, keeps_straight=False), call, is_final=True)
            assert best is not None  # the last attempt raises
        return best

    def _joined(self, call: Call, *, keeps_straight: bool) -> _Joined:
        """Return all turns and pieces, where each piece begins at the end of the turn before it."""
        problem, parts = call.problem, parts_between_turns(call.path)
        earlier = _parts_like(call.earlier, parts)
        anytime = self.settings.anytime
        searched = [_straight(part, part.start, part.end, anytime) is None for part in parts if isinstance(part, Path)]
        to_search = sum(searched) if keeps_straight else len(searched)
        self.outcome.converged = True
        found, pose = _Joined([], 0.0, kept=False), problem.start
        for i, part in enumerate(parts):
            if isinstance(part, TurnSegment):
                turn = part.turn + normalize_angle(part.pose.yaw - pose.yaw)
                if i == len(parts) - 1:
                    turn += normalize_angle(problem.goal.yaw - (pose.yaw + turn))
                if abs(turn) > SAME_YAW:
                    turned = TurnSegment(pose, turn)
                    found.segments.append(turned)
                    pose = turned.end
                continue
            piece = _piece_problem(problem, parts, i, pose)
            line = _straight(part, pose, piece.goal, anytime) if keeps_straight else None
            if line is not None and piece.start_curvature in (None, 0.0):
                found.segments.append(line)
                found = found._replace(cost=found.cost + call.formulation.weights.length * line.length, kept=True)
            else:
                after = sum(later.length for later in parts[i + 1 :] if isinstance(later, Path))
                before = sum(one.length for one in found.segments if not isinstance(one, TurnSegment))
                asked = call._replace(path=part, problem=piece, earlier=earlier[i], within=problem)
                asked = asked._replace(after=after, before=before)
                best = self._smoothed(asked, found.segments, max(to_search, 1))
                found.segments.extend(best.path.segments)
                found = found._replace(cost=found.cost + best.cost)
                to_search -= 1
            pose = Pose2.from_sequence(found.segments[-1].poses_at(found.segments[-1].length)[0])
        return found

    def _smoothed(self, call: Call, before: Sequence[Segment], to_search: int) -> Incumbent:
        """Smooth one piece within its share of the remaining time."""
        left = (1.0 - _CERTIFICATE_SHARE) * self.deadline.left / to_search
        solver = Solver(
            self.pool, self.deadline.shortened(at_most=self.deadline.elapsed + left), self.cancelled, self.settings
        )
        began = sum(segment.length for segment in before)
        try:
            best = solver.follow_strategy(call)
        except FailedToSmoothPath as error:
            where = {**error.where, "s": began + float(cast("float", error.where["s"]))}
            place = f"of the piece between turns in place that begins at s = {began:.3f} m"
            refused = FailedToSmoothPath(f"{error} ({place})", where=where)
            tried = PartialPlan.left_by(error).path
            if tried is not None:
                refused.partial = PartialPlan(path=Path((*before, *tried.segments), tried.frame))
            raise refused from error
        finally:
            made, total = solver.outcome, self.outcome
            total.iterations += made.iterations
            total.certify_time += made.certify_time
            total.setup_time = total.setup_time or made.setup_time
            total.converged = total.converged and made.converged
        return best

    def _certified(self, found: _Joined, call: Call, *, is_final: bool) -> Incumbent | None:
        """Return the whole path if it is accepted; otherwise raise the violation if `is_final`, or return None."""
        began, problem = self.deadline.elapsed, call.problem
        if not found.segments:
            raise FailedToSmoothPath("goal_unreachable: the raw path has no piece left between its turns", where={})
        path = Path(tuple(found.segments), problem.frame)
        latest = self.settings.anytime.latest
        verdict = call.judged(path, lambda: self.deadline.left < -latest)
        self.outcome.certify_time += self.deadline.elapsed - began
        if verdict.accepted:
            self.outcome.first_certified = self.deadline.elapsed
            kept = SmoothingStatus.INPUT_KEPT if self.outcome.iterations == 0 else None
            return Incumbent(path, verdict.certificate, found.cost, kept)
        if self.deadline.passed():
            message = f"no certified path within {1e3 * self.deadline.seconds:.1f} ms"
            raise SmootherTimedOut(message, where={"iterations": self.outcome.iterations})
        if is_final:
            raise verdict.refusal(path).error()
        return None


def with_turns(path: Path) -> Path:
    """Return the path with large in-place turns of its polylines replaced by turn segments.

    Grid and lattice planners produce such steps. A turn at the end of a path is kept unchanged, because planners
    overwrite the heading of the last pose with the heading of the goal.
    """
    segments: list[Segment] = []
    for segment in path.segments:
        segments.extend(_split(segment) if isinstance(segment, PolylineSegment) else [segment])
    is_meant = len(segments) > len(path.segments) and not isinstance(segments[-1], TurnSegment)
    return Path(tuple(segments), path.frame) if is_meant else path


def _split(segment: PolylineSegment) -> list[Segment]:
    """Return the drives and turns of a polyline, in order."""
    poses, is_still = segment.poses, np.diff(segment.knots) <= 0.0
    parts: list[Segment] = []
    begin = at = 0
    for still, steps in itertools.groupby(is_still.tolist()):
        end = at + len(list(steps))
        turn = float(poses[end, 2] - poses[at, 2])
        if still and abs(turn) >= _MEANT:
            if at > begin:
                parts.append(PolylineSegment(poses[begin : at + 1], segment.direction))
            parts.append(TurnSegment(Pose2.from_sequence(poses[at]), turn))
            begin = end
        at = end
    if at > begin:
        parts.append(PolylineSegment(poses[begin : at + 1], segment.direction))
    return parts


def _piece_problem(problem: DockingProblem, parts: Sequence[Path | TurnSegment], i: int, pose: Pose2) -> DockingProblem:
    """Return the problem of the piece at `i` from `pose`, with the rules for the ends of the path that it contains."""
    part, later = parts[i], parts[i + 1 :]
    dock = problem.dock
    direction = DockDirection.AUTO if any(isinstance(other, Path) for other in later) else dock.direction
    if not later:
        target, straight = problem.goal, dock.final_straight
    elif len(later) == 1:  # a turn at the goal follows
        target, straight = Pose2(problem.goal.x, problem.goal.y, part.end.yaw), 0.0
    else:
        target, straight = part.end, 0.0
    return DockingProblem(
        pose,
        Dock(target, direction=direction, final_straight=straight),
        problem.robot,
        problem.all_obstacles,
        problem.clearance,
        start_speed=problem.start_speed if i == 0 else 0.0,
        start_curvature=problem.start_curvature if i == 0 else None,
        frame=problem.frame,
    )


def _straight(part: Path, start: Pose2, end: Pose2, settings: AnytimeSettings) -> ClothoidSegment | None:
    """Return the straight line between two poses if the piece is straight and both poses are on one axis."""
    line = straight_line(part, start, end, settings)
    if line is None:
        return None
    poses = part.poses_at(np.linspace(0.0, part.length, _STRAIGHT_SAMPLES))
    c, s = math.cos(start.yaw), math.sin(start.yaw)
    beside = np.abs(c * (poses[:, 1] - start.y) - s * (poses[:, 0] - start.x))
    return line if float(beside.max()) <= settings.same_pose else None


def _parts_like(earlier: Path | None, parts: Sequence[Path | TurnSegment]) -> Sequence[Path | None]:
    """Return the pieces of an earlier result with the same sequence of drives and turns, or None for each part."""
    nothing: tuple[Path | None, ...] = (None,) * len(parts)
    if earlier is None:
        return nothing
    found = parts_between_turns(earlier)
    if [type(part) for part in found] != [type(part) for part in parts]:
        return nothing
    return [part if isinstance(part, Path) else None for part in found]
