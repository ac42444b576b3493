"""The same cases with growing budgets: how many are certified, how late calls return, whether plans get worse."""

from __future__ import annotations

from typing import TYPE_CHECKING

from experiments.benchmarks.tables import Table, percentile
from experiments.manoeuvres.run import CERTIFIED

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from experiments.manoeuvres.run import Record

__all__ = ["BUDGETS", "budget_table"]

BUDGETS = (0.05, 0.1, 0.25, 0.5, 1.0)  # [s]
_SAME = 1e-6  # relative: what counts as no worse


def budget_table(by_budget: Mapping[float, Sequence[Record]]) -> Table:
    """A row per budget. `lost`: certified with the budget before, and not with this one; `worse`: at a higher price."""
    header = ("budget ms", "n", "certified", "impossible", "lost", "worse", "price s p50")
    header = (*header, "late ms p50", "p99", "worst", "late cpu ms worst")
    before, rows = None, []
    for budget, records in sorted(by_budget.items()):
        plans = [one for one in records if one.outcome == CERTIFIED]
        pairs = list(zip(before, records, strict=True)) if before else []
        late = [1e3 * (one.wall - budget) for one in records]
        rows.append(
            (
                1e3 * budget,
                len(records),
                len(plans),
                sum(one.outcome.startswith("impossible") for one in records),
                sum(old.outcome == CERTIFIED != new.outcome for old, new in pairs),
                sum(_is_worse(old, new) for old, new in pairs),
                percentile([one.price for one in plans], 50),
                *(percentile(late, share) for share in (50, 99, 100)),
                1e3 * max(one.cpu - budget for one in records),
            )
        )
        before = records
    note = "price: duration and what the search asks for a cusp; late: elapsed less budget, negative when early"
    return Table("Budgets", header, tuple(rows), note)


def _is_worse(old: Record, new: Record) -> bool:
    return old.outcome == new.outcome == CERTIFIED and new.price > old.price * (1.0 + _SAME)
