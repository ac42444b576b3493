"""The common contract and the goal checkers' contract catch every plugin that breaks a sentence of theirs."""

import itertools
import math

import pytest
from pydantic import ConfigDict, Field

from optdock.errors import InvalidValue
from optdock.plugins.interfaces import GoalChecker, Tolerances
from optdock.plugins.parameters import PluginParameters
from optdock.plugins.registry import INTERFACES
from optdock.testing.contracts import GoalCheckerContract, PluginContract
from optdock.testing.contracts.plugin import (
    ContractBroken,
    refused,
    require,
    require_cancellable,
)


class NearParameters(PluginParameters):
    tolerance: float = Field(0.3, gt=0.0, description="accepted distance [m]")
    yaw_tolerance: float = Field(0.4, gt=0.0, description="accepted heading error [rad]")
    longest: float = Field(1.0, gt=0.0, description="longest remaining path [m]")
    stateful: bool = Field(default=True, description="once reached stays reached")


class Near(GoalChecker):
    Parameters = NearParameters
    parameters: NearParameters

    def __init__(self, **parameters):
        super().__init__(**parameters)
        self._reached = False

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        p = self.parameters
        if self._reached and p.stateful:
            return True
        length = sum(a.distance_to(b) for a, b in itertools.pairwise(path))
        turned = abs(math.remainder(query_pose.yaw - goal_pose.yaw, 2.0 * math.pi))
        near = query_pose.distance_to(goal_pose) < p.tolerance and turned < p.yaw_tolerance
        self._reached = near and length <= p.longest
        return self._reached

    @property
    def tolerances(self):
        p = self.parameters
        return Tolerances(x=p.tolerance, y=p.tolerance, yaw=p.yaw_tolerance, path_length=p.longest)

    def reset(self):
        self._reached = False


def checker(judge, **more):
    return type("Broken", (Near,), {"is_goal_reached": judge, **more})


def nan_axis(self, query_pose, goal_pose, velocity, path):
    if len(path) > 2 and path[-1].distance_to(path[-2]) < 1e-6:
        return float(path[-1].yaw * math.nan) > 0.0
    return Near.is_goal_reached(self, query_pose, goal_pose, velocity, path)


def emptying(self, query_pose, goal_pose, velocity, path):
    reached = Near.is_goal_reached(self, query_pose, goal_pose, velocity, path)
    if isinstance(path, list):
        path.clear()
    return reached


def in_world_axes(self, query_pose, goal_pose, velocity, path):
    return bool(abs(query_pose.x - goal_pose.x) < 0.3 and abs(query_pose.y - goal_pose.y) < 0.01)


def test_every_gate_of_goal_checkers_can_fail(every_gate):
    broken = {
        "test_a_robot_at_rest_at_the_goal_has_arrived": [checker(lambda *_: False), checker(nan_axis)],
        "test_a_robot_elsewhere_has_not_arrived": [
            checker(lambda *_: True),
            checker(lambda self, q, g, v, p: q.distance_to(g) < 0.3),
        ],
        "test_tolerances_are_numbers_or_none": [type("Broken", (Near,), {"tolerances": Tolerances(x=math.nan, y=0.1)})],
        "test_verdicts_are_booleans_and_inputs_stay": [
            checker(emptying),
            type("Broken", (Near,), {"is_goal_xy_reached": lambda *_: False}),
        ],
        "test_reset_clears_every_latch": [type("Broken", (Near,), {"reset": lambda self: None})],
        "test_the_origin_of_the_frame_has_no_influence": [checker(in_world_axes)],
    }
    every_gate(GoalCheckerContract, Near, broken)


class Lax(PluginParameters):
    model_config = ConfigDict(extra="ignore")
    tolerance: float = Field(0.3, gt=0.0, description="[m]")


class Unitless(PluginParameters):
    tolerance: float = Field(0.3, gt=0.0, description="accepted distance")


class Short:
    """A checker of one distance, for other parameters."""

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return query_pose.distance_to(goal_pose) < self.parameters.tolerance

    tolerances = Tolerances()


def with_parameters(model):
    return type("Broken", (Short, GoalChecker), {"Parameters": model})


class Memorizing(Near):
    def on_configure(self):
        self.radius = self.parameters.tolerance

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return query_pose.distance_to(goal_pose) < self.radius


class Clinging(Near):
    def cleanup(self):
        kept = self.context
        super().cleanup()
        self.context = kept


class OnceConfigured(Near):
    seen = False

    def on_cleanup(self):
        self.seen = True

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return self.seen or super().is_goal_reached(query_pose, goal_pose, velocity, path)


class Counting(Near):
    calls = 0

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        self.calls += 1
        return self.calls > 60


class Shared(Near):
    latch = []  # noqa: RUF012 - shared by all instances: the defect

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        found = super().is_goal_reached(query_pose, goal_pose, velocity, path)
        return found or len(self.latch) > 2

    def set_parameters(self, **changes):
        super().set_parameters(**changes)
        self.latch.append(changes)


def test_every_gate_of_all_plugins_can_fail(every_gate):
    one = Near()
    broken = {
        "test_it_is_built_in_one_call": [{"make_plugin": lambda suite: one}, with_parameters(Lax)],
        "test_every_parameter_is_described_with_its_unit": [with_parameters(Unitless)],
        "test_a_change_has_the_effect_of_the_constructor": [Memorizing],
        "test_it_works_at_every_stage": [OnceConfigured, Clinging],
        "test_equal_calls_have_equal_results": [Counting, Shared],
    }
    attributes = {"interface": GoalChecker, "exercise": GoalCheckerContract.exercise}
    every_gate(PluginContract, Near, broken, queries=GoalCheckerContract.queries, **attributes)


def test_a_plugin_of_another_kind_or_without_its_context_is_caught():
    class Misplaced(GoalCheckerContract):
        interface = INTERFACES["smoothers"]

        def make_plugin(self):
            return Near()

    with pytest.raises(ContractBroken, match="it is a Smoother"):
        Misplaced().test_it_is_built_in_one_call()
    Misplaced.needs_context = True
    with pytest.raises(ContractBroken, match="an unconfigured plugin raises an OptdockError"):
        Misplaced().test_it_works_at_every_stage()


def test_rules_hold_break_and_chain():
    require([1], "not empty")
    with pytest.raises(ContractBroken, match="the rule"):
        require(0.0, "the rule")
    assert isinstance(refused(lambda: Near(tolerance=0), InvalidValue, "zero"), InvalidValue)
    with pytest.raises(ContractBroken, match="zero: wanted KeyError, got InvalidValue") as error:
        refused(lambda: Near(tolerance=0), KeyError, "zero")
    assert isinstance(error.value.__cause__, InvalidValue)
    with pytest.raises(ContractBroken, match="wanted KeyError, got the result 3"):
        refused(lambda: 3, KeyError, "three")


def deaf(cancelled):
    for _ in range(150):
        cancelled()


def obedient(cancelled):
    for _ in range(150):
        if cancelled():
            raise KeyError


def late(cancelled):
    if sum(cancelled() for _ in range(150)):
        raise KeyError


def test_a_deaf_a_late_and_a_silent_worker_are_caught():
    for wrong, rule in (
        (deaf, "if poll 1 returns True"),
        (late, "no poll follows"),
        (lambda _: None, "at least once"),
    ):
        with pytest.raises(ContractBroken, match=rule):
            require_cancellable(wrong, KeyError)
    require_cancellable(obedient, KeyError)
