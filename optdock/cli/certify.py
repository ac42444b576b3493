"""`optdock certify`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from optdock.cli.common import NOT_CERTIFIED, ScenarioArgument, VerboseOption, reported

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from optdock.io.plan_file import PlanFile, TrajectoryColumns
    from optdock.path import Path as DockPath
    from optdock.problem import DockingProblem
    from optdock.trajectory import TimeLaw
    from optdock.verification import Certificate, ImpossibilityProof, SampledMotionVerdict, Violation

__all__ = ["certify"]

_SAMPLED = 0.01  # relative, of the curvature of a path that is known by samples


def certify(
    plan: Annotated[Path, typer.Argument(help="Plan file (JSON), by whomever.", show_default=False)],
    scenario: ScenarioArgument,
    *,
    verbose: VerboseOption = False,
) -> None:
    """Judge a plan file, also one that optdock did not make: prove it, or name every rule it breaks.

    The path is proven or refused. The motion is proven where the file holds its phases; samples alone can be refuted,
    never proven, and what they leave open is said. Exit status 0: path certified and motion certified or not refuted.
    Of a refusal that holds a proof that no motion exists the proof is judged; exit status 0 then: impossible, proven.
    """
    with reported(verbose=verbose):
        from optdock.config import load_scenario
        from optdock.io.plan_file import load_plan

        problem = load_scenario(scenario).problem
        faults = _judged(load_plan(plan), problem)
    if faults:
        typer.echo(f"not certified: {faults[0]}", err=True)
        raise typer.Exit(NOT_CERTIFIED)


class _Motion(NamedTuple):
    """What is said of a motion: in the verdict, in its own row, and every fault."""

    verdict: str
    row: str
    faults: list[str]


def _judged(plan: PlanFile, problem: DockingProblem) -> list[str]:
    """Every broken rule, printed with what was proven and what the file does not say."""
    from optdock.path import may_be_one_frame
    from optdock.report import certificate_rows, table
    from optdock.verification import certify_path

    if plan.impossibility is not None:
        return _judged_impossible(plan.impossibility, problem)
    if plan.path is None:
        return [f"the file holds no path, its status is {plan.status}"]
    if not may_be_one_frame(plan.frame, problem.frame):
        return [f"the plan stands in frame {plan.frame!r}, the scenario in {problem.frame!r}; transform one of them"]
    certificate = certify_path(plan.path, problem)
    motion = _motion(plan, plan.path, problem)
    # A collision before all else.
    broken = sorted(certificate.violations, key=lambda violation: violation.kind != "clearance")
    faults = [*map(_said, broken), *motion.faults]
    claims, made_for = list(_false_claims(plan, certificate)), _proven_against(plan, certificate)
    rows = [
        ("verdict", "not certified" if faults else motion.verdict),
        *certificate_rows(certificate),
        *((("file proven for", made_for),) if made_for else ()),
        *(("false claim", claim) for claim in claims),
        ("motion", motion.row),
        *(("violation", fault) for fault in faults),
    ]
    typer.echo(table(rows))
    for claim in claims:
        typer.echo(f"false claim: {claim}", err=True)
    return faults


def _said(violation: Violation) -> str:
    """What is broken, with the pose where one was found."""
    from optdock.geometry.pose import Pose2

    pose = violation.where.get("pose") if violation.kind == "clearance" else None
    return f"{violation.message}, at {Pose2.from_sequence(pose).brief}" if isinstance(pose, list) else violation.message


def _judged_impossible(proof: ImpossibilityProof, problem: DockingProblem) -> list[str]:
    """Whether the proof that no motion exists holds, printed with what it says of the bottleneck."""
    from optdock.report import table
    from optdock.verification import check_impossibility

    verdict = check_impossibility(proof, problem)
    faults = [] if verdict.proven else [f"the proof that no motion exists does not hold: {verdict.reason}"]
    others = ", ".join(proof.problem.differences(problem.fingerprint))
    bottleneck = proof.bottleneck
    rows = [
        ("verdict", "impossible, proven" if verdict.proven else "not certified"),
        ("proof", f"{verdict.cells} cells of poses around the {proof.end} judged again"),
        *((("bottleneck", f"{bottleneck} (as the file says, not proven)"),) if bottleneck is not None else ()),
        *((("file proven for", f"another problem: {others} differ; judged here for this one"),) if others else ()),
        *(("violation", fault) for fault in faults),
    ]
    typer.echo(table(rows))
    return faults


def _motion(plan: PlanFile, path: DockPath, problem: DockingProblem) -> _Motion:
    if plan.trajectory is None:
        return _Motion("path certified", "none in the file, the path alone is judged", [])
    if plan.time_law is None:
        return _sampled(plan.trajectory, path, problem)
    return _exact(plan.trajectory, path, plan.time_law, problem)


def _exact(motion: TrajectoryColumns, path: DockPath, law: TimeLaw, problem: DockingProblem) -> _Motion:
    """The proof of the phases, and whether the samples are those of them."""
    from optdock.trajectory import Trajectory
    from optdock.verification import are_rounded_phases, certify_motion, check_samples_of

    trajectory = Trajectory(path, law)
    proof = certify_motion(trajectory, problem)
    samples = check_samples_of(trajectory, motion, problem)
    faults = [violation.message for violation in (*proof.violations, *samples.violations)]
    said = f"{law.durations.size} phases, {law.duration:.3f} s"
    if faults and are_rounded_phases(trajectory, motion):
        judged = _sampled(motion, path, problem)
        return judged._replace(row=f"the phases are rounded and prove nothing; {judged.row}")
    if faults:
        return _Motion("not certified", f"{said}, refuted", faults)
    return _Motion("certified", f"{said}, certified; {samples.samples} samples agree with them{_beside(samples)}", [])


def _beside(verdict: SampledMotionVerdict) -> str:
    """What is said of samples that lie beside the path."""
    if not verdict.off_path:
        return ""
    apart, turned = verdict.offset
    return f", with poses up to {apart:.2g} m and {turned:.2g} rad off it, which its clearance covers"


def _sampled(motion: TrajectoryColumns, path: DockPath, problem: DockingProblem) -> _Motion:
    """What the samples refute, and what they leave open."""
    from optdock.verification import check_sampled_motion

    verdict = check_sampled_motion(motion, path, problem)
    if verdict.refuted:
        faults = [violation.message for violation in verdict.violations]
        return _Motion("not certified", f"{verdict.samples} samples, refuted", faults)
    units = {"speed": "m/s", "acceleration": "m/s^2", "place": "m", "yaw rate": "rad/s"}
    open_ = ", ".join(f"{name} to within {bound:.2g} {units[name]}" for name, bound in verdict.unproven.items())
    row = (
        f"{verdict.samples} samples agree with each other, the path and the limits{_beside(verdict)}; between samples "
        f"({1e3 * verdict.step:.3g} ms) unproven: the jerk, and if it keeps its limit {open_}"
    )
    return _Motion("path certified, motion not refuted", row, [])


def _proven_against(plan: PlanFile, certificate: Certificate) -> str:
    """In what the problem that the file's certificate was made for is another one; empty where it does not say so."""
    claimed = (plan.certificate or {}).get("problem")
    if not isinstance(claimed, dict):
        return ""
    here = certificate.problem._asdict()
    others = [name for name, value in here.items() if name in claimed and claimed[name] != value]
    return f"another problem: {', '.join(others)} differ; judged here for this one" if others else ""


def _false_claims(plan: PlanFile, certificate: Certificate) -> Iterator[str]:
    """Every claim of the file that is better than the truth."""
    from optdock.io.plan_file import CERTIFIED

    claimed = plan.certificate or {}
    if not certificate.certified and plan.status == CERTIFIED:
        yield f"status is {CERTIFIED!r}, the path is not"
    if not certificate.certified and claimed.get("certified") is True:
        yield "certificate.certified is true, the path is not certified"
    yield from _false_numbers(claimed, certificate)


def _false_numbers(claimed: Mapping[str, object], certificate: Certificate) -> Iterator[str]:
    from optdock.io.numbers import is_number
    from optdock.verification import SHARPNESS, TOLERANCE

    clearance = claimed.get("min_clearance")
    if is_number(clearance) and clearance > certificate.min_clearance + SHARPNESS + TOLERANCE:
        yield f"certificate.min_clearance is {clearance:.6g} m, proven are {certificate.min_clearance:.6g} m"
    relief = claimed.get("start_relief", 0.0)
    if certificate.certified and is_number(relief) and relief < certificate.start_relief - TOLERANCE:
        yield f"certificate.start_relief is {relief:.6g} m, the proof grants {certificate.start_relief:.6g} m"
    tube = claimed.get("tube", 0.0)
    if is_number(tube) and tube > certificate.tube + TOLERANCE:
        yield f"certificate.tube is {tube:.6g} m, proven are {certificate.tube:.6g} m"
    for name, least, unit in (
        ("max_curvature", certificate.max_curvature, "1/m"),
        ("max_curvature_rate", certificate.max_curvature_rate, "1/m^2"),
    ):
        value = claimed.get(name)
        if is_number(value) and value < least * (1.0 - _SAMPLED) - TOLERANCE:
            yield f"certificate.{name} is {value:.6g} {unit}, the path has {least:.6g} {unit}"
    length = claimed.get("length")
    if is_number(length) and not abs(length - certificate.length) <= TOLERANCE * (1.0 + certificate.length):
        yield f"certificate.length is {length:.6g} m, the path is {certificate.length:.6g} m long"
