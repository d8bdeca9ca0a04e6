"""Triangulated irregular networks that grow: Delaunay triangulations updated where new vertices fall.

A batch of new vertices changes a Delaunay triangulation only inside their cavities: the triangles whose circumcircle
contains a new vertex. Three facts make an exact update out of ordinary Delaunay calls on small point sets, which run in
a thread pool and never look at the rest of the network:

* the cavity of one vertex is connected, holds no other vertex inside, and is found by walking over neighbours from the
  triangle that contains it;
* an edge from a new vertex p to an old one stays within the cavity of p, and an edge to another new vertex q crosses only
  triangles that belong to the cavity of p or of q (an empty circle through p and q and the circumcircle of a triangle
  that their segment crosses would otherwise meet in four points). So the Delaunay triangulation of "vertices of the cavity
  of p, and new vertices whose cavities touch it" contains every new triangle at p;
* triangles with old vertices only are either untouched or gone.

Taking vertices out changes only the triangles at them, and is done in the same way (:meth:`Tin.remove`).

The triangulation is made unique by moving every node, for triangulation and location only, by less than half a quantum
of the coordinates in a direction that its own coordinates decide (lidar coordinates are decimal, so that squares, which
have two Delaunay triangulations, are everywhere). So it does not depend on the order of the points, on threads or on the
history of the network.
"""

from __future__ import annotations

import copy
import dataclasses
import itertools
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, Delaunay

from ..core.cloud import QUANTUM

CHUNK = 4096
"""New vertices per Delaunay call: small sets are triangulated fastest, large ones repeat less along their seams."""
_SMALLEST_CHUNK = 512
_CROWD = 8
_ROOT = 4096


def perturbed(xy: np.ndarray) -> np.ndarray:
    """f64[n, 2] of local f32[n, >=2]: each position moved by less than half a quantum, decided by the position."""
    lattice = np.rint(xy[:, :2].astype(np.float64) / QUANTUM).astype(np.int64).view(np.uint64)
    h = lattice[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ lattice[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
    out = np.empty((len(xy), 2))
    for axis in range(2):  # finaliser of splitmix64: every input bit reaches every output bit
        h = (h ^ (h >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        h = (h ^ (h >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        h ^= h >> np.uint64(31)
        out[:, axis] = xy[:, axis] + ((h >> np.uint64(11)) * 2.0**-53 - 0.5) * QUANTUM
    return out


def delaunay(xy: np.ndarray) -> Delaunay:
    """Delaunay triangulation of f64[n, 2], centred first, with the tables that ``find_simplex`` needs already made."""
    local = xy - xy.mean(axis=0)
    tri = Delaunay(local)
    corner = local[tri.simplices]
    u, v = corner[:, 0] - corner[:, 2], corner[:, 1] - corner[:, 2]
    det = u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = np.where(det == 0, np.nan, 1.0 / det)
        table = np.empty((len(det), 3, 2))
        table[:, 0, 0], table[:, 0, 1] = v[:, 1] * inverse, -v[:, 0] * inverse
        table[:, 1, 0], table[:, 1, 1] = -u[:, 1] * inverse, u[:, 0] * inverse
    table[:, 2] = corner[:, 2]
    tri._transform = table  # the same as SciPy would make, without a LAPACK call for each triangle
    return tri


def _in_circle(xy: np.ndarray, triangles: np.ndarray, tri: np.ndarray, p: np.ndarray) -> np.ndarray:
    """bool[n]: node ``p`` lies strictly inside the circumcircle of the counter-clockwise triangle ``tri``."""
    px, py = xy[p].T
    (ax, ay), (bx, by), (cx, cy) = ((x - px, y - py) for x, y in (xy[corner].T for corner in triangles[tri].T))
    a, b, c = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    return a * (bx * cy - by * cx) - b * (ax * cy - ay * cx) + c * (ax * by - ay * bx) > 0


def _distinct(*parts: np.ndarray) -> np.ndarray:
    """Sorted distinct values of integer arrays that span a moderate range: a mask is faster than a sort."""
    low = min(int(p.min()) for p in parts if p.size)
    mask = np.zeros(max(int(p.max()) for p in parts if p.size) - low + 1, bool)
    for p in parts:
        mask[p - low] = True
    return np.flatnonzero(mask) + low


def _ranges(starts: np.ndarray, stops: np.ndarray) -> np.ndarray:
    """Concatenation of ``arange(start, stop)`` for every pair."""
    length = stops - starts
    total = int(length.sum())
    if total == 0:
        return np.zeros(0, np.int64)
    first = np.cumsum(length) - length
    return np.arange(total) + np.repeat(starts - first, length)


@dataclasses.dataclass
class _Patch:
    """New triangles of one chunk: kept triangles, their neighbours (-2 = elsewhere), and points located in them."""

    triangles: np.ndarray
    neighbours: np.ndarray
    located: np.ndarray
    inside: np.ndarray


class Tin:
    """Triangulations of one or several separate sheets over one pool of nodes.

    Attributes:
        xyz: f32[k, 3] local metres, all nodes that are or may become vertices, sheet by sheet, each sheet in canonical order
            (nodes that are near in this order should be near in the plane).
        sheet: i32[k], ascending.
        triangles: i32[t, 3] nodes, counter-clockwise; neighbours: i32[t, 3], the triangle opposite each vertex, -1 outside.
        vertex: bool[k], nodes that are vertices.
        where: i32[k], the triangle that contains each node that is not a vertex; -1 outside its sheet's hull.
    """

    def __init__(
        self, xyz: np.ndarray, sheet: np.ndarray, vertices: np.ndarray, pool: Executor, workers: int = 2
    ) -> None:
        """Triangulate ``vertices`` (i64, ascending; every sheet has three or more, not on a line) and locate the rest."""
        self.xyz = xyz
        self.sheet = sheet
        self.xy = perturbed(xyz)
        self.pool = pool
        self.workers = workers
        self.rebuilt = 0
        self.vertex = np.zeros(len(xyz), bool)
        self.where = np.full(len(xyz), -1, np.int32)
        self._stamp = np.full(len(xyz), np.iinfo(np.int32).max, np.int32)
        self._at = np.full(len(xyz), -1, np.int32)  # for each vertex one of its triangles
        self._build(np.asarray(vertices))

    def __len__(self) -> int:
        return len(self.triangles)

    def copies(self, sheets: np.ndarray, of_nodes: np.ndarray) -> tuple[Tin, np.ndarray]:
        """A network of its own whose i-th sheet is a copy of sheet ``sheets[i]`` of this one, i64[s].

        Sheets may be left out or repeated. Their nodes follow each other in the order of ``sheets``. ``of_nodes``, i32[k],
        holds a triangle for each node, or -1: the same for the copies comes back as well.
        """
        count = int(self.sheet[-1]) + 1
        node_start = np.searchsorted(self.sheet, np.arange(count + 1))
        tri_sheet = self.sheet[self.triangles[:, 0]]
        order = np.argsort(tri_sheet, kind="stable")
        tri_start = np.searchsorted(tri_sheet[order], np.arange(count + 1))
        rank = np.empty(len(order) + 1, np.int32)
        rank[order], rank[-1] = np.arange(len(order), dtype=np.int32), -1

        def taken(start: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            """Rows to take, which copy each belongs to, and by how much its rows have moved."""
            size = np.diff(start)[sheets]
            rows = _ranges(start[sheets], start[sheets] + size)
            return rows, np.repeat(np.arange(len(sheets)), size), np.cumsum(size) - size - start[sheets]

        nodes, sheet, node_shift = taken(node_start)
        tris, tri_copy, tri_shift = taken(tri_start)
        out = copy.copy(self)
        for name in ("xyz", "xy", "vertex", "_stamp"):
            setattr(out, name, getattr(self, name)[nodes])
        out.sheet = sheet.astype(np.int32)
        out.triangles = (self.triangles[order[tris]] + node_shift[tri_copy][:, None]).astype(np.int32)
        beside = rank[self.neighbours[order[tris]]]
        out.neighbours = np.where(beside < 0, -1, beside + tri_shift[tri_copy][:, None]).astype(np.int32)

        def pointed(table: np.ndarray, known: np.ndarray) -> np.ndarray:
            at = rank[np.where(known[nodes], table[nodes], -1)]
            return np.where(at < 0, -1, at + tri_shift[sheet]).astype(np.int32)

        out.where = pointed(self.where, ~self.vertex)
        out._at = pointed(self._at, self.vertex)
        return out, pointed(of_nodes, of_nodes >= 0)

    def _build(self, vertices: np.ndarray, root: int = _ROOT) -> None:
        """Triangulate from scratch: sheets with many vertices from a sparse root, into which the others are inserted."""
        self.vertex[:] = False
        bounds = np.searchsorted(self.sheet, np.arange(int(self.sheet[-1]) + 2))
        of_sheet = np.split(vertices, np.searchsorted(vertices, bounds[1:-1]))
        step = [max(1, len(v) // root) for v in of_sheet]
        roots = [np.union1d(v[::s], self._hull(v)) if s > 1 else v for v, s in zip(of_sheet, step, strict=True)]

        def one(job: tuple[np.ndarray, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            root, low, high = job
            mesh = delaunay(self.xy[root])
            inside = mesh.find_simplex(self.xy[low:high] - self.xy[root].mean(axis=0)).astype(np.int32)
            return root[mesh.simplices].astype(np.int32), mesh.neighbors, inside

        parts = list(self.pool.map(one, zip(roots, bounds[:-1], bounds[1:], strict=True)))
        shift = np.cumsum([0] + [len(p[0]) for p in parts])
        self.triangles = np.concatenate([p[0] for p in parts])
        self.neighbours = np.concatenate(
            [np.where(p[1] < 0, -1, p[1] + s) for p, s in zip(parts, shift[:-1], strict=True)]
        ).astype(np.int32)
        self.where[:] = np.concatenate(
            [np.where(p[2] < 0, -1, p[2] + s) for p, s in zip(parts, shift[:-1], strict=True)]
        )
        self.vertex[np.concatenate(roots)] = True
        self.where[self.vertex] = -1
        self._note(np.arange(len(self.triangles), dtype=np.int32))
        rest = vertices[~self.vertex[vertices]]
        if len(rest):
            self.insert(rest)

    def _hull(self, vertices: np.ndarray) -> np.ndarray:
        """The vertices on the convex hull, so that a root triangulation covers all that is to come."""
        xy = self.xy[vertices]
        return vertices[ConvexHull(xy - xy.mean(axis=0)).vertices]

    def insert(self, nodes: np.ndarray) -> np.ndarray:
        """Make nodes (i64, ascending, not vertices, at positions of their own, inside the hull) vertices.

        Returns bool[t]: the triangles that are new. ``where`` is up to date afterwards.
        """
        if len(nodes) == 0:
            return np.zeros(len(self.triangles), bool)
        nodes = np.asarray(nodes)
        if len(nodes) > CHUNK and len(nodes) > _CROWD * len(_distinct(self.where[nodes])):
            # Cavities are as large as the triangles: with many nodes in each, patches would overlap widely.
            sparse = np.zeros(len(nodes), bool)
            sparse[::_CROWD] = True
            early = self.insert(nodes[sparse])
            late = self.insert(nodes[~sparse])
            late[: len(early)] |= early
            return late
        cuts = np.flatnonzero(np.diff(self.sheet[nodes]) != 0) + 1
        size = min(CHUNK, max(_SMALLEST_CHUNK, -(-len(nodes) // self.workers)))
        starts = np.arange(0, len(nodes), size)
        edges = np.unique(np.concatenate([[0, len(nodes)], cuts, starts]))
        chunks = list(itertools.pairwise(edges))
        self._stamp[nodes] = np.arange(len(nodes), dtype=np.int32)

        found = list(self.pool.map(lambda start: self.cavities(nodes[start : start + size]), starts))
        owner, hit = (np.concatenate(part) for part in zip(*found, strict=True))
        if len(chunks) == len(found):
            cavities = [tri for _, tri in found]
        else:  # cavities of many sheets are found together, but patched one by one
            place = np.searchsorted(edges, self._stamp[owner], side="right")
            order = np.argsort(place, kind="stable")
            cavities = np.split(hit[order], np.searchsorted(place[order], np.arange(2, len(edges))))
        removed = _distinct(hit)
        gone = np.zeros(len(self.triangles) + 1, bool)  # the last is for -1, "none"
        gone[removed] = True
        self.vertex[nodes] = True
        moved = np.flatnonzero(gone[self.where])
        moved = moved[~self.vertex[moved]]
        corner = self.triangles[self.where[moved], 0]
        slot = np.empty(len(self.triangles), np.int32)  # only the places of removed triangles are ever read
        slot[removed] = np.arange(len(removed), dtype=np.int32)
        points_in = _by_cell(slot[self.where[moved]], moved, len(removed))
        new_at = _by_cell(slot[hit], owner, len(removed))

        def patch(job: tuple[tuple[int, int], np.ndarray]) -> _Patch:
            (low, high), tri = job
            rows = _distinct(tri)
            ring = self.neighbours[rows].ravel()
            ring = slot[_distinct(rows, ring[(ring >= 0) & gone[ring]])]
            return self._patch(rows, low, high, points_in(ring), new_at(ring))

        patches = list(self.pool.map(patch, zip(chunks, cavities, strict=True)))
        self._stamp[nodes] = np.iinfo(np.int32).max
        changed = self._stitch(removed, gone, patches, len(removed) + 2 * len(nodes))
        if changed is None:  # Qhull saw a tie where there is none: start again, from all vertices
            self.rebuilt += 1
            vertices = np.flatnonzero(self.vertex)
            self._build(vertices, root=len(vertices))
            return np.ones(len(self.triangles), bool)
        self.where[nodes] = -1
        self.where[moved] = -1
        for p in patches:
            self.where[p.located] = p.inside
        lost = self.where[moved] < 0
        if lost.any():  # in a triangle that reaches beyond the cavities of its own chunk
            rest = moved[lost]
            self.where[rest] = self.walk(self.xy[rest], self._at[corner[lost]], self.sheet[rest])
        return changed

    def remove(self, nodes: np.ndarray) -> np.ndarray:
        """Make vertices (i64, ascending, not on the hull of their sheet) ordinary nodes again, located in their triangles.

        The triangles at the vertices leave holes. Kept triangles stay Delaunay triangles, so the edges around a hole
        do too, and fill it: the Delaunay triangulation of the vertices around holes holds all triangles inside them.
        Returns bool[t]: the triangles that are new, or have another row than before.
        """
        nodes = np.asarray(nodes)
        if len(nodes) == 0:
            return np.zeros(len(self.triangles), bool)
        removed = self.around(nodes)
        gone = np.zeros(len(self.triangles) + 1, bool)  # the last is for -1, "none"
        gone[removed] = True
        self.vertex[nodes] = False
        self.where[nodes] = self._at[nodes]
        moved = np.flatnonzero(gone[self.where])
        slot = np.empty(len(self.triangles), np.int32)
        slot[removed] = np.arange(len(removed), dtype=np.int32)
        points_in = _by_cell(slot[self.where[moved]], moved, len(removed))
        holes = self._holes(removed, gone, slot)

        patches = list(self.pool.map(lambda rows: self._fill(removed[rows], gone, points_in(rows)), holes))
        changed = self._stitch(removed, gone, patches, len(removed) - 2 * len(nodes))
        if changed is None:
            self.rebuilt += 1
            vertices = np.flatnonzero(self.vertex)
            self._build(vertices, root=len(vertices))
            return np.ones(len(self.triangles), bool)
        self.where[moved] = -1
        for p in patches:
            self.where[p.located] = p.inside
        lost = moved[self.where[moved] < 0]
        if len(lost):
            kept = np.flatnonzero(self.vertex)
            near = kept[np.minimum(np.searchsorted(kept, lost), len(kept) - 1)]
            self.where[lost] = self.walk(self.xy[lost], self._at[near], self.sheet[lost])
        return changed

    def _holes(self, removed: np.ndarray, gone: np.ndarray, slot: np.ndarray) -> list[np.ndarray]:
        """Places in ``removed`` in parts of about a chunk, such that triangles that share an edge are in one part."""
        step = self.neighbours[removed]
        row, edge = np.nonzero((step >= 0) & gone[step])
        links = coo_array((np.ones(len(row), np.int8), (row, slot[step[row, edge]])), shape=(len(removed),) * 2)
        hole = connected_components(links, directed=False)[1]
        first = np.full(int(hole.max()) + 1, len(self.xy))
        np.minimum.at(first, hole, self.triangles[removed].min(axis=1))
        place = np.argsort(first[hole], kind="stable")  # near in canonical order, near in the plane
        new_hole = np.diff(first[hole[place]], prepend=-1) != 0
        part = np.searchsorted(np.flatnonzero(new_hole), np.arange(len(place)), side="right")
        size = min(CHUNK, max(_SMALLEST_CHUNK, -(-int(part[-1]) // self.workers)))
        return np.split(place, np.flatnonzero(np.diff((part - 1) // size)) + 1)

    def _fill(self, rows: np.ndarray, gone: np.ndarray, points: np.ndarray) -> _Patch:
        """New triangles in the holes that the triangles ``rows`` leave, which are whole holes."""
        corner = self.triangles[rows]
        nodes = _distinct(corner.ravel())
        nodes = nodes[self.vertex[nodes]]
        xy = self.xy[nodes]
        mesh = delaunay(xy)
        simplices = nodes[mesh.simplices]
        beyond = self.neighbours[rows]
        row, edge = np.nonzero((beyond < 0) | ~gone[beyond])
        k = len(self.xy)
        rim = np.sort(corner[row, (edge + 1) % 3].astype(np.int64) * k + corner[row, (edge + 2) % 3])
        ahead, behind = np.roll(simplices, -1, axis=1), np.roll(simplices, -2, axis=1)
        inner = _among(
            ahead * k + behind, rim
        )  # edge opposite each corner, counter-clockwise: the hole lies to its left
        row, edge = np.nonzero(~inner & ~_among(behind * k + ahead, rim) & (mesh.neighbors >= 0))
        links = coo_array((np.ones(len(row), np.int8), (row, mesh.neighbors[row, edge])), shape=(len(simplices),) * 2)
        region = connected_components(links, directed=False)[1]
        keep = np.isin(region, region[inner.any(axis=1)])
        rank = np.where(keep, np.cumsum(keep) - 1, -2).astype(np.int32)
        neighbours = np.where((mesh.neighbors < 0) | inner, -2, rank[mesh.neighbors])[keep]
        points = np.sort(points)
        cell = mesh.find_simplex(self.xy[points] - xy.mean(axis=0))
        cell = np.where(cell < 0, -2, rank[cell])
        mine = cell >= 0
        return _Patch(simplices[keep].astype(np.int32), neighbours, points[mine], cell[mine])

    def cavities(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """All pairs of a node and a triangle whose circumcircle contains it."""
        p, tri = nodes, self.where[nodes]
        parent = np.full(len(nodes), -1, np.int32)
        pairs = [(p, tri)]
        while len(p):
            step = self.neighbours[tri]
            row, edge = np.nonzero((step >= 0) & (step != parent[:, None]))
            reached = step[row, edge]
            inside = _in_circle(self.xy, self.triangles, reached, p[row])
            row = row[inside]
            parent, p, tri = tri[row], p[row], reached[inside]
            pairs.append((p, tri))
        return np.concatenate([p for p, _ in pairs]), np.concatenate([t for _, t in pairs])

    def _patch(self, rows: np.ndarray, low: int, high: int, points: np.ndarray, new: np.ndarray) -> _Patch:
        """Triangulate the vertices of cavities ``rows`` with the new nodes; keep the triangles that belong to this chunk.

        A triangle belongs to the chunk that holds its first new vertex.
        """
        nodes = _distinct(self.triangles[rows].ravel(), new)
        xy = self.xy[nodes]
        mesh = delaunay(xy)
        simplices = nodes[mesh.simplices]
        stamp = self._stamp[simplices]
        first = np.minimum(np.minimum(stamp[:, 0], stamp[:, 1]), stamp[:, 2])
        keep = (first >= low) & (first < high)
        rank = np.where(keep, np.cumsum(keep) - 1, -2).astype(np.int32)
        neighbours = np.where(mesh.neighbors < 0, -2, rank[mesh.neighbors])[keep]
        points = np.sort(points)
        cell = mesh.find_simplex(self.xy[points] - xy.mean(axis=0))
        cell = np.where(cell < 0, -2, rank[cell])
        mine = cell >= 0
        return _Patch(simplices[keep].astype(np.int32), neighbours, points[mine], cell[mine])

    def _stitch(
        self, removed: np.ndarray, gone: np.ndarray, patches: Sequence[_Patch], count: int
    ) -> np.ndarray | None:
        """Put the patches in the place of the removed triangles. None if they do not fit, with nothing changed.

        ``count``: how many triangles the patches must have together.
        """
        old_count = len(self.triangles)
        added = np.concatenate([p.triangles for p in patches])
        if count != len(added):
            return None
        more = np.arange(old_count, old_count + max(0, count - len(removed)))
        rows = np.concatenate([removed[:count], more]).astype(np.int32)
        shift = np.cumsum([0] + [len(p.triangles) for p in patches])
        links = np.concatenate(
            [np.where(p.neighbours < 0, -2, p.neighbours + s) for p, s in zip(patches, shift[:-1], strict=True)]
        )
        links = np.where(links < 0, -2, rows[np.maximum(links, 0)])

        # Open edges: of new triangles without a neighbour yet, and of old triangles that bordered a removed one.
        new_row, new_edge = np.nonzero(links == -2)
        beyond = self.neighbours[removed]
        hull_edges = int((beyond == -1).sum())
        rim = np.unique(beyond[(beyond >= 0) & ~gone[beyond]])
        rim_row, rim_edge = np.nonzero((self.neighbours[rim] >= 0) & gone[self.neighbours[rim]])
        tri = np.concatenate([rows[new_row], rim[rim_row]]).astype(np.int32)
        edge = np.concatenate([new_edge, rim_edge])
        corner = np.concatenate([added[new_row], self.triangles[rim[rim_row]]])
        pick = np.arange(len(edge))
        one, two = corner[pick, (edge + 1) % 3].astype(np.int64), corner[pick, (edge + 2) % 3].astype(np.int64)
        key = np.minimum(one, two) * len(self.xy) + np.maximum(one, two)
        order = np.argsort(key, kind="stable")
        key = key[order]
        pair = np.flatnonzero(key[1:] == key[:-1])
        if len(key) - 2 * len(pair) != hull_edges or (len(pair) > 1 and (np.diff(pair) < 2).any()):
            return None

        self._grow(old_count + len(more))
        self.triangles[rows] = added
        self._note(rows)
        self.neighbours[rows] = np.where(links == -2, -1, links)
        left, right = order[pair], order[pair + 1]
        self.neighbours[tri[left], edge[left]] = tri[right]
        self.neighbours[tri[right], edge[right]] = tri[left]
        for p, s in zip(patches, shift[:-1], strict=True):
            p.inside = rows[p.inside + s]
        changed = np.zeros(len(self.triangles), bool)
        changed[rows] = True
        return changed if count >= len(removed) else self._compact(removed[count:], changed, patches)

    def _compact(self, dead: np.ndarray, changed: np.ndarray, patches: Sequence[_Patch]) -> np.ndarray:
        """Move the last triangles into the rows ``dead`` (ascending), and shorten the tables. Returns ``changed`` so too."""
        old_count = len(self.triangles)
        count = old_count - len(dead)
        alive = np.ones(len(dead), bool)
        alive[dead[dead >= count] - count] = False
        source = (np.flatnonzero(alive) + count).astype(np.int32)
        target = dead[: len(source)]
        row = np.arange(old_count, dtype=np.int32)
        row[source] = target
        self.triangles[target] = self.triangles[source]
        self.neighbours[target] = self.neighbours[source]
        beside = self.neighbours[target].ravel()
        beside = np.unique(np.concatenate([target, row[beside[beside >= 0]]]))
        self.neighbours[beside] = np.where(self.neighbours[beside] < 0, -1, row[self.neighbours[beside]])
        for name in ("triangles", "neighbours"):
            setattr(self, name, getattr(self, name)[:count])
        for table in (self.where, self._at):
            high = np.flatnonzero((table >= count) & (table < old_count))  # others are out of use
            table[high] = row[table[high]]
        for p in patches:
            p.inside = row[p.inside]
        changed[target] = True
        return changed[:count]

    def _grow(self, count: int) -> None:
        """Make room for so many triangles; the tables are views of larger ones, so that few rounds copy them."""
        for name in ("triangles", "neighbours"):
            table = getattr(self, name)
            whole = table if table.base is None else table.base
            if len(whole) < count:
                whole = np.empty((count + count // 2, 3), np.int32)
                whole[: len(table)] = table
            setattr(self, name, whole[:count])

    def _note(self, rows: np.ndarray) -> None:
        """Remember triangles as those at their vertices."""
        self._at[self.triangles[rows].ravel()] = np.repeat(rows, 3)

    def around(self, vertices: np.ndarray) -> np.ndarray:
        """Rows of all triangles at the vertices; ascending."""
        return np.unique(np.concatenate([np.zeros(0, np.int32), *(tri for _, tri in self._turns(vertices))]))

    def any_around(self, vertices: np.ndarray, marked: np.ndarray) -> np.ndarray:
        """bool[n]: one of the triangles at each vertex is marked, bool[t]."""
        out = np.zeros(len(vertices), bool)
        for which, tri in self._turns(vertices):
            out[which] |= marked[tri]
        return out

    def first_around(self, vertices: np.ndarray) -> np.ndarray:
        """i32[n]: of the triangles at each vertex the one whose corners come first, whatever the history of the network."""
        best, rank = self._at[vertices], np.full((len(vertices), 3), len(self.xy), np.int64)
        for which, tri in self._turns(vertices):
            corner, least = np.sort(self.triangles[tri], axis=1), rank[which]
            differs = (corner != least).argmax(axis=1)[:, None]
            comes_first = (np.take_along_axis(corner, differs, 1) < np.take_along_axis(least, differs, 1))[:, 0]
            best[which[comes_first]], rank[which[comes_first]] = tri[comes_first], corner[comes_first]
        return best

    def _turns(self, vertices: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Places in ``vertices`` and a triangle at each, until all triangles at the vertices have come, some of them twice."""
        for side in (1, 2):  # one way, and the other in case the hull stopped it
            which, tri = np.arange(len(vertices)), self._at[vertices]
            first = tri
            while len(which):
                yield which, tri
                corner = (self.triangles[tri] == vertices[which, None]).argmax(axis=1)
                step = self.neighbours[tri, (corner + side) % 3]
                on = (step >= 0) & (step != first)
                which, tri, first = which[on], step[on], first[on]

    def walk(self, xy: np.ndarray, start: np.ndarray, sheet: np.ndarray) -> np.ndarray:
        """i32[n]: the triangle that contains each position f64[n, 2], walking from triangles ``start``; -1 outside."""
        tri = np.array(start, np.int32)
        wrong = self.sheet[self.triangles[tri, 0]] != sheet
        if wrong.any():
            by_sheet = self.sheet[self.triangles[:, 0]]
            order = np.argsort(by_sheet, kind="stable")
            tri[wrong] = order[np.searchsorted(by_sheet[order], sheet[wrong])]
        active = np.arange(len(tri))
        for _ in range(len(self.triangles)):
            here = tri[active]
            corner = self.xy[self.triangles[here]] - xy[active][:, None, :]
            ahead = np.roll(corner, -1, axis=1)
            turn = corner[:, :, 0] * ahead[:, :, 1] - corner[:, :, 1] * ahead[:, :, 0]  # edge k -> k+1
            worst = turn.argmin(axis=1)
            out = turn[np.arange(len(active)), worst] < -1e-9
            if not out.any():
                break
            step = self.neighbours[here[out], (worst[out] + 2) % 3]
            active = active[out]
            tri[active] = step
            active = active[step >= 0]
            if len(active) == 0:
                break
        return tri

    def corners(self, tri: np.ndarray) -> np.ndarray:
        """f32[n, 3, 3]: the vertices of triangles, local metres."""
        return self.xyz[self.triangles[tri]]

    def triangle_of_vertices(self) -> np.ndarray:
        """i32[k]: for each vertex one of its triangles; for other nodes the triangle that contains them."""
        return np.where(self.vertex, self._at, self.where)


def _among(values: np.ndarray, ascending: np.ndarray) -> np.ndarray:
    """bool of the shape of ``values``: those that are among the values of an ascending array that is not empty."""
    return ascending[np.minimum(np.searchsorted(ascending, values), len(ascending) - 1)] == values


def _by_cell(cell: np.ndarray, values: np.ndarray, count: int) -> Any:
    """A function from cell numbers to all values in these cells."""
    order = np.argsort(cell, kind="stable")
    sorted_values = values[order]
    start = np.concatenate([[0], np.cumsum(np.bincount(cell, minlength=count))])

    def pick(cells: np.ndarray) -> np.ndarray:
        return sorted_values[_ranges(start[cells], start[cells + 1])]

    return pick
