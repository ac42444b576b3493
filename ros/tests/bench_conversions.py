"""What the conversions take, with the classes of `rclpy` or of `rosbags`; bars: 1 M cells 5 ms, 1,000 poses 15 ms.

.venv-ros/bin/python ros/tests/bench_conversions.py
.venv/bin/python ros/tests/bench_conversions.py rosbags
"""

import sys
import time
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import numpy as np

import optdock as od
from optdock import ros
from optdock.ros.bag import bag_types

ROUNDS = 30
T = TypeVar("T")
CELLS, POSES = 5.0, 15.0  # [ms], the bars


class Figure(NamedTuple):
    """A measurement: the fastest round, the median [ms], and their limit."""

    name: str
    fastest: float
    middle: float
    bar: float


def measured(name: str, bar: float, call: Callable[[], T]) -> tuple[Figure, T]:
    """Return the measurement of a call, and its result."""
    spent, result = list[float](), call()
    for _ in range(ROUNDS):
        began = time.perf_counter()
        result = call()
        spent.append(1e3 * (time.perf_counter() - began))
    return Figure(name, min(spent), sorted(spent)[ROUNDS // 2], bar), result


def main() -> int:
    """Print the table; exit with status 1 if a limit is exceeded."""
    types: ros.MessageTypes = bag_types if "rosbags" in sys.argv[1:] else ros.imported
    way = np.linspace(0.0, 3.0, 1000)
    poses = np.column_stack((way, np.sin(way), np.cos(way)))
    grid = od.Costmap(np.random.default_rng(0).integers(0, 256, (1000, 1000)).astype(np.uint8), 0.05)
    figures: list[Figure] = []
    for name, bar, write, read in (
        ("1,000 poses", POSES, lambda: ros.path_message(types, poses, "map", 1.0), ros.path_poses),
        ("1 M cells, Costmap", CELLS, lambda: ros.costmap_message(types, grid, "map", 1.0), ros.costmap),
        ("1 M cells, OccupancyGrid", CELLS, lambda: ros.occupancy_message(types, grid, "map", 1.0), ros.costmap),
    ):
        figure, message = measured(f"write {name}", bar, write)
        figures += [figure, measured(f"read {name}", bar, lambda read=read, message=message: read(message))[0]]
    for figure in figures:
        print(f"{figure.name:32} {figure.fastest:6.2f} ms, median {figure.middle:6.2f} ms, bar {figure.bar:g} ms")
    return int(any(figure.middle > figure.bar for figure in figures))


if __name__ == "__main__":
    sys.exit(main())
