"""Every installed plugin, found through its entry point, keeps the contract of its kind.

The samples below are the observations of layers, the commands of behaviors, and pure numbers.
"""

import re
import subprocess
import sys
import textwrap

import numpy as np
import pytest

from optdock.errors import InvalidValue
from optdock.model.costmap import OccupancyGrid
from optdock.plugins.registry import INTERFACES, available_plugins
from optdock.testing.contracts import CONTRACTS, installed_suites


def feed_map(suite, layer):
    occupancy = np.where(np.random.default_rng(2).random((50, 70)) < 0.1, 100, 0)
    layer.set_map(OccupancyGrid(occupancy, 0.05, (-1.5, -1.2)))


DRIVE = {"target": 1.0, "speed": 0.3}
SAMPLES = {
    "planners.DockPlanner": {"needs_context": True, "unitless": {"step", "alpha", "beta", "gamma"}},
    "planners.ManoeuvrePlanner": {
        "needs_context": True,
        "is_equivariant": False,
        "unitless": {"turning_radius_factor"},
    },
    "smoothers.SimpleSmoother": {"unitless": {"w_data", "w_smooth"}},
    "timing.Windowed": {"unitless": {"cap_ratio", "yaw_share"}},
    "controllers.TrackingController": {"unitless": {"damping"}},
    "controllers.MpcController": {"plugin_parameters": {"steps": 8}, "unitless": {"damping", "steps"}},
    "behaviors.DriveOnHeading": {
        "needs_context": True,
        "command": DRIVE,
        "timed_command": {**DRIVE, "time_allowance": 3.0},
        "bad_commands": ({}, {**DRIVE, "speed": -0.3}, {**DRIVE, "target": 0.0}, {**DRIVE, "target": "far"}),
        "invalid_code": 724,
        "timeout_code": 721,
        "blocked_code": 723,
    },
    "behaviors.BackUp": {
        "needs_context": True,
        "command": DRIVE,
        "timed_command": {**DRIVE, "time_allowance": 3.0},
        "bad_commands": ({}, {**DRIVE, "speed": 0.0}, {**DRIVE, "target": 0.0}),
        "invalid_code": 713,
        "timeout_code": 711,
        "blocked_code": 714,
    },
    "layers.StaticLayer": {"feed": feed_map},
}
globals().update(installed_suites(SAMPLES))


def test_every_installed_plugin_has_a_suite_and_every_kind_a_contract():
    assert set(CONTRACTS) == set(INTERFACES)
    for kind, contract in CONTRACTS.items():
        assert contract.interface is INTERFACES[kind]
    collected = [globals()[name] for name in installed_suites(SAMPLES)]
    assert len(collected) == len(available_plugins()) >= 17
    for suite, info in zip(collected, available_plugins(), strict=True):
        assert issubclass(suite, CONTRACTS[info.kind])
        assert suite.__doc__ == f"{info.kind}: {info.target}."


def test_every_sample_belongs_to_a_plugin_and_has_known_attributes():
    assert set(SAMPLES) <= {f"{info.kind}.{info.name}" for info in available_plugins()}
    with pytest.raises(InvalidValue, match=re.escape("GlobalPlannerContract has no need_context; did you mean needs_")):
        installed_suites({"planners.DockPlanner": {"need_context": True}})


FOREIGN = """
from optdock.plugins.interfaces import GoalChecker, Tolerances

class Always(GoalChecker):
    tolerances = Tolerances()
    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return True

class Near(GoalChecker):
    tolerances = Tolerances(x=0.1, y=0.1)
    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return query_pose.distance_to(goal_pose) < 0.1
"""
JUDGE = """
import sys
sys.path.insert(0, sys.argv[1])
from optdock.testing.contracts import failures, installed_suites
suites = installed_suites()
print("pytest" in sys.modules)
print(failures(suites["TestGoalCheckersNear"]))
print(sorted(failures(suites["TestGoalCheckersAlways"])))
"""


def test_a_plugin_of_another_distribution_is_judged_by_the_same_suite_without_pytest(tmp_path):
    (tmp_path / "foreign.py").write_text(FOREIGN)
    info = tmp_path / "foreign-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[optdock.goal_checkers]\nAlways = foreign:Always\nNear = foreign:Near\n")
    command = [sys.executable, "-c", textwrap.dedent(JUDGE), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == [
        "False",
        "{}",
        "['test_a_robot_elsewhere_has_not_arrived', 'test_reset_clears_every_latch']",
    ]
