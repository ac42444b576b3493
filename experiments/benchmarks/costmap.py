"""CPU times of maps and costmaps: `python -m experiments.benchmarks costmap`; milliseconds, best of several runs."""

from __future__ import annotations

import argparse
import os
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from optdock.io.maps import load_map
from optdock.model.cell_obstacles import obstacles_from_costmap

if TYPE_CHECKING:
    from collections.abc import Callable


_REPEATS = 7


def best_ms(work: Callable[[], object]) -> float:
    """Return the smallest CPU time of several runs [ms]."""
    times = []
    for _ in range(_REPEATS):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return 1e3 * min(times)


def report_maps(paths: list[str]) -> None:
    """Measure map reading and the conversion of cells to rectangles, for the whole map and its central 6 m x 6 m."""
    print(f"{'map':<42}{'cells':>10}{'read':>8}{'whole':>8}{'pieces':>8}{'6 m':>8}{'pieces':>8}")
    for path in paths:
        costmap = load_map(path).costmap
        middle = (np.array(costmap.lower) + costmap.upper) / 2
        region = (middle - 3.0, middle + 3.0)
        whole, part = obstacles_from_costmap(costmap), obstacles_from_costmap(costmap, region=region)
        read_ms = best_ms(lambda path=path: load_map(path).costmap)
        whole_ms = best_ms(lambda costmap=costmap: obstacles_from_costmap(costmap))
        part_ms = best_ms(lambda costmap=costmap, region=region: obstacles_from_costmap(costmap, region=region))
        print(
            f"{path[-40:]:<42}{costmap.data.size:>10}{read_ms:>8.2f}{whole_ms:>8.2f}{len(whole):>8}"
            f"{part_ms:>8.2f}{len(part):>8}"
        )


def main(arguments: list[str]) -> None:
    """Measure the map YAML files in `arguments`, or the real maps if available."""
    parser = argparse.ArgumentParser(prog="python -m experiments.benchmarks costmap", description=__doc__)
    parser.add_argument("maps", nargs="*", help="map YAML files (default: Nav2's, if available)")
    given = parser.parse_args(arguments).maps
    default = Path(os.environ.get("OPTDOCK_DATA", Path(__file__).resolve().parents[3] / "shared" / "data"))
    paths = given or sorted(str(path) for path in default.glob("nav2/maps/*.yaml"))
    if paths:
        report_maps(paths)


if __name__ == "__main__":
    main(sys.argv[1:])
