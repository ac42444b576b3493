"""Check of a plan file: every part is proven, compared with proven values, or listed as not checked.

The path is proven. The motion is proven if the file has its phases; otherwise its samples may refute it. A proof that
no motion exists is checked. Other values (certificate, tried guesses) are compared with the values computed here, up to
the rounding of files. Columns of paths are compared with their curves on reading, see `optdock.io.path_columns`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from optdock import errors
from optdock.errors import InvalidFile, OptdockError
from optdock.geometry.pose import Pose2, normalize_angle
from optdock.impossibility import BlockedStraight, check_impossibility
from optdock.io.numbers import is_number
from optdock.io.plan_file import CERTIFIED, UNKNOWN
from optdock.io.proof_cells import statement_of
from optdock.io.quoting import shown
from optdock.model.path import may_be_one_frame
from optdock.model.trajectory import Trajectory
from optdock.planners.manoeuvres.price import price_of
from optdock.reports.report import certificate_rows
from optdock.samples import are_rounded_phases, check_sampled_motion, check_samples_of
from optdock.verification import SHARPNESS, TOLERANCE, certify_motion, certify_path, pose_clearance

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.impossibility import NoMotionProof
    from optdock.io.plan_file import PlanFile, TrajectoryColumns
    from optdock.model.constant_jerk import TimeLaw
    from optdock.model.path import Path
    from optdock.model.problem import DockingProblem
    from optdock.samples import SampledMotionVerdict
    from optdock.verification import Certificate, TrajectoryCertificate, Violation

__all__ = ["PlanFileVerdict", "judge_plan_file"]

_ROUNDED = 0.01  # relative tolerance of the curvature of a path that is known only by samples
_SAME_PLACE = 1e-3  # [m], [rad]: tolerance between the ends of raw path and path


class PlanFileVerdict(NamedTuple):
    """Verdict on a plan file; true if certified.

    Attributes:
        outcome: `certified`: path and motion, if the file has one, are proven, and no value is false.
            `unproven`: the path is proven, and the samples of the motion do not refute it. `impossible`: the proof that
            no motion exists is valid. `refuted`: otherwise.
        rows: Results, each a name and a sentence.
        faults: Every violated rule.
        false_claims: False values of the file.
    """

    outcome: Literal["certified", "unproven", "impossible", "refuted"]
    rows: tuple[tuple[str, str], ...]
    faults: tuple[str, ...] = ()
    false_claims: tuple[str, ...] = ()

    def __bool__(self) -> bool:
        return self.outcome == "certified"

    @property
    def reason(self) -> str:
        """First violated rule, first incorrect value, or reason why the motion is not proven; empty if certified."""
        unproven = ("samples cannot prove a motion",) if self.outcome == "unproven" else ()
        return next(iter((*self.faults, *self.false_claims, *unproven)), "")


def judge_plan_file(plan: PlanFile, problem: DockingProblem) -> PlanFileVerdict:
    """Check every part of a plan file.

    Args:
        plan: The file, see `load_plan`.
        problem: The problem for which the plan is checked.

    Raises:
        InvalidFile: If parts of the file contradict each other.
    """
    _refuse_contradictions(plan)
    if plan.impossibility is not None:
        return _judged_impossible(plan, plan.impossibility, problem)
    if plan.path is None:
        return _refused(plan, f"the file has no path; its status is {plan.status}")
    if not may_be_one_frame(plan.frame, problem.frame):
        fault = f"the plan is in frame {plan.frame!r}, the scenario in frame {problem.frame!r}; transform one of them"
        return _refused(plan, fault)
    return _judged_path(plan, plan.path, problem)


def _refuse_contradictions(plan: PlanFile) -> None:
    """Check for parts that exclude each other.

    Raises:
        InvalidFile: If parts exclude each other.
    """
    parts = {name: getattr(plan, name) for name in ("path", "trajectory", "certificate", "error", "impossibility")}
    held = [name for name, value in parts.items() if value is not None]
    if plan.impossibility is not None:
        wrong = [name for name in held if name in ("path", "trajectory", "certificate")]
        if wrong or plan.status == CERTIFIED:
            other = wrong[0] if wrong else f"status {CERTIFIED!r}"
            raise InvalidFile(f"impossibility: a proof that no motion exists contradicts {other}")
    if plan.status == CERTIFIED and "path" not in held:
        raise InvalidFile(f"status: is {CERTIFIED!r}, but the file has no path")
    if "error" in held and not _is_refusal(plan):
        raise InvalidFile(f"error: contradicts status {shown(plan.status)}, which is not an error's name")
    if _is_refusal(plan) and "trajectory" in held:
        raise InvalidFile(f"trajectory: contradicts status {plan.status!r}, the name of an error")
    if "certificate" in held and "path" not in held:
        raise InvalidFile("certificate: the file has no path")


def _is_refusal(plan: PlanFile) -> bool:
    """Whether the status of a file is the name of an error."""
    found = getattr(errors, plan.status, None) if plan.status in errors.__all__ else None
    return isinstance(found, type) and issubclass(found, OptdockError)


def _refused(plan: PlanFile, fault: str) -> PlanFileVerdict:
    rows = [("verdict", "not certified"), *_not_judged(plan, ()), ("violation", fault)]
    return PlanFileVerdict("refuted", tuple(rows), (fault,))


def _judged_impossible(plan: PlanFile, proof: NoMotionProof, problem: DockingProblem) -> PlanFileVerdict:
    """Check the proof that no motion exists."""
    verdict = check_impossibility(proof, problem)
    faults = [] if verdict.proven else [f"the proof that no motion exists is not valid: {verdict.reason}"]
    others = ", ".join(proof.problem.differences(problem.fingerprint))
    bottleneck = proof.bottleneck
    if isinstance(proof, BlockedStraight):
        judged = "poses on the final straight"
    else:
        judged = f"cells of poses around the {proof.end}"
    rows = [
        ("verdict", "impossible, proven" if verdict.proven else "not certified"),
        ("proof", f"{verdict.cells} {judged} checked"),
        *((("bottleneck", f"{bottleneck} (from the file, not proven)"),) if bottleneck is not None else ()),
        *((("file proven for", f"another problem: {others} differ; checked here for this one"),) if others else ()),
        *_not_judged(plan, ("bottleneck",) if bottleneck is not None else ()),
        *(("violation", fault) for fault in faults),
    ]
    return PlanFileVerdict("impossible" if verdict.proven else "refuted", tuple(rows), tuple(faults))


def _judged_path(plan: PlanFile, path: Path, problem: DockingProblem) -> PlanFileVerdict:
    certificate = certify_path(path, problem)
    motion = _motion(plan, path, problem)
    # Collisions are reported first.
    broken = sorted(certificate.violations, key=lambda violation: violation.kind != "clearance")
    faults = [*map(_described, broken), *motion.faults]
    if _is_refusal(plan):
        faults.append(f"the file is a refusal; its status is {plan.status}")
    claims = _Claims(plan, path, certificate, motion, problem)
    false = tuple(claims.false())
    refuted = bool(faults or false)
    rows = [
        ("verdict", "not certified" if refuted else motion.verdict),
        *certificate_rows(certificate),
        *((("file proven for", claims.made_for),) if claims.made_for else ()),
        *(("false claim", claim) for claim in false),
        *_not_judged(plan, claims.not_judged()),
        ("motion", motion.row),
        *(("violation", fault) for fault in faults),
    ]
    outcome: Literal["certified", "unproven"] = "unproven" if motion.is_sampled else "certified"
    return PlanFileVerdict("refuted" if refuted else outcome, tuple(rows), tuple(faults), false)


def _described(violation: Violation) -> str:
    """Return the message of a violation; for a collision also its pose."""
    pose = violation.where.get("pose") if violation.kind == "clearance" else None
    return f"{violation.message}, at {Pose2.from_sequence(pose).brief}" if isinstance(pose, list) else violation.message


def _not_judged(plan: PlanFile, parts: tuple[str, ...]) -> list[tuple[str, str]]:
    """Return one row with the parts that cannot be checked, or no row if all parts can be checked."""
    foreign = (
        [f"status {shown(plan.status)}"] if plan.status not in (CERTIFIED, UNKNOWN) and not _is_refusal(plan) else []
    )
    held = [*foreign, "completed", *(name for name in ("timing_ms", "tried", "error") if getattr(plan, name))]
    named = [*parts, *held, *plan.unjudged]
    return [("not judged", ", ".join(named))] if named else []


class _MotionVerdict(NamedTuple):
    """Result for a motion: verdict, row, faults, and the proof or None.

    `is_sampled`: whether the motion is known only from samples, which do not refute it.
    """

    verdict: str
    row: str
    faults: list[str]
    proof: TrajectoryCertificate | None = None
    is_sampled: bool = False


def _motion(plan: PlanFile, path: Path, problem: DockingProblem) -> _MotionVerdict:
    if plan.trajectory is None:
        return _MotionVerdict("path certified", "none in the file; only the path is checked", [])
    if plan.time_law is None:
        return _sampled(plan.trajectory, path, problem)
    return _exact(plan.trajectory, path, plan.time_law, problem)


def _exact(motion: TrajectoryColumns, path: Path, law: TimeLaw, problem: DockingProblem) -> _MotionVerdict:
    """Certify the motion that the file's time law defines, and compare the file's samples with it."""
    trajectory = Trajectory(path, law)
    proof = certify_motion(trajectory, problem)
    samples = check_samples_of(trajectory, motion, problem)
    faults = [violation.message for violation in (*proof.violations, *samples.violations)]
    summary = f"{law.durations.size} phases, {law.duration:.3f} s"
    if faults and are_rounded_phases(trajectory, motion):
        judged = _sampled(motion, path, problem)
        return judged._replace(row=f"the phases are rounded and cannot prove the motion; {judged.row}")
    if faults:
        return _MotionVerdict("not certified", f"{summary}, refuted", faults)
    agree = f"{summary}, certified; {samples.samples} samples agree with them{_offset(samples)}"
    return _MotionVerdict("certified", agree, [], proof)


def _offset(verdict: SampledMotionVerdict) -> str:
    """Return a description of samples that deviate from the path, or an empty string."""
    if not verdict.off_path:
        return ""
    apart, turned = verdict.offset
    return f", with poses up to {apart:.2g} m and {turned:.2g} rad off it, which its clearance covers"


def _sampled(motion: TrajectoryColumns, path: Path, problem: DockingProblem) -> _MotionVerdict:
    """Check a motion that is known only from samples."""
    verdict = check_sampled_motion(motion, path, problem)
    if verdict.refuted:
        faults = [violation.message for violation in verdict.violations]
        return _MotionVerdict("not certified", f"{verdict.samples} samples, refuted", faults)
    row = (
        f"{verdict.samples} samples agree with each other, the path and the limits{_offset(verdict)}; the motion "
        f"between them ({1e3 * verdict.step:.3g} ms) is not proven"
    )
    return _MotionVerdict("path certified, motion not refuted and not proven", row, [], is_sampled=True)


class _Claims:
    """Comparison of the other values of a file with the proven values.

    A certificate is valid for the problem and the path of its digests. Values for a different problem cannot be
    compared; if the curves were rounded later, values are compared with a larger tolerance.
    """

    def __init__(
        self, plan: PlanFile, path: Path, certificate: Certificate, motion: _MotionVerdict, problem: DockingProblem
    ) -> None:
        self._plan, self._path, self._certificate, self._motion = plan, path, certificate, motion
        self._problem = problem
        self._claimed = plan.certificate or {}
        self._of_path = self._claimed.get("path") in (None, certificate.path)
        self._others = self._other_parts()

    def _other_parts(self) -> list[str]:
        claimed = self._claimed.get("problem")
        here = self._certificate.problem._asdict()
        if not isinstance(claimed, dict):
            return []
        return [name for name, value in here.items() if name in claimed and claimed[name] != value]

    @property
    def made_for(self) -> str:
        """Differences between the problem and path of the file's certificate and those checked here; may be empty."""
        parts = []
        if self._others:
            parts.append(f"another problem: {', '.join(self._others)} differ; checked here for this problem")
        if not self._of_path:
            parts.append("a path with other numbers, such as before rounding; checked here for this path")
        return "; ".join(parts)

    def not_judged(self) -> tuple[str, ...]:
        """Return the names of the values that cannot be compared."""
        names = ["certificate.poses_checked"] if "poses_checked" in self._claimed else []
        if "at_s" in self._claimed and not self._of_path and not self._others:
            names.append("certificate.at_s")
        if self._claimed and self._others:
            names.append("certificate (of another problem)")
        if "trajectory" in self._claimed and (self._motion.proof is None or self._others):
            names.append("certificate.trajectory")
        if self._plan.proof is not None:
            names.append("proof.cells" if self._is_comparable else "proof")
        return tuple(names)

    @property
    def _is_comparable(self) -> bool:
        """Whether the file's certificate was made for this problem and this path."""
        return self._certificate.certified and self._of_path and not self._others

    def false(self) -> Iterator[str]:
        """Generate a message for every false value."""
        plan, certificate = self._plan, self._certificate
        if not certificate.certified and plan.status == CERTIFIED:
            yield f"status is {CERTIFIED!r}, but the path is not certified"
        yield from self._false_verdict("certificate", self._claimed, certificate, "the path is")
        yield from self._false_numbers()
        if certificate.certified and not self._others:
            yield from self._false_place()
            proof, claimed = self._motion.proof, self._claimed.get("trajectory")
            if proof is not None and isinstance(claimed, dict):
                yield from self._false_verdict("certificate.trajectory", claimed, proof, "the motion is")
                yield from self._false_motion(proof, claimed)
        if self._plan.proof is not None and self._is_comparable:
            here = statement_of(self._path, self._problem, self._certificate.start_relief)
            yield from (
                f"proof.{name} is not that of the problem"
                for name, value in here.items()
                if self._plan.proof.get(name) != value
            )
        yield from self._false_guess()
        yield from self._false_price()

    def _false_verdict(
        self, name: str, claimed: Mapping[str, object], verdict: Certificate | TrajectoryCertificate, subject: str
    ) -> Iterator[str]:
        claim = claimed.get("certified")
        if claim is True and not verdict.certified:
            yield f"{name}.certified is true, but {subject} not certified"
        elif claim is False and verdict.certified and not self._others:
            yield f"{name}.certified is false, but {subject} certified"
        if claim is True and claimed.get("violations"):
            yield f"{name}.violations is not empty, but {name}.certified is true"

    def _false_numbers(self) -> Iterator[str]:
        """Check the numbers of the certificate: clearances to within `SHARPNESS`, margins only for the same path."""
        here, sharp = self._certificate, SHARPNESS + TOLERANCE
        of_problem = here.certified and not self._others
        same, exact = of_problem and self._of_path, self._of_path and "path" in self._claimed
        bend, rate = here.max_curvature, here.max_curvature_rate
        view = math.nan if here.view_margin is None else here.view_margin
        for name, value, unit, near, is_comparable in (
            ("length", here.length, "m", TOLERANCE * (1.0 + here.length), True),
            ("max_curvature", bend, "1/m", TOLERANCE * (1.0 + bend), exact),
            ("max_curvature_rate", rate, "1/m^2", TOLERANCE * (1.0 + rate), exact),
            ("min_clearance", here.min_clearance, "m", sharp, of_problem),
            ("required_clearance", here.required_clearance, "m", sharp, of_problem),
            ("start_relief", here.start_relief, "m", TOLERANCE, of_problem),
            ("tube", here.tube, "m", TOLERANCE, of_problem),
            ("margin", here.margin, "m", sharp, same),
            ("view_margin", view, "m", TOLERANCE, same),
        ):
            claim = _number(self._claimed, name, math.inf)
            if claim is None:
                continue
            wrong = is_comparable and not _near(claim, value, near)
            # The differences of rounded poses are too large to compare; only values below the proven value are false.
            wrong |= name.startswith("max_") and claim < value * (1.0 - _ROUNDED) - TOLERANCE
            # On another path, the margin is at most the difference at the least clearance.
            most = here.min_clearance - here.required_clearance + sharp
            wrong |= name == "margin" and of_problem and claim != value and not claim <= most
            if wrong:
                yield f"certificate.{name} is {claim:.6g} {unit}, proven is {value:.6g} {unit}"

    def _false_place(self) -> Iterator[str]:
        """Check the obstacle and the position of the least clearance."""
        nearest, obstacles = self._claimed.get("nearest"), self._problem.all_obstacles
        if nearest == "" and self._certificate.nearest:
            yield f"certificate.nearest is empty, but {self._certificate.nearest} is nearest"
        elif nearest and nearest not in {obstacles.name_of(row) for row in range(len(obstacles))}:
            yield f"certificate.nearest is {shown(nearest)}, but no obstacle has this name"
        here, at = self._certificate, _number(self._claimed, "at_s", math.nan)
        if at is None or not self._of_path or not math.isfinite(here.min_clearance) or _same(at, here.at_s):
            return
        if not -TOLERANCE <= at <= self._path.length + TOLERANCE:
            yield f"certificate.at_s is {at:.6g} m, but the length of the path is {self._path.length:.6g} m"
            return
        found, least = self._clearance_at(at), max(self._clearance_at(here.at_s), here.min_clearance)
        if not found <= least + SHARPNESS:
            claim = f"where the clearance is {found:.6g} m, not {here.min_clearance:.6g} m"
            yield f"certificate.at_s is {at:.6g} m, {claim}"

    def _clearance_at(self, s: float) -> float:
        pose, problem = self._path.pose_at(s), self._problem
        return pose_clearance(pose, problem.robot.footprint, problem.all_obstacles)[0]

    def _false_motion(self, proof: TrajectoryCertificate, claimed: Mapping[str, object]) -> Iterator[str]:
        duration, ratios = _number(claimed, "duration", math.inf), claimed.get("ratios")
        if duration is not None and not _same(duration, proof.duration):
            yield f"certificate.trajectory.duration is {duration:.6g} s, but the motion takes {proof.duration:.6g} s"
        for name, claim in ratios.items() if isinstance(ratios, dict) else ():
            value = proof.ratios.get(name)
            if value is None:
                yield f"certificate.trajectory.ratios.{shown(name)} is the ratio of no limit"
            elif not is_number(claim) or not _same(claim, value):
                yield f"certificate.trajectory.ratios.{name} is {shown(claim)}, proven is {value:.6g}"

    def _false_guess(self) -> Iterator[str]:
        """Check that the raw path has the same ends as the path."""
        guess = self._plan.raw_path
        if guess is None:
            return
        for what, one, other in (("begins", guess.start, self._path.start), ("ends", guess.end, self._path.end)):
            apart, turned = one.distance_to(other), abs(normalize_angle(one.yaw - other.yaw))
            if not max(apart, turned) <= _SAME_PLACE:
                yield f"raw_path {what} {apart:.3g} m and {turned:.3g} rad from where the path {what}"

    def _false_price(self) -> Iterator[str]:
        """Check that the plan has the lowest price of the tried guesses and belongs to the raw path."""
        law, guess = self._plan.time_law, self._plan.raw_path
        priced = [one for one in self._plan.tried if is_number(one.get("price"))]
        if not priced or law is None or self._motion.proof is None or self._others:
            return
        price = price_of(self._path, law.duration, self._problem.robot)
        best = min(priced, key=lambda one: one["price"])  # type: ignore[arg-type,return-value]  # numbers, see above
        if not _same(best["price"], price):  # type: ignore[arg-type]
            yield f"tried: the lowest price is {best['price']:.6g} s, but the price of the plan is {price:.6g} s"
        elif guess is not None and is_number(best.get("length")) and best.get("cusps") is not None:
            near = abs(best["length"] - guess.driven) <= _SAME_PLACE  # type: ignore[operator]
            if not near or best["cusps"] != len(guess.cusps):
                yield "tried: the guess of the lowest price differs from raw_path in length or cusps"


def _number(claimed: Mapping[str, object], name: str, null: float) -> float | None:
    """Return the number of a key; `null` for null, which means infinity, and None if the key is missing."""
    if name not in claimed:
        return None
    claim = claimed[name]
    return null if claim is None else float(np.float64(claim))  # type: ignore[arg-type]  # a number, as files are read


def _same(claim: float, value: float) -> bool:
    return _near(claim, value, TOLERANCE * (1.0 + abs(value)))


def _near(claim: float, value: float, near: float) -> bool:
    return claim == value or abs(claim - value) <= near  # infinities are equal
