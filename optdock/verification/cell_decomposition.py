"""The search for a proof that no motion exists: approximate cell decomposition, refined where a route is left.

What such a proof is, and why it is one, stands in `impossibility`. Here tiles of cells are made until no route from
start to goal is left, one is found that is wide open, or time is up ([BrooksLozanoPerez1985], [ZhangKimManocha2008]):

    1. The plane is a quadtree of tiles. Of a tile that nobody has looked at everything counts as free.
    2. A tile that was looked at falls into blocked cells, cells that look open, and narrow ones between. Connected
       cells of one kind are one node of a graph.
    3. The cheapest route through the graph is the one through the fewest narrow and unseen tiles. These are split.

How a tile looks is a matter of a few milliseconds: its cells share one lattice of distances from the obstacles, and
every disc of the body at every heading reads it shifted by whole nodes.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optdock.deadline import Deadline, OutOfTime, never_late
from optdock.geometry.pose import transform_points
from optdock.verification.impossibility import (
    CELLS,
    SLACK,
    Bottleneck,
    ImpossibilityProof,
    least_required,
)
from optdock.verification.proximity import end_clearances

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from optdock.geometry.arrays import BoolArray, FloatArray, IntArray
    from optdock.geometry.footprint import Footprint
    from optdock.geometry.pose import Pose2
    from optdock.problem import DockingProblem

__all__ = ["prove_impossible"]

_FINEST = 4  # level of the finest tiles
_REACH = 0.7  # of a cell's turn: points at this share of the body's reach move as far by it as by half a cell's side
# Half a cell of level 0, as a share of the largest disc's radius: cells of level 0 must be able to close a thin wall.
_CELL = 0.27
_FIT = 0.03  # of the largest disc's radius: how far the body may stick out of its discs
_SMALLER = 0.6  # from one disc in a corner to the next
_LARGEST = 6  # levels of unseen tiles above level 0
_GATHERED = 250_000  # distances read in one go, less than a millisecond
_OPEN = 1e-6  # the cost of a node that looks open, or lies outside: of two routes that are open the shorter
_SEEN_FROM = 30.0  # [m]: obstacles further from start and goal widen no tile


def prove_impossible(
    problem: DockingProblem, *, time_budget: float = 1.0, cancel_checker: Callable[[], bool] = never_late
) -> ImpossibilityProof | None:
    """Try to prove that no motion of any kind joins start and goal, reversing and turning in place included.

    Args:
        problem: From where, to where, with what, among what.
        time_budget: Wall-clock seconds; the call returns at most some milliseconds later.
        cancel_checker: Asked as often; True ends the search.

    Returns:
        The proof; or None: there may be a motion, or the time was too short. `check_impossibility` judges it.
    """
    deadline = Deadline(time_budget, stop=cancel_checker)
    if len(problem.all_obstacles) == 0:
        return None
    try:
        search = _Search(problem, deadline)
        while not search.is_closed():
            if not search.refine():
                return None
    except OutOfTime:
        return None
    return search.proof(None)


class _Body(NamedTuple):
    """A footprint as discs within it: centre (2,) in its frame, discs (n, 3), reach from the centre [m]."""

    centre: FloatArray
    discs: FloatArray
    reach: float


@functools.lru_cache(maxsize=16)
def _body(footprint: Footprint) -> _Body:
    """Few discs that fill a footprint but for `_FIT`: each covers as much of the outline, to that, as is left."""
    outline = footprint.vertices
    centre = 0.5 * (outline.min(axis=0) + outline.max(axis=0))
    outline = outline - centre
    reach = float(np.hypot(*outline.T).max())
    step = np.linspace(-reach, reach, 61)
    points = np.stack(np.meshgrid(step, step), axis=-1).reshape(-1, 2)
    points = np.vstack((points, 0.0 * points[:1]))
    radius = _depth(points, outline)
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    largest = radius.max() if radius.size else 0.0
    # Into every corner, ever smaller ones: along the line from the corner on which the depth grows fastest.
    along = points[:, None] - outline
    steep = radius[:, None] / np.hypot(along[..., 0], along[..., 1])
    inward = along[steep.argmax(axis=0), np.arange(len(outline))]
    shares = _SMALLER ** np.arange(1, 12)
    corners = (outline[:, None] + shares[:, None] * inward[:, None]).reshape(-1, 2)
    points = np.vstack((points, corners))
    radius = np.concatenate((radius, _depth(corners, outline)))
    points, radius = points[radius > 0.0], radius[radius > 0.0]
    ends = np.roll(outline, -1, axis=0)
    share = np.linspace(0.0, 1.0, 40, endpoint=False)[:, None, None]
    samples = (outline + share * (ends - outline)).reshape(-1, 2)
    gap = np.hypot(*(samples[:, None] - points).transpose(2, 0, 1)) - radius
    covers = gap <= _FIT * largest
    covers[np.arange(len(samples)), gap.argmin(axis=1)] = True
    left, chosen = np.ones(len(samples), dtype=np.bool_), [int(radius.argmax())]
    left &= ~covers[:, chosen[0]]
    while left.any():
        chosen.append(int(covers[left].sum(axis=0).argmax()))
        left &= ~covers[:, chosen[-1]]
    return _Body(centre, np.column_stack((points, radius))[chosen], reach)


def _depth(points: FloatArray, outline: FloatArray) -> FloatArray:
    """How deep points lie in a polygon, Shape (n,) [m]; not above 0 outside."""
    start, edge = outline, np.roll(outline, -1, axis=0) - outline
    to = points[:, None] - start
    along = np.clip((to * edge).sum(axis=2) / (edge * edge).sum(axis=1), 0.0, 1.0)
    distance = np.hypot(*(to - along[..., None] * edge).transpose(2, 0, 1)).min(axis=1)
    end = np.roll(outline, -1, axis=0)
    crosses = (start[:, 1] > points[:, 1:]) != (end[:, 1] > points[:, 1:])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = start[:, 0] + (points[:, 1:] - start[:, 1]) / edge[:, 1] * edge[:, 0]
    inside = (crosses & (points[:, :1] < at)).sum(axis=1) % 2 == 1
    found: FloatArray = np.where(inside, distance - 1e-9, -distance)
    return found


class _Grid(NamedTuple):
    """Cells of every level: see `ImpossibilityProof`."""

    origin: FloatArray
    cell: float
    headings: int

    def half(self, level: int) -> float:
        return self.cell * 0.5**level

    def side(self, level: int) -> float:
        return 2.0 * CELLS * self.half(level)

    def count(self, level: int) -> int:
        return self.headings << level


class _Tile(NamedTuple):
    """One tile of the quadtree.

    `labels`: the node of every cell, -1 in blocked ones, Shape (headings, n, n); of an unseen tile (1, 1, 1).
    `margin`: clearance above what is required at the middle of the cells, about [m], likewise; None of an unseen one.
    """

    level: int
    column: int
    row: int
    labels: IntArray
    margin: NDArray[np.float32] | None


class _Obstacles:
    """Obstacles in the frame of the tiles, for distances of lattice nodes from them."""

    def __init__(self, problem: DockingProblem, origin: FloatArray) -> None:
        everything = problem.all_obstacles
        self.normals, self.vertices = everything.normals, everything.vertices - origin
        self.offsets = (self.normals * self.vertices).sum(axis=2)
        self.lower, self.upper = everything.lower - origin, everything.upper - origin
        corner = (self.vertices == self.lower[:, None]) | (self.vertices == self.upper[:, None])
        x, y = self.vertices[..., 0], self.vertices[..., 1]
        area = 0.5 * np.abs((x * np.roll(y, -1, axis=1) - np.roll(x, -1, axis=1) * y).sum(axis=1))
        full = np.prod(self.upper - self.lower, axis=1)
        self.is_box = corner.all(axis=(1, 2)) & (area > 0.75 * full)
        starts, ends = self.vertices.reshape(-1, 2), np.roll(self.vertices, -1, axis=1).reshape(-1, 2)
        kept = (starts != ends).any(axis=1)
        self.starts, self.along = starts[kept], (ends - starts)[kept]
        self.low, self.high = np.minimum(starts, ends)[kept], np.maximum(starts, ends)[kept]

    def distances(self, corner: FloatArray, step: float, count: int) -> NDArray[np.float32]:
        """Upper bounds of the distances of nodes from the obstacles, Shape (count, count), rows along y [m].

        Every node is measured against a point of an obstacle near the node that is nearest among those near obstacles.

        Args:
            corner: The first node [m].
            step: Between nodes [m].
            count: Nodes along each side; what lies further out is left out.
        """
        from scipy import ndimage

        extent = step * (count - 1)
        inside = self._inside(corner, step, count)
        points = self._samples(corner, extent, 0.5 * step)
        node = np.rint(points / step).astype(np.int64)
        at_x, at_y = np.meshgrid(step * np.arange(count), step * np.arange(count))
        point_x, point_y = at_x.copy(), at_y.copy()
        point_x[node[:, 1], node[:, 0]], point_y[node[:, 1], node[:, 0]] = points.T
        none = ~inside
        none[node[:, 1], node[:, 0]] = False
        if none.all():
            return np.full((count, count), np.inf, dtype=np.float32)
        row, column = ndimage.distance_transform_edt(none, return_distances=False, return_indices=True)
        nearest = row * count + column
        found = np.hypot(at_x - point_x.take(nearest), at_y - point_y.take(nearest))
        found[inside] = 0.0
        single: NDArray[np.float32] = found.astype(np.float32)
        return single

    def _inside(self, corner: FloatArray, step: float, count: int) -> BoolArray:
        """Which nodes lie in an obstacle."""
        first = np.ceil(np.clip((self.lower - corner) / step, 0, count)).astype(np.int64)
        stop = np.floor(np.clip((self.upper - corner) / step, -1, count - 1)).astype(np.int64) + 1
        met = (stop > first).all(axis=1)
        boxes = np.flatnonzero(met & self.is_box)
        change = np.zeros((count + 1, count + 1), dtype=np.int32)
        for y, x, sign in ((first, first, 1), (first, stop, -1), (stop, first, -1), (stop, stop, 1)):
            np.add.at(change, (y[boxes, 1], x[boxes, 0]), sign)
        inside: BoolArray = change.cumsum(axis=0).cumsum(axis=1)[:-1, :-1] > 0
        for k in np.flatnonzero(met & ~self.is_box).tolist():
            (i0, j0), (i1, j1) = first[k], stop[k]
            x, y = corner[0] + step * np.arange(i0, i1), corner[1] + step * np.arange(j0, j1)
            part = np.ones((j1 - j0, i1 - i0), dtype=np.bool_)
            for (nx, ny), offset in zip(self.normals[k], self.offsets[k], strict=True):
                part &= ny * y[:, None] + nx * x <= offset
            inside[j0:j1, i0:i1] |= part
        return inside

    def _samples(self, corner: FloatArray, extent: float, spacing: float) -> FloatArray:
        """Points of the outlines within a square, at most `spacing` apart, from its corner. Shape (n, 2) [m]."""
        rows = np.flatnonzero(((self.low <= corner + extent) & (self.high >= corner)).all(axis=1))
        start, along = self.starts[rows] - corner, self.along[rows]
        with np.errstate(divide="ignore", invalid="ignore"):
            first, second = -start / along, (extent - start) / along
        still = along == 0.0
        enter = np.where(still, 0.0, np.minimum(first, second)).max(axis=1, initial=0.0)
        leave = np.where(still, 1.0, np.maximum(first, second)).min(axis=1, initial=1.0)
        kept = enter <= leave
        enter, leave, start, along = enter[kept], leave[kept], start[kept], along[kept]
        number = np.ceil((leave - enter) * np.hypot(*along.T) / spacing).astype(np.int64) + 1
        edge = np.repeat(np.arange(number.size), number)
        place = (np.arange(edge.size) - np.repeat(np.cumsum(number) - number, number)) / np.maximum(number - 1, 1)[edge]
        share = enter[edge] + place * (leave - enter)[edge]
        points: FloatArray = np.clip(start[edge] + share[:, None] * along[edge], 0.0, extent)
        return points


class _Search:
    """The tiles so far, and the graph of what is free in them."""

    def __init__(self, problem: DockingProblem, deadline: Deadline) -> None:
        self.problem, self.deadline = problem, deadline
        self.body = _body(problem.robot.footprint)
        self.start_clearance = end_clearances(problem).start
        cell = _CELL * float(self.body.discs[:, 2].max())
        headings = max(8, math.ceil(math.pi * _REACH * self.body.reach / cell))
        lower, upper = self._extent(cell)
        side = 2.0 * CELLS * cell
        self.above = int(np.clip(math.ceil(math.log2(max(float((upper - lower).max()) / side, 1.0))), 0, _LARGEST))
        self.grid = _Grid(0.5 * (lower + upper) - 0.5 * side * 2**self.above, cell, headings)
        self.obstacles = _Obstacles(problem, self.grid.origin)
        self.tiles: dict[int, _Tile] = {}
        self.key = 0
        self.tile_at = np.full((2 ** (self.above + _FINEST),) * 2, -1, dtype=np.int64)
        # Node 0 is the outside, 1 the start, 2 the goal.
        self.cost, self.tile_of = [_OPEN] * 3, [-1] * 3
        self.joints: dict[tuple[int, int], IntArray] = {}
        self.ends = [
            _middle_of(pose, self.body.centre) - (*self.grid.origin, 0.0) for pose in (problem.start, problem.goal)
        ]
        self.route: list[int] = []
        self._add([self._unseen(-self.above, 0, 0)])

    def _extent(self, cell: float) -> tuple[FloatArray, FloatArray]:
        """Corners of what tiles must cover: both ends, and obstacles as far as they may matter [m]."""
        ends = np.array([[end.x, end.y] for end in (self.problem.start, self.problem.goal)])
        near = self.body.reach + float(np.hypot(*self.body.centre)) + self.problem.clearance.required + 2.0 * cell
        lower, upper = ends.min(axis=0), ends.max(axis=0)
        everything = self.problem.all_obstacles.in_box(lower - _SEEN_FROM, upper + _SEEN_FROM)
        if len(everything):
            lower = np.minimum(lower, np.maximum(everything.lower.min(axis=0), lower - _SEEN_FROM))
            upper = np.maximum(upper, np.minimum(everything.upper.max(axis=0), upper + _SEEN_FROM))
        return lower - near, upper + near

    def is_closed(self) -> bool:
        """Whether no route is left; otherwise `route` is the cheapest."""
        from scipy import sparse
        from scipy.sparse import csgraph

        self.deadline.look()
        ends = [self._nodes_at(end) for end in self.ends]
        pairs = [np.array([(k, node) for node in nodes]).reshape(-1, 2) for k, nodes in zip((1, 2), ends, strict=True)]
        joints = np.concatenate((*pairs, *self.joints.values())).astype(np.int32)
        cost = np.array(self.cost)
        first, second = np.concatenate((joints, joints[:, ::-1])).T
        graph = sparse.csr_matrix((cost[second], (first, second)), shape=(cost.size, cost.size))
        spent, before = csgraph.dijkstra(graph, indices=np.array([1]), return_predecessors=True)
        if not np.isfinite(spent[0, 2]):
            return True
        self.route = [2]
        while self.route[-1] != 1:
            self.route.append(int(before[0, self.route[-1]]))
        return False

    def refine(self) -> bool:
        """Split the narrow and unseen tiles on the route; whether there were any."""
        on_route = {self.tile_of[node]: self.cost[node] for node in self.route if self.cost[node] > _OPEN}
        split = [key for key in on_route if self.tiles[key].level < _FINEST]
        new: list[_Tile] = []
        for key in split:
            tile = self.tiles.pop(key)
            self.joints = {pair: joint for pair, joint in self.joints.items() if key not in pair}
            if tile.margin is None and tile.level == 0:
                new.append(self._seen(*tile[:3]))
                continue
            make = self._unseen if tile.level < 0 else self._seen
            for i, j in ((0, 0), (0, 1), (1, 0), (1, 1)):
                new.append(make(tile.level + 1, 2 * tile.column + i, 2 * tile.row + j))
        self._add(new)
        return bool(split)

    def proof(self, bottleneck: Bottleneck | None) -> ImpossibilityProof:
        tiles: dict[bool, list[tuple[int, int, int]]] = {True: [], False: []}
        for tile in self.tiles.values():
            tiles[tile.margin is not None].append(tile[:3])
        seen, unseen = (np.array(sorted(tiles[which]), dtype=np.int64).reshape(-1, 3) for which in (True, False))
        (x, y), (cx, cy) = self.grid.origin.tolist(), self.body.centre.tolist()
        return ImpossibilityProof(
            (x, y),
            self.grid.cell,
            self.grid.headings,
            (cx, cy),
            self.body.discs,
            seen,
            unseen,
            bottleneck,
            self.problem.fingerprint,
        )

    def _new_nodes(self, count: int, cost: float) -> None:
        self.cost.extend([cost] * count)
        self.tile_of.extend([-1] * count)

    def _unseen(self, level: int, column: int, row: int) -> _Tile:
        labels = np.full((1, 1, 1), len(self.cost))
        self._new_nodes(1, self.grid.side(level))
        return _Tile(level, column, row, labels, None)

    def _seen(self, level: int, column: int, row: int) -> _Tile:
        from scipy import ndimage

        self.deadline.look()
        blocked, margin = self._judge(level, column, row)
        is_open = ~blocked & (margin > self.grid.half(level))
        labels = np.full(blocked.shape, -1)
        for which, cost in ((is_open, _OPEN), (~(blocked | is_open), self.grid.side(level))):
            found, count = ndimage.label(which)
            labels[which] = found[which] + (len(self.cost) - 1)
            self._new_nodes(count, cost)
        return _Tile(level, column, row, labels, margin)

    def _judge(self, level: int, column: int, row: int) -> tuple[BoolArray, NDArray[np.float32]]:
        """Which cells of a tile are blocked, and about how much clearance is left at their middles [m]."""
        half, count, body = self.grid.half(level), self.grid.count(level), self.body
        turn, required_most = math.pi / count, self.problem.clearance.required
        halo = math.ceil((body.reach + required_most) / half) + 1
        nodes = 2 * CELLS + 1 + 2 * halo
        corner = np.array([column, row]) * self.grid.side(level)
        distance = self.obstacles.distances(corner - halo * half, half, nodes).ravel()
        self.deadline.look()
        middle = halo + 1 + 2 * np.arange(CELLS)
        at = (middle[:, None] * nodes + middle).ravel()
        x, y, radius = body.discs.T
        # Of a disc's place: within the cell, and to the nearest node.
        moved = math.sqrt(2.0) * half + 2.0 * np.hypot(x, y) * math.sin(0.5 * turn) + math.sqrt(0.5) * half + SLACK
        yaw = turn * (2.0 * np.arange(count) + 1.0)
        c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        shift = (np.rint((s * x + c * y) / half) * nodes + np.rint((c * x - s * y) / half)).astype(np.int64)
        least, most = np.empty((count, at.size), np.float32), np.empty((count, at.size), np.float32)
        chunk = max(1, _GATHERED // (at.size * radius.size))
        for k in range(0, count, chunk):
            rows = slice(k, k + chunk)
            read = distance.take(at + shift[rows, :, None])
            read -= radius[:, None].astype(np.float32)
            read.min(axis=1, out=least[rows])
            read += moved[:, None].astype(np.float32)
            read.min(axis=1, out=most[rows])
            self.deadline.look()
        required = self._required(corner, half, (c, s), turn)
        shape = (count, CELLS, CELLS)
        return (most < required).reshape(shape), (least - required).astype(np.float32).reshape(shape)

    def _required(
        self, corner: FloatArray, half: float, turned: tuple[FloatArray, FloatArray], turn: float
    ) -> FloatArray:
        """The least clearance required in each cell, Shape (headings, cells) [m]."""
        (mx, my), (c, s) = self.body.centre, turned
        along = half * (2.0 * np.arange(CELLS) + 1.0)
        y, x = (axis.ravel() for axis in np.meshgrid(along, along, indexing="ij"))
        x0, y0 = self.grid.origin + corner
        reach = math.sqrt(2.0) * half + 2.0 * math.hypot(mx, my) * math.sin(0.5 * turn)
        at = x0 + x - (c * mx - s * my), y0 + y - (s * mx + c * my)
        return least_required(self.problem, *at, reach, self.start_clearance)

    def _add(self, new: list[_Tile]) -> None:
        """Put tiles into the plane, and join them to what is beside them."""
        keys = []
        for tile in new:
            self.key += 1
            keys.append(self.key)
            self.tiles[self.key] = tile
            rows, columns = self._place(tile)
            self.tile_at[rows, columns] = self.key
            nodes = np.unique(tile.labels)
            for node in nodes[nodes >= 0].tolist():
                self.tile_of[node] = self.key
            self.joints[self.key, self.key] = _met_within(tile.labels)
        for key in keys:
            tile = self.tiles[key]
            rows, columns = self._place(tile)
            for axis, sides in ((0, (columns.start - 1, columns.stop)), (1, (rows.start - 1, rows.stop))):
                for edge, beyond in zip((0, -1), sides, strict=True):
                    self._join(key, axis, edge, beyond, rows if axis == 0 else columns)

    def _join(self, key: int, axis: int, edge: int, beyond: int, along: slice) -> None:
        """Join a tile over its lower (0) or upper (-1) side along an axis."""
        if not 0 <= beyond < len(self.tile_at):
            nodes = np.unique(_face(self.tiles[key], axis, edge))
            nodes = nodes[nodes >= 0]
            known = self.joints.get((key, -1), np.zeros((0, 2), dtype=np.int64))
            self.joints[key, -1] = np.vstack((known, np.column_stack((nodes, 0 * nodes))))
            return
        strip = self.tile_at[along, beyond] if axis == 0 else self.tile_at[beyond, along]
        for other in np.unique(strip).tolist():
            pair = (min(key, other), max(key, other))
            if pair not in self.joints:
                self.joints[pair] = self._met_over(self.tiles[key], self.tiles[other], axis, edge)

    def _met_over(self, tile: _Tile, other: _Tile, axis: int, edge: int) -> IntArray:
        """Nodes that meet over a side of `tile`, Shape (n, 2)."""
        both = [(tile, _face(tile, axis, edge)), (other, _face(other, axis, -1 - edge))]
        spans = [self._place(each)[0 if axis == 0 else 1] for each, _ in both]
        low, high = max(span.start for span in spans), min(span.stop for span in spans)
        cells = [(span.stop - span.start) * CELLS // face.shape[1] for span, (_, face) in zip(spans, both, strict=True)]
        at = np.arange(low * CELLS, high * CELLS, min(cells))
        headings = max(face.shape[0] for _, face in both)
        met = []
        for (_, face), span, cell in zip(both, spans, cells, strict=True):
            layers = np.arange(headings) * face.shape[0] // headings
            met.append(face[np.ix_(layers, (at - span.start * CELLS) // cell)].ravel())
        return _pairs(met[0], met[1], len(self.cost))

    def _place(self, tile: _Tile) -> tuple[slice, slice]:
        """Rows and columns of a tile in `tile_at`."""
        size = 2 ** (_FINEST - tile.level)
        return slice(tile.row * size, (tile.row + 1) * size), slice(tile.column * size, (tile.column + 1) * size)

    def _nodes_at(self, pose: FloatArray) -> list[int]:
        """The nodes of the free cells that a pose of the centre is in, or less than `SLACK` from."""
        found: set[int] = set()
        size = self.grid.side(_FINEST)
        for dx in (-SLACK, SLACK):
            for dy in (-SLACK, SLACK):
                i, j = math.floor((pose[0] + dx) / size), math.floor((pose[1] + dy) / size)
                if not (0 <= i < len(self.tile_at) and 0 <= j < len(self.tile_at)):
                    found.add(0)
                    continue
                tile = self.tiles[int(self.tile_at[j, i])]
                headings, n, _ = tile.labels.shape
                side = self.grid.side(tile.level)
                column = math.floor(((pose[0] + dx) / side - tile.column) * n)
                row = math.floor(((pose[1] + dy) / side - tile.row) * n)
                for turned in (-SLACK, SLACK):
                    layer = math.floor((pose[2] + turned) * headings / (2.0 * math.pi)) % headings
                    found.add(int(tile.labels[layer, min(max(row, 0), n - 1), min(max(column, 0), n - 1)]))
        return sorted(found - {-1})


def _middle_of(pose: Pose2, centre: FloatArray) -> FloatArray:
    """Where a point of the robot is at a pose, and its heading, Shape (3,)."""
    return np.append(transform_points(pose.as_array()[None], centre[None])[0, 0], pose.yaw)


def _face(tile: _Tile, axis: int, edge: int) -> IntArray:
    """The nodes of the cells at the lower (0) or upper (-1) side of a tile along an axis, Shape (headings, n)."""
    face: IntArray = np.take(tile.labels, edge, axis=2 - axis)
    return face


def _met_within(labels: IntArray) -> IntArray:
    """Nodes of one tile that meet, Shape (n, 2)."""
    most = int(labels.max()) + 1
    found = [
        _pairs(labels[:, :, 1:], labels[:, :, :-1], most),
        _pairs(labels[:, 1:], labels[:, :-1], most),
        _pairs(labels, np.roll(labels, 1, axis=0), most),
    ]
    return np.concatenate(found)


def _pairs(first: IntArray, second: IntArray, most: int) -> IntArray:
    """Different pairs of nodes below `most` at the same places of two arrays, Shape (n, 2)."""
    met = (first >= 0) & (second >= 0) & (first != second)
    codes = first[met] * most + second[met]
    changes = np.ones(codes.size, dtype=np.bool_)
    changes[1:] = codes[1:] != codes[:-1]
    return np.column_stack(np.divmod(np.unique(codes[changes]), most))
