"""Calls of Python and C functions in a plan, counted."""

import shutil
import sys

import numpy as np
import pytest

from experiments.benchmarks.kernels import EASY
from experiments.families import instance
from optdock.deadline import budget_clock
from optdock.kernels import using_kernels
from optdock.planning.pipeline import plan_dock, warm_up

MEDIAN = 3_000
# 1.1 times the calls that were reached, so that work done twice is noticed.
MEAN, MOST = 3_680, 9_750


def calls_of(problem):
    """Return the number of calls in a plan after the first one for the problem."""
    count = 0

    def counted(_frame, event, _argument):
        nonlocal count
        count += event in {"call", "c_call"}

    plan_dock(problem, time_budget=60.0)
    before = sys.getprofile()
    sys.setprofile(counted)
    try:
        plan_dock(problem, time_budget=60.0)
    finally:
        sys.setprofile(before)
    return count


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_an_easy_plan_makes_few_calls():
    warm_up()
    with using_kernels("native"), budget_clock("cpu"):
        calls = [calls_of(instance(family, seed).problem) for family in EASY for seed in range(5)]
    assert np.median(calls) <= MEDIAN
    assert np.mean(calls) <= MEAN
    assert max(calls) <= MOST
