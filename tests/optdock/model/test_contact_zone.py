"""The contact zone: cells are free only where the docked robot touches the station."""

import numpy as np
import pytest

from optdock.executor.planning_scene import with_contact_zone
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2, transform_points
from optdock.model.costmap import Costmap
from optdock.model.costs import FREE_SPACE, LETHAL
from optdock.model.dock import Dock, DockDirection


@pytest.mark.parametrize("direction", [DockDirection.FORWARD, DockDirection.BACKWARD])
def test_cells_are_free_where_the_robot_touches_and_nowhere_else(direction):
    robot = Footprint.rectangle(0.3, 0.25, 0.4)  # 0.3 m ahead, 0.25 m behind, 0.4 m wide
    full = Costmap(np.full((60, 60), LETHAL, dtype=np.uint8), 0.05, (-1.5, -1.5))
    dock = Dock(Pose2(0.2, -0.1, 0.4), direction=direction)
    freed = with_contact_zone(full, dock, robot, 0.05)
    cells = np.argwhere(freed.data == FREE_SPACE)[:, ::-1]
    seen = transform_points(dock.pose.inverse().as_array()[None], freed.centre_of(cells))[0]
    front = 0.3 if direction is DockDirection.FORWARD else -0.25
    assert len(cells) > 10
    assert np.abs(seen[:, 0] - front).max() <= 0.076
    assert np.abs(seen[:, 1]).max() <= 0.2 + 0.076
    elsewhere = Dock(Pose2(9.0, 9.0, 0.0), direction=direction)
    assert with_contact_zone(full, elsewhere, robot, 0.05) is full
