"""Search for a proof that no motion exists: approximate cell decomposition ([Brooks1985], [Zhang2008]).

`proof` defines such proofs. Tiles of cells are refined until no route from the start to the goal is left, an open route
is found, or the time has run out:

1. The plane is a quadtree of tiles. A tile that has not been examined counts as free.
2. Each cell of an examined tile is blocked, appears open, or is narrow, which means that neither is known. Connected
   cells of one kind are one node of a graph.
3. The cheapest route through the graph passes the fewest narrow and unexamined tiles. These tiles are split.

The examination of a tile takes a few milliseconds because its cells share one lattice of distances from the obstacles.
For every disc of the body and every heading, distances are read from this lattice, shifted by a whole number of nodes.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
from typing import TYPE_CHECKING

import numpy as np

from optdock.deadline import Deadline, OutOfTime, never_late
from optdock.geometry.lazy import cached_property
from optdock.geometry.pose import Pose2, transform_points
from optdock.geometry.separation import separation
from optdock.impossibility.connectivity_graph import (
    FINEST,
    GOAL,
    OPEN,
    OUTSIDE,
    ROOM,
    START,
    CellGrid,
    ConnectivityGraph,
    PlaceGraph,
    Tile,
    by_certainty,
    by_margin,
    connected_cells,
)
from optdock.impossibility.footprint_discs import DiscCover, disc_cover
from optdock.impossibility.obstacle_lattice import ObstacleLattice, least_and_most
from optdock.impossibility.proof import CELLS, SLACK, Bottleneck, ImpossibilityProof, least_required
from optdock.verification.clearance_kernel import end_clearances

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from optdock.geometry.arrays import BoolArray, FloatArray
    from optdock.model.problem import DockingProblem

__all__ = ["ImpossibilitySearch", "prove_impossible"]

_REACH = 0.7  # share of the body's reach at which half a cell's turn moves a point by half a cell's side
# Half a cell of level 0 as a share of the largest disc's radius: cells of level 0 must be able to close a thin wall.
_CELL = 0.27
_LARGEST = 6  # levels of unexamined tiles above level 0
_GATHERED = 250_000  # distances per vectorized read, less than a millisecond
_LATTICES = (41, 1.0), (129, 0.0)  # of the first check: nodes along each side, margin in steps
_AROUND = 6.0  # border of these lattices around start and goal, in radii of the largest disc
_STEP = 0.004  # [s]: longest time between two checks of the clock, on an idle machine
_FEWEST_HEADINGS = 8  # of cells of level 0
_SHARP = 0.25  # tolerance of the margin of the widest route, in halves of a cell
_ROUNDS_OF_DISC = 10  # refinements for the bottleneck of a disc
_CLOSE = 0.01  # [m]: half a cell; accuracy of the narrowest place of a disc
_ROUNDS = 8  # refinements for the bottleneck: four are usual, more where a wall has the same thickness everywhere
_PLACES = 5  # places on the widest route that are compared by exact distances
_POLISHED = 2  # refinements of a place, by a factor of four each
_POLISHED_AT = (33, 9, 5)  # places along each axis with one, two or three free axes
_FINE = 0.08  # [m]: twice the side of a cell; the place within smaller cells is found by exact distances
_SEEN_FROM = 30.0  # [m]: obstacles farther from start and goal do not enlarge the tiles


def prove_impossible(
    problem: DockingProblem, *, time_budget: float = 1.0, cancel_checker: Callable[[], bool] = never_late
) -> ImpossibilityProof | None:
    """Try to prove that no motion of any kind connects the start to the goal.

    Motions of any kind include reversing and turning in place.

    Args:
        problem: The planning problem.
        time_budget: Wall-clock time [s]; the call returns at most a few milliseconds later.
        cancel_checker: Polled every few milliseconds; True ends the search.

    Returns:
        The proof, or None if a motion may exist or the time was too short. `check_impossibility` checks the proof.
    """
    return ImpossibilitySearch(problem).proof(time_budget, cancel_checker)


class ImpossibilitySearch:
    """A search for a proof that can be continued after an interruption.

    The first search replaces the robot by the largest disc within it. A gap too narrow for the disc is too narrow for
    the robot at any heading, and a search without headings has a hundred times fewer cells.

    Args:
        problem: The planning problem.
    """

    def __init__(self, problem: DockingProblem) -> None:
        self.problem = problem
        # Bodies still to be searched, the next one last; None: not computed yet.
        self._left: list[DiscCover] | None = None if len(problem.all_obstacles) else []
        self._search: _Search | None = None

    @property
    def ended(self) -> bool:
        """Whether the search has no further steps."""
        return self._left == []

    def proof(
        self, time_budget: float, cancel_checker: Callable[[], bool] = never_late, *, only_disc: bool = False
    ) -> ImpossibilityProof | None:
        """Continue the search.

        Args:
            time_budget: Wall-clock time [s]; the call returns at most a few milliseconds later.
            cancel_checker: Polled every few milliseconds; True interrupts the search.
            only_disc: Stop if there is no proof with the largest disc alone.

        Returns:
            The proof, with a bottleneck whose accuracy depends on the time used; None if no proof has been found so
            far.
        """
        deadline = Deadline(time_budget - _STEP, stop=cancel_checker)
        with contextlib.suppress(OutOfTime):
            deadline.look()
            if self._left is None:
                body = disc_cover(self.problem.robot.footprint, deadline.look)
                self._left = [body, body.largest_disc]
            while len(self._left) > int(only_disc):
                if self._search is None:
                    self._search = _Search(self.problem, self._left[-1], deadline)
                if len(self._left) == 1 or not self._search.looks_open(deadline):
                    proof = self._search.proof(deadline)
                    if proof is not None:
                        return proof
                self._search = None
                self._left.pop()
        return None


class _Search:
    """Search for one body: the present tiles, and the graph of their cells that may be free."""

    def __init__(self, problem: DockingProblem, body: DiscCover, deadline: Deadline) -> None:
        self.problem, self.body, self.deadline = problem, body, deadline
        self.start_clearance = end_clearances(problem).start
        self.known: dict[tuple[int, int, int], Tile] = {}

    @cached_property
    def graph(self) -> ConnectivityGraph:
        """Graph of the present tiles, at first one tile."""
        graph = ConnectivityGraph(self.grid, self.ends, by_certainty(self.grid))
        graph.add([Tile(-self.grid.above, 0, 0)])
        return graph

    @cached_property
    def obstacles(self) -> ObstacleLattice:
        """Obstacles relative to the grid."""
        return ObstacleLattice(self.problem, self.grid.origin, self._look)

    @cached_property
    def ends(self) -> list[FloatArray]:
        """Poses of start and goal relative to the grid, Shape (3,) each [m, m, rad]."""
        return [_middle(pose, self.body.centre, self.grid.origin) for pose in (self.problem.start, self.problem.goal)]

    @cached_property
    def grid(self) -> CellGrid:
        """Grid of tiles that covers start, goal and the obstacles that are near enough to be relevant."""
        cell = _CELL * float(self.body.discs[:, 2].max())
        ends = np.array([[end.x, end.y] for end in (self.problem.start, self.problem.goal)])
        near = self.body.reach + float(np.hypot(*self.body.centre)) + self.problem.path_clearance.required + 2.0 * cell
        lower, upper = ends.min(axis=0), ends.max(axis=0)
        everything = self.problem.all_obstacles.in_box(lower - _SEEN_FROM, upper + _SEEN_FROM)
        if len(everything):
            lower = np.minimum(lower, np.maximum(everything.lower.min(axis=0), lower - _SEEN_FROM))
            upper = np.maximum(upper, np.minimum(everything.upper.max(axis=0), upper + _SEEN_FROM))
        side, extent = 2.0 * CELLS * cell, float((upper - lower).max()) + 2.0 * near
        above = min(max(math.ceil(math.log2(extent / side)), 0), _LARGEST)
        turning = max(_FEWEST_HEADINGS, math.ceil(math.pi * _REACH * self.body.reach / cell))
        headings = turning if self.body.turns else 1
        return CellGrid(0.5 * (lower + upper) - 0.5 * side * 2**above, cell, headings, above)

    def _look(self) -> None:
        self.deadline.look()

    def looks_open(self, deadline: Deadline) -> bool:
        """Whether free nodes of a coarse lattice connect the start to the goal for a disc (a heuristic, no proof).

        A coarser lattice with a margin, which connects them in most open scenes, is examined first.
        """
        self.deadline, radius = deadline, float(self.body.discs[0, 2])
        border, origin = radius + self.problem.path_clearance.required, np.zeros(2)
        ends = np.array(
            [_middle(pose, self.body.centre, origin)[:2] for pose in (self.problem.start, self.problem.goal)]
        )
        low, high = ends.min(axis=0), ends.max(axis=0)
        side = float((high - low).max()) + 2.0 * (border + _AROUND * radius)
        corner = 0.5 * (low + high - side)
        obstacles = ObstacleLattice(self.problem, corner, self._look)
        for nodes, margin in _LATTICES:
            step = side / (nodes - 1)
            if margin * step > radius:
                continue  # a wall might be missed between two nodes
            clearance = obstacles.distances(origin, step, nodes) - radius - margin * step
            is_free = self._is_enough(clearance, corner, step)
            # Nodes near the border are not valid: obstacles outside were not examined.
            kept = slice(math.ceil(border / step), -math.ceil(border / step))
            labels = np.full(is_free.shape, -1)
            labels[kept, kept] = connected_cells(is_free[None, kept, kept].astype(np.int64))[0][0]
            around = np.rint((ends - corner) / step).astype(np.int64).tolist()
            found = [set(labels[j - 1 : j + 2, i - 1 : i + 2].flat) for i, j in around]
            if set.intersection(*found) - {-1}:
                return True
        return False

    def _is_enough(self, clearance: FloatArray, corner: FloatArray, step: float) -> BoolArray:
        """Whether the disc has the required clearance at the nodes of a lattice, given its clearances, Shape (n, n)."""
        is_free: BoolArray = clearance >= self.problem.path_clearance.required
        row, column = (~is_free & (clearance >= 0.0)).nonzero()  # free if less is required there
        x, y = corner[0] + step * column, corner[1] + step * row
        required = least_required(self.problem, x, y, float(np.hypot(*self.body.centre)), self.start_clearance)
        is_free[row, column] = clearance[row, column] >= required
        return is_free

    def proof(self, deadline: Deadline) -> ImpossibilityProof | None:
        """Split the narrow tiles on the cheapest route until no route is left or one route is open.

        After an interruption another call continues the search.
        """
        self.deadline = deadline
        while True:
            self.deadline.look()
            self.graph.add((), self.deadline.look)  # after an interruption
            route = self.graph.route()
            if not route:
                break
            narrow = {self.graph.tile_of[node] for node in route if self.graph.cost[node] > OPEN}
            if not self._split(self.graph, narrow):
                return None
        proof = self._around_an_end()
        with contextlib.suppress(OutOfTime):
            for bottleneck in self._bottlenecks() if self.body.turns else self._bottlenecks_of_disc():
                proof = dataclasses.replace(proof, bottleneck=bottleneck)
        return proof

    def _split(self, graph: ConnectivityGraph, keys: set[int]) -> bool:
        """Refine tiles above the finest level, by examination or splitting; return whether there are any."""
        keys = {key for key in keys if graph.tiles[key].level < FINEST}
        new: list[Tile] = []
        for key in sorted(keys):
            tile = graph.tiles[key]
            if tile.level < 0:
                new += [Tile(*place) for place in tile.split()]
            else:
                new += [self._seen(*place) for place in (tile.split() if tile.margin is not None else [tile[:3]])]
        graph.remove(keys)
        graph.add(new, self.deadline.look)
        return bool(keys)

    def _around_an_end(self) -> ImpossibilityProof:
        """Return the proof when no route is left, with cells around the goal or, if that fails, around the start."""
        graph = self.graph
        goal = graph.reached(GOAL)
        end, reached = ("start", graph.reached(START)) if goal[OUTSIDE] else ("goal", goal)
        tiles, whole = {}, []
        for key in graph.present():
            tile, labels = graph.tiles[key], graph.labels[key]
            inside = (labels >= 0) & reached[labels]
            if tile.margin is not None:
                tiles[tile[:3]] = inside
            elif inside.all():
                whole.append(tile[:3])
        order = sorted(tiles)
        (x, y), (cx, cy) = self.grid.origin.tolist(), self.body.centre.tolist()
        return ImpossibilityProof(
            end=end,
            origin=(x, y),
            cell=self.grid.cell,
            headings=self.grid.headings,
            centre=(cx, cy),
            discs=self.body.discs,
            tiles=np.array(order, dtype=np.int64).reshape(-1, 3),
            inside=tuple(tiles[place] for place in order),
            whole=np.array(sorted(whole), dtype=np.int64).reshape(-1, 3),
            bottleneck=None,
            problem=self.problem.fingerprint,
        )

    def _bottlenecks_of_disc(self) -> Iterator[Bottleneck]:
        """Yield the narrowest point of the widest route of a disc, from cells refined until the point is accurate."""
        graph, found = PlaceGraph(self.grid, self.ends, by_certainty(self.grid)), None
        graph.add([self.graph.tiles[key] for key in self.graph.present()], self.deadline.look)
        with contextlib.suppress(OutOfTime):
            for _ in range(_ROUNDS_OF_DISC):
                self.deadline.look()
                route = graph.route()
                found = max(route, key=lambda node: graph.cost[node])
                dearest = graph.cost[found]
                if dearest <= -ROOM:
                    return
                half = self.grid.half(graph.tiles[graph.tile_of[found]].level)
                keys = {graph.tile_of[node] for node in route if graph.cost[node] >= dearest - _SHARP * half}
                if not self._split(graph, {key for key in keys if self.grid.half(graph.tiles[key].level) > _CLOSE}):
                    break
        if found is not None:
            bottleneck = self._at_place(graph, found)
            if bottleneck is not None:
                yield bottleneck

    def _at_place(self, graph: ConnectivityGraph, node: int) -> Bottleneck | None:
        """Return the bottleneck at a position of the disc, with the body's best heading; None inside an obstacle."""
        tile, place = graph.tiles[graph.tile_of[node]], node - int(graph.labels[graph.tile_of[node]].min())
        half, (row, column) = self.grid.half(tile.level), divmod(place, CELLS)
        middle = 2.0 * half * (CELLS * np.array([tile.column, tile.row]) + (column + 0.5, row + 0.5))
        (x, y, _), most = self._best_near(np.append(middle, 0.0), np.array([half, half, 0.0]), self.body)
        if most + float(self.body.discs[0, 2]) <= 2.0 * half:
            return None
        body = disc_cover(self.problem.robot.footprint, self.deadline.look)
        shift = self.body.centre - body.centre
        whole = DiscCover(body.centre, body.discs - (*shift, 0.0), body.reach)
        (_, _, yaw), _ = self._best_near(np.array([x, y, 0.5 * math.pi]), np.array([0.0, 0.0, 0.5 * math.pi]), whole)
        return self._bottleneck((x, y, yaw), most, half)

    def _bottlenecks(self) -> Iterator[Bottleneck]:
        """Yield the narrowest point of the widest route, from margins at the centres of successively finer cells."""
        present, half = set(self.graph.present()), self.grid.cell
        tiles = [  # the examined ones of level 0, and all that were not examined
            tile
            for key, tile in enumerate(self.graph.tiles)
            if (tile.level == 0 and tile.margin is not None) or (tile.margin is None and key in present)
        ]
        low, high = -self.problem.path_clearance.required - float(self.body.discs[:, 2].max()) - half, 0.0
        for _ in range(_ROUNDS):
            low, high = self._widest(tiles, low, high, _SHARP * half)
            graph = self._by_margin(tiles, low, high)
            route = graph.route()
            narrow = [node for node in route if graph.cost[node] > OPEN]
            if not narrow:
                return
            some = narrow[:: -(-len(narrow) // _PLACES)]  # coarse cells may appear as narrow as the narrowest place
            yield max((self._at_node(graph, node) for node in some), key=lambda found: found.missing_width)
            keys = {graph.tile_of[node] for node in narrow}
            half = max(self.grid.half(graph.tiles[key].level) for key in keys)
            keys = {key for key in keys if 4.0 * self.grid.half(graph.tiles[key].level) > _FINE}
            # Unexamined tiles count as wide and hide the thickness of a wall.
            passed = {graph.tile_of[node] for node in route if node > GOAL}
            keys |= {key for key in passed if graph.tiles[key].margin is None}
            if not self._split(graph, keys):
                return
            tiles = [graph.tiles[key] for key in graph.present()]
            low, high = low - half, high + half

    def _widest(self, tiles: list[Tile], low: float, high: float, sharp: float) -> tuple[float, float]:
        """Bracket and bisect the margin; return a margin with a route and a larger margin without a route [m]."""
        step = high - low
        while self._by_margin(tiles, high, high).route():
            low, high = high, high + step
        while not self._by_margin(tiles, low, low).route():
            low, high = low - step, low
        while high - low > sharp:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if self._by_margin(tiles, middle, middle).route() else (low, middle)
        return low, high

    def _by_margin(self, tiles: list[Tile], low: float, high: float) -> ConnectivityGraph:
        self.deadline.look()
        graph = ConnectivityGraph(self.grid, self.ends, by_margin(low, high))
        graph.add(tiles)
        return graph

    def _seen(self, level: int, column: int, row: int) -> Tile:
        """Return a tile after its examination; each tile is examined only once."""
        self.deadline.look()
        known = self.known.get((level, column, row))
        if known is not None:
            return known
        half, count, body = self.grid.half(level), self.grid.count(level), self.body
        turn, required_most = math.pi / count, self.problem.path_clearance.required
        halo = math.ceil((body.reach + required_most) / half) + 1
        nodes = 2 * CELLS + 1 + 2 * halo
        corner = np.array([column, row]) * self.grid.side(level)
        distance = self.obstacles.distances(corner - halo * half, half, nodes).ravel()
        self.deadline.look()
        middle = halo + 1 + 2 * np.arange(CELLS)
        at = (middle[:, None] * nodes + middle).ravel()
        x, y, radius = body.discs.T
        # Displacement of a disc: within the cell, and to the nearest node; the middles of cells are nodes.
        off = np.hypot(x, y)
        to_node = np.where(off > 0.0, math.sqrt(0.5) * half, 0.0)
        moved = math.sqrt(2.0) * half + 2.0 * off * math.sin(0.5 * turn) + to_node + SLACK
        yaw = turn * (2.0 * np.arange(count) + 1.0)
        c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
        shift = (np.rint((s * x + c * y) / half) * nodes + np.rint((c * x - s * y) / half)).astype(np.int64)
        parts = []
        chunk = max(1, _GATHERED // (at.size * radius.size))
        for k in range(0, count, chunk):
            parts.append(least_and_most(distance, at, shift[k : k + chunk], radius, moved))
            self.deadline.look()
        least, most = (np.concatenate(part) for part in zip(*parts, strict=True))
        required = self._required(corner, half, (c, s), turn)
        shape = (count, CELLS, CELLS)
        tile = self.known[level, column, row] = Tile(
            level, column, row, (most < required).reshape(shape), (least - required).astype(np.float32).reshape(shape)
        )
        return tile

    def _required(
        self, corner: FloatArray, half: float, turned: tuple[FloatArray, FloatArray], turn: float
    ) -> FloatArray:
        """Return the least clearance required in each cell, Shape (headings, cells) [m]."""
        (mx, my), (c, s) = self.body.centre, turned
        along = half * (2.0 * np.arange(CELLS) + 1.0)
        y, x = (axis.ravel() for axis in np.meshgrid(along, along, indexing="ij"))
        x0, y0 = self.grid.origin + corner
        reach = math.sqrt(2.0) * half + 2.0 * math.hypot(mx, my) * math.sin(0.5 * turn)
        at = x0 + x - (c * mx - s * my), y0 + y - (s * mx + c * my)
        return least_required(self.problem, *at, reach, self.start_clearance)

    def _at_node(self, graph: ConnectivityGraph, node: int) -> Bottleneck:
        """Return the bottleneck at the cell of a node that has the largest margin."""
        key = graph.tile_of[node]
        tile = graph.tiles[key]
        assert tile.margin is not None
        margin = np.where(graph.labels[key] == node, tile.margin, -np.inf)
        layer, j, i = np.unravel_index(int(margin.argmax()), margin.shape)
        half, turn = self.grid.half(tile.level), math.pi / margin.shape[0]
        yaw = turn * (2.0 * float(layer) + 1.0)
        x, y = (2.0 * half * (CELLS * first + k + 0.5) for first, k in ((tile.column, float(i)), (tile.row, float(j))))
        at, most = self._best_near(np.array([x, y, yaw]), np.array([half, half, turn]), self.body)
        return self._bottleneck(at, most, half)

    def _bottleneck(self, at: tuple[float, float, float], most: float, half: float) -> Bottleneck:
        """Return the bottleneck at a pose of the centre where the discs are at least `most` [m] away from obstacles."""
        (x, y, yaw), (x0, y0), (mx, my) = at, self.grid.origin, self.body.centre
        c, s = math.cos(yaw), math.sin(yaw)
        pose = Pose2(float(x0 + x - (c * mx - s * my)), float(y0 + y - (s * mx + c * my)), yaw)
        required = least_required(self.problem, np.array(pose.x), np.array(pose.y), 0.0, self.start_clearance)
        body = -2.0 * most
        return Bottleneck(pose.x, pose.y, pose.yaw, body + 2.0 * float(required), body, 4.0 * half, self._between(pose))

    def _best_near(
        self, pose: FloatArray, reach: FloatArray, body: DiscCover
    ) -> tuple[tuple[float, float, float], float]:
        """Return the pose near `pose` at which the discs are farthest from obstacles, and their smallest distance.

        `reach`: largest differences from `pose` in x [m], y [m] and yaw [rad], Shape (3,).
        """
        import shapely

        everything, (x, y, radius) = self.obstacles, body.discs.T
        extent = 2.0 * body.reach
        near = ((everything.lower <= pose[:2] + extent) & (everything.upper >= pose[:2] - extent)).all(axis=1)
        tree = shapely.STRtree(shapely.polygons(everything.vertices[near]))
        count = _POLISHED_AT[np.count_nonzero(reach) - 1]
        shares = [np.linspace(-extent, extent, count) if extent else np.zeros(1) for extent in reach.tolist()]
        around = np.stack(np.meshgrid(*shares), axis=-1).reshape(-1, 3)
        most = -math.inf if near.any() else 0.0
        for k in range(_POLISHED if near.any() else 0):
            if k > 0 and self.deadline.passed():
                break
            poses = pose + around
            c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
            at = poses[:, :1] + c * x - s * y, poses[:, 1:2] + s * x + c * y
            apart = tree.query_nearest(
                shapely.points(*(v.ravel() for v in at)), return_distance=True, all_matches=False
            )[1]
            margin = (apart.reshape(at[0].shape) - radius).min(axis=1)
            best = int(margin.argmax())
            pose, most, around = poses[best], float(margin[best]), 0.25 * around
        return (float(pose[0]), float(pose[1]), float(pose[2])), most

    def _between(self, pose: Pose2) -> tuple[str, ...]:
        """Return the names of the obstacle nearest to the robot at a pose, and of the nearest one on the other side."""
        obstacles, footprint = self.problem.all_obstacles, self.problem.robot.footprint
        reach = footprint.circumscribed_radius + 2.0 * self.problem.path_clearance.required + self.grid.cell
        at = np.array([pose.x, pose.y])
        rows = obstacles.rows_in_box(at - reach, at + reach)
        if rows.size == 0:  # in a cell larger than the robot
            return ()
        found = [
            separation(body, np.tile(pose.as_array(), (rows.size, 1)), obstacles.pieces(rows))
            for body in footprint.bodies
        ]
        distance, axis = (np.concatenate(parts) for parts in zip(*found, strict=True))
        row = np.tile(rows, len(footprint.bodies))
        first = int(distance.argmin())
        facing = np.where(axis @ axis[first] < 0.0, distance, np.inf)
        second = int(facing.argmin())
        both = [first] if np.isinf(facing[second]) else [first, second]
        return tuple(obstacles.name_of(int(row[k])) for k in both)


def _middle(pose: Pose2, centre: FloatArray, origin: FloatArray) -> FloatArray:
    """Return the position of a point of the robot relative to an origin, and the heading, for a pose. Shape (3,)."""
    x, y = (transform_points(pose.as_array()[None], centre[None])[0, 0] - origin).tolist()
    return np.array((x, y, pose.yaw))
