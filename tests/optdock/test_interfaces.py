"""The seam to Nav2: method for method, enumeration for enumeration, error code for error code.

The tables follow Nav2's headers (nav2_core, nav2_costmap_2d::Layer, TimedBehavior) and its action definitions.
"""

import inspect
import re
from enum import IntEnum

import pytest

from optdock import errors
from optdock.errors import OptdockError
from optdock.nav2.behaviors.drive import BackUp, DriveOnHeading
from optdock.plugins import interfaces
from optdock.plugins.interfaces import (
    Behavior,
    BehaviorResult,
    BehaviorStatus,
    Bounds,
    Controller,
    CostmapInfoType,
    DockType,
    GlobalPlanner,
    GoalChecker,
    Layer,
    Plugin,
    PluginContext,
    Smoother,
    SmoothingReport,
    SmoothingResult,
    TimeParameterizer,
    Tolerances,
    never_cancelled,
)
from optdock.plugins.registry import INTERFACES

# Interface, Nav2's method, ours, whether an author must write it, its parameters after self.
METHODS = [
    (Plugin, "getName", "name", False, None),
    (Plugin, "configure", "configure", False, ["context"]),
    (Plugin, "activate", "activate", False, []),
    (Plugin, "deactivate", "deactivate", False, []),
    (Plugin, "cleanup", "cleanup", False, []),
    (GlobalPlanner, "createPlan", "create_plan", True, ["start", "goal", "cancel_checker"]),
    (Smoother, "smooth", "smooth", True, ["path", "max_time", "problem", "warm_start", "cancel_checker"]),
    (Controller, "setPath", "set_path", True, ["path", "start_stamp"]),
    (
        Controller,
        "computeVelocityCommands",
        "compute_velocity_commands",
        True,
        ["pose", "velocity", "goal_checker", "stamp"],
    ),
    (Controller, "setSpeedLimit", "set_speed_limit", True, ["limit", "percentage"]),
    (Controller, "reset", "reset", False, []),
    (Controller, "cancel", "cancel", False, []),
    (Behavior, "getResourceInfo", "resource_info", True, None),
    (Behavior, "onRun", "on_run", True, ["command"]),
    (Behavior, "onCycleUpdate", "on_cycle_update", True, ["pose", "velocity"]),
    (Layer, "updateBounds", "update_bounds", True, ["robot", "bounds"]),
    (Layer, "updateCosts", "update_costs", True, ["master", "min_i", "min_j", "max_i", "max_j"]),
    (Layer, "reset", "reset", True, []),
    (Layer, "isClearable", "is_clearable", False, []),
    (Layer, "matchSize", "match_size", False, []),
    (Layer, "onFootprintChanged", "on_footprint_changed", False, []),
    (Layer, "isCurrent", "is_current", False, []),
    (Layer, "setCurrent", "set_current", False, ["current"]),
    (Layer, "isEnabled", "is_enabled", False, []),
    (GoalChecker, "reset", "reset", False, []),
    (
        GoalChecker,
        "isGoalReached",
        "is_goal_reached",
        True,
        ["query_pose", "goal_pose", "velocity", "path"],
    ),
    (
        GoalChecker,
        "isGoalXYReached",
        "is_goal_xy_reached",
        False,
        ["query_pose", "goal_pose", "velocity", "path"],
    ),
    (GoalChecker, "getTolerances", "tolerances", True, None),
]
# Of ours alone: Nav2 has no time parameterizer, and its docks are asked other questions.
OURS = [(TimeParameterizer, "parameterize"), (DockType, "contact")]


@pytest.mark.parametrize(("interface", "theirs", "ours", "abstract", "parameters"), METHODS)
def test_every_method_of_nav2_has_its_place(interface, theirs, ours, abstract, parameters):
    member = inspect.getattr_static(interface, ours)
    assert (ours in interface.__abstractmethods__) is abstract
    assert snake_case(theirs).removeprefix("get_") == ours
    assert inspect.getdoc(member)
    if parameters is None:
        assert isinstance(member, property)
    else:
        assert list(inspect.signature(member).parameters)[1:] == parameters


def snake_case(name):
    return re.sub(r"([A-Z]+)(?=[A-Z][a-z]|$)|([A-Z])", lambda found: f"_{found[0].lower()}", name)


@pytest.mark.parametrize("interface", INTERFACES.values())
def test_the_abstract_methods_are_those_of_the_table(interface):
    asked = {ours for owner, _, ours, abstract, _ in METHODS if owner is interface and abstract}
    asked |= {ours for owner, ours in OURS if owner is interface}
    assert interface.__abstractmethods__ == asked
    assert issubclass(interface, Plugin)
    with pytest.raises(TypeError, match="abstract"):
        interface()


@pytest.mark.parametrize("interface", INTERFACES.values())
def test_an_interface_has_no_data(interface):
    assert "__init__" not in vars(interface)
    assert set(getattr(interface, "__annotations__", {})) <= set(Plugin.__annotations__)


def minimal(interface):
    """A plugin that writes only what the interface asks for."""
    return type("Minimal", (interface,), dict.fromkeys(interface.__abstractmethods__))()


def test_optional_methods_have_nav2s_defaults():
    controller, layer = minimal(Controller), minimal(Layer)
    assert controller.cancel() is True
    assert controller.reset() is None
    assert layer.is_clearable() is False
    assert layer.is_current() is True
    assert layer.is_enabled() is True
    layer.set_current(False)
    assert layer.is_current() is False
    assert minimal(Layer).is_current() is True
    layer.set_current(True)
    assert layer.is_current() is True
    assert (layer.name, controller.name) == ("Minimal", "Minimal")
    layer.configure(PluginContext(name="obstacles"))
    assert layer.name == "obstacles"
    assert layer.match_size() is layer.on_footprint_changed() is minimal(GoalChecker).reset() is None
    assert never_cancelled() is False


def test_arguments_unknown_to_nav2_are_keyword_only():
    kinds = {name: parameter.kind for name, parameter in inspect.signature(Smoother.smooth).parameters.items()}
    for name in ("problem", "warm_start", "cancel_checker"):
        assert kinds[name] is inspect.Parameter.KEYWORD_ONLY


@pytest.mark.parametrize(
    ("enumeration", "numbers"),
    [
        (CostmapInfoType, {"NONE": 0, "LOCAL": 1, "GLOBAL": 2, "BOTH": 3}),
        (BehaviorStatus, {"SUCCEEDED": 1, "FAILED": 2, "RUNNING": 3}),
    ],
)
def test_enumerations_have_nav2s_numbers(enumeration, numbers):
    assert issubclass(enumeration, IntEnum)
    assert {member.name: int(member) for member in enumeration} == numbers


def test_nav2s_output_arguments_are_results():
    assert SmoothingResult(None).completed is True
    assert SmoothingResult(None).report == SmoothingReport()
    assert BehaviorResult(BehaviorStatus.SUCCEEDED) == BehaviorResult(BehaviorStatus.SUCCEEDED, 0, "")
    assert Bounds._fields == ("min_x", "min_y", "max_x", "max_y")
    assert Tolerances() == (None,) * 6
    assert {"logger", "clock", "costmap", "footprint"} <= set(inspect.signature(PluginContext).parameters)
    assert sorted(interfaces.__all__) == sorted(set(interfaces.__all__))


# Domain: parent of its exceptions with UNKNOWN's code; then Nav2's exception, its code, and ours.
ERRORS = [
    ("PlannerException", 200, "PlannerException", OptdockError),
    ("StartOutsideMapBounds", 203, "StartOutsideMapBounds", errors.PlannerException),
    ("GoalOutsideMapBounds", 204, "GoalOutsideMapBounds", errors.PlannerException),
    ("StartOccupied", 205, "StartOccupied", errors.PlannerException),
    ("GoalOccupied", 206, "GoalOccupied", errors.PlannerException),
    ("PlannerTimedOut", 207, "PlannerTimedOut", errors.PlannerException),
    ("NoValidPathCouldBeFound", 208, "NoValidPathCouldBeFound", errors.PlannerException),
    ("PlannerCancelled", 0, "PlannerCancelled", errors.PlannerException),
    ("ControllerException", 100, "ControllerException", OptdockError),
    ("InvalidPath", 103, "ControllerInvalidPath", errors.ControllerException),
    ("NoValidControl", 106, "NoValidControl", errors.ControllerException),
    ("SmootherException", 500, "SmootherException", OptdockError),
    ("SmootherTimedOut", 502, "SmootherTimedOut", errors.SmootherException),
    ("FailedToSmoothPath", 504, "FailedToSmoothPath", errors.SmootherException),
    ("InvalidPath", 505, "InvalidPath", errors.SmootherException),
    ("DockNotInDB", 901, "DockNotInDB", errors.InvalidValue),
    ("DockNotValid", 902, "DockNotValid", errors.InvalidFile),
]
# PlannerTFError 202, ControllerTFError 102 and the behaviors' TF_ERROR belong to a transform tree, NoViapointsGiven 309
# to planning through poses, InvalidPlanner 201, InvalidController 101 and InvalidSmoother 501 to servers (an unknown
# plugin is a PluginError), PatienceExceeded 104, FailedToMakeProgress 105 and ControllerTimedOut 107 to a server's loop
# and progress checker, TIMEOUT 108 to the client of an action, FAILED_TO_DETECT_DOCK 904 and FAILED_TO_CHARGE 906 to
# sensors: there is none of these here. 903, 905, 907 and 999 are results of Undock.
WITHOUT_COUNTERPART = {101, 102, 104, 105, 107, 108, 201, 202, 309, 501, 904, 906}
# What Nav2 has no exception for; certification answers with the code of a smoothed path in collision, a proof that
# there is no way with that of a planner that found none.
OWN = {
    "BehaviorException": 0,
    "Cancelled": 0,
    "CertificationFailed": 503,
    "FailedToTimePath": 600,
    "InvalidFile": 0,
    "InvalidMessage": 0,
    "InvalidValue": 0,
    "LifecycleError": 0,
    "MissingExtra": 0,
    "NoMotionExists": 208,
    "OptdockError": 0,
    "PluginError": 0,
    "SmootherCancelled": 0,
    "TimedOut": 0,
    "TimingCancelled": 0,
    "TimingTimedOut": 601,
}


@pytest.mark.parametrize(("theirs", "code", "ours", "parent"), ERRORS)
def test_every_exception_carries_nav2s_code(theirs, code, ours, parent):
    error = getattr(errors, ours)
    assert error.code == code
    assert error.__bases__[0] is parent
    assert set(error.__bases__[1:]) <= {errors.TimedOut, errors.Cancelled}
    assert ours.endswith(theirs)
    assert inspect.getdoc(error)


def test_no_exception_is_left_out_of_the_tables():
    exported = {name for name in errors.__all__ if issubclass(getattr(errors, name), Exception)}
    assert exported == set(errors.__all__) == {ours for _, _, ours, _ in ERRORS} | set(OWN)
    assert {name: getattr(errors, name).code for name in OWN} == OWN
    assert not WITHOUT_COUNTERPART & {getattr(errors, name).code for name in errors.__all__}


def test_one_except_clause_catches_every_error_of_ours():
    for name in errors.__all__:
        assert issubclass(getattr(errors, name), OptdockError)
    assert issubclass(errors.InvalidValue, ValueError)
    assert issubclass(errors.SmootherCancelled, errors.SmootherException)


def test_an_error_has_a_place():
    error = errors.GoalOccupied("too close", where={"s": 1.5})
    assert (str(error), error.code, error.where, error.partial) == ("too close", 206, {"s": 1.5}, None)
    where = {"s": 1.0}
    kept = OptdockError("x", where=where)
    where["s"] = 2.0
    assert kept.where == {"s": 1.0}
    assert OptdockError("x").where == {}


# Nav2: UNKNOWN, TIMEOUT, COLLISION_AHEAD, INVALID_INPUT; a code that Nav2 lacks is UNKNOWN's.
def test_behaviors_have_nav2s_codes():
    assert (BackUp.codes, DriveOnHeading.codes) == ((710, 711, 714, 713), (720, 721, 723, 724))
    assert BackUp.codes._fields == ("unknown", "timeout", "collision_ahead", "invalid_input")
