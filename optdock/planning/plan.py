"""Results of planning: the certified plan, and the partial plan of a failed call."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from optdock.errors import CertificationFailed, InvalidFile, MissingExtra, OptdockError
from optdock.geometry.checked import exactly, instance
from optdock.geometry.lazy import cached_property
from optdock.geometry.obstacles import in_words
from optdock.io.plan_file import (
    CERTIFIED,
    DEFAULT_PERIOD,
    DEFAULT_SPACING,
    PlanFile,
    TrajectoryColumns,
    load_plan,
    save_columns_csv,
    save_plan,
)
from optdock.io.proof_cells import proof_of
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.trajectory import Trajectory
from optdock.planners.manoeuvres.price import price_of
from optdock.plugins.outcomes import SmoothingReport, TimingReport
from optdock.verification import ProvenMotion, compiled_clearances, end_clearances, prove_motion

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path as FilePath

    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = ["Attempt", "DockPlan", "PartialPlan", "Tightest", "tightest_place"]


_FAR = 2.0  # [m]: obstacles farther away are not considered


class Tightest(NamedTuple):
    """Place on a path with the least clearance beyond the required one.

    `margin`: that clearance [m]. `s`: path coordinate [m]. `obstacle`: name of the nearest obstacle.
    """

    margin: float
    s: float
    obstacle: str


def tightest_place(
    path: Path, problem: DockingProblem, start_relief: float = 0.0, step: float = 0.01, within: float = _FAR
) -> Tightest | None:
    """Return the place of `DockPlan.tightest` on any path.

    Args:
        path: A path, which does not need to be certified.
        problem: The problem.
        start_relief: `start_relief` of the certificate of the path [m].
        step: Distance between the samples [m].
        within: Largest distance of obstacles that are considered [m].
    """
    s, rule = np.arange(0.0, path.length, step), problem.clearance
    poses, at_start = path.poses_at(s), end_clearances(problem).start
    is_far = rule.required_for(poses, problem.goal, problem.start, at_start, start_relief) >= rule.required
    s, poses = s[is_far], poses[is_far]
    if not s.size or not len(problem.all_obstacles):
        return None
    clearances, rows = compiled_clearances(poses, problem.robot.footprint, problem.all_obstacles, within)
    k = int(np.argmin(clearances))
    if not clearances[k] < within:
        return None
    return Tightest(float(clearances[k] - rule.required), float(s[k]), problem.all_obstacles.name_of(int(rows[k])))


class Attempt(NamedTuple):
    """A guess and its result.

    Attributes:
        stage: Source of the guess: the stage of a planner, `given` for a guess of the caller, or the name of a planner
            that had no guess.
        guess: The guess; None if a planner had none.
        seconds: Time for smoothing, proof and timing [s].
        price: Price of the plan [s], see `DockPlan.price`; inf if there is no plan.
        reason: Reason for the failure; empty if there is a plan.
    """

    stage: str
    guess: Path | None
    seconds: float = 0.0
    price: float = math.inf
    reason: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return plain values for a plan file."""
        shape = {} if self.guess is None else {"length": self.guess.driven, "cusps": len(self.guess.cusps)}
        found = {"reason": self.reason} if self.reason else {"price": self.price}
        return {"stage": self.stage, **shape, "seconds": self.seconds, **found}

    def __str__(self) -> str:
        shape = "" if self.guess is None else f" {self.guess.driven:.2f} m, {len(self.guess.cusps)} cusps"
        found = self.reason or f"certified, price {self.price:.2f} s"
        return f"{self.stage}{shape}, {1e3 * self.seconds:.1f} ms: {found}"


@dataclass(frozen=True, eq=False, repr=False)
class DockPlan:
    """A certified plan.

    Args:
        motion: The proven path and time law, with the problem and the start pose; made by `prove_motion`.
        raw_path: The guess from which the plan was made, for comparison; it is not certified.
        completed: False if the deadline ended the smoothing early; the path is certified in either case.
        timing_ms: Wall-clock milliseconds per stage over all guesses: plan, smooth, certify, time, prove; also `first`,
            the time until the first certified plan, and `total`, the time of the call.
        smoothing_report: Report of the smoother.
        timing_report: Report of the time parameterizer.
        tried: Every guess in order, with its result; this plan has the lowest price.

    Raises:
        InvalidValue: If `motion` is not a proven motion, or `raw_path` not a path.
    """

    motion: ProvenMotion
    raw_path: Path
    completed: bool = True
    timing_ms: Mapping[str, float] = field(default_factory=dict)
    smoothing_report: SmoothingReport = field(default_factory=SmoothingReport)
    timing_report: TimingReport = field(default_factory=TimingReport)
    tried: tuple[Attempt, ...] = ()

    def __post_init__(self) -> None:
        exactly(ProvenMotion, self.motion, "plan.motion")
        exactly(Path, self.raw_path, "plan.raw_path")
        _ = self.motion.trajectory  # raises without a proof

    @property
    def problem(self) -> DockingProblem:
        """The problem for which path and motion are proven."""
        return self.motion.problem

    @property
    def path(self) -> Path:
        """The certified path."""
        return self.motion.trajectory.path

    @property
    def trajectory(self) -> Trajectory:
        """The certified motion along the path."""
        return self.motion.trajectory

    @property
    def certificate(self) -> Certificate:
        """The certificate of the path."""
        return self.motion.certificate

    @property
    def trajectory_certificate(self) -> TrajectoryCertificate:
        """The certificate of the motion limits."""
        return self.motion.trajectory_certificate

    def __str__(self) -> str:
        status = CERTIFIED if self.completed else f"{CERTIFIED}, stopped early by the time budget"
        parts = [f"{status}: {self.path.driven:.2f} m in {self.trajectory.duration:.2f} s"]
        if math.isfinite(self.certificate.min_clearance):
            parts.append(f"closest {self.certificate.min_clearance:.3f} m to {in_words(self.certificate.nearest)}")
        if self.smoothing_report.sampled:
            names = ", ".join(bound.name for bound in self.smoothing_report.sampled)
            parts.append(f"sampled, not proven: {names}")
        if "total" in self.timing_ms:
            parts.append(f"planned in {self.timing_ms['total']:.1f} ms")
        return ", ".join(parts)

    def __repr__(self) -> str:
        return f"<DockPlan {self}>"

    @cached_property
    def price(self) -> float:
        """The price by which plans are compared [s], see `price_of`."""
        return price_of(self.path, self.trajectory.duration, self.motion.problem.robot)

    @property
    def stage(self) -> str:
        """Source of the guess of this plan; empty if unknown."""
        return next((attempt.stage for attempt in self.tried if attempt.guess is self.raw_path), "")

    @property
    def frame(self) -> str:
        """Name of the coordinate frame of all poses."""
        return self.path.frame

    def tightest(self, step: float = 0.01, within: float = _FAR) -> Tightest | None:
        """Return the sampled pose with the least clearance beyond the required one, away from the start and the dock.

        Only poses at which the whole clearance is required are considered.

        Args:
            step: Distance between the samples [m].
            within: Largest distance of obstacles that are considered [m].

        Returns:
            The place; None if there is no such pose.
        """
        return tightest_place(self.path, self.problem, self.certificate.start_relief, step, within)

    def as_file(self, period: float = DEFAULT_PERIOD, *, proof: bool = False) -> PlanFile:
        """Return the content of the plan file.

        Args:
            period: Largest time between trajectory samples [s].
            proof: Whether the file has the proof for the second judge, which takes some milliseconds.

        Raises:
            InvalidValue: If the period is not > 0, or is far too small.
        """
        certificate, sampled = self.certificate, self.smoothing_report.sampled
        own: dict[str, object] = {"sampled": [bound.as_dict() for bound in sampled]} if sampled else {}
        return PlanFile(
            status=CERTIFIED,
            completed=self.completed,
            frame=self.frame,
            raw_path=self.raw_path,
            path=self.path,
            trajectory=TrajectoryColumns.from_trajectory(self.trajectory, period),
            time_law=self.trajectory.time_law,
            certificate={**certificate.as_dict(), "trajectory": self.trajectory_certificate.as_dict(), **own},
            timing_ms=self.timing_ms,
            tried=tuple(attempt.as_dict() for attempt in self.tried),
            proof=proof_of(self.path, self.problem, certificate.start_relief) if proof else None,
        )

    def save(self, target: str | FilePath, *, spacing: float = DEFAULT_SPACING, period: float = DEFAULT_PERIOD) -> None:
        """Write a plan file, format `optdock-plan/1`, with the proof for the second judge.

        Args:
            target: File name.
            spacing: Largest distance between path samples [m].
            period: Largest time between trajectory samples [s].

        Raises:
            InvalidFile: If the file cannot be written.
            InvalidValue: If spacing or period is not > 0, or is far too small.
        """
        save_plan(target, self.as_file(period, proof=True), spacing=spacing)

    def save_csv(self, target: str | FilePath, *, period: float = DEFAULT_PERIOD) -> None:
        """Write the trajectory as a table, one row per sample; the first row has column names and units.

        Args:
            target: File name.
            period: Largest time between samples [s]; ends and cusps are among them.

        Raises:
            InvalidFile: If the file cannot be written.
            InvalidValue: If the period is not > 0, or is far too small.
        """
        save_columns_csv(target, TrajectoryColumns.from_trajectory(self.trajectory, period))

    @classmethod
    def load(cls, source: str | FilePath, problem: DockingProblem) -> DockPlan:
        """Read a plan file and prove its path and motion for `problem`; the certificate in the file is not used.

        `load_plan` reads a file without proving its content.

        Args:
            source: File with the exact time law that `save` writes.
            problem: Problem for which the plan is certified again.

        Raises:
            InvalidFile: If the file cannot be read, violates the format, or contains no path, raw path or time law.
            InvalidPath: If the path is not in the frame of the problem.
            CertificationFailed: If the plan does not solve `problem`.
            InvalidValue: If `problem` is not a DockingProblem.
        """
        instance(DockingProblem, problem, "problem")
        found = load_plan(source)
        if found.path is None or found.raw_path is None or found.time_law is None:
            missing = [name for name in ("raw_path", "path", "time_law") if getattr(found, name) is None]
            listed = ", ".join("trajectory.phases" if name == "time_law" else name for name in missing)
            raise InvalidFile(f"{source}: holds no {listed}, so there is no plan to prove")
        path, raw_path = found.path.with_frame(problem.frame), found.raw_path.with_frame(problem.frame)
        try:
            motion = prove_motion(Trajectory(path, found.time_law), problem)
        except CertificationFailed as error:
            raise CertificationFailed(f"{source}: for this problem {error}", where=error.where) from error
        return cls(motion, raw_path, found.completed, found.timing_ms)

    def plot(self, target: str | FilePath, title: str = "") -> None:
        """Draw the map, the obstacles, the dock, the paths, the swept footprint, and the position of least clearance.

        Args:
            target: File name; the suffix selects the format.
            title: Title; if empty, a description of the plan in one line.

        Raises:
            MissingExtra: If Matplotlib is not installed.
            InvalidFile: If the file cannot be written.
            InvalidValue: If the suffix names no picture format.
        """
        from optdock.plotting import save_plan_picture

        save_plan_picture(target, **self._drawing(title))

    def show(self) -> None:
        """Open a window with the picture of `plot`.

        Notebooks display this picture if the last expression of a cell is the plan.

        Raises:
            MissingExtra: If Matplotlib is not installed.
        """
        from optdock.plotting import PlanDrawing, show_plan_picture

        show_plan_picture(PlanDrawing(**self._drawing()))

    def _repr_png_(self) -> bytes | None:
        """Return the picture for notebooks; None without Matplotlib."""
        from optdock.plotting import PlanDrawing, plan_picture_png

        with suppress(MissingExtra):
            return plan_picture_png(PlanDrawing(**self._drawing()))
        return None

    def _drawing(self, title: str = "") -> dict[str, Any]:
        return {
            "problem": self.problem,
            "raw_path": self.raw_path,
            "path": self.path,
            "certificate": self.certificate,
            "title": title or str(self),
        }


@dataclass(eq=False, repr=False)
class PartialPlan:
    """Results that a call had produced when it failed, available as attribute `partial` of the error.

    Args:
        raw_path: The planner's path, or None.
        path: The smoothed path. After an error of the smoother, `path` is the smoother's best path, which violates the
            bound named in the error and may miss the goal. The path is certified only if `certificate` is true. None if
            there is no path.
        certificate: The certificate of `path`, or None.
        timing_ms: Wall-clock milliseconds per stage.
        tried: Every guess and its result.
    """

    raw_path: Path | None = None
    path: Path | None = None
    certificate: Certificate | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)
    tried: tuple[Attempt, ...] = ()

    @classmethod
    def left_by(cls, error: OptdockError) -> PartialPlan:
        """Return the partial plan of an error, or an empty partial plan if the error has none."""
        return error.partial if isinstance(error.partial, cls) else cls()

    def __repr__(self) -> str:
        has = [name for name in ("raw_path", "path", "certificate") if getattr(self, name) is not None]
        spent = f" after {self.timing_ms['total']:.1f} ms" if "total" in self.timing_ms else ""
        return f"<PartialPlan with {', '.join(has) or 'nothing'}{spent}>"
