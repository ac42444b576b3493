"""Searches that no step improves: penalties, trust region, certificates and repairs."""

import dataclasses
import math
from types import SimpleNamespace

import pytest

from experiments.families import instance
from optdock.deadline import ENDLESS
from optdock.plugins.interfaces import PluginContext
from optdock.verification import Violation, certify_path
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp import search as strategy
from smoothers.scp.loop import _State
from smoothers.scp.qp_step import Penalties
from smoothers.scp.search import PathVerdict, SearchOutcome, Solver
from smoothers.scp.settings import DEFAULT_SETTINGS

LOOP, PATIENCE = DEFAULT_SETTINGS.loop, 100


def state():
    return _State(LOOP, 0.4, 1.0, PATIENCE, Penalties(LOOP.clearance_penalty, LOOP.goal_penalty))


def test_trust_region_grows_unless_a_step_was_rejected_before():
    region = state()
    region.accept()
    grown = region.trust_region
    assert grown > 0.4
    region.reject(math.inf)
    rejected = region.trust_region
    assert rejected < grown
    region.accept()
    assert region.trust_region == rejected
    region.accept()
    assert region.trust_region > rejected


def test_rejected_steps_of_an_infeasible_iterate_raise_the_penalties_and_then_end_the_search():
    """The patience, with which a shortfall that shrinks slowly is met, plays no part."""
    region, infeasible = state(), SimpleNamespace(feasible=False, missing=1e-4, cost=10.0)
    raised = []
    while len(raised) < PATIENCE:
        region.reject(math.inf)
        before = region.penalties.clearance
        if region.is_hopeless(infeasible):
            break
        raised.append(region.penalties.clearance > before)
    each = LOOP.max_rejections_infeasible + 1
    raises = round(math.log(LOOP.most_penalty / LOOP.clearance_penalty, LOOP.raised))
    assert raised == [(i + 1) % each == 0 for i in range(each * raises + each - 1)]


def test_nearly_feasible_iterate_of_a_stuck_search_is_certified(monkeypatch):
    case, search = instance("pillar", 0), strategy.search

    def stuck(*args):
        *_, last = search(*args)
        nearly = last.iterate._replace(feasible=False, shortfall=1e-3)
        yield last._replace(iterate=nearly, finished=False, is_stuck=True)
        raise AssertionError("the search goes on")

    monkeypatch.setattr(strategy, "search", stuck)
    smoother = CasadiSmoother()
    smoother.configure(PluginContext(name="smoother"))
    result = smoother.smooth(case.raw_path, 10.0, problem=case.problem)
    assert result.completed
    assert certify_path(result.path, case.problem).certified


@pytest.mark.parametrize(
    ("kind", "amount", "shortfall", "is_at_a_pose"),
    [
        ("clearance", 3e-3, 3.1e-3, True),
        ("clearance", 1e-3, 3.1e-3, False),  # most of it is due to the bound between nodes
        ("clearance", 3e-4, 3e-4, False),  # another search may gain as much as the buffer
        ("unproven", 3e-3, 3.1e-3, False),
    ],
)
def test_candidate_is_repaired_unless_a_pose_is_too_close(kind, amount, shortfall, is_at_a_pose):
    case = instance("pillar", 0)
    certificate = certify_path(case.witness, case.problem)
    broken = Violation(kind, "", s=1.0, amount=amount, where={})
    verdict = PathVerdict(dataclasses.replace(certificate, violations=(broken,)))
    solver = Solver(None, ENDLESS, None, DEFAULT_SETTINGS, SearchOutcome(refused=(case.witness, verdict)))
    assert solver._comes_too_close(SimpleNamespace(shortfall=shortfall)) is is_at_a_pose
