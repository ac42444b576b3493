"""What a plan file says of itself, against what was proven."""

from __future__ import annotations

from typing import TYPE_CHECKING

from optdock.io.numbers import is_number
from optdock.io.plan_file import CERTIFIED
from optdock.verification import SHARPNESS, TOLERANCE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from optdock.io.plan_file import PlanFile
    from optdock.verification import Certificate

__all__ = ["false_claims", "proven_against"]

_SAMPLED = 0.01  # relative, of the curvature of a path that is known by samples


def false_claims(plan: PlanFile, certificate: Certificate) -> list[str]:
    """Every claim of the file that is better than the truth.

    Args:
        plan: The file.
        certificate: What was proven of its path, just now.
    """
    return list(_claims(plan, certificate))


def proven_against(plan: PlanFile, certificate: Certificate) -> str:
    """In what the problem that the file's certificate was made for is another one; empty where it does not say so.

    Args:
        plan: The file.
        certificate: What was proven of its path, just now.
    """
    claimed = (plan.certificate or {}).get("problem")
    if not isinstance(claimed, dict):
        return ""
    here = certificate.problem._asdict()
    others = [name for name, value in here.items() if name in claimed and claimed[name] != value]
    return f"another problem: {', '.join(others)} differ; judged here for this one" if others else ""


def _claims(plan: PlanFile, certificate: Certificate) -> Iterator[str]:
    claimed = plan.certificate or {}
    if not certificate.certified and plan.status == CERTIFIED:
        yield f"status is {CERTIFIED!r}, the path is not"
    if not certificate.certified and claimed.get("certified") is True:
        yield "certificate.certified is true, the path is not certified"
    clearance = claimed.get("min_clearance")
    if is_number(clearance) and clearance > certificate.min_clearance + SHARPNESS + TOLERANCE:
        yield f"certificate.min_clearance is {clearance:.6g} m, proven are {certificate.min_clearance:.6g} m"
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
