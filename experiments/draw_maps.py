"""Draw the maps of this project as recorded by a simulated laser scanner: a hall, a corridor, a storage.

Walls, pillars and racks are shapes in metres. A laser scanner with 12 m range stands at every stop of a tour. Cells
crossed by a beam are free, the end cell of a beam is occupied, and cells that no beam reaches stay unknown: the inside
of racks and pillars, the niches behind them, the space beyond the walls. Beam ends have noise of 8 mm (standard
deviation), so walls are as rough as in a recorded map. Writes NAME.pgm and NAME.yaml, cells of 5 cm, for map_server.

    python experiments/draw_maps.py [--out experiments/maps] [--seed 1]
"""

from __future__ import annotations

import argparse
import itertools
import math
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from optdock.io.atomic_file import replacing, write_text

RESOLUTION = 0.05  # [m]: cell of the map
FINE = 0.01  # [m]: cell of the drawing
RANGE, BEAMS, ROUGH = 12.0, 1440, 0.008  # [m], beams per turn, range noise [m]
MARGIN = 0.5  # [m] of unknown space around the walls
FREE, UNKNOWN, OCCUPIED = 254, 205, 0  # as written by map_saver


class Place(NamedTuple):
    """Building: solid except for its rooms; rooms contain boxes and round pillars.

    Args:
        rooms: Lower left and upper right corners [m].
        boxes: Corners of walls, racks, pallets, in the same form [m].
        pillars: Centre and radius [m].
        tour: Positions of the scanner [m].
    """

    rooms: list[tuple[float, float, float, float]]
    boxes: list[tuple[float, float, float, float]]
    pillars: list[tuple[float, float, float]]
    tour: list[tuple[float, float]]


PLACES = {
    # Four pillars in two rows, two shelves, a partition, workbenches along the south wall.
    "hall": Place(
        rooms=[(0.0, 0.0, 12.0, 9.0)],
        boxes=[(0.0, 5.6, 2.4, 5.8), (7.2, 7.6, 9.6, 8.2), (5.0, 0.0, 6.6, 0.7), (9.2, 3.9, 9.6, 4.3)],
        pillars=[(3.6, 3.0, 0.2), (3.6, 6.2, 0.2), (7.2, 3.0, 0.2), (7.2, 6.0, 0.2)],
        tour=[
            (1.5, 1.5), (5.5, 1.6), (10.5, 1.5), (1.2, 4.2), (5.4, 4.5), (10.5, 5.2), (1.5, 7.6), (5.5, 7.8),
            (10.8, 8.0),
        ],
    ),
    # 2.4 m wide, with two niches for chargers, a door to a side room, and a cabinet in the way.
    "corridor": Place(
        rooms=[(0.0, 2.0, 16.0, 4.4), (3.0, 4.4, 4.6, 5.6), (10.4, 0.6, 12.0, 2.0), (6.0, 4.4, 8.8, 7.4)],
        boxes=[(6.0, 4.4, 6.8, 4.55), (8.0, 4.4, 8.8, 4.55), (13.2, 2.0, 14.4, 2.5)],
        pillars=[],
        tour=[(1.0, 3.2), (3.8, 3.2), (3.8, 5.0), (7.4, 3.4), (7.4, 6.0), (11.2, 3.2), (11.2, 1.4), (15.0, 3.4)],
    ),
    # Three racks with aisles of 2.6 m, pallets in a bay, a conveyor's end.
    "storage": Place(
        rooms=[(0.0, 0.0, 16.0, 12.0)],
        boxes=[
            (2.6, 2.8, 3.8, 9.2), (6.4, 2.8, 7.6, 9.2), (10.2, 2.8, 11.4, 9.2), (13.6, 10.4, 14.8, 12.0),
            (12.6, 0.0, 13.8, 1.0), (14.8, 0.0, 16.0, 1.0), (4.9, 11.3, 7.2, 12.0),
        ],
        pillars=[(1.2, 10.6, 0.15), (14.8, 6.0, 0.15)],
        tour=[
            (1.3, 1.4), (1.3, 6.0), (1.3, 9.8), (5.1, 1.4), (5.1, 6.0), (5.1, 10.2), (8.9, 1.4), (8.9, 6.0),
            (8.9, 10.4), (12.6, 3.0), (12.9, 6.5), (12.4, 10.6), (14.2, 1.6), (15.4, 9.6),
        ],
    ),
}  # fmt: skip


def solid(place: Place) -> np.ndarray:
    """Return whether each point of a fine grid lies in a wall or an object; rows from the bottom."""
    right, top = (max(room[i] for room in place.rooms) for i in (2, 3))
    x, y = np.meshgrid(*(np.arange(-MARGIN + FINE / 2, end + MARGIN, FINE) for end in (right, top)))
    inside = np.zeros(x.shape, dtype=bool)
    for (x0, y0, x1, y1), value in (*((room, True) for room in place.rooms), *((box, False) for box in place.boxes)):
        inside[(x > x0) & (x < x1) & (y > y0) & (y < y1)] = value
    for px, py, radius in place.pillars:
        inside[np.hypot(x - px, y - py) < radius] = False
    return ~inside


def scanned(world: np.ndarray, tour: list[tuple[float, float]], rng: np.random.Generator) -> np.ndarray:
    """Return the map that a scanner records on its tour; rows from the bottom."""
    cells = [math.ceil(size * FINE / RESOLUTION) for size in world.shape]
    seen, ends = np.zeros(cells, dtype=bool), np.zeros(cells, dtype=int)
    along = np.arange(0.0, RANGE, FINE / 2)
    for (x, y), angle in itertools.product(tour, np.arange(BEAMS) * (2.0 * math.pi / BEAMS)):
        direction = np.array([math.sin(angle), math.cos(angle)])
        points = np.array([y, x]) + MARGIN + along[:, None] * direction
        points = points[((points >= 0.0) & (points < np.array(world.shape) * FINE)).all(axis=1)]
        rows, columns = (points / FINE).astype(int).T
        stop = int(np.argmax(world[rows, columns]))
        if not world[rows[stop], columns[stop]]:
            continue
        rows, columns = (points[:stop] / RESOLUTION).astype(int).T
        seen[rows, columns] = True
        end = points[stop] + rng.normal(0.0, ROUGH) * direction
        ends[tuple((end / RESOLUTION).astype(int))] += 1
    drawn = np.where(seen, FREE, UNKNOWN)
    drawn[ends > 0] = OCCUPIED
    return drawn.astype(np.uint8)


def main() -> None:
    """Draw every map."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--out", type=Path, default=Path(__file__).parent / "maps", help="output directory (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="seed of the range noise (default: %(default)s)")
    options = parser.parse_args()
    for name, place in PLACES.items():
        picture = scanned(solid(place), place.tour, np.random.default_rng(options.seed))
        with replacing(options.out / f"{name}.pgm") as temporary:
            Image.fromarray(picture[::-1]).save(temporary, format="PPM")
        write_text(
            options.out / f"{name}.yaml",
            f"# Drawn by experiments/draw_maps.py.\nimage: {name}.pgm\nmode: trinary\nresolution: {RESOLUTION}\n"
            f"origin: [{-MARGIN}, {-MARGIN}, 0.0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.196\n",
        )
        shares = ", ".join(
            f"{100 * np.mean(picture == grey):.0f} % {kind}"
            for kind, grey in (("free", FREE), ("unknown", UNKNOWN), ("occupied", OCCUPIED))
        )
        print(f"{name}: {picture.shape[1]} x {picture.shape[0]} cells, {shares}")


if __name__ == "__main__":
    main()
