"""Triangulated irregular networks that grow: Delaunay triangulations whose vertices come and go in place.

The triangulation of the vertices is unique whatever the order, the batches and the history in which they came: it depends
on their positions only (:mod:`jaxfilter.engines.tin.predicates`). It begins with one triangle of each sheet.
"""

from __future__ import annotations

import copy
import itertools
import os
from collections.abc import Callable
from concurrent.futures import Executor, ThreadPoolExecutor

import numpy as np

from ...core.arrays import takes
from ...core.cloud import QUANTUM
from ...core.errors import InputError
from ...core.points import pieces
from ..neighbours import tree_of

NODES_AT_ONCE = 65536
"""At most so many nodes are worked on by one call of compiled code, so that an interrupt is obeyed."""
_SHARE = 8192
"""At least so many are worth a thread of their own where each takes a walk."""
_MADE = 10_000_000
"""New triangles after which such a call comes back at the latest."""
_CORNERS = np.array([[0, 1, 2], [2, 1, 3], [0, 2, 3], [1, 0, 3]])
_BESIDE = np.array([[1, 2, 3], [3, 2, 0], [1, 3, 0], [2, 1, 0]])
"""A triangle and the ghosts beyond its edges: their corners, of which the last is nowhere, and neighbours."""


def lattice(xy: np.ndarray) -> np.ndarray:
    """i32[n, 2]: positions [n, >=2] in local metres, in steps of the quantum of the coordinates. Raises: ValueError for those
    that are too far from zero to be counted so."""
    steps = np.empty((len(xy), 2), np.int32)
    with np.errstate(invalid="raise"):
        try:
            for part in pieces(len(xy)):
                steps[part] = np.rint(xy[part, :2].astype(np.float64) / QUANTUM)
        except FloatingPointError as error:
            far = f"{2**31 * QUANTUM / 1000:.0f} km from the corner of the cloud"
            raise ValueError(f"positions more than {far}: move them nearer, or leave out stray ones") from error
    return steps


class Tin:
    """Triangulations of one or several separate sheets over one pool of nodes.

    Attributes:
        xyz: f32[k, 3] local metres, all nodes that are or may become vertices, sheet by sheet, each sheet in canonical order
            (nodes that are near in this order should be near in the plane).
        sheet: i32[k], ascending.
        triangles: i32[t, 3] nodes, counter-clockwise; neighbours: i32[t, 3], the triangle opposite each vertex. A triangle
            beyond an edge of a hull has a corner -1; numbers that are not in use have corners -2.
        vertex: bool[k], nodes that are vertices.
        where: i32[k], a triangle that contains each node, as far as :meth:`locate` has brought it up to date; for a vertex
            one of its own.
        stamp: i32[t], the ``now`` at which each triangle last changed.
        now: counted up by the user, once a round.
    """

    def __init__(
        self, xyz: np.ndarray, sheet: np.ndarray, vertices: np.ndarray, pool: Executor, workers: int = 1
    ) -> None:
        """Triangulate ``vertices`` (i64, ascending; every sheet has three or more, not on a line) and locate the rest.

        The vertices are at positions of their own. Raises: ValueError for positions more than 140 km apart, too far from zero, on
        one line or repeated.
        """
        from . import flips, walks  # these import Numba, which takes longer than all the rest
        from .predicates import SPAN

        self._flips, self._walks = flips, walks
        self.xyz, self.sheet, self.xy, self.pool, self.workers = xyz, sheet, lattice(xyz), pool, workers
        if max(int(self.xy[:, axis].max()) - int(self.xy[:, axis].min()) for axis in range(2)) > SPAN:
            far = f"{SPAN * QUANTUM / 1000:.0f} km apart"
            raise ValueError(f"nodes more than {far}: triangulate them in parts, or leave out stray ones")
        self.vertex = np.zeros(len(xyz), bool)
        self.where = np.full(len(xyz), -1, np.int32)
        self.now, self._room = 0, dict[str, np.ndarray]()
        self._waiting, self._following = np.zeros(0, np.int32), np.zeros(0, np.int32)  # see walks.changed
        bounds = np.searchsorted(sheet, np.arange(int(sheet[-1]) + 2))
        begin = np.array([self._one(part) for part in np.split(vertices, np.searchsorted(vertices, bounds[1:-1]))])
        self._first, self._hull = np.arange(0, 4 * len(begin), 4), np.full(len(begin), 3)
        corners = np.insert(begin, 3, walks.NOWHERE, axis=1)[:, _CORNERS]
        self.triangles = corners.reshape(-1, 3).astype(np.int32)
        self.neighbours = (self._first[:, None, None] + _BESIDE).reshape(-1, 3).astype(np.int32)
        self.stamp, self._unused = np.zeros(len(self.triangles), np.int32), np.zeros(0, np.int32)
        self.where[begin] = self._first[:, None]
        self.vertex[begin] = True
        rest = vertices[~self.vertex[vertices]]
        self.locate(rest)
        self.insert(rest)
        self.locate(np.flatnonzero(~self.vertex))

    @property
    def _tables(self) -> tuple[np.ndarray, ...]:
        return self.xy, self.triangles, self.neighbours, self.where, self.stamp

    def __len__(self) -> int:
        """How many triangles there are."""
        return len(self.triangles) - len(self._unused) - int(self._hull.sum())

    def copied(self) -> Tin:
        """The same, to grow on its own, with one thread."""
        out = copy.copy(self)
        for name in ("triangles", "neighbours", "where", "_first", "_unused", "xyz", "vertex", "stamp", "_hull"):
            setattr(out, name, getattr(self, name).copy())
        out._room, out.workers = {}, 1
        return out

    def _one(self, vertices: np.ndarray) -> np.ndarray:
        """A triangle of vertices, counter-clockwise: the first, the farthest from it, and the farthest from their line."""
        x, y = (self.xy[vertices].astype(np.int64) - self.xy[vertices[0]]).T
        far = int(np.argmax(x * x + y * y))
        turn = x[far] * y - y[far] * x
        off = int(np.argmax(np.abs(turn)))
        if turn[off] == 0:
            raise ValueError("they are on one line: at least three positions are needed that are not")
        return vertices[[0, far, off] if turn[off] > 0 else [0, off, far]]

    def _spread(self, count: int, work: Callable[[slice], None], least: int | None = None) -> None:
        """Do work on parts of so many nodes, in threads; a part has ``least``, or else :data:`NODES_AT_ONCE`."""
        size = min(NODES_AT_ONCE, max(least or NODES_AT_ONCE, -(-count // self.workers)))
        parts = [slice(i, i + size) for i in range(0, count, size)]
        list((self.pool.map if self.workers > 1 and len(parts) > 1 else map)(work, parts))

    def _fresh(self, count: int) -> np.ndarray:
        """i32[count, 2]: numbers for new triangles."""
        used, more = len(self.triangles), 2 * count - len(self._unused)
        if more > 0:
            self._unused = np.append(self._unused, np.arange(used, used + more, dtype=np.int32))
            self._lengthen("triangles", used + more)[used:] = self._walks.DEAD
            self._lengthen("stamp", used + more)[used:] = 0
            self._lengthen("neighbours", used + more)
        fresh, self._unused = self._unused[: 2 * count], self._unused[2 * count :]
        return fresh.reshape(-1, 2)

    def _lengthen(self, name: str, rows: int) -> np.ndarray:
        """Give a table so many rows. It has room for all that there can be, whose memory is none before it is written to."""
        one, room = getattr(self, name), self._room.get(name)
        if room is None or len(room) < rows:
            room = self._room[name] = np.empty((max(rows, 2 * len(self.xyz)), *one.shape[1:]), one.dtype)
            room[: len(one)] = one
        setattr(self, name, room[:rows])
        return room[:rows]

    def insert(self, nodes: np.ndarray) -> None:
        """Make nodes (i64, ascending, not vertices, at positions of their own) vertices, in threads."""
        fresh = self._fresh(len(nodes))
        cuts = np.flatnonzero(np.diff(self.sheet[nodes])) + 1
        jobs = [slice(*cut) for cut in itertools.pairwise([0, *cuts, len(nodes)])]

        def one(job: slice) -> None:
            for part in _coarse_first(job.stop - job.start):
                own, numbers = nodes[job][part], fresh[job][part]
                if len(jobs) == 1 and self.workers > 1 and len(own) > 2 * _SHARE:
                    left = self._insert_apart(own, numbers)
                    own, numbers = own[left], numbers[left]
                self._insert(own, numbers)

        list(self.pool.map(one, jobs) if len(jobs) > 1 else map(one, jobs))
        self.vertex[nodes] = True

    def _insert(self, nodes: np.ndarray, fresh: np.ndarray, low: int = -1, high: int = 2**31 - 1) -> np.ndarray:
        """Insert nodes one after the other; bool[n], those that were left out."""
        left, done, room = np.zeros(len(nodes), bool), 0, np.empty((64, 7), np.int32)
        own = self.sheet, self._hull
        while done < len(nodes):
            some, before = (nodes[: done + NODES_AT_ONCE], fresh, left), done
            done = self._flips.insert(*self._tables, *own, *some, low, high, done, self.now, _MADE, room)
            if done < 0:
                raise ValueError(f"node {nodes[-1 - done]} is at the position of a vertex: give each position once")
            if done == before:
                room = np.empty((2 * len(room), 7), np.int32)
        return left

    def _insert_apart(self, nodes: np.ndarray, fresh: np.ndarray) -> np.ndarray:
        """Insert nodes in threads, each of which keeps to a range of nodes; bool[n], those too close to another's range."""
        left, share = np.zeros(len(nodes), bool), -(-len(nodes) // self.workers)
        begins = range(0, len(nodes), share)
        ranges = list(itertools.pairwise([0, *nodes[begins[1:]].tolist(), len(self.xyz)]))
        for step in range(0, share, NODES_AT_ONCE):

            def one(k: int, step: int = step) -> None:
                part = slice(begins[k] + step, min(begins[k] + min(step + NODES_AT_ONCE, share), len(nodes)))
                left[part] = self._insert(nodes[part], fresh[part], *ranges[k])

            list(self.pool.map(one, range(len(begins))))
        return left

    def remove(self, nodes: np.ndarray) -> None:
        """Make vertices (i64, not on the hull of their sheet) ordinary nodes again. Raises: ValueError."""
        for order in reversed(_coarse_first(len(nodes))):
            for start in range(0, len(order), NODES_AT_ONCE):
                part = nodes[order[start : start + NODES_AT_ONCE]]
                freed = np.empty((len(part), 2), np.int32)
                done = self._flips.remove(*self._tables, part, freed, self.now)
                if done < len(part):
                    raise ValueError(f"node {part[done]} is on the hull")
                self._unused = np.concatenate([self._unused, freed.ravel()])
                self.vertex[part] = False
        if self.sheet[-1] > 0:  # or nodes would be in the wrong sheet when another takes these numbers
            self._flips.leave(self.triangles, self.neighbours, self.where)

    def become(self, vertices: np.ndarray) -> None:
        """Move to other vertices, i64; those on the hull of their sheet stay."""
        after = np.zeros(len(self.vertex), bool)
        after[vertices] = True
        self.remove(np.flatnonzero(self.vertex & ~after))
        self.insert(np.flatnonzero(after & ~self.vertex))

    def locate(self, nodes: np.ndarray) -> None:
        """Bring ``where`` up to date for nodes, i64, best in canonical order."""
        given = *self._tables[:4], self.sheet
        self._spread(len(nodes), lambda part: self._walks.locate(*given, nodes[part], self._first), _SHARE)

    def walk(self, xy: np.ndarray, start: np.ndarray) -> np.ndarray:
        """i32[n]: the triangle that contains each position [n, >=2] in local metres, walking from triangles near it.

        Positions count to a quantum. Outside the hull it is -1 - t, where t is the triangle behind an edge in sight.
        """
        out, tables, at = np.empty(len(xy), np.int32), self._tables[:3], lattice(xy)
        work = self._walks.locate_positions
        self._spread(len(xy), lambda part: work(*tables, start[part], at[part], out[part]), _SHARE)
        return out

    def twins(self, nodes: np.ndarray) -> np.ndarray:
        """i64[n]: for located nodes, i64, the vertex at the same position, or -1."""
        out, tables = np.empty(len(nodes), np.int64), (self.xy, self.triangles, self.where)
        self._spread(len(nodes), lambda part: self._walks.twins(*tables, nodes[part], out[part]))
        return out

    def nearest(self, vertices: np.ndarray, counts: np.ndarray) -> np.ndarray:
        """i64[n]: the vertex nearest to each vertex, i64[n], in the plane, among others that count, bool[k]; -1 = none."""
        out = np.empty(len(vertices), np.int64)
        self._walks.nearest(self.xy, self.triangles, self.neighbours, self.where, counts, vertices, out)
        far = np.flatnonzero(out == self._walks.FAR)
        sheets = self.sheet[vertices[far]]
        for sheet in np.unique(sheets):
            others = np.flatnonzero(self.vertex & counts & (self.sheet == sheet))
            out[far[sheets == sheet]] = self._nearest_of_all(vertices[far[sheets == sheet]], others)
        return out

    def _nearest_of_all(self, vertices: np.ndarray, others: np.ndarray) -> np.ndarray:
        """As :meth:`nearest`, where many vertices lie nearer that do not count: by a KD-tree, ties by whole numbers."""
        out = np.full(len(vertices), -1)
        if len(others) == 0:
            return out
        at, centres = self.xy[others].astype(np.int64), self.xy[vertices].astype(np.int64)
        tree = tree_of(at.astype(np.float64))
        distance, index = tree.query(centres, k=[1, 2])
        itself = np.append(others, -1)[index[:, 0]] == vertices
        radius = np.where(itself, distance[:, 1], distance[:, 0])
        for k in np.flatnonzero(np.isfinite(radius)):
            near = np.array(tree.query_ball_point(centres[k], radius[k] * (1 + 1e-12)))
            near = near[others[near] != vertices[k]]
            x, y = at[near].T
            out[k] = others[near[np.lexsort([y, x, ((at[near] - centres[k]) ** 2).sum(axis=1)])[0]]]
        return out

    def changed(self, nodes: np.ndarray) -> np.ndarray:
        """i64, ascending: those watched whose triangle has changed now, which are watched no longer.

        ``nodes``: i64, located nodes that are watched, too. Nobody looks at the others as long as their triangles stay.
        """
        if len(self._following) == 0:
            self._following = np.full(len(self.xyz), self._walks.LOOSE, np.int32)
        known, out = len(self._waiting), np.empty(len(self.xyz), np.int32)
        self._lengthen("_waiting", len(self.triangles))[known:] = self._walks.NOWHERE
        lists = self._waiting, self._following
        count = self._walks.changed(self.where, self.stamp, nodes, self.now, *lists, out)
        return np.sort(out[:count]).astype(np.int64)

    def touch(self, vertices: np.ndarray) -> None:
        """The triangles at vertices count as changed."""
        self._flips.touch(*self._tables[1:], vertices, self.now)

    def corners(self, rows: np.ndarray) -> np.ndarray:
        """i32[n, 3]: the nodes at the corners of triangles, i32[n], counter-clockwise from the first on.

        Beyond an edge of a hull they are those of the triangle behind it.
        """
        out, tables = np.empty((len(rows), 3), np.int32), (self.triangles, self.neighbours)
        self._spread(len(rows), lambda part: self._walks.corners(*tables, rows[part], out[part]))
        return out

    def planes(self, rows: np.ndarray) -> np.ndarray:
        """f32[3, 3, n]: the positions of these corners, local metres: by corners, then axes."""
        out = np.empty((3, 3, len(rows)), np.float32)
        self._walks.planes(self.xyz, self.triangles, self.neighbours, rows, out)
        return out

    def facets(self) -> tuple[np.ndarray, np.ndarray]:
        """i32[t, 3] triangles and i32[t, 3] neighbours (-1 outside), in an order that only the nodes decide."""
        rows = np.flatnonzero((self.triangles >= 0).all(axis=1))
        corner = self.corners(rows)
        turn = ((self.triangles[rows] == corner[:, :1]).argmax(axis=1)[:, None] + np.arange(3)) % 3
        order = np.argsort(corner[:, 0].astype(np.int64) << 32 | corner[:, 1])  # no two begin with the same edge
        rank = np.full(len(self.triangles), -1, np.int32)
        rank[rows[order]] = np.arange(len(rows), dtype=np.int32)
        return corner[order], rank[np.take_along_axis(self.neighbours[rows], turn, axis=1)[order]]


@takes(xyz="f32[points, 3]")
def triangulated(xyz: np.ndarray, workers: int | None = None, kind: type[Tin] = Tin) -> Tin:
    """The triangulation of positions of their own, f32[points, 3], in one sheet. ``workers``: threads, None = cores.

    Raises: InputError for positions that are on one line (as fewer than three are), repeated, not finite or too far apart.
    """
    threads, every = workers or os.cpu_count() or 1, np.arange(len(xyz))
    try:
        with ThreadPoolExecutor(threads) as pool:
            tin = kind(xyz, np.zeros(len(xyz), np.int32), every, pool, threads)
    except ValueError as error:
        raise InputError(f"xyz of {len(xyz):,} points: {error}") from error
    tin.workers = 1  # the others have gone
    return tin


def _coarse_first(count: int) -> list[np.ndarray]:
    """The numbers below ``count`` in parts: every 64th, every 8th of the rest, the others.

    Where many nodes fall into few triangles, as along lines, this keeps the number of new triangles per node small; the
    other way round it does so when nodes are taken out.
    """
    if count <= 64:
        return [np.arange(count)]
    eighth = np.arange(0, count, 8)
    rest = np.arange(-(-count // 8) * 8).reshape(-1, 8)[:, 1:].ravel()
    return [eighth[::8], np.delete(eighth, np.s_[::8]), rest[: count - len(eighth)]]
