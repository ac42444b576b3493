"""The layers keep the contract of the layer interface."""

import numpy as np
import pytest

from optdock.errors import LifecycleError
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.model.costmap import OccupancyGrid
from optdock.model.dock import Dock
from optdock.nav2.layers.dock_layer import DockLayer
from optdock.nav2.layers.static import StaticLayer
from optdock.plugins.lifecycle import PluginContext
from optdock.testing.contracts import LayerContract


class TestStaticLayer(LayerContract):
    def make_plugin(self):
        return StaticLayer(footprint_clearing_enabled=True)

    def feed(self, layer):
        layer.set_map(OccupancyGrid(np.random.default_rng(0).choice([0, 100, -1], (20, 20)), 0.1))


class TestDockLayer(LayerContract):
    def make_plugin(self):
        return DockLayer()

    def feed(self, layer):
        layer.set_dock(Dock(Pose2(1.0, 1.0, 0.3), Footprint.rectangle(0.6, -0.2, 0.5)))


@pytest.mark.parametrize("kind", [StaticLayer, DockLayer])
def test_the_lifecycle_can_be_walked_and_jumps_are_refused(kind):
    layer = kind()
    with pytest.raises(LifecycleError):
        layer.activate()
    layer.configure(PluginContext(name="layer"))
    layer.activate()
    layer.deactivate()
    layer.cleanup()
    layer.shutdown()
    with pytest.raises(LifecycleError):
        layer.configure(PluginContext())
