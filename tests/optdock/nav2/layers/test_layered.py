import math

import numpy as np
import pytest

from optdock.errors import InvalidValue, LifecycleError, PluginError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import OccupancyGrid
from optdock.nav2.global_costmap import layered_costmap
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.nav2_layer import NOWHERE, joined, outline_bounds
from optdock.nav2.layers.static import StaticLayer
from optdock.plugins.interfaces import Bounds, Layer
from optdock.plugins.lifecycle import LifecycleState

HERE = Pose2(0.5, 0.5, 0.0)
ROBOT = Footprint.rectangle(0.2, 0.2, 0.3)
PLACE = OccupancyGrid(np.full((5, 10), 100), 0.1, (-15.1, 3.0))


class Stamp(Layer):
    """Writes `cost` into its window and records the calls."""

    def __init__(self, cost=7, bounds=None, error=None):
        super().__init__()
        self.cost, self.bounds, self.error = cost, bounds, error
        self.windows, self.seen = [], None

    def reset(self):
        pass

    def update_bounds(self, robot, bounds):
        self.seen = robot, self.state, self.context.name, self.context.footprint
        return self.bounds or bounds

    def update_costs(self, master, min_i, min_j, max_i, max_j):
        self.windows.append((min_i, min_j, max_i, max_j))
        if self.error:
            raise self.error
        master.data[min_j:max_j, min_i:max_i] = self.cost


def test_layers_write_the_whole_grid_in_order_while_they_are_active():
    first, second = Stamp(1), Stamp(2)
    costs = layered_costmap(PLACE, {"first": first, "second": second}, HERE, ROBOT)
    assert (costs.data.shape, costs.resolution, costs.origin) == ((5, 10), 0.1, (-15.1, 3.0))
    assert np.all(costs.data == 2)
    assert not costs.data.flags.writeable
    assert first.windows == second.windows == [(0, 0, 10, 5)]
    assert second.seen == (HERE, LifecycleState.ACTIVE, "second", ROBOT)
    assert (first.state, second.state) == (LifecycleState.UNCONFIGURED,) * 2


@pytest.mark.parametrize(("track", "fill"), [(True, 255), (False, 0)])
def test_cells_that_no_layer_writes_are_unknown_or_free(track, fill):
    layer = DockLayer(enabled=False)
    assert np.all(layered_costmap(PLACE, {"off": layer}, HERE, track_unknown_space=track).data == fill)


@pytest.mark.parametrize("box", [(0.3, 0.3, 0.2, 0.2), (math.nan, -math.inf, math.inf, math.inf)])
def test_a_layer_that_shrinks_the_bounds_is_refused_by_name(box):
    bad = Stamp(bounds=Bounds(*box))
    with pytest.raises(PluginError, match="layer bad: update_bounds must extend"):
        layered_costmap(PLACE, {"good": Stamp(), "bad": bad}, HERE)
    assert bad.state is LifecycleState.UNCONFIGURED


def test_an_error_of_a_layer_leaves_no_layer_active():
    good, bad = Stamp(), Stamp(error=RuntimeError("sensor on fire"))
    with pytest.raises(RuntimeError, match="on fire"):
        layered_costmap(PLACE, {"good": good, "bad": bad}, HERE)
    assert (good.state, bad.state) == (LifecycleState.UNCONFIGURED,) * 2


def test_layers_in_use_or_given_twice_and_other_objects_are_refused():
    fine, used = Stamp(), Stamp()
    used.configure(used.context)
    with pytest.raises(LifecycleError, match="cannot configure"):
        layered_costmap(PLACE, {"fine": fine, "used": used}, HERE)
    assert used.state is LifecycleState.INACTIVE
    with pytest.raises(InvalidValue, match="is given twice"):
        layered_costmap(PLACE, {"a": fine, "b": fine}, HERE)
    for odd in (3, StaticLayer, "static_layer"):
        with pytest.raises(InvalidValue, match=r"costmap\.layers\.odd: must be a Layer, got"):
            layered_costmap(PLACE, {"fine": fine, "odd": odd}, HERE)
    assert fine.state is LifecycleState.UNCONFIGURED


def test_boxes_are_joined_and_hold_outlines():
    box = Bounds(0.0, 0.0, 1.0, 2.0)
    assert joined(box, NOWHERE) == joined(NOWHERE, box) == box
    assert joined(box, Bounds(-1.0, 0.5, 0.5, 3.0)) == (-1.0, 0.0, 1.0, 3.0)
    found = outline_bounds(Footprint.rectangle(0.3, 0.1, 0.2), Pose2(1.0, 2.0, math.pi / 2))
    assert found == pytest.approx((0.9, 1.9, 1.1, 2.3))
