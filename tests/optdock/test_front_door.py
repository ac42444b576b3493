"""The front door: one import, one page of script, every name where it is said to be."""

import ast
import importlib
import subprocess
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

import optdock as od

# As a new user writes it. Nothing here is abridged.
SCRIPT = """
import optdock as od

robot = od.Robot(od.Footprint.rectangle(0.45, 0.45, 0.6), od.MotionLimits(max_curvature=1.5, max_curvature_rate=6.0))
dock = od.Dock(od.Pose2(4.0, 1.0, 0.0), final_straight=0.3, approach_speed=0.1, approach_distance=0.3)
problem = od.DockingProblem(od.Pose2(1.0, 0.2, 0.4), dock, robot, obstacles=[[(1, 2), (3, 2), (3, 2.4), (1, 2.4)]], clearance=0.05)
try:
    plan = od.plan_dock(problem, time_budget=0.1)
except od.OptdockError as why:
    print(why.code, why.where, why.partial)
else:
    print(plan)                  # one line a person can read: certified, length, duration, clearance and to what
    plan.save("plan.json")
    plan.plot("plan.png")
    t, poses, twists = plan.trajectory.sampled(0.02)        # times, (n, 3) poses, (n, 2) speed and yaw rate
    again = od.plan_dock(problem.starting_at(od.Pose2(1.5, 0.3, 0.3)), warm_start=plan)
    path = od.CasadiSmoother(max_iterations=20).smooth(plan.raw_path, 0.05, problem=problem).path
"""  # noqa: E501 - as a new user writes it


def run_script():
    """The names that the script leaves behind; a machine that kept it waiting for whole budgets gets another try."""
    for _ in range(20):
        names = {}
        try:
            exec(compile(SCRIPT, "script", "exec"), names)
        except od.TimedOut:
            continue
        if "path" in names:
            return names
    raise AssertionError("no plan in 20 tries")


def test_the_script_of_the_front_page_runs(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = run_script()
    plan, problem = names["plan"], names["problem"]
    said = capsys.readouterr().out.strip().splitlines()[-1]
    assert said == str(plan)
    assert said.startswith("certified")
    assert f"{plan.path.length:.2f} m in {plan.trajectory.duration:.2f} s, closest" in said
    assert "to obstacles[0]" in said
    assert od.certify_path(names["path"], problem).certified
    assert od.certify_path(names["again"].path, problem.starting_at(od.Pose2(1.5, 0.3, 0.3))).certified
    assert (tmp_path / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert od.load_plan("plan.json").status == "certified"
    assert names["t"][-1] == plan.trajectory.duration
    assert names["poses"].shape == (len(names["t"]), 3)
    assert names["twists"].shape == (len(names["t"]), 2)
    assert od.DockPlan.load("plan.json", problem).path.digest == plan.path.digest


def test_every_name_exists_and_is_shown():
    found = {name: getattr(od, name) for name in od.__all__}
    assert dir(od) == sorted([*od.__all__, "__version__"])  # and nothing else: what completion offers
    star = {}
    exec("from optdock import *", star)
    assert {name: star[name] for name in found} == found
    assert od.CasadiSmoother.__name__ == "CasadiSmoother"
    with pytest.raises(AttributeError, match="No optdock attribute plan_duck"):
        od.plan_duck  # noqa: B018


def test_the_stub_tells_type_checkers_the_same_objects():
    """Plugins of other packages by their entry points; all others where the stub says."""
    tree = ast.parse(Path(od.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    told = {alias.name: node.module for node in tree.body if isinstance(node, ast.ImportFrom) for alias in node.names}
    assigned = {node.targets[0].id: ast.unparse(node.value) for node in tree.body if isinstance(node, ast.Assign)}
    assert sorted((*told, *assigned)) == od.__all__
    for name, module in told.items():
        assert getattr(importlib.import_module(f"optdock.{module}"), name) is getattr(od, name)
    for name, where in assigned.items():
        package, _, attribute = where.rpartition(".")
        assert getattr(importlib.import_module(package), attribute) is getattr(od, name)


def in_a_fresh_process(code):
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(code)], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


def test_importing_loads_nothing_heavy_and_names_load_only_what_they_need():
    loaded = in_a_fresh_process(
        """
        import sys
        import optdock as od
        assert not {"numpy", "pydantic", "yaml"} & set(sys.modules), "the import alone"
        dir(od)
        od.Pose2(1.0, 2.0, 0.0), od.DockingProblem, od.OptdockError
        print(*[name for name in ("casadi", "ruckig", "matplotlib", "smoothers", "checkers") if name in sys.modules])
        """
    )
    assert loaded == []


def test_the_core_works_without_the_plugin_packages():
    """They are found by their entry points; where there are none, only their own names are missing."""
    said = in_a_fresh_process(
        """
        import sys
        sys.modules["smoothers"] = sys.modules["checkers"] = None
        import optdock as od
        od.certify_path, od.plan_dock, od.DockPlanner
        try:
            od.CasadiSmoother
        except od.PluginError as error:
            print("CasadiSmoother" in str(error))
        """
    )
    assert said == ["True"]


def small_plan():
    robot = od.Robot(od.Footprint.rectangle(0.3, 0.3, 0.5), od.MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))
    wall = [(-2.0, 0.8), (0.0, 0.8), (0.0, 1.0), (-2.0, 1.0)]
    problem = od.DockingProblem(od.Pose2(-2.0, 0.1, 0.1), od.Dock(od.Pose2(0.0, 0.0, 0.0)), robot, obstacles=[wall])
    return od.plan_dock(problem, time_budget=20.0)


def test_every_value_shows_itself_in_a_line():
    plan = small_plan()
    grid = od.Costmap(np.zeros((40, 60), dtype=np.uint8), 0.05, (-1.0, 0.0))
    values = [
        *(
            plan,
            plan.path,
            plan.raw_path,
            plan.trajectory,
            plan.trajectory.time_law,
            plan.problem,
            plan.as_file(),
            grid,
        ),
        *(*plan.path.segments, *plan.raw_path.segments, plan.path.segments[0].spline),
        *(plan.certificate, plan.trajectory_certificate, plan.problem.robot.footprint, plan.problem.all_obstacles),
    ]
    for value in values:
        assert len(repr(value)) < 240, repr(value)
        assert "array" not in repr(value)
        assert "\n" not in repr(value)
    assert repr(grid) == "<Costmap 60 x 40 cells of 0.05 m from (-1, 0) m>"
    assert "obstacles[0]" in repr(plan.certificate)
    assert len(repr(plan.problem.dock) + repr(plan.problem.robot)) < 900


def test_a_wrong_parameter_of_a_plugin_is_named():
    with pytest.raises(od.InvalidValue, match="CasadiSmoother.max_iteration: unknown parameter; did you mean max_iter"):
        od.CasadiSmoother(max_iteration=20)
