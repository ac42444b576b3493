"""Repetitions of calls with the readings of the clock of the first one."""

import functools
import os
import time

import pytest

from experiments.benchmarks.repeated_calls import Repetitions, recorded
from optdock.deadline import Deadline

FIRST = os.getpid()
BUDGET = 0.005  # [s]


def worked(seconds):
    """Use the processor for a time; its clock is not the one of time budgets, which is replaced."""
    until = time.clock_gettime(time.CLOCK_PROCESS_CPUTIME_ID) + seconds
    while time.clock_gettime(time.CLOCK_PROCESS_CPUTIME_ID) < until:
        pass


def answer(extra, budget):
    """Work in steps of 1 ms until the budget ends, and `extra` [s] more; the first process is held up by 20 ms."""
    deadline = Deadline(budget)
    while not deadline.passed():
        worked(0.001)
    worked(extra + (0.02 if os.getpid() == FIRST else 0.0))


def uneven(_, budget):
    """Read the clock once more in the first process."""
    worked(budget)
    for _ in range(2 if os.getpid() == FIRST else 1):
        Deadline().passed()


def late_twice(call, extra):
    """Return the lateness of a call, and what repetitions say."""
    again = Repetitions(call)
    try:
        readings = recorded(lambda: call(extra, BUDGET))
        return readings[-1] - readings[0] - BUDGET, again.lateness(functools.partial(float, extra), BUDGET, readings)
    finally:
        again.close()


@pytest.mark.parametrize("extra", [0.0, 0.008])
def test_what_held_up_only_the_first_call_does_not_count(extra):
    first, again = late_twice(answer, extra)
    assert first >= extra + 0.02
    assert extra <= again <= first - 0.01  # the repetitions are copies of a process, which takes time too


def test_a_call_that_cannot_be_repeated_keeps_its_lateness():
    first, again = late_twice(uneven, 0.0)
    assert again == pytest.approx(first, abs=1e-12)
