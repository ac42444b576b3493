"""Tables of the manoeuvre benchmark: rates and times by family, proofs against the truth, budgets, refusals."""

from __future__ import annotations

import math
import re
from collections import Counter
from itertools import groupby
from typing import TYPE_CHECKING

from experiments.benchmarks.tables import Table, percentile
from experiments.manoeuvres.run import CERTIFIED, IMPOSSIBLE, NOT_FOUND

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from experiments.manoeuvres.run import Record

__all__ = ["budget_table", "report", "summary"]

# [s]: durations of the solutions published by AutomatedValetParking (wenqing, BSD-2) for the cases that it solves
# without a collision, by an independent evaluator; planning took 46 s to 207 s.
REFERENCE_DURATIONS = {"case 1": 10.82, "case 2": 14.37, "case 3": 14.22, "case 6": 14.34, "case 9": 37.73}

_NUMBERS = re.compile(r"-?\d[\d.e+-]*")
_LETTERS = {CERTIFIED: "C", IMPOSSIBLE: "I", NOT_FOUND: "."}
_SAME = 1e-6  # relative tolerance of equal prices


def report(records: Sequence[Record]) -> Iterator[str]:
    """Return all tables that have rows, and a line for each plan or proof refuted by the independent check."""
    families = {one.family for one in records}
    yield str(summary(records))
    own = {"tpcap": reference_table, "near dock": grid_table, "blocked": proof_table, "blocked straight": proof_table}
    for family, table in own.items():
        if family in families:
            yield str(table([one for one in records if one.family == family]))
    yield str(refusal_table(records))
    outside = [one for one in records if one.outside > 1e-6]
    if outside:
        most = max(one.outside for one in outside)
        yield f"\n{len(outside)} plans leave the bounds that OBCA's source has for the rear axle, by up to {most:.2f} m"
    yield from (f"REFUTED {one.family}: {one.name}: {one.faults}" for one in records if one.faults)
    yield from (f"tried for {one.name}: {one.tried}" for one in records if one.family == "tpcap" and one.error)


def summary(records: Sequence[Record]) -> Table:
    """Return a row per family and per tag."""
    header = ("cases", "n", "certified", "impossible", "not found", "certified %")
    header = (
        *header,
        "CPU ms p50",
        "CPU ms p90",
        "CPU ms p99",
        "first ms p50",
        "s p50",
        "m p50",
        "cusps mean",
        "max",
        "refuted",
    )
    rows = []
    for family, of_family in groupby(records, key=lambda one: one.family):
        members = list(of_family)
        rows.append(_row(family, members))
        tags = list(dict.fromkeys(one.tag for one in members))
        if tags != [family]:
            rows += [_row(f"  {tag}", [one for one in members if one.tag == tag]) for tag in tags]
    note = (
        "CPU of whole calls with any result; first: wall clock until the first certified plan; s, m: duration and "
        "length of the plans; refuted: certified plans with a fault found by the independent check"
    )
    return Table("Manoeuvres", header, tuple(rows), note)


def _row(name: str, records: Sequence[Record]) -> tuple[object, ...]:
    counts = Counter(one.outcome for one in records)
    plans = [one for one in records if one.outcome == CERTIFIED]
    cpu = [1e3 * one.cpu for one in records]
    return (
        name,
        len(records),
        *(counts[word] for word in (CERTIFIED, IMPOSSIBLE, NOT_FOUND)),
        round(100.0 * len(plans) / len(records), 1),
        *(percentile(cpu, share) for share in (50, 90, 99)),
        percentile([1e3 * one.first for one in plans], 50),
        percentile([one.duration for one in plans], 50),
        percentile([one.length for one in plans], 50),
        sum(one.cusps for one in plans) / len(plans) if plans else math.nan,
        max((one.cusps for one in plans), default=0),
        sum(bool(one.faults) for one in plans),
    )


def refusal_table(records: Sequence[Record]) -> Table:
    """Return the refusals by family, with the numbers removed from the messages."""
    refusals = Counter((one.family, _NUMBERS.sub("#", one.error)[:110]) for one in records if one.error)
    stages = Counter((one.family, f"certified: {one.stage}") for one in records if one.outcome == CERTIFIED)
    rows = [
        (family, text, n)
        for (family, text), n in sorted((refusals + stages).items(), key=lambda kv: (kv[0][0], -kv[1]))
    ]
    return Table("How calls end", ("family", "message", "n"), tuple(rows))


def reference_table(records: Sequence[Record]) -> Table:
    """Return the competition's cases next to the durations of an independent planner that are free of collisions."""
    rows = []
    for one in records:
        if one.family == "tpcap":
            reference = REFERENCE_DURATIONS.get(one.name, math.nan)
            rows.append((one.name, one.outcome, one.duration, reference, one.length, one.cusps, 1e3 * one.cpu))
    header = ("case", "outcome", "duration, s", "reference, s", "length, m", "cusps", "CPU ms")
    note = "reference: published solutions of AutomatedValetParking, those that an independent evaluator finds clean"
    return Table("TPCAP", header, tuple(rows), note)


def grid_table(records: Sequence[Record]) -> Table:
    """Return starts near the dock as a grid: a row per lateral offset, a letter per distance, nearest first."""
    rows = [
        (tag, "".join(_LETTERS[one.outcome] for one in some), sum(one.outcome == NOT_FOUND for one in some))
        for tag, some in ((tag, list(found)) for tag, found in groupby(records, key=lambda one: one.tag))
    ]
    note = "C certified, I impossible (proven), . not found; 5 cm from letter to letter, from 0.3 m to 1.5 m"
    return Table("Near the dock", ("aside", "by distance", "not found"), tuple(rows), note)


def proof_table(records: Sequence[Record]) -> Table:
    """Return statistics of blocked scenes: number of proofs, their time and accuracy."""
    header = (
        "blocked",
        "n",
        "proven",
        "wall ms p50",
        "worst",
        "place off cm worst",
        "width off cm worst",
        "wrong cause",
    )
    rows = []
    for tag in dict.fromkeys(one.tag for one in records):
        some = [one for one in records if one.tag == tag]
        proven = [one for one in some if one.outcome == IMPOSSIBLE]
        rows.append(
            (
                tag,
                len(some),
                len(proven),
                percentile([1e3 * one.wall for one in some], 50),
                1e3 * max(one.wall for one in some),
                percentile([100.0 * one.bottleneck_error for one in proven], 100),
                percentile([100.0 * abs(one.missing_error) for one in proven], 100),
                sum(one.cause == "wrong" for one in proven),
            )
        )
    note = "a certified plan here is a false certificate; cause: whether body or clearance does not fit"
    return Table("Blocked scenes", header, tuple(rows), note)


def budget_table(by_budget: Mapping[float, Sequence[Record]]) -> Table:
    """Return a row per budget. `lost`: certified only with the previous budget; `worse`: at a higher price."""
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
    note = "price: duration plus a penalty per cusp; late: elapsed less budget, negative when early"
    return Table("Budgets", header, tuple(rows), note)


def _is_worse(old: Record, new: Record) -> bool:
    return old.outcome == new.outcome == CERTIFIED and new.price > old.price * (1.0 + _SAME)
