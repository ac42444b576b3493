"""CPU time and calls of control cycles of the executor: `python -m experiments.benchmarks cycles`.

Random dockings of the docking study, driven at 50 Hz by each controller. The CPU time of planning, which has its own
process on a robot, is not part of a cycle. Every docking is repeated, and the fastest run of each cycle counts, because
other processes on the machine slow down a run. Calls of Python functions and of functions in C are counted in other
runs of the same dockings.
"""

from __future__ import annotations

import argparse
import gc
import sys
import time
from typing import TYPE_CHECKING

import numpy as np

from experiments.benchmarks.tables import Table, percentile
from experiments.docking import methods, watched
from experiments.docking.cases import SPREADS
from experiments.docking.methods import executed
from experiments.docking.worlds import WORLDS, case_of
from optdock.deadline import budget_clock
from optdock.executor import DockingExecutor
from optdock.executor.planning import InlinePlanning
from optdock.planning.pipeline import warm_up

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import FrameType

__all__ = ["calls_of_cycles", "main"]

CONTROLLERS = ("TrackingController", "MpcController")
_WORLDS = ("noisy", "detected")
_RATE = 50.0  # [Hz]


def main(arguments: Sequence[str]) -> None:
    """Time and count the cycles of dockings."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks cycles", description=__doc__)
    parser.add_argument("--dockings", type=int, default=8, help="dockings of each row (default: %(default)s)")
    parser.add_argument("--repeats", type=int, default=3, help="runs of every docking (default: %(default)s)")
    parser.add_argument("--counted", type=int, default=2, help="of which calls are counted (default: %(default)s)")
    options = parser.parse_args(list(arguments))
    warm_up()
    for controller in CONTROLLERS:
        _times("noisy", controller, 0, 1)
    gc.collect()
    gc.freeze()  # as a server does after its start: a full collection takes tens of milliseconds
    rows = [_row(world, controller, options) for world in _WORLDS for controller in CONTROLLERS]
    header = ("world", "controller", "cycles", "ms p50", "ms p90", "ms p99", "ms max", "calls mean", "calls p99")
    note = f"{options.dockings} dockings at {_RATE:g} Hz; CPU time, fastest of {options.repeats} equal runs of a cycle."
    print(Table("Control cycles of the executor", header, tuple(rows), note))


def _row(world: str, controller: str, options: argparse.Namespace) -> tuple[object, ...]:
    times = [spent for n in range(options.dockings) for spent in _times(world, controller, n, options.repeats)]
    calls = [count for number in range(options.counted) for count in calls_of_cycles(world, controller, number)]
    shares = [1e3 * percentile(times, share) for share in (50.0, 90.0, 99.0, 100.0)]
    counts = (float(np.mean(calls)), percentile(calls, 99.0)) if calls else (np.nan, np.nan)
    return (world, controller, len(times), *shares, *counts)


def _times(world: str, controller: str, number: int, repeats: int) -> list[float]:
    """Return the CPU time of every cycle of a docking but the first, which loads modules [s]."""
    kind, runs, clocks = WORLDS[world], [], (methods.clock, watched.now)
    methods.clock = watched.now = time.thread_time
    try:
        for _ in range(repeats):
            with budget_clock("counted"):  # so that all runs have the same plans
                runs.append(executed(case_of(number, SPREADS["nav2"], kind), kind, _RATE, controller).cycles.spent)
    finally:
        methods.clock, watched.now = clocks
    return [min(spent) for spent in zip(*runs, strict=True)][1:]


def calls_of_cycles(world: str, controller: str, number: int) -> list[int]:
    """Return the number of calls in every control cycle of one docking, without those of planning.

    Args:
        world: Name of the world of the docking study.
        controller: Name of the controller.
        number: Number of the docking.
    """
    kind, counted = WORLDS[world], _CallCounter()
    before = sys.getprofile()
    with budget_clock("counted"):  # the plans do not depend on the slow counting
        sys.setprofile(counted)
        try:
            executed(case_of(number, SPREADS["nav2"], kind), kind, _RATE, controller)
        finally:
            sys.setprofile(before)
    return counted.cycles


class _CallCounter:
    """Profile function that counts the calls of each cycle; `cycles` has the counts."""

    def __init__(self) -> None:
        self.cycles: list[int] = []
        self._count = 0
        self._step: FrameType | None = None  # of the present cycle
        self._planning: FrameType | None = None  # of a plan within it
        self._codes = DockingExecutor.step.__code__, InlinePlanning.submit.__code__

    def __call__(self, frame: FrameType, event: str, _: object) -> None:
        step, planning = self._codes
        if event == "return":
            self._leave(frame)
        elif event == "call" and frame.f_code is step:
            self._step, self._count = frame, 0
        elif event == "call" and frame.f_code is planning:
            self._planning = frame
        elif event in ("call", "c_call") and self._step is not None and self._planning is None:
            self._count += 1

    def _leave(self, frame: FrameType) -> None:
        if frame is self._planning:
            self._planning = None
        elif frame is self._step:
            self._step = None
            self.cycles.append(self._count)
