"""Without a problem: what the smoother reads from the costmap is enough, or it is read again."""

import threading

import numpy as np
import pytest

from optdock.costmap.costmap import Costmap
from optdock.errors import FailedToSmoothPath
from optdock.geometry.footprint import Footprint
from optdock.geometry.pose import Pose2
from optdock.interfaces import PluginContext
from optdock.path import Path
from smoothers import casadi_smoother
from smoothers.casadi_smoother import CasadiSmoother
from smoothers.scp.qp_step import pool_of_this_thread

FOOTPRINT = Footprint.rectangle(0.4, 0.4, 0.5)
# The start looks up to the left: the result bulges there, away from the straight input.
RAW = Path.from_poses([Pose2(1.0, 2.0, 0.9), *(Pose2(x, 2.0, 0.0) for x in np.linspace(1.1, 5.0, 40))])


def smoother(costmap):
    made = CasadiSmoother(max_curvature=1.0, max_curvature_rate=4.0)
    made.configure(PluginContext(costmap=costmap, footprint=FOOTPRINT))
    return made


def hall(blocked_from):
    data = np.zeros((120, 140), dtype=np.uint8)
    data[int(blocked_from / 0.05) :, 20:60] = 254
    return Costmap(data, 0.05)


def test_an_obstacle_outside_what_was_read_is_not_driven_into(monkeypatch):
    bulge = smoother(hall(5.9)).smooth(RAW, 10.0).path.sample(0.02).y.max()
    assert bulge > 2.0 + FOOTPRINT.circumscribed_radius - 0.2  # blocking 0.2 m above it lies outside what is read
    monkeypatch.setattr(casadi_smoother, "_READ_AROUND", 0.0)
    with pytest.raises(FailedToSmoothPath, match="map"):
        smoother(hall(bulge + 0.2)).smooth(RAW, 10.0)
    assert smoother(hall(bulge + 0.8)).smooth(RAW, 10.0).completed


def test_a_result_is_covered_within_the_margin_only():
    near = Path.from_poses([Pose2(1.0, 2.0, 0.0), Pose2(5.0, 3.0, 0.0)])
    far = Path.from_poses([Pose2(1.0, 2.0, 0.0), Pose2(5.0, 3.6, 0.0)])
    assert casadi_smoother.covers(RAW, near)
    assert not casadi_smoother.covers(RAW, far)


def test_every_thread_has_programs_of_its_own():
    seen = []
    thread = threading.Thread(target=lambda: seen.append(pool_of_this_thread()))
    thread.start()
    thread.join()
    assert seen[0] is not pool_of_this_thread()
    assert pool_of_this_thread() is pool_of_this_thread()


def test_threads_may_smooth_at_once():
    alone = smoother(hall(5.9)).smooth(RAW, 10.0).path.length
    shared, lengths = smoother(hall(5.9)), []
    threads = [threading.Thread(target=lambda: lengths.append(shared.smooth(RAW, 10.0).path.length)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert lengths == pytest.approx([alone] * 4, abs=1e-9)
