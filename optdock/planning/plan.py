"""Plans: what `plan_dock` returns, and what exists of one when it fails. They print, save and draw themselves."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, NamedTuple

from optdock.errors import CertificationFailed, InvalidFile, MissingExtra, OptdockError
from optdock.geometry.checked import exactly, instance
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
from optdock.model.path import Path
from optdock.model.problem import DockingProblem
from optdock.model.trajectory import Trajectory
from optdock.planners.manoeuvres.price import price_of
from optdock.plugins.outcomes import SmoothingReport, TimingReport
from optdock.verification import ProvenMotion, prove_motion

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path as FilePath

    from optdock.verification import Certificate, TrajectoryCertificate

__all__ = ["Attempt", "DockPlan", "PartialPlan"]


class Attempt(NamedTuple):
    """A guess, and what became of it.

    Attributes:
        stage: Where the guess came from: the stage of a planner, `given` by the caller, or a planner that had none.
        guess: The guess; None where a planner had none.
        seconds: What smoothing, proof and timing took.
        price: Of the plan that was made of it [s], see `DockPlan.price`; inf where none was.
        reason: Why none was; empty where one was.
    """

    stage: str
    guess: Path | None
    seconds: float = 0.0
    price: float = math.inf
    reason: str = ""

    def as_dict(self) -> dict[str, object]:
        """Plain values for a plan file."""
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
        motion: What is proven: path and time law, for what problem, from which pose. `prove_motion` makes it.
        raw_path: What the planner made; not certified, kept for comparison.
        completed: False when the deadline stopped the smoothing early; the result is certified all the same.
        timing_ms: Wall-clock milliseconds per stage, over all guesses: plan, smooth, certify, time, prove; the first
            certified plan was there after `first`, all was done after `total`.
        smoothing_report: What the smoother says about its work.
        timing_report: What the time parameterizer says about its work.
        tried: Every guess that was tried, in this order, and what became of it; this plan is the one of the lowest
            price.

    Raises:
        InvalidValue: `motion` is not a proven motion, or `raw_path` not a path.
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
        _ = self.motion.trajectory  # raises where no proof was made of it

    @property
    def problem(self) -> DockingProblem:
        """What was asked for, and what path and motion are proven for."""
        return self.motion.problem

    @property
    def path(self) -> Path:
        """The certified path."""
        return self.motion.trajectory.path

    @property
    def trajectory(self) -> Trajectory:
        """The certified motion along it."""
        return self.motion.trajectory

    @property
    def certificate(self) -> Certificate:
        """The proof of the path."""
        return self.motion.certificate

    @property
    def trajectory_certificate(self) -> TrajectoryCertificate:
        """The proof of the motion limits."""
        return self.motion.trajectory_certificate

    def __str__(self) -> str:
        status = CERTIFIED if self.completed else f"{CERTIFIED}, stopped early by the time budget"
        parts = [f"{status}: {self.path.driven:.2f} m in {self.trajectory.duration:.2f} s"]
        if math.isfinite(self.certificate.min_clearance):
            parts.append(f"closest {self.certificate.min_clearance:.3f} m to {in_words(self.certificate.nearest)}")
        if "total" in self.timing_ms:
            parts.append(f"planned in {self.timing_ms['total']:.1f} ms")
        return ", ".join(parts)

    def __repr__(self) -> str:
        return f"<DockPlan {self}>"

    @property
    def price(self) -> float:
        """What plans are chosen by [s], see `price_of`."""
        return price_of(self.path, self.trajectory.duration, self.motion.problem.robot)

    @property
    def stage(self) -> str:
        """Where the guess of this plan came from; empty where it was not given."""
        return next((attempt.stage for attempt in self.tried if attempt.guess is self.raw_path), "")

    @property
    def frame(self) -> str:
        """Name of the coordinate frame that every pose of the plan stands in."""
        return self.path.frame

    def as_file(self, period: float = DEFAULT_PERIOD) -> PlanFile:
        """The content of its plan file, the trajectory sampled at most every `period` [s].

        Raises:
            InvalidValue: The period is not > 0, or far too small.
        """
        return PlanFile(
            status=CERTIFIED,
            completed=self.completed,
            frame=self.frame,
            raw_path=self.raw_path,
            path=self.path,
            trajectory=TrajectoryColumns.from_trajectory(self.trajectory, period),
            time_law=self.trajectory.time_law,
            certificate={**self.certificate.as_dict(), "trajectory": self.trajectory_certificate.as_dict()},
            timing_ms=self.timing_ms,
            tried=tuple(attempt.as_dict() for attempt in self.tried),
        )

    def save(self, target: str | FilePath, *, spacing: float = DEFAULT_SPACING, period: float = DEFAULT_PERIOD) -> None:
        """Write a plan file, format `optdock-plan/1`.

        Args:
            target: Where.
            spacing: Largest distance between path samples [m].
            period: Largest time between trajectory samples [s].

        Raises:
            InvalidFile: The file cannot be written.
            InvalidValue: Spacing or period is not > 0, or far too small.
        """
        save_plan(target, self.as_file(period), spacing=spacing)

    def save_csv(self, target: str | FilePath, *, period: float = DEFAULT_PERIOD) -> None:
        """Write the trajectory as a table, a row per sample; the first row names columns and units.

        Args:
            target: Where.
            period: Largest time between samples [s]; ends and cusps are among them.

        Raises:
            InvalidFile: The file cannot be written.
            InvalidValue: The period is not > 0, or far too small.
        """
        save_columns_csv(target, TrajectoryColumns.from_trajectory(self.trajectory, period))

    @classmethod
    def load(cls, source: str | FilePath, problem: DockingProblem) -> DockPlan:
        """Read a plan file and prove its path and its motion anew, for `problem`; what the file claims plays no part.

        `load_plan` reads a file without judging it.

        Args:
            source: The file, with the exact time law that `save` writes.
            problem: What the plan must solve now.

        Raises:
            InvalidFile: The file cannot be read, breaks its format, or holds no path, raw path or time law.
            InvalidPath: It stands in another frame than the problem.
            CertificationFailed: It does not solve `problem`, or not any more.
            InvalidValue: `problem` is none.
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
        """Draw map, obstacles, dock, paths, the swept footprint, and the tightest place.

        Args:
            target: Where; the suffix chooses the format.
            title: Above the picture; empty: the plan in a line.

        Raises:
            MissingExtra: Matplotlib is not installed.
            InvalidFile: The file cannot be written.
            InvalidValue: The suffix names no picture format.
        """
        from optdock.plotting import save_plan_picture

        save_plan_picture(target, **self._drawing(title))

    def show(self) -> None:
        """Open a window with the picture that `plot` draws; a notebook shows it below a cell that ends with the plan.

        Raises:
            MissingExtra: Matplotlib is not installed.
        """
        from optdock.plotting import PlanDrawing, show_plan_picture

        show_plan_picture(PlanDrawing(**self._drawing()))

    def _repr_png_(self) -> bytes | None:
        """The picture, as notebooks ask for it; None without Matplotlib."""
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
    """Whatever exists of a plan so far; hangs as `partial` on the error that ended it.

    Args:
        raw_path: The planner's path, or None.
        path: The smoothed path; or, on a smoother's refusal, the best path that it found, which breaks the bound that
            the error names: it is for looking at, and may end beside the goal. Certified only where `certificate` says
            so. None: there is none.
        certificate: The verdict on `path`, or None.
        timing_ms: Wall-clock milliseconds of the stages that ran.
        tried: Every guess that was tried, and what became of it.
    """

    raw_path: Path | None = None
    path: Path | None = None
    certificate: Certificate | None = None
    timing_ms: dict[str, float] = field(default_factory=dict)
    tried: tuple[Attempt, ...] = ()

    @classmethod
    def left_by(cls, error: OptdockError) -> PartialPlan:
        """What a call had finished when it failed; nothing where the error does not say."""
        return error.partial if isinstance(error.partial, cls) else cls()

    def __repr__(self) -> str:
        has = [name for name in ("raw_path", "path", "certificate") if getattr(self, name) is not None]
        spent = f" after {self.timing_ms['total']:.1f} ms" if "total" in self.timing_ms else ""
        return f"<PartialPlan with {', '.join(has) or 'nothing'}{spent}>"
