"""The sequential steps against ipopt on the same problem with free separating lines."""

import pytest

from optdock.testing.families import instance
from optdock.verification import certify_path
from smoothers.casadi_smoother import CasadiSmoother


@pytest.mark.parametrize("family", ["open_s", "car_bay", "reverse_alcove"])
def test_both_find_the_same_optimum(family):
    case = instance(family, 0)
    fast = CasadiSmoother().smooth(case.raw_path, 30.0, problem=case.problem)
    reference = CasadiSmoother(backend="ipopt").smooth(case.raw_path, 60.0, problem=case.problem)
    assert certify_path(reference.path, case.problem).certified
    assert fast.report["cost"] == pytest.approx(reference.report["cost"], rel=0.01)
