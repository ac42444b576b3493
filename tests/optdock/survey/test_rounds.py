"""Rounds of a survey: every verdict opens as a proof, and nothing depends on the workers."""

import collections
import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optdock.deadline import budget_clock
from optdock.errors import InvalidValue, StartOccupied
from optdock.geometry.footprint import Footprint
from optdock.runner import Outcome
from optdock.survey.grid import SurveyGrid
from optdock.survey.opened import plan_of_cell
from optdock.survey.questions import answer_tile
from optdock.survey.rounds import CellState, Spacing, connected, meeting, representatives
from optdock.survey.tails import time_rests
from tests.optdock.survey.scenes import asked, box, judged, scenario

OUTCOMES = {CellState.CERTIFIED: "certified", CellState.IMPOSSIBLE: "impossible"}
FREE = (CellState.CERTIFIED, CellState.IMPOSSIBLE, CellState.NOT_FOUND)
CLOSED = box(1.9, 0, 2.1, 3)
NARROW = (box(1.9, 0, 2.1, 1.4), box(1.9, 1.65, 2.1, 3))  # 0.25 m for a robot of 0.3 m


@pytest.fixture(scope="module")
def surveys():
    """Surveys by name: scenario, task, answers."""
    made = {
        "open": (scenario(), (1.5, 0.5, 3.0, 2.5)),
        "closed": (scenario(CLOSED), (1.0, 1.0, 3.0, 2.0)),
        "narrow": (scenario(*NARROW), (1.25, 1.0, 2.75, 2.0)),
    }
    return {name: (given, *asked(given, region)) for name, (given, region) in made.items()}


@pytest.mark.parametrize("name", ["open", "closed", "narrow"])
def test_answers_open_as_plan_files_with_the_same_verdict(surveys, name, tmp_path):
    """A sample of each method."""
    given_, task, answers = surveys[name]
    methods = collections.defaultdict(list)
    for cell in np.flatnonzero(np.isin(answers.verdict, FREE)).tolist():
        methods[answers.method[cell]].append(cell)
    assert {"planned", "inherited", "shared"} <= set(methods)
    with budget_clock("counted"):
        for method, cells in methods.items():
            for cell in cells[:: -(-len(cells) // 9)]:
                verdict = CellState(answers.verdict[cell])
                assert judged(answers, cell, given_, task.time_budget, tmp_path) == OUTCOMES[verdict], (method, cell)


@pytest.mark.parametrize("name", ["closed", "narrow"])
def test_cells_behind_a_wall_are_impossible_and_no_shared_answer_crosses_it(surveys, name):
    _, task, answers = surveys[name]
    x = task.grid.poses(np.arange(answers.verdict.size))[:, 0]
    is_free = np.isin(answers.verdict, FREE)
    assert set(answers.verdict[is_free & (x < 2.0)].tolist()) == {CellState.IMPOSSIBLE}
    assert set(answers.verdict[is_free & (x > 2.0)].tolist()) == {CellState.CERTIFIED}
    assert set(answers.verdict[~is_free].tolist()) == {CellState.OCCUPIED}


def test_an_answer_belongs_to_its_cell(surveys):
    """Motions begin in the cell; a shared answer is that of another cell of the same heading and block."""
    _, task, answers = surveys["open"]
    for cell in np.flatnonzero(answers.verdict == CellState.CERTIFIED).tolist():
        begins = int(task.grid.cells(answers.start[cell][None])[0])
        assert math.isfinite(answers.seconds[cell])
        k, j, i = np.unravel_index([cell, begins], task.grid.shape)
        if answers.method[cell] == "shared":
            assert k[0] == k[1]
            assert (j // 4)[0] == (j // 4)[1]
            assert (i // 4)[0] == (i // 4)[1]
        else:
            assert begins == cell
        assert answers.asked[int(answers.source[cell])].motion is not None


class Drawn:
    """Workers that answer by a rule instead of planning, and record their cases."""

    def __init__(self, rule, passes=None, timed=None):
        self.rule, self.passes, self.timed, self.cases = rule, passes or {}, timed, []

    def __call__(self, function, cases):
        self.cases += [case.key for case in cases]
        for case in cases:
            if function is time_rests:
                yield Outcome(case.key, self.timed, "" if self.timed else "RuntimeError: planted")
                continue
            assert function is answer_tile
            answers, passed = [], {"cell": [], "source": [], "s": [], "price": []}
            for cell in case.arguments[0].cells:
                verdict = self.rule(cell)
                motion = {"curves": [], "durations": [], "jerks": []} if verdict == "certified" else None
                price = 20.0 if motion else None
                answers.append({
                    "cell": cell, "verdict": verdict, "method": "planned", "seconds": price, "price": price,
                    "reason": "planted", "motion": motion,
                })  # fmt: skip
                for other in self.passes.get(cell, ()):
                    for name, value in zip(passed, (other, cell, 0.5, 5.0), strict=True):
                        passed[name].append(value)
            yield Outcome(case.key, {"answers": answers, "proofs": [], "passed": passed})


REGION = (0.5, 0.5, 3.25, 2.5)


def drawn(rule, obstacles=(), headings=2, **options):
    run = Drawn(rule, **options)
    task, answers = asked(scenario(*obstacles), REGION, headings=headings, run=run)
    return run, task, answers


def test_every_free_cell_has_a_verdict_even_if_no_rest_can_be_timed():
    """A motion passes all cells, so that no other question is asked; then the processes fail."""
    every = range(2 * 9 * 12)
    _, _, answers = drawn(lambda cell: "certified", passes=dict.fromkeys(every, every))
    assert set(answers.verdict.tolist()) <= {CellState.CERTIFIED, CellState.OCCUPIED}
    assert not (answers.method == "").any()


def test_a_cell_that_a_certified_motion_passes_is_certified_even_if_no_motion_was_found_from_it():
    """By a motion that was found before, or by one of a cell that is asked because verdicts meet there."""
    timed = [{"seconds": [5.0], "poses": [[1.0, 1.0, 0.0]], "stops": [0]}]

    def surveyed(passes):
        options = {"passes": passes, "timed": timed} if passes else {}
        return drawn(lambda cell: "certified" if cell % 12 < 7 else "not found", **options)[2]

    before = surveyed({})
    first = min(cell for cell, one in before.asked.items() if one.verdict == "not found")
    motions = [cell for cell, one in before.asked.items() if one.verdict == "certified"]
    for source in (motions[0], motions[-1]):
        answers = surveyed({source: [first]})
        assert before.verdict[first] == CellState.NOT_FOUND
        assert answers.verdict[first] == CellState.CERTIFIED
        assert answers.method[first] == "inherited"
        assert answers.source[first] == source
        assert answers.seconds[first] == 5.0


def test_the_cells_next_to_another_verdict_are_asked():
    """So that shared answers are at least one cell away from the border of the verdicts."""
    _, task, answers = drawn(lambda cell: "certified" if cell % 12 < 7 else "not found")
    by_cell = answers.verdict.reshape(task.grid.shape)
    is_shared = (answers.method == "shared").reshape(task.grid.shape)
    assert is_shared.any()
    column = np.arange(12)
    free = by_cell != CellState.OCCUPIED
    assert np.all(by_cell[free & (column < 7)] == CellState.CERTIFIED)
    assert np.all(by_cell[free & (column >= 7)] == CellState.NOT_FOUND)
    assert not is_shared[meeting(by_cell)].any()


def test_a_shared_answer_comes_from_its_own_block():
    """Not from a nearer cell in the next block, which may be behind an obstacle."""
    _, task, answers = drawn(lambda cell: "certified", obstacles=[box(2.3, 0, 2.4, 3)])
    shared = np.flatnonzero(answers.method == "shared")
    assert shared.size
    x = task.grid.poses(np.arange(answers.verdict.size))[:, 0]
    assert np.all((x[shared] < 2.3) == (x[answers.source[shared]] < 2.3))


def test_a_failed_case_is_not_found_with_its_error():
    def broken(function, cases):
        return (Outcome(case.key, error="ValueError: planted") for case in cases)

    _, answers = asked(scenario(), REGION, headings=2, run=broken)
    assert set(answers.verdict.tolist()) <= {CellState.NOT_FOUND, CellState.OCCUPIED}
    assert {one.reason for one in answers.asked.values()} == {"ValueError: planted"}


def test_nothing_is_asked_where_nothing_is_free():
    run = Drawn(lambda cell: "certified")
    full = scenario(box(0.0, 0.0, 3.0, 3.0))
    task, answers = asked(full, (0.5, 0.5, 2.0, 2.0), run=run)
    assert run.cases == []
    assert set(answers.verdict.tolist()) == {CellState.OCCUPIED}
    with pytest.raises(StartOccupied, match="overlaps or touches an obstacle"):
        plan_of_cell(answers, 0, full, task.time_budget)


def test_a_cell_outside_the_region_has_no_plan(surveys):
    given_, task, answers = surveys["open"]
    outside = np.full_like(answers.verdict, CellState.OUTSIDE)
    known, answers.verdict = answers.verdict, outside
    try:
        with pytest.raises(InvalidValue, match="outside the surveyed region"):
            plan_of_cell(answers, 0, given_, task.time_budget)
    finally:
        answers.verdict = known


@pytest.mark.parametrize(("resolution", "block"), [(0.1, 5), (0.2, 2), (0.25, 2), (1.0, 1), (0.01, 50)])
def test_tiles_are_multiples_of_blocks(resolution, block):
    found = Spacing.of(Footprint.rectangle(0.45, 0.45, 0.6), resolution)
    assert found.block == block
    assert found.tile % found.block == 0


ANY = st.tuples(st.integers(1, 4), st.integers(1, 5), st.integers(1, 5), st.integers(0, 2**32), st.floats(0.2, 0.9))


def neighbours(cell, shape):
    """Yield the neighbours of a cell; the last heading is next to the first one."""
    k, j, i = cell
    for dk, dj, di in itertools.product((-1, 0, 1), repeat=3):
        if 0 <= j + dj < shape[1] and 0 <= i + di < shape[2]:
            yield (k + dk) % shape[0], j + dj, i + di


@given(ANY)
@settings(max_examples=60)
def test_components_agree_with_a_flood_fill(drawn_):
    *shape, seed, share = drawn_
    free = np.random.default_rng(seed).random(shape) < share
    found, number = connected(free), 0
    assert np.array_equal(found >= 0, free)
    seen = set()
    for cell in zip(*np.nonzero(free), strict=True):
        if cell in seen:
            continue
        front, part = [cell], {cell}
        while front:
            for other in neighbours(front.pop(), shape):
                if free[other] and other not in part:
                    part.add(other)
                    front.append(other)
        assert len({int(found[one]) for one in part}) == 1
        seen |= part
        number += 1
    assert np.unique(found[free]).size == number


@given(ANY)
@settings(max_examples=60)
def test_meeting_agrees_with_its_definition(drawn_):
    *shape, seed, _ = drawn_
    verdict = np.random.default_rng(seed).integers(-1, 5, shape)
    found = meeting(verdict)
    for cell in itertools.product(*map(range, shape)):
        beside = {int(verdict[other]) for other in neighbours(cell, shape)} & set(map(int, FREE))
        assert found[cell] == (int(verdict[cell]) in FREE and len(beside) > 1)


@given(ANY)
@settings(max_examples=40)
def test_representatives_are_next_to_the_mean(drawn_):
    *shape, seed, share = drawn_
    random, grid = np.random.default_rng(seed), SurveyGrid((0, 0), tuple(shape), 1.0)
    cells = np.flatnonzero(random.random(math.prod(shape)) < share)
    label, avoided = random.integers(0, 3, cells.size) * 5, random.random(cells.size) < 0.5
    found = representatives(grid, cells, label, avoided)
    at = np.column_stack(np.unravel_index(cells, grid.shape))
    for row, name in enumerate(np.unique(label).tolist()):
        of = label == name
        usable = of & ~avoided if (of & ~avoided).any() else of
        off = ((at - at[of].mean(axis=0)) ** 2).sum(axis=1)
        assert found[row] in cells[usable]
        assert off[cells == found[row]][0] == pytest.approx(off[usable].min())
