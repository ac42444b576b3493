"""Cases as plain data, their verdicts, and their random generators."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

__all__ = ["FAULTS", "Case", "Verdict", "load_case", "rng_of", "save_case"]

Case: TypeAlias = dict[str, Any]  # JSON: numbers, strings, lists and dicts of them; "kind" names the judge

# Failures of the library, the worst first; all other outcomes are only counted.
FAULTS = (
    "false certificate",
    "false proof",
    "kernel differs",
    "overclaimed bound",
    "accepted forgery",
    "uncertified plan",
    "untyped exception",
    "hang",
    "crash",
    "mutable value",
    "CertificationFailed",
    "false refusal",
    "late",
)


@dataclass(frozen=True)
class Verdict:
    """Verdict on one case.

    Args:
        outcome: `certified`, `refused: KIND`, the name of an error, or one of `FAULTS`.
        detail: Violated rule, location and amount, for people.
        evidence: A case that reproduces the fault without the clock, if there is one (a plan's path).
        checked: Numbers of the library's verdicts that were compared with the truth, by their names; the cases of some
            kinds have several questions.
    """

    outcome: str
    detail: str = ""
    evidence: Case | None = field(default=None, compare=False)
    checked: dict[str, int] = field(default_factory=dict, compare=False)

    @property
    def is_fault(self) -> bool:
        """Whether the library failed."""
        return self.outcome in FAULTS

    @property
    def signature(self) -> str:
        """Common signature of equal failures: the outcome and the first words of the detail."""
        return f"{self.outcome}: {self.detail.split(':')[0]}" if self.detail else self.outcome


def rng_of(kind: str, seed: int, number: int) -> np.random.Generator:
    """Return the random generator of one case; identical on every machine."""
    return np.random.Generator(np.random.PCG64([zlib.crc32(kind.encode()), seed, number]))


def save_case(target: Path, case: Case, verdict: Verdict, note: str) -> None:
    """Write a failing case with its verdict and the command that repeats it."""
    target.parent.mkdir(parents=True, exist_ok=True)
    document = {"fault": verdict.outcome, "detail": verdict.detail, "note": note, "case": case}
    target.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")


def load_case(source: Path) -> Case:
    """Return the case of a file written by `save_case`."""
    case: Case = json.loads(source.read_text(encoding="utf-8"))["case"]
    return case
