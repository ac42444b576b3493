"""Study 6: parking a car, in slots of this project and in the public cases TPCAP and OBCA if they are present.

The slots are those of `experiments.manoeuvres.hard_cases.bays`: perpendicular and parallel, with 1.2 to 1.5 lengths of
the car. TPCAP has ten cases of a competition [Li2023]; of OBCA's two scenes [Zhang2021], a sample of the starts is
used. Every plan is checked by an independent check every 1 cm. Cusps and duration are those of the plan that is found
within 3 s of CPU time; the time to the first plan is the time after which a certified plan was known.

    python experiments/06_parking.py [--scale S] [--jobs N]
"""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from experiments.dense_check import dense_check
from experiments.manoeuvres.cases import data_folder, obca, tpcap
from experiments.manoeuvres.hard_cases import bays
from experiments.study_run import Report, median_interval, run, scaled, share_text
from optdock.errors import OptdockError
from optdock.planning.pipeline import plan_dock
from optdock.plotting.canvas import COLOURS
from optdock.reports.report import table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from matplotlib.figure import Figure

    from experiments.manoeuvres.cases import Case

FAMILIES = {"slots": bays, "TPCAP": tpcap, "OBCA": obca}
FILES = {"TPCAP": "tpcap/Case1.csv", "OBCA": "obca/scenes.json"}
BUDGET = 3.0  # [s] of CPU time
CLOCK = "cpu"
SIZE = (9.5, 4.2)


class Task(NamedTuple):
    """Family and number of a case."""

    family: str
    number: int


class Row(NamedTuple):
    """Result of one case; figures that do not exist are None."""

    family: str
    tag: str
    name: str
    status: str
    is_refuted: bool = False
    cusps: int | None = None
    duration: float | None = None  # [s]
    first: float | None = None  # [ms] until the first certified plan
    cpu: float | None = None  # [ms]


def available() -> list[str]:
    """Return the families whose files exist."""
    return [name for name in FAMILIES if name not in FILES or (data_folder() / FILES[name]).is_file()]


def cases_of(family: str) -> list[Case]:
    """Return the cases of a family."""
    return list(FAMILIES[family]())


def tasks(scale: float) -> list[Task]:
    """Return the cases, evenly distributed; at full scale 36 slots, 10 cases of TPCAP and 42 starts of OBCA."""
    found = []
    for family in available():
        total = len(cases_of(family))
        count = min(total, scaled(scale, total // 4 if family == "OBCA" else total, 2))
        found += [Task(family, number) for number in np.linspace(0, total - 1, count).round().astype(int).tolist()]
    return found


def work(task: Task) -> Iterator[Row]:
    """Plan one case."""
    family, number = task
    case = cases_of(family)[number]
    row, began = Row(family, case.tag, case.name, ""), time.process_time()
    try:
        plan = plan_dock(case.problem, time_budget=BUDGET)
    except OptdockError as error:
        yield row._replace(status=type(error).__name__, cpu=1e3 * (time.process_time() - began))
        return
    cpu = 1e3 * (time.process_time() - began)
    yield row._replace(
        status="certified",
        is_refuted=not dense_check(plan.path, case.problem, 0.01).ok,
        cusps=len(plan.path.cusps),
        duration=plan.trajectory.duration,
        first=plan.timing_ms["first"],
        cpu=cpu,
    )


def report(rows: Sequence[Row]) -> Report:
    """Return one line per kind of slot; sound if no plan is refuted."""
    columns = {"cusps, median": "cusps", "duration s, median": "duration", "first plan ms, median": "first"}
    lines = [("set", "kind", "certified", "refuted", *columns)]
    for key in dict.fromkeys((row.family, row.tag) for row in rows):
        group = [row for row in rows if row[:2] == key]
        plans = [row for row in group if row.status == "certified"]
        medians = [median_interval([getattr(row, name) for row in plans]) for name in columns.values()]
        texts = [f"{middle:.3g} ({low:.3g} to {high:.3g})" if plans else "-" for middle, low, high in medians]
        lines.append((*key, share_text(len(plans), len(group)), str(sum(row.is_refuted for row in plans)), *texts))
    certified, refuted = sum(row.status == "certified" for row in rows), sum(row.is_refuted for row in rows)
    first = [row.first for row in rows if row.first is not None]
    closing = (
        f"{share_text(certified, len(rows))} cases have a certified plan within {BUDGET:g} s of CPU time, the median "
        f"case after {median_interval(first)[0]:.0f} ms; the independent check refutes {refuted} of them."
    )
    missing = [name for name in FAMILIES if name not in available()]
    notes = f"Without {' and '.join(missing)}: set OPTDOCK_DATA to the folder of their files.\n\n" if missing else ""
    return Report(notes + table(lines), closing, is_sound=refuted == 0)


def draw(figure: Figure, rows: Sequence[Row]) -> None:
    """Draw cusps and time to the first plan of every case, by kind of slot."""
    kinds = list(dict.fromkeys((row.family, row.tag) for row in rows))
    panels = figure.subplots(1, 2, sharey=True)
    colours = dict(zip(FAMILIES, (COLOURS["path"], COLOURS["goal"], COLOURS["start"]), strict=True))
    rng = np.random.default_rng(1)
    for axes, (column, label) in zip(
        panels, {"first": "CPU time until the first certified plan, ms", "cusps": "cusps"}.items(), strict=True
    ):
        for family, colour in colours.items():
            group = [row for row in rows if row.family == family and getattr(row, column) is not None]
            at = [kinds.index(row[:2]) + rng.uniform(-0.2, 0.2) for row in group]
            axes.plot([getattr(row, column) for row in group], at, ".", color=colour, alpha=0.7)
        axes.set_xlabel(label)
        axes.grid(axis="x", alpha=0.25)
    panels[0].set_xscale("log")
    panels[0].xaxis.set_major_formatter("{x:g}")
    panels[1].set_xlim(-0.5, None)
    panels[0].set_yticks(
        range(len(kinds)), [tag if tag.lower() == family.lower() else f"{family}: {tag}" for family, tag in kinds]
    )
    panels[0].set_ylim(len(kinds) - 0.5, -0.5)


if __name__ == "__main__":
    sys.exit(run(__file__))
