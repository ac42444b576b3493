"""Plugins: parameters, lifecycle, lookup by entry point, also from a foreign distribution."""

import itertools
import pathlib
import subprocess
import sys
import textwrap
from enum import Enum

import pytest
from pydantic import ConfigDict, Field, PrivateAttr

import checkers
from optdock.errors import InvalidValue, LifecycleError, PluginError
from optdock.plugins.interfaces import GoalChecker, LifecycleState, Smoother, Tolerances
from optdock.plugins.lifecycle import Plugin, PluginContext
from optdock.plugins.parameters import PluginParameters, parse_parameters
from optdock.plugins.registry import INTERFACES, available_plugins, create_plugin, load_plugin


class NearParameters(PluginParameters):
    tolerance: float = Field(0.1, gt=0.0)
    cycles: int = 3
    loud: bool = False


class Near(GoalChecker):
    Parameters = NearParameters
    parameters: NearParameters

    def is_goal_reached(self, query_pose, goal_pose, velocity, path):
        return query_pose.distance_to(goal_pose) < self.parameters.tolerance

    @property
    def tolerances(self):
        return Tolerances(x=self.parameters.tolerance, y=self.parameters.tolerance)

    def check_change(self, changed):
        if changed.cycles == 13:
            raise InvalidValue("cycles: 13 is refused while running")

    def on_configure(self):
        if self.context.name == "broken":
            raise InvalidValue("cannot be configured")


class ListedParameters(PluginParameters):
    names: list[str] = Field(default_factory=list)


def test_immutable_parameters_are_validated_once_and_mutable_ones_are_not_shared():
    values = {"tolerance": 0.2, "cycles": 4}
    first = parse_parameters(NearParameters, values, "Near")
    assert parse_parameters(NearParameters, dict(values), "Near") is first
    assert parse_parameters(NearParameters, {"tolerance": 0.2, "cycles": 5}, "Near").cycles == 5
    with pytest.raises(InvalidValue, match="cycles: must be a number"):
        parse_parameters(NearParameters, {"tolerance": 0.2, "cycles": True}, "Near")
    mine, other = (parse_parameters(ListedParameters, {}, "Listed") for _ in range(2))
    mine.names.append("mine")
    assert other.names == parse_parameters(ListedParameters, {}, "Listed").names == []


class Gear(Enum):
    FORWARD = 1
    REVERSE = -1

    def __repr__(self):
        return "a gear"


class GearParameters(PluginParameters):
    gear: Gear = Gear.FORWARD


class OpenParameters(PluginParameters):
    model_config = ConfigDict(frozen=False)
    cycles: int = 3


class RememberingParameters(PluginParameters):
    _seen: list[str] = PrivateAttr(default_factory=list)


class NumberedParameters(PluginParameters):
    number: int = Field(default_factory=itertools.count().__next__)


def test_parameters_that_are_not_constant_are_not_shared():
    for gear in Gear:
        assert parse_parameters(GearParameters, {"gear": gear}, "Gear").gear is gear
    mine, other = (parse_parameters(OpenParameters, {}, "Open") for _ in range(2))
    mine.cycles = 7
    assert other.cycles == 3
    mine, other = (parse_parameters(RememberingParameters, {}, "Remembering") for _ in range(2))
    mine._seen.append("mine")
    assert other._seen == []
    assert len({parse_parameters(NumberedParameters, {}, "Numbered").number for _ in range(3)}) == 3


def test_parameters_have_defaults_and_are_checked_all_at_once():
    assert Near().parameters == NearParameters(tolerance=0.1, cycles=3)
    with pytest.raises(InvalidValue) as error:
        Near(tolerance=-1.0, cycles="many", tolerancce=2)
    text = str(error.value)
    assert "Near.tolerance" in text
    assert "Near.cycles" in text
    assert "Near.tolerancce: unknown parameter; did you mean tolerance?" in text


@pytest.mark.parametrize("bad", [float("nan"), float("inf"), None, "wide", True])
def test_a_number_is_a_finite_number(bad):
    with pytest.raises(InvalidValue, match="Near.tolerance"):
        Near(tolerance=bad)


@pytest.mark.parametrize("bad", ["0.5", b"0.5", "1e-3", "true"])
def test_text_is_no_number_and_no_switch(bad):
    with pytest.raises(InvalidValue, match=r"Near.tolerance: must be a number \(got "):
        Near(tolerance=bad)
    with pytest.raises(InvalidValue, match=r"Near.cycles: must be a number \(got "):
        Near().set_parameters(cycles=bad)
    with pytest.raises(InvalidValue, match=r"Near.loud: must be true or false \(got "):
        Near(loud=bad)


@pytest.mark.parametrize("bad", [0, 1, 1.0])
def test_a_number_is_no_switch(bad):
    with pytest.raises(InvalidValue, match=r"Near.loud: must be true or false \(got "):
        Near(loud=bad)


def test_integers_and_integral_floats_are_interchangeable():
    assert Near(tolerance=1, cycles=4.0).parameters == NearParameters(tolerance=1.0, cycles=4)
    with pytest.raises(InvalidValue, match="Near.cycles"):
        Near(cycles=4.5)


@pytest.mark.parametrize("name", ["self", 3, "class", "", "a b"])
def test_any_name_that_a_file_may_hold_is_refused_by_name(name):
    with pytest.raises(InvalidValue, match=f"SimpleGoalChecker.{name}: unknown parameter"):
        create_plugin(GoalChecker, "SimpleGoalChecker", {name: 1})


def test_self_is_an_unknown_parameter():
    with pytest.raises(InvalidValue, match="self: unknown parameter"):
        Near().set_parameters(**{"self": 1})


@pytest.mark.parametrize("bad", [3, [("tolerance", 1.0)], "tolerance"])
def test_parameters_are_a_mapping(bad):
    with pytest.raises(InvalidValue, match="parameters must be a mapping of names to values"):
        create_plugin(GoalChecker, "SimpleGoalChecker", bad)


@pytest.mark.parametrize("name", [None, 3, ["AxisGoalChecker"]])
def test_a_name_that_is_no_text_is_refused(name):
    with pytest.raises(PluginError, match="goal_checkers: a plugin's name must be text"):
        load_plugin(GoalChecker, name)


def test_parameters_change_all_or_nothing():
    checker = Near()
    checker.set_parameters(tolerance=0.3, cycles=4)
    assert checker.parameters == NearParameters(tolerance=0.3, cycles=4)
    for changes in ({"tolerance": 0.5, "cycles": "x"}, {"tolerance": 0.5, "cycles": 13}, {"nonsense": 1}):
        with pytest.raises(InvalidValue):
            checker.set_parameters(**changes)
        assert checker.parameters == NearParameters(tolerance=0.3, cycles=4)


ALLOWED = {
    LifecycleState.UNCONFIGURED: {"configure": LifecycleState.INACTIVE, "shutdown": LifecycleState.FINALIZED},
    LifecycleState.INACTIVE: {
        "activate": LifecycleState.ACTIVE,
        "cleanup": LifecycleState.UNCONFIGURED,
        "shutdown": LifecycleState.FINALIZED,
    },
    LifecycleState.ACTIVE: {"deactivate": LifecycleState.INACTIVE, "shutdown": LifecycleState.FINALIZED},
    LifecycleState.FINALIZED: {},
}
ROUTES = {
    LifecycleState.UNCONFIGURED: (),
    LifecycleState.INACTIVE: ("configure",),
    LifecycleState.ACTIVE: ("configure", "activate"),
    LifecycleState.FINALIZED: ("shutdown",),
}


def call(plugin, transition):
    if transition == "configure":
        plugin.configure(PluginContext(name="near"))
    else:
        getattr(plugin, transition)()


@pytest.mark.parametrize("state", list(LifecycleState))
@pytest.mark.parametrize("transition", ["configure", "activate", "deactivate", "cleanup", "shutdown"])
def test_every_transition_is_allowed_or_refused_as_in_the_table(state, transition):
    plugin = Near()
    for step in ROUTES[state]:
        call(plugin, step)
    assert plugin.state is state
    if transition in ALLOWED[state]:
        call(plugin, transition)
        assert plugin.state is ALLOWED[state][transition]
    else:
        with pytest.raises(LifecycleError, match=f"cannot {transition} when {state.value}"):
            call(plugin, transition)
        assert plugin.state is state


def test_a_failed_configuration_leaves_the_plugin_as_it_was():
    plugin = Near()
    before = plugin.context
    with pytest.raises(InvalidValue):
        plugin.configure(PluginContext(name="broken"))
    assert plugin.state is LifecycleState.UNCONFIGURED
    assert plugin.context is before


@pytest.mark.parametrize("release", ["cleanup", "shutdown"])
def test_cleanup_and_shutdown_release_the_context(release):
    plugin, context = Near(), PluginContext(name="near")
    plugin.configure(context)
    getattr(plugin, release)()
    assert plugin.context is not context


def test_configure_requires_a_context():
    plugin = Near()
    with pytest.raises(InvalidValue, match="Near: configure needs a PluginContext, got None"):
        plugin.configure(None)
    assert plugin.state is LifecycleState.UNCONFIGURED


def test_every_listed_plugin_is_a_subclass_of_its_interface():
    listed = available_plugins()
    assert {info.kind for info in listed} <= set(INTERFACES)
    for info in listed:
        assert issubclass(load_plugin(INTERFACES[info.kind], info.name), INTERFACES[info.kind])


@pytest.mark.parametrize(
    "name", ["AxisGoalChecker", "nav2_controller::AxisGoalChecker", "nav2_controller/AxisGoalChecker"]
)
def test_nav2_names_find_our_plugins(name):
    assert load_plugin(GoalChecker, name).__name__ == "AxisGoalChecker"


def test_an_unknown_plugin_is_refused_with_the_nearest_name():
    with pytest.raises(
        PluginError, match="goal_checkers: unknown plugin 'AxisGoalCheker'; did you mean AxisGoalChecker"
    ):
        load_plugin(GoalChecker, "AxisGoalCheker")
    with pytest.raises(PluginError, match="unknown plugin 'AxisGoalChecker'"):
        load_plugin(Smoother, "AxisGoalChecker")


def test_an_unknown_interface_is_refused():
    with pytest.raises(PluginError, match="must be one of"):
        load_plugin(Plugin, "x")


def test_parameters_reach_the_plugin():
    with pytest.raises(InvalidValue, match="unknown parameter; did you mean along_path_tolerance"):
        create_plugin(GoalChecker, "AxisGoalChecker", {"along_path_tolerence": 0.2})
    assert create_plugin(GoalChecker, "AxisGoalChecker", {"along_path_tolerance": 0.2}).tolerances.x == 0.2


def foreign_distribution(folder):
    """An installed distribution as the import system sees one: a module and its metadata."""
    (folder / "foreign.py").write_text(
        textwrap.dedent(
            """
            from optdock.plugins.interfaces import GoalChecker, Tolerances

            class Always(GoalChecker):
                tolerances = Tolerances()
                def is_goal_reached(self, query_pose, goal_pose, velocity, path):
                    return True

            class NotAChecker:
                pass

            class Half(GoalChecker):
                tolerances = Tolerances()

            class Sulking(Always):
                def __init__(self, **parameters):
                    raise RuntimeError("not today")
            """
        )
    )
    (folder / "broken_foreign.py").write_text("import a_module_that_does_not_exist\n")
    (folder / "leaving_foreign.py").write_text("raise SystemExit('good-bye')\n")
    info = folder / "foreign-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: foreign\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[optdock.goal_checkers]\nAlways = foreign:Always\nNot = foreign:NotAChecker\nBroken = broken_foreign:X\n"
        "Gone = foreign:Missing\nHalf = foreign:Half\nSulking = foreign:Sulking\nLeaving = leaving_foreign:X\n"
    )


def run(folder, code):
    script = f"import sys; sys.path.insert(0, {str(folder)!r})\n" + textwrap.dedent(code)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)


def test_a_plugin_of_another_distribution_is_found_loaded_and_named_in_errors(tmp_path):
    foreign_distribution(tmp_path)
    done = run(
        tmp_path,
        """
        from optdock.errors import PluginError
        from optdock.geometry.pose import Pose2, Twist2
        from optdock.plugins.interfaces import GoalChecker
        from optdock.plugins.registry import available_plugins, create_plugin
        print([info.target for info in available_plugins() if info.name == "Always"])
        checker = create_plugin(GoalChecker, "Always")
        print(checker.is_goal_reached(Pose2(0, 0, 0), Pose2(1, 0, 0), Twist2(), []))
        for name in ("Not", "Broken", "Gone", "Half", "Sulking", "Leaving"):
            try:
                create_plugin(GoalChecker, name)
            except PluginError as error:
                print(error)
        """,
    )
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0] == "['foreign:Always']"
    assert lines[1] == "True"
    assert lines[2] == "goal_checkers: plugin Not (foreign:NotAChecker) is not a GoalChecker"
    assert lines[3].startswith("goal_checkers: plugin Broken (broken_foreign:X) cannot be imported: No module named")
    assert lines[4].startswith("goal_checkers: plugin Gone (foreign:Missing) cannot be imported")
    assert lines[5].startswith("plugin Half (foreign:Half) cannot be built: Can't instantiate abstract class Half")
    assert lines[6] == "plugin Sulking (foreign:Sulking) cannot be built: not today"
    assert lines[7] == "goal_checkers: plugin Leaving (leaving_foreign:X) cannot be imported: good-bye"


@pytest.mark.parametrize(
    ("name", "content"),
    [("checkers/__init__.py", ""), ("checkers/axis.py", "class AxisGoalChecker: pass"), ("checkers.py", "")],
)
def test_a_folder_next_to_the_script_that_hides_the_plugins_is_named(tmp_path, name, content):
    hiding = tmp_path / name.split("/")[0]
    if hiding.suffix != ".py":
        hiding.mkdir()
        (hiding / "__init__.py").touch()
    (tmp_path / name).write_text(content)
    done = run(
        tmp_path, "import optdock; from optdock.plugins.registry import plugin_class; plugin_class('AxisGoalChecker')"
    )
    what = "file" if hiding.suffix else "folder"
    place = pathlib.Path(checkers.__file__).parent
    said = f"; the {what} {hiding} hides the package {place}: rename that {what}, or start Python elsewhere"
    assert done.stderr.strip().endswith(said)
    assert "PluginError: goal_checkers: plugin AxisGoalChecker (checkers.axis:AxisGoalChecker)" in done.stderr


def test_a_folder_that_hides_nothing_is_not_named(tmp_path):
    foreign_distribution(tmp_path)
    (tmp_path / "checkers").mkdir()  # no package: Python goes on to the installed one
    done = run(
        tmp_path, "from optdock.plugins.registry import plugin_class; print(plugin_class('AxisGoalChecker').__module__)"
    )
    assert done.stdout == "checkers.axis\n"
    done = run(tmp_path, "from optdock.plugins.registry import plugin_class; plugin_class('Broken')")
    assert "hides the package" not in done.stderr


def test_two_plugins_of_one_name_are_refused(tmp_path):
    foreign_distribution(tmp_path)
    other = tmp_path / "other-1.0.dist-info"
    other.mkdir()
    (other / "METADATA").write_text("Metadata-Version: 2.1\nName: other\nVersion: 1.0\n")
    (other / "entry_points.txt").write_text("[optdock.goal_checkers]\nAlways = elsewhere:Always\n")
    done = run(
        tmp_path,
        """
        from optdock.plugins.interfaces import GoalChecker
        from optdock.plugins.registry import load_plugin
        load_plugin(GoalChecker, "AxisGoalChecker")
        """,
    )
    assert "two plugins are named Always" in done.stderr
