"""The second judge against the certificates: a small campaign, and every damage at least once."""

import numpy as np
import pytest

from experiments.families import instance
from experiments.fuzz.case import rng_of
from experiments.fuzz.generators.damaged_proofs import DAMAGES, damaged
from experiments.fuzz.kinds import judged
from optdock.planning.pipeline import plan_dock
from optdock.planning.plan import DockPlan
from optdock.verification import judge as judge_file


@pytest.fixture(scope="module")
def text(tmp_path_factory):
    """A planned file among obstacles, as the program writes it."""
    target = tmp_path_factory.mktemp("judged") / "plan.json"
    plan = plan_dock(instance("many_obstacles", 0).problem, time_budget=5.0)
    assert isinstance(plan, DockPlan)
    plan.save(target)
    return target.read_text()


def test_the_judges_agree_on_random_paths_and_motions():
    outcomes = []
    for number in range(30):
        case = judged.draw(rng_of("judged", 5, number))
        if "path" in case:  # plans are in the campaign
            outcomes.append(judged.judge(case))
    assert [found for found in outcomes if found.is_fault] == []
    assert sum(found.outcome.startswith("accepted") for found in outcomes) > 5


def test_a_planned_file_is_accepted_and_no_damage_of_it(text):
    assert judged.refusal_of(text) == ""
    applied = set()
    for name in (*DAMAGES, "hostile", "repeated"):
        for seed in range(6):
            broken = damaged(text, name, np.random.default_rng(seed), "")
            if broken is not None:
                applied.add(name)
                assert judged.refusal_of(broken), (name, seed)
                break
    assert applied == {*DAMAGES, "hostile", "repeated"} - {"turn_forbidden"}


def test_parts_of_two_files_do_not_fit_together(text):
    assert judged.refusal_of(judged.another_file()) == ""
    for seed in range(8):
        swapped = damaged(text, "swapped", np.random.default_rng(seed), judged.another_file())
        assert judged.refusal_of(swapped)


def test_a_judge_without_the_proof_of_clearance_is_found(monkeypatch, text):
    """The damages see a judge that is blind to obstacles."""
    monkeypatch.setattr(judge_file._Clearance, "check", lambda *_: None)
    broken = damaged(text, "obstacle_moved_in", np.random.default_rng(0), "")
    assert broken is not None
    assert judged.refusal_of(broken) == ""
