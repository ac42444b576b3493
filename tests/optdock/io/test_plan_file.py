import dataclasses
import json
import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, reject, settings
from hypothesis import strategies as st

from optdock.errors import InvalidFile, InvalidPath, InvalidValue, StartOccupied
from optdock.geometry.clothoid import ClothoidSpline
from optdock.geometry.pose import Pose2
from optdock.io.plan_file import PlanError, PlanFile, TrajectoryColumns, load_plan, save_plan
from optdock.model.constant_jerk import TimeLaw
from optdock.model.path import ClothoidSegment, Direction, Path, PolylineSegment
from optdock.model.trajectory import Trajectory


def two_gears(curvature=0.8):
    first = ClothoidSpline(Pose2(1.0, 2.0, 0.3), np.array([0.0, 0.4, 1.0]), np.array([0.0, curvature, 0.1]))
    second = ClothoidSpline(first.end, np.array([0.0, 0.7]), np.array([0.1, -curvature]), -1)
    return Path((ClothoidSegment(first), ClothoidSegment(second)))


def rest_to_rest(path):
    """Jerk up, down, down, up over `path`, one gear after the other."""
    phases = np.tile([1.0, -1.0, -1.0, 1.0], len(path.segments))
    quarter = np.repeat([(segment.length / 2.0) ** (1.0 / 3.0) for segment in path.segments], 4)
    return Trajectory(path, TimeLaw(quarter, phases))


def full_plan():
    path = two_gears()
    return PlanFile(
        completed=True,
        frame="depot",
        raw_path=Path.from_poses(path.sample(0.1).poses),
        path=path,
        trajectory=TrajectoryColumns.from_trajectory(rest_to_rest(path), 0.02),
        certificate={"min_clearance": math.inf, "at_s": np.float64(0.5), "max_curvature": 0.8, "violations": ()},
        timing_ms={"plan": 1.0, "total": 2.5},
    )


def saved(tmp_path, plan, **options):
    save_plan(tmp_path / "plan.json", plan, **options)
    return json.loads((tmp_path / "plan.json").read_text())


def broken(tmp_path, change, plan=None):
    document = json.loads((plan or full_plan()).as_json())
    change(document)
    (tmp_path / "broken.json").write_text(json.dumps(document))
    with pytest.raises(InvalidFile) as caught:
        load_plan(tmp_path / "broken.json")
    return str(caught.value).replace(str(tmp_path) + "/", "")


def test_the_keys_are_those_of_the_format(tmp_path):
    document = saved(tmp_path, full_plan())
    assert list(document) == [
        "format", "status", "completed", "frame", "raw_path", "path", "trajectory", "certificate", "timing_ms",
    ]  # fmt: skip
    assert list(document["path"]) == ["s", "x", "y", "yaw", "curvature", "direction", "segments"]
    assert list(document["trajectory"]) == [
        "t", "x", "y", "yaw", "speed", "acceleration", "jerk", "yaw_rate", "yaw_acceleration",
    ]  # fmt: skip
    assert (document["format"], document["status"], document["completed"]) == ("optdock-plan/1", "certified", True)


def test_the_time_law_stands_beside_its_samples(tmp_path):
    plan = full_plan()
    law = rest_to_rest(plan.path).time_law
    document = saved(tmp_path, dataclasses.replace(plan, time_law=law))
    assert list(document["trajectory"])[-1] == "phases"
    assert list(document["trajectory"]["phases"]) == ["start", "durations", "jerks"]
    loaded = load_plan(tmp_path / "plan.json").time_law
    np.testing.assert_array_equal(loaded.states, law.states)
    np.testing.assert_array_equal(loaded.times, law.times)
    assert load_plan(tmp_path / "plan.json").trajectory.t.size == plan.trajectory.t.size


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"jerks": [1.0]}, "trajectory.phases: time law: needs >= 1 phase with a jerk each, got 8, 1"),
        ({"durations": [-1.0] * 8}, "trajectory.phases: time law.durations: must be > 0 s"),
        ({"start": [0.0]}, "trajectory.phases.start: List should have at least 3 items"),
        ({"durations": [1e10] * 8}, "trajectory.phases.durations.0: Input should be less than or equal to"),
        ({"durations": [1.0] * 10_001}, "trajectory.phases.durations: List should have at most 10000 items"),
    ],
)
def test_wrong_phases_are_named(tmp_path, change, message):
    plan = dataclasses.replace(full_plan(), time_law=rest_to_rest(two_gears()).time_law)
    assert message in broken(tmp_path, lambda document: document["trajectory"]["phases"].update(change), plan)


def test_phases_that_rounding_made_nothing_of_are_left_out(tmp_path):
    document = json.loads(dataclasses.replace(full_plan(), time_law=rest_to_rest(two_gears()).time_law).as_json())
    phases = document["trajectory"]["phases"]
    phases["durations"].insert(3, 0.0)
    phases["jerks"].insert(3, 9.0)
    (tmp_path / "zero.json").write_text(json.dumps(document))
    assert load_plan(tmp_path / "zero.json").time_law.durations.size == 8


def test_yaws_in_degrees_are_asked_about(tmp_path):
    def in_degrees(document):
        columns = document["path"]
        del columns["segments"]
        columns["yaw"] = [math.degrees(yaw) for yaw in columns["yaw"]]

    message = broken(tmp_path, in_degrees)
    assert message.startswith("broken.json: path.yaw: ")
    assert message.endswith(" is beyond 2 pi, and the robot moves along its yaws in degrees; write radians")


def test_yaws_that_went_on_turning_are_no_degrees(tmp_path):
    spline = ClothoidSpline(Pose2(0.0, 0.0, 0.0), np.array([0.0, 25.0]), np.array([1.0, 1.0]))
    document = json.loads(PlanFile(path=Path((ClothoidSegment(spline),))).as_json())
    del document["path"]["segments"]
    (tmp_path / "turns.json").write_text(json.dumps(document))
    assert load_plan(tmp_path / "turns.json").path.end.yaw == pytest.approx(25.0, abs=1e-3)


@pytest.mark.parametrize("decimals", [6, 5, 4])
def test_a_rounded_path_of_samples_is_read(tmp_path, decimals):
    document = json.loads(full_plan().as_json())
    columns = document["path"]
    for key in ("s", "x", "y", "yaw", "curvature"):
        columns[key] = [round(value, decimals) for value in columns[key]]
    del columns["segments"]
    (tmp_path / "rounded.json").write_text(json.dumps(document))
    assert load_plan(tmp_path / "rounded.json").path.length == pytest.approx(1.7, abs=1e-2)


def test_where_all_numbers_are_rounded_the_samples_are_the_path(tmp_path, caplog):
    def rounded(value):
        if isinstance(value, dict):
            return {key: rounded(item) for key, item in value.items()}
        if isinstance(value, list):
            return [rounded(item) for item in value]
        return round(value, 6) if isinstance(value, float) else value

    spline = ClothoidSpline(Pose2(0.1, 0.2, 1 / 3), np.array([0.0, 1.0, 3 + 1 / 7]), np.array([1 / 3, 2 / 3, 1 / 7]))
    document = json.loads(PlanFile(path=Path((ClothoidSegment(spline),))).as_json())
    document["path"]["segments"][0]["knots"][1] += 1e-5
    (tmp_path / "rounded.json").write_text(json.dumps(rounded(document)))
    (segment,) = load_plan(tmp_path / "rounded.json").path.segments
    assert isinstance(segment, PolylineSegment)
    assert "the segments are rounded, so the samples are used" in caplog.text
    document["path"]["segments"][0]["knots"][1] += 1e-5 / 3.0
    (tmp_path / "exact.json").write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match="off the segments"):
        load_plan(tmp_path / "exact.json")


def test_another_curve_between_the_same_ends_is_not_called_rounded(tmp_path):
    x = np.round(np.linspace(0.0, 2.0, 21), 6)
    straight = Path((PolylineSegment(np.column_stack((x, 0.0 * x, 0.0 * x))),))
    document = json.loads(PlanFile(path=straight).as_json(spacing=0.1))
    bulge = np.round(0.03 * np.sin(np.pi * x), 6)
    document["path"]["segments"] = [{"poses": np.column_stack((x, bulge, 0.0 * x)).tolist(), "direction": 1}]
    document["path"]["s"] = [round(float(s), 6) for s in PolylineSegment(np.column_stack((x, bulge, 0.0 * x))).knots]
    (tmp_path / "other.json").write_text(json.dumps(document))
    with pytest.raises(InvalidFile, match="off the segments"):
        load_plan(tmp_path / "other.json")


def test_a_column_of_wrong_values_is_told_in_a_few_lines(tmp_path):
    def spoil(document):
        document["path"]["x"] = ["a"] * len(document["path"]["x"])

    lines = broken(tmp_path, spoil).splitlines()
    assert len(lines) == 21
    assert lines[-1] == "broken.json: and 67 more faults"


def test_spacing_bounds_the_distance_between_samples_and_the_cusp_appears_with_each_direction(tmp_path):
    path = saved(tmp_path, full_plan(), spacing=0.05)["path"]
    s, direction = np.array(path["s"]), np.array(path["direction"])
    assert np.diff(s).max() <= 0.05 + 1e-12
    assert np.diff(s).max() > 0.04
    (cusp,) = np.flatnonzero(np.diff(direction))
    assert s[cusp] == s[cusp + 1] == 1.0
    assert (direction[cusp], direction[cusp + 1]) == (1, -1)


def test_reading_back_gives_the_exact_path(tmp_path):
    plan = full_plan()
    save_plan(tmp_path / "p.json", plan, spacing=0.3)
    loaded = load_plan(tmp_path / "p.json")
    s = np.linspace(0.0, plan.path.length, 500)
    np.testing.assert_array_equal(loaded.path.poses_at(s), plan.path.poses_at(s))
    np.testing.assert_array_equal(loaded.path.curvature_at(s), plan.path.curvature_at(s))
    np.testing.assert_array_equal(loaded.raw_path.poses_at(s), plan.raw_path.poses_at(s))
    for name in TrajectoryColumns._fields:
        np.testing.assert_array_equal(getattr(loaded.trajectory, name), getattr(plan.trajectory, name))
    assert loaded.timing_ms == plan.timing_ms
    assert (loaded.frame, loaded.completed, loaded.status) == ("depot", True, "certified")


steps = st.lists(
    st.tuples(st.floats(0.01, 2.0), st.floats(-3.0, 3.0), st.floats(-3.0, 3.0), st.sampled_from([1, -1])),
    min_size=1,
    max_size=5,
)


@settings(max_examples=25)
@given(start=st.tuples(st.floats(-50, 50), st.floats(-50, 50), st.floats(-7, 7)), pieces=steps)
def test_any_clothoid_path_survives_the_round_trip(tmp_path_factory, start, pieces):
    segments, pose = [], Pose2(*start)
    for length, first, last, sign in pieces:
        segments.append(ClothoidSegment(ClothoidSpline(pose, np.array([0.0, length]), np.array([first, last]), sign)))
        pose = segments[-1].spline.end
    path, target = Path(tuple(segments)), tmp_path_factory.mktemp("plans") / "p.json"
    save_plan(target, PlanFile(path=path))
    loaded = load_plan(target).path
    s = np.linspace(0.0, path.length, 50)
    np.testing.assert_array_equal(loaded.poses_at(s), path.poses_at(s))
    np.testing.assert_array_equal(loaded.direction_at(s), path.direction_at(s))


@settings(max_examples=25)
@given(st.lists(st.tuples(st.floats(-5, 5), st.floats(-5, 5), st.floats(-10, 10)), min_size=2, max_size=8, unique=True))
def test_any_polyline_survives_the_round_trip(tmp_path_factory, rows):
    try:
        path = Path.from_poses(np.array(rows))
    except InvalidPath:  # all poses are the same but for rounding
        reject()
    target = tmp_path_factory.mktemp("plans") / "p.json"
    save_plan(target, PlanFile(raw_path=path))
    loaded = load_plan(target).raw_path
    assert len(loaded.segments) == len(path.segments)
    for mine, theirs in zip(loaded.segments, path.segments, strict=True):
        np.testing.assert_array_equal(mine.poses, theirs.poses)
        assert mine.direction == theirs.direction


def test_samples_alone_make_a_polyline_with_the_right_gears(tmp_path):
    document = json.loads(full_plan().as_json(spacing=0.01))
    foreign = {"format": "optdock-plan/1", "path": {k: document["path"][k] for k in ("x", "y", "yaw")}}
    (tmp_path / "foreign.json").write_text(json.dumps(foreign))
    loaded = load_plan(tmp_path / "foreign.json")
    assert [segment.direction for segment in loaded.path.segments] == [Direction.FORWARD, Direction.REVERSE]
    assert all(isinstance(segment, PolylineSegment) for segment in loaded.path.segments)
    assert loaded.path.length == pytest.approx(two_gears().length, abs=1e-5)
    assert (loaded.status, loaded.raw_path, loaded.trajectory) == ("unknown", None, None)


def test_a_failure_file_carries_the_error_and_what_exists(tmp_path):
    error = StartOccupied("start touches crate", where={"obstacle": "crate", "depth": np.float64(0.1), "at": (1, 2.0)})
    plan = PlanFile(status="StartOccupied", raw_path=two_gears(), error=PlanError.from_exception(error))
    document = saved(tmp_path, plan)
    assert document["error"] == {
        "code": 205,
        "message": "start touches crate",
        "where": {"obstacle": "crate", "depth": 0.1, "at": [1, 2.0]},
    }
    assert "path" not in document
    assert "trajectory" not in document
    loaded = load_plan(tmp_path / "plan.json")
    assert loaded.error.message == "start touches crate"
    assert loaded.path is None


def test_numbers_that_json_does_not_know_are_never_written(tmp_path):
    text = full_plan().as_json()
    assert "Infinity" not in text
    assert "NaN" not in text
    assert json.loads(text)["certificate"]["min_clearance"] is None
    columns = full_plan().trajectory._replace(jerk=np.full(full_plan().trajectory.t.size, np.nan))
    with pytest.raises(InvalidValue, match="must be finite"):
        save_plan(tmp_path / "nan.json", PlanFile(trajectory=columns))
    assert list(tmp_path.iterdir()) == []


def test_a_failed_write_keeps_the_old_file(tmp_path):
    target = tmp_path / "plan.json"
    target.write_text("old")
    with pytest.raises(InvalidValue, match=r"spacing: must be finite and > 0 m, got -1\.0"):
        save_plan(target, full_plan(), spacing=-1.0)
    assert target.read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["plan.json"]
    with pytest.raises(InvalidFile, match=r"plan\.json/below: cannot be written"):
        save_plan(target / "below", full_plan())


def test_samples_off_their_segments_are_refused(tmp_path):
    def shift(document):
        document["path"]["x"][7] += 2e-6

    assert "path: sample 7 is 2e-06 m" in broken(tmp_path, shift)


def test_repeated_samples_hide_no_wrong_heading(tmp_path):
    def turn_every_sample_by_one_radian(document):
        columns = document["path"]
        for key in ("s", "x", "y", "yaw", "curvature", "direction"):
            columns[key] = [value for value in columns[key] for _ in range(2)]
        columns["yaw"] = [yaw + 1.0 for yaw in columns["yaw"]]

    assert "1 rad off the segments" in broken(tmp_path, turn_every_sample_by_one_radian)


def test_many_samples_of_many_gears_fit_into_memory(tmp_path):
    poses = [[0.1 * (i % 2), 0.0, 0.0] for i in range(900)]  # a table of samples by gears takes 71 MB
    document = json.loads(PlanFile(path=Path.from_poses(np.array(poses))).as_json(spacing=0.01))
    (tmp_path / "long.json").write_text(json.dumps(document))
    tracemalloc.start()
    try:
        assert len(load_plan(tmp_path / "long.json").path.segments) == 899
        assert tracemalloc.get_traced_memory()[1] < 50e6
    finally:
        tracemalloc.stop()


def test_samples_that_end_elsewhere_are_refused(tmp_path):
    def stretch(document):
        document["path"]["segments"][1]["knots"][-1] = 0.8

    assert broken(tmp_path, stretch) == "broken.json: path: samples end at s = 1.7 m, segments at 1.8 m"


def test_samples_within_the_tolerance_pass(tmp_path):
    document = json.loads(full_plan().as_json())
    document["path"]["x"][7] += 5e-7
    (tmp_path / "near.json").write_text(json.dumps(document))
    assert load_plan(tmp_path / "near.json").path.length == pytest.approx(1.7)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="optdock-plan/9"), "broken.json: format: Input should be 'optdock-plan/1'"),
        (lambda d: d["path"].pop("x"), "broken.json: path.x: Field required"),
        (lambda d: d["path"]["y"].append(0.0), "broken.json: path.y: must have as many values as path.x"),
        (
            lambda d: d["path"]["direction"].__setitem__(3, 2),
            "broken.json: path.direction.3: Input should be 1, -1 or 0",
        ),
        (lambda d: d["path"]["x"].__setitem__(2, "a"), "broken.json: path.x.2: Input should be a valid number"),
        (lambda d: d["path"]["x"].__setitem__(2, "1.5"), "broken.json: path.x.2: Input should be a valid number"),
        (lambda d: d["path"]["x"].__setitem__(2, True), "broken.json: path.x.2: Input should be a valid number"),
        (lambda d: d["trajectory"]["t"].__setitem__(0, "0"), "broken.json: trajectory.t.0: Input should be a valid"),
        (lambda d: d["path"]["s"].__setitem__(0, -0.5), "broken.json: path.s: must start at 0 m, got -0.5"),
        (lambda d: d["path"]["s"].__setitem__(5, 0.0), "broken.json: path.s: grows by"),
        (lambda d: d["path"].update(direction=[1] * len(d["path"]["x"])), "path.direction: differs from that of the"),
        (
            lambda d: d["path"].update(direction=[1] * len(d["path"]["x"]), segments=None),
            "path.direction: 1 at sample 52, but the robot moves in the other gear there",
        ),
        (
            lambda d: d["path"].update(direction=[0] * len(d["path"]["x"]), segments=None),
            "path.direction: 0 at sample 0, but the robot moves there",
        ),
        (lambda d: d["trajectory"]["t"].__setitem__(1, 0.0), "trajectory.t: needs at least 2 samples"),
        (lambda d: d["trajectory"]["speed"].pop(), "trajectory.speed: must have as many values as trajectory.t"),
        (lambda d: d["path"]["segments"][0]["knots"].__setitem__(1, 9.0), "clothoid.knots: must start at 0"),
    ],
)
def test_every_broken_column_is_named(tmp_path, change, message):
    assert message in broken(tmp_path, change)


def test_all_faults_are_listed_at_once(tmp_path):
    def spoil(document):
        document["raw_path"]["s"][0] = 1.0
        document["path"]["y"].append(0.0)
        document["trajectory"]["t"][1] = 0.0

    lines = broken(tmp_path, spoil).splitlines()
    assert [line.split(": ")[1] for line in lines] == ["raw_path.s", "path.y", "trajectory.t"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", r"p\.json:1: not JSON"),
        ('{"format": "optdock-plan/1", "path": {"x": [NaN], "y": [0], "yaw": [0]}}', "NaN is not JSON"),
        ("[]", "top level: Input should be"),
        ("[" * 100_000, "not a plan file"),
    ],
)
def test_text_that_is_no_plan_is_refused(tmp_path, text, message):
    (tmp_path / "p.json").write_text(text)
    with pytest.raises(InvalidFile, match=message):
        load_plan(tmp_path / "p.json")


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InvalidFile, match=r"none\.json: cannot be read: No such file or directory"):
        load_plan(tmp_path / "none.json")
