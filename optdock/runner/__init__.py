"""Runs of many independent cases, in one process, on several cores or on a dask cluster, with resuming.

- `cases`: cases, outcomes and their order;
- `workers`: the processes that compute cases;
- `outcome_store`: the file from which an interrupted run is resumed.
"""

from __future__ import annotations

from optdock.runner.cases import Case, Outcome, run_cases
from optdock.runner.outcome_store import OutcomeStore, run_head
from optdock.runner.workers import Workers

__all__ = ["Case", "Outcome", "OutcomeStore", "Workers", "run_cases", "run_head"]
