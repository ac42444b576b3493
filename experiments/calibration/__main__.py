"""Calibration study: robots of the field world with hidden properties; intervals, fresh dockings, the tube.

    python -m experiments.calibration                             # 50 robots of 6 recordings, 2 fresh pairs each
    python -m experiments.calibration --robots 4 --fresh 1

Writes results/calibration/: recordings, which are reused if they exist, intervals.csv, pairs.csv and table.md.
"""

from __future__ import annotations

import argparse
import csv
import os
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import TYPE_CHECKING

from optdock.deadline import set_clock

if TYPE_CHECKING:
    from collections.abc import Sequence

OUT = Path("results") / "calibration"


def main(arguments: Sequence[str] | None = None) -> int:
    """Record, calibrate, compare, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robots", type=int, default=50, help="number of robots (default: %(default)s)")
    parser.add_argument(
        "--recordings", type=int, default=6, help="number of recordings of each robot (default: %(default)s)"
    )
    parser.add_argument(
        "--fresh", type=int, default=2, help="pairs of fresh dockings of each robot (default: %(default)s)"
    )
    parser.add_argument("--jobs", type=int, default=2, help="number of processes (default: %(default)s)")
    parser.add_argument("--out", type=Path, default=OUT)
    options = parser.parse_args(arguments)
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):  # before NumPy is imported
        os.environ.setdefault(name, "1")
    from experiments.calibration.robots import hidden_robot
    from experiments.calibration.study import QuantityResult, RobotTask, studied
    from experiments.calibration.tables import coverage_table, paired_table, tube_table
    from experiments.docking.field.outcome import FieldOutcome

    options.out.mkdir(parents=True, exist_ok=True)
    tasks = [RobotTask(number, options.recordings, options.fresh, str(options.out)) for number in range(options.robots)]
    with ProcessPoolExecutor(options.jobs, get_context("spawn"), initializer=set_clock, initargs=("cpu",)) as pool:
        found = []
        for robot in pool.map(studied, tasks):
            found.append(robot)
            sys.stderr.write(f"\r{len(found)} of {len(tasks)} robots")
    judged, pairs = [one for robot in found for one in robot.judged], [one for robot in found for one in robot.pairs]
    deviations = [robot.deviations for robot in found]
    _write(options.out / "intervals.csv", QuantityResult._fields, judged)
    rows = [(one.robot, one.run, name, *outcome) for one in pairs for name, outcome in one.outcomes]
    _write(options.out / "pairs.csv", ("robot", "run", "settings", *FieldOutcome._fields), rows)
    radius = hidden_robot(0).layout.problem.robot.footprint.circumscribed_radius
    parts = [coverage_table(judged)]
    if pairs:
        parts.append(paired_table(pairs))
    if any(deviations):
        parts.append(tube_table(deviations, [one.deviation for one in pairs if one.deviation is not None], radius))
    text = "\n\n".join(parts)
    (options.out / "table.md").write_text(text + "\n", encoding="utf-8")
    sys.stdout.write(text + "\n")
    return 0


def _write(file: Path, head: Sequence[str], rows: Sequence[tuple[object, ...]]) -> None:
    with file.open("w", newline="", encoding="utf-8") as target:
        writer = csv.writer(target)
        writer.writerow(head)
        writer.writerows(rows)


if __name__ == "__main__":
    sys.exit(main())
