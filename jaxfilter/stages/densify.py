"""Progressive TIN densification: the one loop of all TIN methods.

Each round tests all open points whose facet has changed since they were last tested against one triangulation, accepts
all that pass, or the lowest over each facet, and makes them vertices; either way the order of the points does not matter.
A point whose facet has not changed would fail again, and is left alone. The network may consist of several sheets (FPTD's
blocks) that share nothing: their triangulations run in a thread pool, and one padded kernel call a round tests the points
of all sheets together.
"""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax.numpy as jnp
import numpy as np
from scipy.spatial import cKDTree

from ..core.result import Decision, Progress
from ..host.tin import Tin
from ..ops.facets import Rule, Verdict, judge, mirrored

_BATCHES = (2048, 16384, 65536)
"""Sizes that kernel calls are padded to; larger requests are cut."""
INSERTIONS = ("batch", "one_per_facet")
"""What a round adds of the points that pass: all of them, or the lowest over each facet (after Nie et al. 2017)."""
_KEPT = ("accepted", "decision", "margin", "angle", "elevation", "height", "slope")


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

    ``slope``: degrees of facet slope above which a point is mirrored; ``about``: "highest" or "nearest" vertex;
    ``mode``: "replace" tests the mirrored point only, "or" gives it as a second chance.
    """

    slope: float
    about: str = "highest"
    mode: str = "replace"


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
    insertion: str = "batch",
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
        insertion: one of :data:`INSERTIONS`. "one_per_facet" adds, of the points over a facet that pass and may become
            vertices, the one that lies lowest over it; the others are tested again over the new facets.
        max_rounds: give up after so many rounds.
        keep_labels: record the labels after every round in the trace.
    """
    threads = workers or os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        run = _Run(network, rule, mirror, refresh_border, vertex_spacing, insertion, pool, threads, keep_labels)
        return run.run(max_rounds, progress)


class _Run:
    """One densification under way."""

    def __init__(
        self,
        network: Network,
        rule: Rule,
        mirror: Mirror | None,
        refresh_border: bool,
        vertex_spacing: float,
        insertion: str,
        pool: ThreadPoolExecutor,
        threads: int,
        keep_labels: bool,
    ) -> None:
        k = len(network.xyz)
        self.net, self.mirror, self.pool, self.keep_labels = network, mirror, pool, keep_labels
        self.rule = Rule(*(jnp.float32(v) for v in rule))
        self.ground = network.seed.copy()
        self.virtual = np.flatnonzero(network.row < 0)
        self.head = _same_position(network.xyz, network.sheet)
        self.vertex_at = np.full(k, -1, np.int64)  # per head: the node that stands for this position in the network
        self.square = _squares(network, vertex_spacing) if vertex_spacing > 0 else None
        self.taken = np.zeros(0 if self.square is None else int(self.square.max(initial=-1)) + 1, bool)
        seeds = self._to_insert(np.flatnonzero(network.seed))
        self.tin = Tin(network.xyz.copy(), network.sheet, seeds, pool, threads)
        self.one_per_facet = insertion == "one_per_facet"
        self.refresh_border = refresh_border and len(self.virtual) > 0
        self.border_gap = np.full(len(self.virtual), np.inf)
        self._refresh(seeds[network.row[seeds] >= 0])
        nan = np.full(k, np.nan, np.float32)
        self.angle, self.elevation, self.margin = nan.copy(), nan.copy(), nan.copy()
        self.steep = np.zeros(k, bool)
        self.decision = np.where(network.seed, Decision.SEED, Decision.ANGLE).astype(np.uint8)
        self.trace: list[dict[str, Any]] = []

    def run(self, max_rounds: int, progress: Progress) -> Densified:
        """Rounds until no point is accepted, first without the suspected low outliers, then with them."""
        waiting = self.net.open & ~self.ground
        total = max(1, int(waiting.sum()))
        todo = rest = np.flatnonzero(waiting & ~self.net.late)
        all_admitted = not self.net.late.any()
        mirroring = self.mirror is not None
        converged = False
        for _ in range(max_rounds):
            progress(1.0 - len(rest) / total, "densify")
            accepted, deferred = self._test(todo)
            self.ground[accepted] = True
            waiting[accepted] = False
            inserted = self._to_insert(accepted)
            self.trace.append({"tested": len(todo), "accepted": len(accepted), "inserted": len(inserted)})
            if self.keep_labels:
                self.trace[-1]["ground"] = self.ground.copy()
            changed = self.tin.insert(inserted) if len(inserted) else np.zeros(len(self.tin), bool)
            moved = np.concatenate([self._refresh(inserted), self._lower(accepted)])
            changed[self.tin.around(moved)] = True
            rest = rest[waiting[rest]]
            again = changed[self.tin.where[rest]]
            again[np.searchsorted(rest, deferred)] = True
            if mirroring and changed.any():
                again |= self.steep[rest]  # the facet under their mirror image may be another one
            todo = rest[again]
            if len(todo) == 0 and not all_admitted:
                all_admitted = True
                todo = np.flatnonzero(waiting & self.net.late)
                rest = np.flatnonzero(waiting)
            if len(todo) == 0:
                converged = True
                break
        progress(1.0, "densify")
        return self._result(converged)

    def _test(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Test nodes against their facets, keep the tested quantities, and return those accepted and those deferred."""
        verdict = self._judge(nodes, self.tin.where[nodes])
        if self.mirror is not None and self.mirror.slope < 90.0:
            self._mirror(nodes, verdict)
        self.angle[nodes] = verdict["angle"]
        self.elevation[nodes] = verdict["elevation"]
        self.margin[nodes] = verdict["margin"]
        self.decision[nodes] = verdict["decision"]
        passed = np.flatnonzero(verdict["accepted"])
        if not self.one_per_facet:
            return nodes[passed], nodes[:0]
        put_off = self._not_lowest(nodes[passed], verdict["height"][passed])
        return nodes[passed[~put_off]], nodes[passed[put_off]]

    def _not_lowest(self, nodes: np.ndarray, height: np.ndarray) -> np.ndarray:
        """bool[n]: nodes that could become vertices, but are not the lowest of these over their facet."""
        free = self.vertex_at[self.head[nodes]] < 0
        if self.square is not None:
            free &= ~self.taken[self.square[nodes]]
        free = np.flatnonzero(free)
        facet = self.tin.where[nodes[free]]
        order = np.lexsort((nodes[free], height[free], facet))
        put_off = np.zeros(len(nodes), bool)
        put_off[free[order]] = np.diff(facet[order], prepend=-1) == 0
        return put_off

    def _mirror(self, nodes: np.ndarray, verdict: dict[str, np.ndarray]) -> None:
        """Test points over steep facets at their mirror position as well, or instead; outside the hull nothing changes."""
        assert self.mirror is not None
        self.steep[nodes] = verdict["slope"] > self.mirror.slope
        steep = np.flatnonzero(self.steep[nodes])
        if len(steep) == 0:
            return
        facet = self.tin.where[nodes[steep]]
        image = np.empty((len(steep), 3), np.float32)
        for start in range(0, len(steep), _BATCHES[-1]):
            part = slice(start, start + _BATCHES[-1])
            pair = self.net.xyz[nodes[steep[part]]], self.tin.corners(facet[part])
            found = mirrored(*(_padded(v) for v in pair), self.mirror.about == "highest")
            image[part] = np.asarray(found)[: len(pair[0])]
        there = self.tin.walk(image[:, :2].astype(np.float64), facet, self.net.sheet[nodes[steep]])
        steep, image, there = steep[there >= 0], image[there >= 0], there[there >= 0]
        second = self._judge(nodes[steep], there, image)
        replace = second["accepted"] if self.mirror.mode == "or" else np.ones(len(steep), bool)
        for name in ("accepted", "decision", "margin", "angle", "elevation"):
            verdict[name][steep[replace]] = second[name][replace]

    def _judge(self, nodes: np.ndarray, facet: np.ndarray, image: np.ndarray | None = None) -> dict[str, np.ndarray]:
        """The kernel over nodes, or over ``image`` f32[n, 3] in their place, in facets i32[n]; the result on the host.

        Calls are cut and padded to a few sizes, so that nothing is compiled twice, and prepared in the thread pool.
        """

        def one(start: int) -> dict[str, np.ndarray]:
            part = slice(start, start + _BATCHES[-1])
            xyz = self.net.xyz[nodes[part]] if image is None else image[part]
            late, corners = self.net.late[nodes[part]], self.tin.corners(facet[part])
            verdict: Verdict = judge(self.rule, *(_padded(v) for v in (late, xyz, corners)))
            values = {**verdict._asdict(), **verdict.score._asdict()}
            return {name: np.asarray(values[name])[: len(xyz)] for name in _KEPT}

        parts = list(self.pool.map(one, range(0, max(len(nodes), 1), _BATCHES[-1])))
        return {name: np.concatenate([part[name] for part in parts]) for name in _KEPT}

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


def _padded(values: np.ndarray) -> np.ndarray:
    """The values with zeros behind them, up to the next of the batch sizes."""
    size = next(b for b in _BATCHES if b >= len(values))
    out = np.zeros((size, *values.shape[1:]), values.dtype)
    out[: len(values)] = values
    return out


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
