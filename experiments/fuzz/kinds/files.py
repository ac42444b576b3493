"""Files through `load_scenario`, `load_plan` and `optdock certify`: named errors and statuses, never a traceback."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from typer.testing import CliRunner

from experiments.fuzz.case import Verdict
from experiments.fuzz.generators.documents import files_case
from optdock.cli import app
from optdock.config import load_scenario
from optdock.errors import OptdockError
from optdock.io.plan_file import load_plan

if TYPE_CHECKING:
    import numpy as np

    from experiments.fuzz.case import Case

__all__ = ["draw", "judge"]

_STATUSES = {0: "certified", 2: "bad input", 3: "not certified", 4: "impossible"}


def draw(rng: np.random.Generator) -> Case:
    """Draw files, mostly damaged or forged."""
    return files_case(rng)


def judge(case: Case) -> Verdict:
    """Write the files and load them."""
    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for name in ("scenario", "plan", "map"):
            suffix = {"scenario": "bay.yaml", "plan": "plan.json", "map": "hall.yaml"}[name]
            (root / suffix).write_bytes(case[name].encode("utf-8", errors="surrogatepass"))
        side = case["pixels"]
        (root / "hall.pgm").write_bytes(b"P5 %d %d 255 " % (side, side) + bytes([254]) * (side * side))
        errors = [_loaded(load_scenario, root / "bay.yaml"), _loaded(load_plan, root / "plan.json")]
        return _compared(case, root, errors)


def _loaded(load: object, source: Path) -> str:
    """Return the result of loading a file; exceptions that are no error of the library are raised on."""
    try:
        load(source)  # type: ignore[operator]
    except OptdockError as error:
        return f"{type(error).__name__}: {error}"
    return ""


def _compared(case: Case, root: Path, errors: list[str]) -> Verdict:
    result = CliRunner().invoke(app, ["certify", str(root / "plan.json"), str(root / "bay.yaml")])
    if result.exception is not None and not isinstance(result.exception, SystemExit):
        raise result.exception
    status = _STATUSES.get(result.exit_code)
    if status == "not certified" and "not refuted and not proven" in result.output:
        status = "unproven"  # a motion that is given only by its samples
    if status is None:
        return Verdict("untyped exception", f"exit status {result.exit_code}: {result.output[-200:]}")
    contradicts = not any(errors) and "plan.json: " in result.output  # parts that are each valid alone
    if any(errors) != (status == "bad input") and not contradicts:
        return Verdict("untyped exception", f"inconsistent verdicts: certify: {status}; loading: {errors}")
    return _expected(case, status, errors) or Verdict(status)


def _expected(case: Case, status: str, errors: list[str]) -> Verdict | None:
    """Return a verdict if the result differs from the expected one."""
    wanted = case["expected"]
    if wanted == "not certified" and status != wanted:
        return Verdict("accepted forgery", f"{case['forgery']}: {status} {errors}")
    if wanted == "certified" and status not in (wanted, "unproven"):
        return Verdict("false refusal", f"honest plan: {status} {errors}")
    if wanted == "refused as degrees" and "degrees" not in errors[0]:
        return Verdict("accepted forgery", f"degrees: {status}: {errors[0]}")
    return None
