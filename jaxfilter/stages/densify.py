"""Progressive TIN densification: the one loop of all TIN methods.

Each round tests all open points whose facet has changed since they were last tested against one triangulation, accepts
all that pass, or the lowest over each facet, or as many as cannot influence each other, and makes them vertices; the order
of the points never matters.
A point whose facet has not changed would fail again, and is left alone, unless the thresholds were loosened. The network
may consist of several sheets (FPTD's blocks) that share nothing: their triangulations run in a thread pool, and one
padded kernel call a round tests the points of all sheets together.
"""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.sparse import coo_array
from scipy.spatial import cKDTree

from ..core.compilation import on_same_device
from ..core.grid import Grid
from ..core.result import Decision, Progress
from ..host.tin import Tin
from ..ops.facets import Rule, Verdict, judge, mirrored

_BATCHES = (2048, 16384, 65536)
"""Sizes that kernel calls are padded to; larger requests are cut."""
INSERTIONS = ("batch", "one_per_facet", "sequential")
"""What a round adds of the points that pass: all of them, the lowest over each facet (after Nie et al. 2017), or one after
the other from below, each as far as the vertices before it leave its facet alone."""
_SAMPLE = 65536
"""At most about so many quantities decide adaptive thresholds."""
_KEPT = ("accepted", "decision", "margin", "angle", "elevation", "distance", "height", "slope")


@dataclasses.dataclass(frozen=True, eq=False)
class Network:
    """What densification starts from: nodes of one or several sheets.

    Attributes:
        xyz: f32[k, 3], local metres, sheet by sheet, each in canonical order, simulated border nodes last.
        sheet: i32[k], ascending.
        row: i64[k], the point that each node is; -1 for simulated border nodes.
        seed: bool[k], ground from the start (border nodes too). Per sheet at least three, around all its nodes.
        open: bool[k], nodes to be classified in this sheet.
        late: bool[k], suspected low outliers: they take part when the others are done, and are tested on both sides.
    """

    xyz: np.ndarray
    sheet: np.ndarray
    row: np.ndarray
    seed: np.ndarray
    open: np.ndarray
    late: np.ndarray


@dataclasses.dataclass(frozen=True)
class Mirror:
    """Mirroring over steep facets (Axelsson 2000; Zhang & Lin 2013).

    ``slope``: degrees of facet slope above which a point is mirrored; ``about``: "highest" or "nearest" vertex,
    or "off"; ``mode``: "replace" tests the mirrored point only, "or" gives it as a second chance, with "and" both must pass.
    """

    slope: float
    about: str = "highest"
    mode: str = "replace"


@dataclasses.dataclass(frozen=True)
class Vertices:
    """Which ground points become vertices: the lowest in each cell of a grid, on finer and finer grids (Uray & Varlik 2024).

    A lower point that is accepted later takes the place of the vertex of its cell. The other ground points are none.

    Attributes:
        grids: from coarse to fine.
        stop_share: go on to the next grid, or end, when a round accepts fewer than this share of all points; below any
            share it still has to accept one. Infinity = one round on each grid.
    """

    grids: Sequence[Grid]
    stop_share: float = 0.0


@dataclasses.dataclass(frozen=True)
class Adaptive:
    """Thresholds that follow the ground found so far.

    Attributes:
        rule: from unsigned distances f32[s], metres, and angles f32[s], degrees, to thresholds. Not called without any.
        sample: "ground" = of ground points that are no vertices, in their facets; "neighbours" = of vertices over the plane
            of the facet beyond the edge opposite them (a sample of them, which does not depend on the order of points).
        every: "round", or "grid" = each time that :class:`Vertices` change to a finer grid.
    """

    rule: Callable[[np.ndarray, np.ndarray], Rule]
    sample: str = "neighbours"
    every: str = "round"


@dataclasses.dataclass(eq=False)
class Densified:
    """Outcome per node; quantities are those of the last test, ``height`` and ``slope`` are over the final surface."""

    ground: np.ndarray
    height: np.ndarray
    slope: np.ndarray
    angle: np.ndarray
    elevation: np.ndarray
    margin: np.ndarray
    decision: np.ndarray
    converged: bool
    trace: list[dict[str, Any]]
    facets: int
    vertices: int


def densify(
    network: Network,
    rule: Rule,
    *,
    mirror: Mirror | None = None,
    refresh_border: bool = False,
    vertex_spacing: float = 0.0,
    vertices: Vertices | None = None,
    adaptive: Adaptive | None = None,
    review: bool = False,
    insertion: str = "batch",
    border_in_tests: bool = True,
    max_rounds: int = 100,
    workers: int | None = None,
    progress: Progress = lambda fraction, step: None,
    keep_labels: bool = False,
) -> Densified:
    """Grow the ground from the seeds until nothing is added.

    Args:
        rule: thresholds.
        mirror: mirror points over steep facets; None = never.
        refresh_border: after each round give every simulated border node the elevation of the ground vertex nearest to it
            in the plane (Li et al. 2021, Sec. II-E, step 6).
        vertex_spacing: metres; at most one accepted point per square of this size becomes a vertex, the lowest. 0 = all do.
        vertices: which points become vertices; None = all, but for ``vertex_spacing``. Not with ``refresh_border``.
        adaptive: how thresholds change as the ground grows; None = they are constant.
        review: at the end test all points but the vertices once more; ground points that fail lose their label.
        insertion: one of :data:`INSERTIONS`. "one_per_facet" adds, of the points over a facet that pass and may become
            vertices, the one that lies lowest over it; the others are tested again over the new facets. "sequential" goes
            through the lowest of each facet from below (of equals, the first in order) and adds a point unless one that
            was added before it changes the facet, or mirror facet, that it passed in; so each passes in the triangulation
            of all before it, as if they were inserted one by one. The others are tested again. Not with ``vertices``.
        border_in_tests: simulated border nodes can be the nearest and the highest vertex of a facet; if not, they only
            carry its plane.
        max_rounds: give up after so many rounds.
        keep_labels: record the labels after every round in the trace.
    """
    threads = workers or os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        run = Growth(
            network,
            rule,
            mirror,
            refresh_border,
            vertex_spacing,
            vertices,
            adaptive,
            insertion,
            pool,
            threads,
            keep_labels,
            border_in_tests,
        )
        return run.run(max_rounds, progress, review)


class Growth:
    """One densification under way."""

    batches: tuple[int, ...] = _BATCHES

    def __init__(
        self,
        network: Network,
        rule: Rule,
        mirror: Mirror | None,
        refresh_border: bool,
        vertex_spacing: float,
        vertices: Vertices | None,
        adaptive: Adaptive | None,
        insertion: str,
        pool: ThreadPoolExecutor,
        threads: int,
        keep_labels: bool,
        border_in_tests: bool,
    ) -> None:
        k = len(network.xyz)
        self.net, self.pool, self.keep_labels = network, pool, keep_labels
        self.insertion, self.border_in_tests = insertion, border_in_tests
        self.mirror = None if mirror is None or mirror.about == "off" else mirror
        self.rule = Rule(*(jnp.float32(v) for v in rule))
        self.ground = network.seed.copy()
        self.virtual = np.flatnonzero(network.row < 0)
        self.head = _same_position(network.xyz, network.sheet)
        self._find_shared()
        self.vertex_at = np.full(k, -1, np.int64)  # per head: the node that stands for this position in the network
        self.square = _squares(network, vertex_spacing) if vertex_spacing > 0 else None
        self.taken = np.zeros(0 if self.square is None else int(self.square.max(initial=-1)) + 1, bool)
        self.adaptive = adaptive
        self.stop_share = vertices.stop_share if vertices else 0.0
        self.finer = list(vertices.grids) if vertices else []
        self.lowest: np.ndarray | None = None  # per cell of the grid: its vertex, or -1
        if vertices:
            self._next_grid()
            seeds = np.sort(np.concatenate([self._lowest(np.flatnonzero(network.seed))[1], self.virtual]))
        else:
            seeds = self._to_insert(np.flatnonzero(network.seed))
        self.tin = Tin(network.xyz.copy(), network.sheet, seeds, pool, threads)
        self.refresh_border = refresh_border and len(self.virtual) > 0
        self.border_gap = np.full(len(self.virtual), np.inf)
        self._refresh(seeds[network.row[seeds] >= 0])
        nan = np.full(k, np.nan, np.float32)
        self.angle, self.elevation, self.margin = nan.copy(), nan.copy(), nan.copy()
        self.image_in = np.full(k, -1, np.int32)  # the facet that the mirror image of a point was tested in
        untested = np.where(network.open, Decision.ANGLE, Decision.SET_ASIDE)
        self.decision = np.where(network.seed, Decision.SEED, untested).astype(np.uint8)
        self.trace: list[dict[str, Any]] = []

    def run(self, max_rounds: int, progress: Progress, review: bool) -> Densified:
        """Rounds until no point is accepted, first without the suspected low outliers, then with them."""
        waiting = self.net.open & ~self.ground
        total = max(1, int(waiting.sum()))
        enough = self.stop_share * int((self.net.row >= 0).sum())
        todo = rest = np.flatnonzero(waiting & ~self.net.late)
        all_admitted = not self.net.late.any()
        self._adapt("round")
        converged = False
        for _ in range(max_rounds):
            progress(1.0 - len(rest) / total, "densify")
            accepted, deferred = self._test(todo)
            self.ground[accepted] = True
            waiting[accepted] = False
            changed, inserted = self._grow(accepted)
            self.trace.append({"tested": len(todo), "accepted": len(accepted), "inserted": inserted})
            self.trace[-1] |= {"facets": len(self.tin)}
            if self.lowest is not None:
                self.trace[-1]["cell"] = self.cell
            if self.adaptive is not None:  # the limits that were applied
                self.trace[-1] |= {name: float(getattr(self.rule, name)) for name in ("max_distance", "max_angle")}
            if self.keep_labels:
                self.trace[-1]["ground"] = self.ground.copy()
            loosened = self._adapt("round")
            rest = rest[waiting[rest]]
            todo = rest[loosened | self._again(rest, deferred, changed)]
            done = len(accepted) + len(deferred) < enough
            while self.finer and (done or len(todo) == 0):
                done = False
                changed = _either(changed, self._refine())
                loosened |= self._adapt("grid")
                todo = rest[loosened | self._again(rest, deferred, changed)]
            if done:
                todo = rest[:0]
            if len(todo) == 0 and not all_admitted:
                all_admitted = True
                todo = np.flatnonzero(waiting & self.net.late)
                rest = np.flatnonzero(waiting)
            if len(todo) == 0:
                converged = True
                break
        if review:
            self._review()
        progress(1.0, "densify")
        return self._result(converged)

    def _again(self, rest: np.ndarray, deferred: np.ndarray, changed: np.ndarray) -> np.ndarray:
        """bool[.]: nodes to test again: their facet, or that of their mirror image, has changed, or they were put off."""
        again = changed[self.tin.where[rest]]
        again[np.searchsorted(rest, deferred)] = True
        place, vertex = self._at_vertex(rest)
        again[place] |= self.tin.any_around(vertex, changed)
        if self.mirror is not None:
            image = self.image_in[rest]
            again |= (image >= 0) & np.append(changed, True)[np.minimum(image, len(changed))]
        return again

    def _grow(self, accepted: np.ndarray) -> tuple[np.ndarray, int]:
        """Bring accepted nodes into the network: bool[t], the triangles that changed, and how many vertices are new."""
        if self.lowest is not None:
            replaced, inserted = self._lowest(accepted)
            return self._exchange(replaced, inserted), len(inserted)
        inserted = self._to_insert(accepted)
        changed = self.tin.insert(inserted)
        moved = np.concatenate([self._refresh(inserted), self._lower(accepted)])
        changed[self.tin.around(moved)] = True
        return changed, len(inserted)

    def _exchange(self, old: np.ndarray, new: np.ndarray) -> np.ndarray:
        """bool[t]: the triangles that changed as vertices ``old`` gave way to ``new``."""
        changed = self.tin.remove(old)
        return _either(changed, self.tin.insert(new))

    def _next_grid(self) -> None:
        grid = self.finer.pop(0)
        self.cell = grid.cell
        sheet = self.net.sheet.astype(np.int64) * (grid.nx * grid.ny)
        self.square = np.where(self.net.row < 0, -1, sheet + grid.flat(self.net.xyz))
        self.lowest = np.full(int(self.square.max(initial=-1)) + 1, -1, np.int64)

    def _refine(self) -> np.ndarray:
        """Change to the next grid; bool[t], the triangles that changed."""
        self._next_grid()
        before = self.tin.vertex
        after = np.zeros_like(before)
        after[self.virtual] = True
        after[self._lowest(np.flatnonzero(self.ground))[1]] = True
        return self._exchange(np.flatnonzero(before & ~after), np.flatnonzero(after & ~before))

    def _lowest(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Vertices that must go because one of the nodes (ascending) is lower in their cell, and the nodes that become
        vertices."""
        assert self.square is not None and self.lowest is not None
        nodes = nodes[self._undercuts(nodes)]
        at, z = self.square[nodes], self.net.xyz[nodes, 2]
        low = np.full(len(self.lowest), np.inf, np.float32)
        np.minimum.at(low, at, z)
        least = z == low[at]
        nodes, at = nodes[least], at[least]
        before = self.lowest.copy()
        self.lowest[at[::-1]] = nodes[::-1]  # of equals the first in order is written last, and stays
        new = self.lowest[at] == nodes
        replaced = before[at[new]]
        return np.sort(replaced[replaced >= 0]), nodes[new]

    def _undercuts(self, nodes: np.ndarray) -> np.ndarray:
        """bool[.]: nodes that lie in a cell without a vertex, or are lower than it (of equals, the first in order)."""
        assert self.square is not None and self.lowest is not None
        at = self.square[nodes]
        vertex = self.lowest[at]
        z, vertex_z = self.net.xyz[nodes, 2], self.net.xyz[vertex, 2]
        return (at >= 0) & ((vertex < 0) | (z < vertex_z) | ((z == vertex_z) & (nodes < vertex)))

    def _adapt(self, moment: str) -> bool:
        """Make new thresholds if it is the moment for it; whether any is looser than before."""
        if self.adaptive is None or self.adaptive.every != moment:
            return False
        distance, angle = getattr(self, f"_over_{self.adaptive.sample}")()
        if len(distance) == 0:
            return False
        before, self.rule = self.rule, Rule(*(jnp.float32(v) for v in self.adaptive.rule(distance, angle)))
        return any(float(new) > float(old) for new, old in zip(self.rule, before, strict=True))

    def _over_ground(self) -> tuple[np.ndarray, np.ndarray]:
        """Unsigned distances and angles of the ground points that are no vertices, in their facets."""
        nodes = np.flatnonzero(self.ground & ~self.tin.vertex)
        found = self._judge(nodes, self._facets(nodes))
        return np.abs(found["distance"]), np.abs(found["angle"])

    def _over_neighbours(self) -> tuple[np.ndarray, np.ndarray]:
        """Unsigned distances and angles of vertices over the facets across the edge from them; simulated ones left out."""
        tin = self.tin
        a, b, c = tin.triangles.T
        step = max(1, 3 * len(tin) // _SAMPLE)
        rows = np.flatnonzero(np.minimum(np.minimum(a, b), c) % step == 0)  # by nodes: rows depend on the history
        corner = np.sort(tin.triangles[rows], axis=1)
        inner = (self.net.row[corner] >= 0).all(axis=1)
        rows, corner = rows[inner], corner[inner]
        beyond = tin.neighbours[rows]
        row, edge = np.nonzero(beyond >= 0)
        there = beyond[row, edge]
        apex = tin.triangles[there, (tin.neighbours[there] == rows[row, None]).argmax(axis=1)]
        real = self.net.row[apex] >= 0
        found = self._score(apex[real], corner[row[real]])
        return np.abs(found["distance"]), np.abs(found["angle"])

    def _review(self) -> None:
        """Test all points but the vertices against the final network; labels are those of this test."""
        nodes = np.flatnonzero((self.net.row >= 0) & self.net.open & ~self.tin.vertex)
        before = self.ground[nodes]
        self.ground[nodes] = False
        insertion, self.insertion = self.insertion, "batch"
        passed, _ = self._test(nodes)
        self.insertion = insertion
        self.ground[passed] = True
        after = self.ground[nodes]
        self.trace.append({"tested": len(nodes), "accepted": int((after & ~before).sum()), "inserted": 0})
        self.trace[-1] |= {"revoked": int((before & ~after).sum()), "facets": len(self.tin)}
        if self.keep_labels:
            self.trace[-1]["ground"] = self.ground.copy()

    def _test(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Test nodes against their facets, keep the tested quantities, and return those accepted and those deferred."""
        facet = self._facets(nodes)
        verdict = self._judge(nodes, facet)
        if self.mirror is not None and self.mirror.slope < 90.0:
            self._mirror(nodes, facet, verdict)
        self.angle[nodes] = verdict["angle"]
        self.elevation[nodes] = verdict["elevation"]
        self.margin[nodes] = verdict["margin"]
        self.decision[nodes] = verdict["decision"]
        passed = np.flatnonzero(verdict["accepted"])
        if self.insertion == "batch":
            return nodes[passed], nodes[:0]
        put_off = self._put_off(nodes[passed], facet[passed], verdict["height"][passed])
        return nodes[passed[~put_off]], nodes[passed[put_off]]

    def _put_off(self, nodes: np.ndarray, facet: np.ndarray, height: np.ndarray) -> np.ndarray:
        """bool[n]: nodes that pass and could become vertices, but must wait for others (see ``insertion``)."""
        if self.lowest is not None:
            free = self._undercuts(nodes)
        else:
            free = self.vertex_at[self.head[nodes]] < 0
            if self.square is not None:
                free &= ~self.taken[self.square[nodes]]
        free = np.flatnonzero(free)
        level = self.net.xyz[nodes, 2] if self.insertion == "sequential" else height
        order = free[np.lexsort((nodes[free], level[free], facet[free]))]
        put_off = np.zeros(len(nodes), bool)
        put_off[order] = np.diff(facet[order], prepend=-1) == 0
        if self.insertion == "sequential":
            first = order[~put_off[order]]
            first = first[np.lexsort((nodes[first], level[first]))]
            put_off[first] = ~self._apart(nodes[first], facet[first])
        return put_off

    def _apart(self, nodes: np.ndarray, facet: np.ndarray) -> np.ndarray:
        """bool[n]: nodes that can be inserted together, those that come first before others.

        Two cannot if one of them changes a facet that the other has passed in, i32[n] or that of its mirror image. So each
        node passes in the triangulation with any of the others in it. Nodes are taken like this: those without a rival
        that is left and comes before them; their rivals leave; and so on.
        """
        n, size = len(nodes), len(self.tin)
        number = np.arange(n)
        owner, changed = self.tin.cavities(nodes)
        by_node = np.argsort(nodes)
        owner = by_node[np.searchsorted(nodes, owner, sorter=by_node)]
        image = self.image_in[nodes]
        mirrored_too = image >= 0
        who, where = np.append(number, number[mirrored_too]), np.append(facet, image[mirrored_too])
        changes = coo_array((np.ones(len(owner)), (owner, changed)), shape=(n, size)).tocsr()
        relies = coo_array((np.ones(len(who)), (who, where)), shape=(n, size)).tocsr()
        touches = changes @ relies.T
        one, other = (touches + touches.T).nonzero()
        one, other = one[one != other], other[one != other]
        taken, left = np.zeros(n, bool), np.ones(n, bool)
        while left.any():
            before = np.full(n, n)
            np.minimum.at(before, one, np.where(left, number, n)[other])
            chosen = left & (number < before)
            taken |= chosen
            left &= ~chosen
            left[other[chosen[one]]] = False
        return taken

    def _mirror(self, nodes: np.ndarray, facet: np.ndarray, verdict: dict[str, np.ndarray]) -> None:
        """Test points over steep facets at their mirror position as well, or instead; outside the hull nothing changes.

        Where a second test cannot change the outcome it is left out.
        """
        assert self.mirror is not None
        mode = self.mirror.mode
        self.image_in[nodes] = -1
        of_use = verdict["slope"] > self.mirror.slope
        if mode != "replace":
            of_use &= verdict["accepted"] == (mode == "and")
        steep = np.flatnonzero(of_use)
        if len(steep) == 0:
            return
        facet = facet[steep]
        image = np.empty((len(steep), 3), np.float32)
        for start in range(0, len(steep), self.batches[-1]):
            part = slice(start, start + self.batches[-1])
            pair = self.net.xyz[nodes[steep[part]]], self.tin.corners(facet[part])
            found = mirrored(*(self._padded(v) for v in pair), self.mirror.about == "highest")
            image[part] = np.asarray(found)[: len(pair[0])]
        there = self.tin.walk(image[:, :2].astype(np.float64), facet, self.net.sheet[nodes[steep]])
        steep, image, there = steep[there >= 0], image[there >= 0], there[there >= 0]
        self.image_in[nodes[steep]] = there
        second = self._judge(nodes[steep], there, image)
        replace = second["accepted"] | (mode != "or")
        for name in ("accepted", "decision", "margin", "angle", "elevation"):
            verdict[name][steep[replace]] = second[name][replace]

    def _find_shared(self) -> None:
        """Find the positions with several nodes: bool[k], whether a node has company; and the nodes that do, by position."""
        alone = np.ones(len(self.head), bool)
        alone[1:] = self.head[1:] != self.head[:-1]  # nodes at one position follow each other
        self.shares = ~alone
        self.shares[:-1] |= ~alone[1:]
        self.shared = np.flatnonzero(self.shares)
        self.position = np.cumsum(alone[self.shared]) - 1

    def _at_vertex(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Places of the nodes that lie exactly at the position of a vertex, and these vertices."""
        place = np.flatnonzero(self.shares[nodes])
        if len(place) == 0:
            return place, place
        vertex = np.full(int(self.position[-1]) + 1, -1)
        here = self.tin.vertex[self.shared]
        vertex[self.position[here]] = self.shared[here]
        found = vertex[self.position[np.searchsorted(self.shared, nodes[place])]]
        other = (found >= 0) & (found != nodes[place])
        return place[other], found[other]

    def _facets(self, nodes: np.ndarray) -> np.ndarray:
        """i32[n]: the facets that contain the nodes. At a vertex all its facets do; the first of them is taken."""
        facet = self.tin.where[nodes]
        place, vertex = self._at_vertex(nodes)
        facet[place] = self.tin.first_around(vertex)
        return facet

    def _judge(self, nodes: np.ndarray, facet: np.ndarray, image: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """Test nodes, or ``image`` f32[n, 3] in their place, in facets i32[n]; the quantities on the host."""

        def one(part: slice) -> tuple[np.ndarray, ...]:
            xyz = self.net.xyz[nodes[part]] if image is None else image[part]
            given = self.net.late[nodes[part]], xyz, self.tin.corners(facet[part])
            if self.border_in_tests:
                return given
            return *given, self.net.row[self.tin.triangles[facet[part]]] >= 0

        return self._kernel(nodes, one)

    def _score(self, nodes: np.ndarray, corner: np.ndarray) -> dict[str, np.ndarray]:
        """Quantities of nodes over the planes through nodes i32[n, 3]."""

        def one(part: slice) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
            return self.net.late[nodes[part]], self.tin.xyz[nodes[part]], self.tin.xyz[corner[part]]

        return self._kernel(nodes, one)

    def _kernel(self, nodes: np.ndarray, arguments: Callable[[slice], tuple[np.ndarray, ...]]) -> dict[str, np.ndarray]:
        """The tests of nodes; ``arguments`` gives what is tested of a part of them.

        Calls are cut and padded to a few sizes, so that nothing is compiled twice, and prepared in the thread pool.
        """
        n, most = len(nodes), self.batches[-1]

        def one(start: int) -> dict[str, np.ndarray]:
            stop = min(n, start + most)
            part = slice(start, stop)
            verdict = self._verdict(nodes[part], *(self._padded(v) for v in arguments(part)))
            values = {**verdict._asdict(), **verdict.score._asdict()}
            return {name: np.asarray(values[name])[: stop - start] for name in _KEPT}

        parts = list(self.pool.map(on_same_device(one), range(0, max(n, 1), most)))
        return {name: np.concatenate([part[name] for part in parts]) for name in _KEPT}

    def _verdict(self, nodes: np.ndarray, *arguments: np.ndarray) -> Verdict:
        """What the thresholds of the nodes say of the padded arguments of the kernel."""
        return judge(self.rule, *arguments)

    def _padded(self, values: np.ndarray) -> np.ndarray:
        """The values with zeros behind them, up to the next of the batch sizes."""
        size = next(b for b in self.batches if b >= len(values))
        out = np.zeros((size, *values.shape[1:]), values.dtype)
        out[: len(values)] = values
        return out

    def _to_insert(self, nodes: np.ndarray) -> np.ndarray:
        """Those of the nodes that become vertices: one per position, and one per square if vertices keep a spacing."""
        nodes = nodes[self.vertex_at[self.head[nodes]] < 0]
        if len(nodes) == 0:
            return nodes
        first = np.ones(len(nodes), bool)
        first[1:] = np.diff(self.head[nodes]) != 0  # canonical order: equal positions follow each other, lowest first
        nodes = nodes[first]
        if self.square is not None:
            real = self.square[nodes] >= 0
            bound = nodes[real]
            order = np.lexsort((bound, self.net.xyz[bound, 2], self.square[bound]))
            square = self.square[bound[order]]
            free = ~self.taken[square]
            free[1:] &= np.diff(square) != 0
            bound = bound[order[free]]
            self.taken[self.square[bound]] = True
            nodes = np.sort(np.concatenate([nodes[~real], bound]))
        self.vertex_at[self.head[nodes]] = nodes
        return nodes

    def _lower(self, accepted: np.ndarray) -> np.ndarray:
        """i64[.]: vertices whose elevation sank because a lower point at the same position was accepted."""
        vertex = self.vertex_at[self.head[accepted]]
        z = self.net.xyz[accepted, 2]
        lower = (vertex >= 0) & (vertex != accepted)
        lower[lower] = z[lower] < self.tin.xyz[vertex[lower], 2]
        np.minimum.at(self.tin.xyz[:, 2], vertex[lower], z[lower])
        return vertex[lower]

    def _refresh(self, inserted: np.ndarray) -> np.ndarray:
        """i64[.]: border nodes that took the elevation of a newly inserted vertex, now the nearest to them."""
        none = self.virtual[:0]
        if not self.refresh_border or len(inserted) == 0:
            return none
        border, reach = self.tin.xy[self.virtual], float(self.border_gap.max())
        low, high = border.min(axis=0) + reach, border.max(axis=0) - reach
        xy = self.tin.xy[inserted]
        close = ((xy <= low) | (xy >= high)).any(axis=1) if np.isfinite(reach) else np.ones(len(xy), bool)
        if not close.any():
            return none
        inserted = inserted[close]
        apart = 1e7 * self.net.sheet.astype(np.float64)  # sheets lie in one tree, far from each other
        tree = cKDTree(np.column_stack([self.tin.xy[inserted], apart[inserted]]))
        gap, at = tree.query(np.column_stack([border, apart[self.virtual]]))
        nearer = gap < np.minimum(self.border_gap, 1e6)
        self.border_gap[nearer] = gap[nearer]
        node, z = self.virtual[nearer], self.tin.xyz[inserted[at[nearer]], 2]
        moved = node[self.tin.xyz[node, 2] != z]
        self.tin.xyz[node, 2] = z
        return moved

    def _result(self, converged: bool) -> Densified:
        nodes = np.flatnonzero(self.net.row >= 0)
        final = self._judge(nodes, self.tin.triangle_of_vertices()[nodes])
        k = len(self.ground)
        height, slope = np.zeros(k, np.float32), np.zeros(k, np.float32)
        height[nodes], slope[nodes] = final["height"], final["slope"]
        height[self.tin.vertex] = self.net.xyz[self.tin.vertex, 2] - self.tin.xyz[self.tin.vertex, 2]
        return Densified(
            ground=self.ground,
            height=height,
            slope=slope,
            angle=self.angle,
            elevation=self.elevation,
            margin=self.margin,
            decision=self.decision,
            converged=converged,
            trace=self.trace,
            facets=len(self.tin),
            vertices=int(self.tin.vertex.sum()),
        )


def _either(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """bool[t]: triangles changed by two steps in a row; ``after`` has the number of triangles that there are now."""
    both = min(len(before), len(after))
    after[:both] |= before[:both]
    return after


def _same_position(xyz: np.ndarray, sheet: np.ndarray) -> np.ndarray:
    """i64[k]: for every node the first node of its sheet at the same x and y (they are consecutive)."""
    first = np.ones(len(xyz), bool)
    if len(xyz) > 1:
        first[1:] = (xyz[1:, 0] != xyz[:-1, 0]) | (xyz[1:, 1] != xyz[:-1, 1]) | (sheet[1:] != sheet[:-1])
    return np.maximum.accumulate(np.where(first, np.arange(len(xyz)), 0))


def _squares(network: Network, spacing: float) -> np.ndarray:
    """i64[k]: number of the square of this size that each node lies in, per sheet; -1 for border nodes."""
    cell = np.floor(network.xyz[:, :2] / np.float32(spacing)).astype(np.int64)
    cell -= cell.min(axis=0)
    nx, ny = cell.max(axis=0) + 1
    key = (network.sheet.astype(np.int64) * ny + cell[:, 1]) * nx + cell[:, 0]
    if key.max() > 8 * len(key):
        key = np.unique(key, return_inverse=True)[1]
    return np.where(network.row < 0, -1, key)
