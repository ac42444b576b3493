"""Plan files are judged whole: a file with a damage that still passes still tells the truth."""

import copy
import dataclasses
import json

import numpy as np
import pytest

from experiments.fuzz.generators.damages import DAMAGES, SCENES, damaged_document, places_of, planned
from experiments.fuzz.kinds.damaged_files import judge
from optdock.config import load_scenario
from optdock.errors import InvalidFile, NoMotionExists
from optdock.io.plan_file import parse_plan
from optdock.io.proof_cells import proof_of
from optdock.reports.plan_file_verdict import judge_plan_file
from optdock.verification import Certificate


@pytest.fixture(scope="module")
def problems(tmp_path_factory):
    folder = tmp_path_factory.mktemp("scenes")
    for name, text in SCENES.items():
        (folder / f"{name}.yaml").write_text(text)
    return {name: load_scenario(folder / f"{name}.yaml").problem for name in SCENES}


def document_of(name):
    return json.loads(planned(name).plan)


def verdict_on(document, problem):
    return judge_plan_file(parse_plan(json.dumps(document), "plan.json"), problem)


@pytest.mark.parametrize("name", SCENES)
def test_what_plan_writes_is_certified_or_impossible(problems, name):
    verdict = verdict_on(document_of(name), problems[name])
    assert verdict.outcome == ("impossible" if name == "shut" else "certified")
    assert bool(verdict) == (name != "shut")
    assert verdict.false_claims == ()


@pytest.mark.parametrize("part", [None, "obstacles", "robot", "dock", "region"])
def test_the_proof_of_another_problem_is_a_false_claim(problems, part):
    document = document_of("bend")
    path, relief = parse_plan(json.dumps(document), "plan.json").path, document["certificate"]["start_relief"]
    document["proof"] = json.loads(json.dumps(proof_of(path, problems["bend"], relief)))
    if part == "obstacles":
        document["proof"]["obstacles"].pop()
    elif part is not None:
        holder = document["proof"] if part == "region" else document["proof"][part]
        holder["footprint" if part == "robot" else "pose" if part == "dock" else part][0] = 7.0
    verdict = verdict_on(document, problems["bend"])
    assert verdict.false_claims == (() if part is None else (f"proof.{part} is not that of the problem",))
    assert "proof.cells" in dict(verdict.rows)["not judged"]


def test_one_damage_anywhere_is_seen_or_means_the_same():
    """One place of every part with one damage, drawn at random; the fuzzer's kind `damaged_files` has them all."""
    rng, parts = np.random.default_rng(3), {}
    for place in places_of(document_of("bend")):
        parts.setdefault(tuple("#" if isinstance(key, int) else key for key in place), []).append(place)
    case = {"kind": "damaged_files", "target": "plan", **planned("bend")._asdict()}
    outcomes = set()
    for places in parts.values():
        place = places[rng.integers(len(places))]
        before = document_of("bend")
        for key in place:
            before = before[key]
        known = DAMAGES if type(before) in (int, float) else DAMAGES[12:]
        for damage in rng.choice(known, 1):
            verdict = judge({**case, "place": list(place), "damage": str(damage)})
            assert not verdict.is_fault or verdict.outcome == "late", verdict
            outcomes.add(verdict.outcome)
    assert outcomes >= {"plan: certified", "plan: refuted", "plan: InvalidFile"}


@pytest.mark.parametrize(
    "place",
    [
        "path.s", "path.x", "path.y", "path.yaw", "path.curvature", "path.direction",
        "raw_path.s", "raw_path.x", "raw_path.y", "raw_path.yaw", "raw_path.curvature", "raw_path.direction",
        "trajectory.t", "trajectory.x", "trajectory.y", "trajectory.yaw", "trajectory.speed", "trajectory.acceleration",
        "trajectory.jerk", "trajectory.yaw_rate", "trajectory.yaw_acceleration",
    ],
)  # fmt: skip
def test_every_column_is_compared(problems, place):
    """Its middle value moved: refused as a file, or refuted."""
    for change in (1e-3, 5.0, -1e6):
        document = document_of("bend")
        column = document[place.partition(".")[0]][place.partition(".")[2]]
        i = len(column) // 2
        column[i] = -column[i] if place.endswith("direction") else column[i] + change
        try:
            said = verdict_on(document, problems["bend"]).outcome
        except InvalidFile as error:
            said = str(error)
        assert said == "refuted" or place.partition(".")[0] in said


@pytest.mark.parametrize("part", ["path", "raw_path"])
def test_the_columns_of_samples_alone_are_compared(problems, part):
    honest = document_of("bend")
    del honest[part]["segments"]
    named = dict(verdict_on(honest, problems["bend"]).rows)["not judged"]
    assert ("raw_path.curvature" in named) == (part == "raw_path")
    for name, change in (("curvature", 1.0), ("s", 1e-3), ("s", 1.0), ("direction", None)):
        if (part, name) == ("raw_path", "curvature"):
            continue
        document = copy.deepcopy(honest)
        column = document[part][name]
        column[7] = -column[7] if change is None else column[7] + change
        with pytest.raises(InvalidFile, match=rf"{part}\.{name}"):
            parse_plan(json.dumps(document), "plan.json")


NUMBERS = [
    "min_clearance", "required_clearance", "margin", "max_curvature", "max_curvature_rate", "length", "start_relief",
    "tube", "at_s",
]  # fmt: skip


@pytest.mark.parametrize("name", NUMBERS)
@pytest.mark.parametrize("change", [0.02, -0.02, 1e6, -1e6])
def test_every_number_of_a_certificate_must_be_proven(problems, name, change):
    document = document_of("bend")
    document["certificate"][name] += change * (100.0 if name == "at_s" else 1.0)
    verdict = verdict_on(document, problems["bend"])
    assert verdict.outcome == "refuted"
    assert f"certificate.{name} is" in verdict.false_claims[0]


def test_no_number_of_a_certificate_is_forgotten():
    """A field of `Certificate` that nobody compares would be believed."""
    compared = {*NUMBERS, "view_margin", "violations", "nearest", "problem", "path"}
    assert {field.name for field in dataclasses.fields(Certificate)} == compared | {"poses_checked"}


def test_every_ratio_must_be_proven(problems):
    ratios = document_of("bend")["certificate"]["trajectory"]["ratios"]
    for name in ratios:
        document = document_of("bend")
        document["certificate"]["trajectory"]["ratios"][name] += 0.01
        assert name in verdict_on(document, problems["bend"]).reason
    document = document_of("bend")
    document["certificate"]["trajectory"]["ratios"]["warp"] = 0.5
    assert "'warp' is the ratio of no limit" in verdict_on(document, problems["bend"]).reason


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda d: d["certificate"].update(certified=False),
            "certificate.certified is false, but the path is certified",
        ),
        (lambda d: d["certificate"].update(violations=[{"kind": "clearance"}]), "certificate.violations is not empty"),
        (lambda d: d["certificate"].update(nearest="the moon"), "no obstacle has this name"),
        (lambda d: d["certificate"].update(nearest=""), "certificate.nearest is empty"),
        (lambda d: d["certificate"].update(min_clearance=None), "certificate.min_clearance is inf m"),
        (lambda d: d["certificate"]["trajectory"].update(duration=1.0), "certificate.trajectory.duration is 1 s"),
        (lambda d: d["tried"][0].update(price=1.0), "tried: the lowest price is 1 s"),
        (lambda d: d.update(raw_path=document_of("straight")["raw_path"]), "raw_path begins"),
        (lambda d: d.update(status="FailedToSmoothPath", trajectory=None), "the file is a refusal"),
        (lambda d: d.update(frame="odom"), "the plan is in frame 'odom'"),
    ],
)
def test_false_claims_refute_a_file(problems, change, said):
    document = document_of("bend")
    change(document)
    verdict = verdict_on(document, problems["bend"])
    assert verdict.outcome == "refuted"
    assert said in verdict.reason


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (
            lambda d: d.update(path=document_of("straight")["path"]),
            "impossibility: a proof that no motion",
        ),
        (lambda d: d.update(certificate={"certified": True}), "impossibility: a proof that no motion"),
        (lambda d: d.update(status="certified"), "impossibility: a proof that no motion"),
        (
            lambda d: d.update(status="certified", impossibility=None),
            "status: is 'certified', but",
        ),
        (lambda d: d.update(status="unknown"), "error: contradicts status 'unknown'"),
    ],
)
def test_contradictions_are_no_plan(problems, change, said):
    document = document_of("shut")
    assert document["status"] == NoMotionExists.__name__
    change(document)
    with pytest.raises(InvalidFile, match=said):
        verdict_on(document, problems["shut"])


def test_a_refusal_without_a_proof_is_not_certified(problems):
    document = document_of("shut")
    del document["impossibility"]
    assert verdict_on(document, problems["shut"]).outcome == "refuted"


def test_a_proof_that_does_not_hold_is_refuted(problems):
    assert verdict_on(document_of("shut"), problems["straight"]).outcome == "refuted"


def test_what_is_not_judged_is_named(problems):
    document = {**document_of("bend"), "note": "hello", "timing_ms": {"plan": 1e9}}
    document["path"]["curvature_rate"] = [1e9]
    verdict = verdict_on(document, problems["bend"])
    assert verdict
    assert dict(verdict.rows)["not judged"] == (
        "certificate.poses_checked, completed, timing_ms, tried, path.curvature_rate (unknown), note (unknown)"
    )


@pytest.mark.parametrize("value", [-1.0, "1", [1.0], True])
def test_times_and_prices_are_numbers_that_can_be(value):
    for part in ({"timing_ms": {"plan": value}}, {"tried": [{"seconds": value}]}, {"tried": [{"price": value}]}):
        with pytest.raises(InvalidFile):
            parse_plan(json.dumps({**document_of("bend"), **part}), "plan.json")


def test_a_certificate_of_another_problem_is_not_compared(problems):
    document = document_of("bend")
    document["certificate"]["problem"]["obstacles"] = "0" * 16
    document["certificate"]["min_clearance"] = 3.0
    verdict = verdict_on(document, problems["bend"])
    assert verdict
    assert dict(verdict.rows)["file proven for"].startswith("another problem: obstacles differ")
    assert "certificate (of another problem)" in dict(verdict.rows)["not judged"]


def test_every_damage_of_the_fuzzer_changes_something():
    case = {"target": "plan", "place": ["path", "x", 3], **planned("bend")._asdict()}
    original = document_of("bend")
    for damage in DAMAGES:
        document, *_ = damaged_document({**case, "damage": damage})
        assert json.dumps(document) != json.dumps(original), damage
        assert document_of("bend") == original
    assert copy.deepcopy(original) == json.loads(planned("bend").plan)


@pytest.mark.parametrize("status", ["recorded", "Certified"])
def test_a_status_of_others_is_not_judged(status, problems):
    document = document_of("bend")
    document["status"] = status
    assert f"status '{status}'" in dict(verdict_on(document, problems["bend"]).rows)["not judged"]
