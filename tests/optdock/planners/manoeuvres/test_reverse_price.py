"""What a metre in reverse is worth: who drives forward instead, and what the price is made of."""

import dataclasses
import math

import numpy as np
import pytest

from optdock.config.scenario import Scenario, load_scenario
from optdock.config.writing import save_scenario
from optdock.errors import InvalidValue, OptdockError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.dock import Dock
from optdock.model.limits import MotionLimits
from optdock.model.problem import DockingProblem
from optdock.model.robot import Robot
from optdock.planners.manoeuvres.price import CUSP_PRICE, least_price, least_prices
from optdock.planning.pipeline import plan_dock

BEYOND = Pose2(2.5, 0.0, 0.0)
ROBOT = Robot(Footprint.rectangle(0.4, 0.3, 0.5), MotionLimits(max_curvature=2.0, max_curvature_rate=8.0))


def problem(price, start=BEYOND, direction="auto"):
    robot = dataclasses.replace(ROBOT, reverse_price=price)
    return DockingProblem(start, Dock(Pose2(0.0, 0.0, 0.0), direction=direction), robot)


def reversing(path):
    return sum(segment.length for segment in path.segments if segment.direction < 0)


@pytest.mark.parametrize("start", [Pose2(0.5, 1.0, 1.5), Pose2(2.0, 1.0, 1.5)])
def test_robot_with_a_price_of_reversing_turns_round(start):
    cheap, dear = (plan_dock(problem(price, start), time_budget=10.0) for price in (0.0, 20.0))
    assert reversing(cheap.path) > 1.0
    assert reversing(dear.path) == 0.0
    assert dear.trajectory.duration > cheap.trajectory.duration


@pytest.mark.parametrize("price", [0.0, 0.5, 3.0])
@pytest.mark.parametrize("start", [Pose2(1.0, 0.8, 2.0), Pose2(2.0, -0.5, -0.3)])
def test_price_is_time_and_stops_and_metres_in_reverse(price, start):
    asked = problem(price, start)
    plan = plan_dock(asked, time_budget=10.0)
    stops = len(plan.path.segments) - 1
    expected = plan.trajectory.duration + CUSP_PRICE * stops + price * reversing(plan.path)
    assert plan.price == pytest.approx(expected)
    assert least_price(plan.path, asked) <= plan.price + 1e-6
    ways = np.array([[segment.direction * segment.length for segment in plan.path.segments]])
    assert least_prices(ways, asked)[0] == pytest.approx(least_price(plan.path, asked))


def test_dock_that_is_entered_backwards_is_entered_backwards_at_any_price():
    plan = plan_dock(problem(50.0, Pose2(2.5, 0.3, 0.2), "backward"), time_budget=5.0)
    assert plan.path.segments[-1].direction == -1


def test_only_a_price_above_zero_makes_another_robot():
    assert dataclasses.replace(ROBOT, reverse_price=0.0).fingerprint == ROBOT.fingerprint
    assert dataclasses.replace(ROBOT, reverse_price=0.1).fingerprint != ROBOT.fingerprint


@pytest.mark.parametrize("price", [-0.1, math.nan, math.inf, "cheap", True])
def test_price_is_a_number(price):
    with pytest.raises(InvalidValue, match=r"robot\.reverse_price"):
        dataclasses.replace(ROBOT, reverse_price=price)


def test_reverse_price_is_a_scenario_key(tmp_path):
    file = tmp_path / "scenario.yaml"
    save_scenario(file, Scenario(problem(0.75)))
    assert "reverse_price: 0.75" in file.read_text()
    assert load_scenario(file).problem.robot.reverse_price == 0.75
    file.write_text(file.read_text().replace("reverse_price: 0.75", "reverse_price: -1"))
    with pytest.raises(OptdockError, match="reverse_price"):
        load_scenario(file)
