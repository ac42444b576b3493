"""Answer to one planning request as plain arrays and texts: the content of the page, made in the planning process."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias

import numpy as np
import shapely

from optdock.errors import Cancelled, NoMotionExists
from optdock.geometry.arrays import readonly
from optdock.geometry.obstacles import in_words
from optdock.geometry.pose import transform_points
from optdock.impossibility import BlockedStraight, ImpossibilityProof
from optdock.io.plan_file import DEFAULT_PERIOD, TrajectoryColumns
from optdock.io.proof_cells import proof_of
from optdock.model.trajectory import Trajectory
from optdock.planning.plan import DockPlan, PartialPlan
from optdock.plotting.plan_picture import VIEW_REASONS, refused_pose
from optdock.plotting.scene import View, camera_cone, view_cones, view_of
from optdock.reports.html.certificate_words import plan_tables, plan_texts
from optdock.reports.html.figures import rings_of
from optdock.reports.html.plan_chapter import enclosed_area, plan_summary, start_relief
from optdock.reports.plan_file_verdict import PlanFileVerdict
from optdock.reports.report import failed_plan_file
from optdock.reports.shown_motion import ShownMotion, clearance_curve, shown_motion
from optdock.verification import pose_clearances

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from optdock.errors import OptdockError
    from optdock.geometry.arrays import FloatArray, IntArray
    from optdock.io.plan_file import PlanFile
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.reports.html.page import Table, Text
    from optdock.reports.shown_motion import ClearanceCurve

__all__ = ["DrawnPlan", "MarkedPlace", "Method", "PlanOutcome", "drawn_plan"]

PlanOutcome: TypeAlias = Literal["certified", "impossible", "refused", "cancelled"]
Method: TypeAlias = Literal["planned", "deformed", "proven"]

_SPACING = 0.05  # [m] between the points of a path: a chord is 1.3 mm off an arc of 4 /m
_OUTLINE_SPACING, _MOST_OUTLINES = 0.1, 150  # [m]
_MOST_TIMES = 240  # at which the quantities of the motion are given, see `_few`
_FAR = 2.0  # [m]: nearest points of obstacles farther away are not computed


class MarkedPlace(NamedTuple):
    """A pose of the robot that the page marks.

    Attributes:
        name: `least clearance`, `tightest place`, `refused here`, `bottleneck` or `blocked`.
        pose: Shape (3,).
        clearance: Signed clearance of the pose [m]; inf if no obstacle is within 2 m.
        obstacle: The nearest obstacle in words; empty without one.
        nearest: The nearest point of the robot and that of the obstacle, Shape (2, 2) [m]; a common point if they
            overlap. Empty, Shape (0, 2), without an obstacle.
    """

    name: str
    pose: FloatArray
    clearance: float
    obstacle: str
    nearest: FloatArray


@dataclass(eq=False)
class DrawnPlan:
    """Everything that the page shows of one answer.

    Args:
        number: Number of the request.
        fingerprint: Fingerprint of the request.
        outcome: `certified`, `impossible`, `refused` or `cancelled`.
        method: `planned`: by `plan_dock`. `deformed`: the previous path deformed. `proven`: the previous proof of
            impossibility, checked for the new scene.
        seconds: Time of the call [s].
        headline: The result in one line.
        texts: Certificate or refusal in words; empty in an answer that is only a picture, as `tables`.
        tables: Values of the certificate, times, and tried guesses.
        error: Name of the error; empty if certified.
        code: Error code of Nav2; 0 without one.
        outline: Footprint in the frame of the robot, Shape (k, 2) [m].
        raw: Points of the raw path, Shape (n, 2) [m]; empty without one, or if it is the path itself.
        path: Poses of the smoothed path, Shape (n, 3); without a certificate, the best path found. May be empty.
        gears: Direction of each pose of `path`, Shape (n,): 1, -1, or 0 in a turn in place.
        cusps: Poses at the cusps, Shape (m, 3).
        swept: Poses along the path at which the outline is drawn, Shape (k, 3), at most 150.
        margins: Clearance minus required clearance of these poses, Shape (k,) [m]; obstacles farther than 2 m count as
            2 m away.
        places: Places to mark.
        region: Closed region of a proof of impossibility, polygons with their outline and holes, Shape (n, 2) [m] each.
        region_end: End around which the region lies, `start` or `goal`; empty without a region.
        motion: Quantities of the motion with their bounds, or of the path if there is no motion; None without a path,
            and in an answer that is only a picture.
        cones: Cones of the camera where the marker must be in view, Shape (n, 2) [m] each.
        view: Visible rectangle; None in an answer that is only a picture.
        file: Content of the plan file without the samples of the motion and the proof, which `plan_file` adds.
    """

    number: int
    fingerprint: str
    outcome: PlanOutcome
    method: Method
    seconds: float
    headline: str
    texts: tuple[Text, ...]
    tables: tuple[Table, ...]
    error: str
    code: int
    outline: FloatArray
    raw: FloatArray
    path: FloatArray
    gears: IntArray
    cusps: FloatArray
    swept: FloatArray
    margins: FloatArray
    places: tuple[MarkedPlace, ...]
    region: tuple[tuple[FloatArray, ...], ...]
    region_end: str
    motion: ShownMotion | None
    cones: tuple[FloatArray, ...]
    view: View | None
    file: PlanFile

    @property
    def outlines(self) -> FloatArray:
        """Outlines of the robot at `swept`, Shape (k, corners, 2) [m]."""
        return transform_points(self.swept, self.outline)

    def plan_file(self, problem: DockingProblem) -> PlanFile:
        """Return the content of the plan file that `optdock plan --out` writes.

        Args:
            problem: The docking problem of the request.
        """
        file = self.file
        if file.path is None or file.time_law is None:
            return file
        motion = TrajectoryColumns.from_trajectory(Trajectory(file.path, file.time_law), DEFAULT_PERIOD)
        proof = proof_of(file.path, problem, start_relief(file)) if self.outcome == "certified" else None
        return replace(file, trajectory=motion, proof=proof)


def drawn_plan(
    asked: tuple[int, str],
    problem: DockingProblem,
    result: DockPlan | OptdockError,
    method: Method = "planned",
    seconds: float = 0.0,
    *,
    picture_only: bool = False,
) -> DrawnPlan:
    """Return the content of the page for the result of a call.

    Args:
        asked: Number and fingerprint of the request.
        problem: The docking problem.
        result: The plan, or the error that ended the call; the proof of a `NoMotionExists` must have been checked.
        method: Origin of the result.
        seconds: Time of the call [s].
        picture_only: Whether words, tables, motion and visible rectangle are left out, as while the hand drags.
    """
    outcome = _outcome(result)
    if isinstance(result, DockPlan):
        file, error = result.as_file(), ""
        path: Path | None = result.path
    else:
        file, error = failed_plan_file(result, problem.frame), type(result).__name__
        path = None if outcome == "impossible" else file.path or PartialPlan.left_by(result).path
    raw = None if file.raw_path is path else file.raw_path
    samples = None if path is None else path.sample(_SPACING)
    swept = np.zeros((0, 3)) if path is None else _spaced(path)
    curve = None if path is None else clearance_curve(swept, problem, problem.path_clearance, start_relief(file))
    places = tuple(_places(problem, result, file, (path, swept, curve)))
    tightest = [one.obstacle for one in places if one.name == "tightest place" and one.obstacle]
    guess = None if raw is None else raw.sample(_SPACING)
    shown = [each.poses for each in (samples, guess) if each is not None]
    proof = file.impossibility if isinstance(file.impossibility, ImpossibilityProof) else None
    verdict = PlanFileVerdict(_VERDICTS.get(outcome, "refuted"), ())
    return DrawnPlan(
        *asked,
        outcome,
        method,
        seconds,
        ", tightest beside ".join((plan_summary(file), *tightest)),
        () if picture_only else tuple(plan_texts(file, problem, verdict)),
        () if picture_only else tuple(table for table in plan_tables(file, verdict) if table.rows),
        error,
        0 if file.error is None else file.error.code,
        problem.robot.footprint.vertices,
        np.zeros((0, 2)) if guess is None else guess.poses[:, :2],
        np.zeros((0, 3)) if samples is None else samples.poses,
        np.zeros(0, dtype=np.int64) if samples is None else samples.direction,
        np.zeros((0, 3)) if path is None or not path.cusps else path.poses_at(np.array(path.cusps)),
        swept,
        np.zeros(0) if curve is None else curve.margins,
        places,
        () if proof is None else _region(proof),
        "" if proof is None else proof.end,
        None if path is None or picture_only else _few(shown_motion(file, path, problem)),
        tuple(_cones(problem, path, result, places)),
        None if picture_only else view_of(problem, [*shown, *(place.pose[None] for place in places)]),
        replace(file, trajectory=None),
    )


_VERDICTS: dict[str, Literal["certified", "impossible"]] = {"certified": "certified", "impossible": "impossible"}


def _outcome(result: DockPlan | OptdockError) -> PlanOutcome:
    if isinstance(result, DockPlan):
        return "certified"
    if isinstance(result, NoMotionExists):
        return "impossible"
    return "cancelled" if isinstance(result, Cancelled) else "refused"


def _spaced(path: Path) -> FloatArray:
    """Return poses along a path about 0.1 m apart, at most 150, with both ends and at least 2. Shape (n, 3)."""
    count = min(max(2, 1 + math.ceil(path.length / _OUTLINE_SPACING)), _MOST_OUTLINES)
    return path.poses_at(np.linspace(0.0, path.length, count))


def _few(motion: ShownMotion) -> ShownMotion:
    """Return a motion with its panels at no more than 240 times."""
    if motion.panels_at.size <= _MOST_TIMES:
        return motion
    rows = np.unique(np.linspace(0, motion.panels_at.size - 1, _MOST_TIMES).round().astype(int))
    panels = [
        panel._replace(**{name: getattr(panel, name)[rows] for name in panel._fields[1:]}) for panel in motion.panels
    ]
    return motion._replace(panels=panels, panels_at=motion.panels_at[rows])


@functools.lru_cache(maxsize=1)  # the same proof holds for many scenes while the hand drags
def _region(proof: ImpossibilityProof) -> tuple[tuple[FloatArray, ...], ...]:
    return tuple(tuple(map(readonly, part)) for part in rings_of(enclosed_area(proof)))


# Places.


def _places(
    problem: DockingProblem,
    result: DockPlan | OptdockError,
    file: PlanFile,
    drawn: tuple[Path | None, FloatArray, ClearanceCurve | None],
) -> Iterator[MarkedPlace]:
    """Generate the poses of least clearance and least margin, or the refused or blocked poses."""
    path, swept, curve = drawn
    proof = file.impossibility
    if isinstance(result, DockPlan):
        assert curve is not None
        if math.isfinite(result.certificate.min_clearance):
            yield _place("least clearance", problem, result.path.poses_at(result.certificate.at_s)[0])
            k = int(np.argmin(curve.margins))
            yield _marked("tightest place", problem, swept[k], (float(curve.clearances[k]), int(curve.rows[k])))
    elif isinstance(proof, BlockedStraight):
        for blocked in proof.poses:
            yield _place("blocked", problem, np.array([blocked.x, blocked.y, blocked.yaw]))
    else:
        pose = refused_pose(problem, type(result).__name__, result.where, path or file.raw_path)
        if pose is not None:
            name = "bottleneck" if proof is not None and proof.bottleneck is not None else "refused here"
            yield _place(name, problem, pose.as_array())


def _place(name: str, problem: DockingProblem, pose: FloatArray) -> MarkedPlace:
    clearances, rows = pose_clearances(pose[None], problem.robot.footprint, problem.all_obstacles, within=_FAR)
    return _marked(name, problem, pose, (float(clearances[0]), int(rows[0])))


def _marked(name: str, problem: DockingProblem, pose: FloatArray, nearest: tuple[float, int]) -> MarkedPlace:
    """Return a place, given its clearance [m] and the row of the nearest obstacle, with the nearest points."""
    obstacles, footprint, (clearance, row) = problem.all_obstacles, problem.robot.footprint, nearest
    if row < 0:
        return MarkedPlace(name, pose, math.inf, "", np.zeros((0, 2)))
    robot, obstacle = shapely.Polygon(transform_points(pose[None], footprint.vertices)[0]), obstacles.vertices[row]
    points = shapely.get_coordinates(shapely.shortest_line(robot, shapely.Polygon(obstacle)))
    return MarkedPlace(name, pose, clearance, in_words(obstacles.name_of(row)), points)


def _cones(
    problem: DockingProblem, path: Path | None, result: DockPlan | OptdockError, places: Sequence[MarkedPlace]
) -> Iterator[FloatArray]:
    """Generate the cones of the camera along the path, and at a pose that is refused because of the view."""
    view = problem.required_view
    if view is None:
        return
    if path is not None:
        yield from view_cones(view, path)
    if not isinstance(result, DockPlan) and result.where.get("reason") in VIEW_REASONS:
        yield from (camera_cone(view, place.pose) for place in places)
