"""Calls of a control cycle, counted, and the benchmark that prints them."""

import shutil

import numpy as np
import pytest

from experiments.benchmarks import cycles
from optdock.kernels import using_kernels

# 1.2 times the calls that were reached, so that work done twice is noticed.
MOST = {"TrackingController": (1090, 1750), "MpcController": (1110, 1570)}


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.parametrize("controller", cycles.CONTROLLERS)
def test_a_control_cycle_makes_few_calls(controller):
    with using_kernels("native"):
        calls = cycles.calls_of_cycles("detected", controller, 0)
    mean, most = MOST[controller]
    assert len(calls) > 200
    assert np.mean(calls) <= mean
    assert np.percentile(calls, 99) <= most


def test_calls_are_counted_in_cycles_and_not_in_planning():
    class Step:
        def __init__(self, code):
            self.f_code = code

    counter = cycles._CallCounter()
    step, planning, other = (Step(code) for code in (*counter._codes, None))
    counter(other, "call", None)  # before the first cycle
    for event, frame in [
        ("call", step), ("call", other), ("c_call", other), ("c_return", other), ("return", other),
        ("call", planning), ("call", other), ("c_call", other), ("return", planning), ("c_call", step),
        ("return", step), ("call", other), ("call", step), ("return", step),
    ]:  # fmt: skip
        counter(frame, event, None)
    assert counter.cycles == [3, 0]


def test_the_benchmark_prints_a_row_for_every_world_and_controller(capsys):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(cycles, "_times", lambda world, controller, number, repeats: [1e-3] * repeats)
        patch.setattr(cycles, "calls_of_cycles", lambda world, controller, number: [800, 1000])
        patch.setattr(cycles, "warm_up", lambda: None)
        patch.setattr(cycles.gc, "freeze", lambda: None)
        cycles.main(["--dockings", "2", "--repeats", "2", "--counted", "1"])
    rows = capsys.readouterr().out.splitlines()[-4:]
    assert [row.split()[:2] for row in rows] == [[w, c] for w in cycles._WORLDS for c in cycles.CONTROLLERS]
    assert all(row.split()[2:] == ["4", "1", "1", "1", "1", "900", "1000"] for row in rows)
