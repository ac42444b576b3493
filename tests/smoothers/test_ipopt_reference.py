"""The sequential steps against ipopt on the same problem with free separating lines."""

import math

import pytest

from experiments.benchmarks.ipopt_reference import smooth_by_ipopt
from experiments.families import instance
from optdock.errors import InvalidValue
from optdock.geometry.pose import Pose2
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother


def test_both_find_the_same_optimum():
    case = instance("reverse_alcove", 0)
    fast = CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem)
    reference = smooth_by_ipopt(case.raw_path, 60.0, case.problem)
    assert certify_path(reference.path, case.problem).certified
    assert fast.report.cost == pytest.approx(reference.report.cost, rel=0.01)


def test_they_agree_in_the_open_too(cases):
    problem = cases.open_problem(Pose2(3.2, 0.7, 0.0), max_curvature_rate=math.inf)
    raw = cases.kinked((0.0, 0.0), (1.2, 0.0), (2.0, 0.7), (3.2, 0.7))
    fast = CasadiSmoother().smooth(raw, 30.0, problem=problem)
    reference = smooth_by_ipopt(raw, 60.0, problem)
    assert fast.report.cost == pytest.approx(reference.report.cost, rel=0.01)


def test_the_former_backend_is_refused_with_where_it_lives_now():
    assert CasadiSmoother(backend="scp").parameters.backend == "scp"
    with pytest.raises(InvalidValue, match="experiments/benchmarks/ipopt_reference.py"):
        CasadiSmoother(backend="ipopt")
