"""Progressive TIN densification: the one loop of all TIN methods.

Each round tests all open points whose facet has changed since they were last tested against one triangulation, accepts
all that pass, or the lowest over each facet, and makes them vertices; the order of the points never matters. A point whose
facet has not changed would fail again, and is left alone, unless the thresholds were loosened. The network may consist of
several sheets (FPTD's blocks) that share nothing: their triangulations run in a thread pool, and one padded kernel call a
round tests the points of all sheets together.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np

from ...core.compilation import on_same_device
from ...core.result import Decision, Progress, silent
from .facets import Rule, judge, mirrored
from .growth import Growth, Mirror, Network
from .triangulation import Tin
from .vertices import LowestPerCell, Spaced, choice_of

_BATCHES = (1024, 8192)
"""Sizes of kernel calls: what does not fill half of the large one is cut into small ones."""
_SAMPLE = 65536
"""At most about so many quantities decide adaptive thresholds."""
_DEVIATION = ("distance", "angle")
_TESTED = ("accepted", "decision", "margin", "angle", "elevation")


def densify(
    network: Network,
    growth: Growth,
    *,
    tin: Tin | None = None,
    scores: bool = True,
    heights: bool = True,
    workers: int | None = None,
    progress: Progress = silent,
    keep_labels: bool = False,
) -> Densification:
    """Grow the ground from the seeds until nothing is added.

    Args:
        tin: the triangulation of the seeds (:func:`triangulated`), which then grows; None = make it.
        scores: keep the tested quantities; heights: make those over the final surface, and slopes. Labels come sooner without.
        keep_labels: record the labels after every round in the trace.
    """
    threads = workers or os.cpu_count() or 1
    with ThreadPoolExecutor(threads) as pool:
        choice = choice_of(network, growth.vertices)
        tin = triangulated(network, choice, pool, threads) if tin is None else tin
        tin.pool, tin.workers = pool, threads
        run = Densification(network, growth, choice, tin, scores, keep_labels)
        run.rounds(progress)
        if heights:
            run.finish()
        progress(1.0, "densify")
        return run


def triangulated(network: Network, choice: Spaced | LowestPerCell, pool: ThreadPoolExecutor, workers: int) -> Tin:
    """The triangulation of the seeds that are vertices, and of the border nodes, with all other nodes located in it."""
    vertices = np.sort(np.concatenate([choice.seeds, network.virtual]))
    return Tin(network.xyz.copy(), network.sheet, vertices, pool, workers)


class Densification:
    """A densification under way, or done.

    Attributes:
        ground: bool[k], nodes that are ground so far; tin: the triangulation of those that are vertices.
        rule: the thresholds that apply now; choice: which of the ground nodes become vertices.
        angle, elevation, margin: f32[k], and decision: u8[k], of the last test of each node.
        height, slope: f32[k], over the final surface.
        image_in: i32[k], the triangle that the mirror image of a node was tested in, or -1.
        converged: whether the rounds ended by themselves; trace: a record of each.
    """

    def __init__(
        self,
        network: Network,
        growth: Growth,
        choice: Spaced | LowestPerCell,
        tin: Tin,
        scores: bool,
        keep_labels: bool,
    ) -> None:
        self.net, self.growth, self.choice, self.tin = network, growth, choice, tin
        self.scores, self.keep_labels = scores, keep_labels
        self.rule = _single(growth.rule)
        self.ground = network.seed.copy()
        self._border_follows()
        k = len(network.xyz)
        self.angle, self.elevation, self.margin = (np.full(k, np.nan, np.float32) for _ in range(3))
        self.height, self.slope = (np.zeros(k, np.float32) for _ in range(2))
        untested = np.where(network.open, Decision.ANGLE, Decision.SET_ASIDE)
        self.decision = np.where(network.seed, Decision.SEED, untested).astype(np.uint8)
        self.image_in = np.full(k, -1, np.int32)
        self.converged = False
        self.trace: list[dict[str, Any]] = []

    def rounds(self, progress: Progress) -> None:
        """Rounds until no point is accepted, on each grid of vertices, and at last with the suspected low outliers."""
        net, tin, choice, policy = self.net, self.tin, self.choice, self.growth.vertices
        waiting = net.open & ~self.ground
        todo = rest = np.flatnonzero(waiting & ~net.late)
        total, enough = max(1, int(waiting.sum())), policy.stop_share * int(net.real.sum())
        suspects_wait, stage, within = bool(net.late.any()), 0, 0
        self._adapt("round")
        for _ in range(self.growth.max_rounds):
            progress(1.0 - len(rest) / total, "densify")
            tin.now += 1
            accepted, put_off, inserted = self._round(todo)
            few, within = len(accepted) + len(put_off) < enough, within + 1
            more: dict[str, Any] = self._limits()
            if isinstance(choice, LowestPerCell):
                more |= {"cell": choice.cell, "stage": stage, "enough": not few}
            self._record(len(todo), len(accepted), inserted, **more)
            waiting[accepted] = False
            rest = rest[waiting[rest]]
            loosened = self._adapt("round")
            todo = rest[self._again(rest, put_off) | loosened]
            ends = few if policy.rounds is None else within >= policy.rounds[stage]
            while ends or len(todo) == 0:  # the next stage
                ends, stage, within = False, stage + 1, 0
                if choice.finer:
                    choice.refine(self.ground, tin)
                    loosened |= self._adapt("grid")
                    todo = rest[self._again(rest, put_off) | loosened]
                elif suspects_wait:
                    suspects_wait = False
                    todo, rest = np.flatnonzero(waiting & net.late), np.flatnonzero(waiting)
                    tin.locate(todo)
                else:
                    self.converged = True
                    return

    def _record(self, tested: int, accepted: int, inserted: int, **more: Any) -> None:
        """Add to the trace what was done."""
        step = {"tested": tested, "accepted": accepted, "inserted": inserted, "facets": len(self.tin), **more}
        self.trace.append(step | ({"ground": self.ground.copy()} if self.keep_labels else {}))

    def _limits(self) -> dict[str, float]:
        """The limits that apply now, if they change."""
        names = () if self.growth.adaptive is None else ("max_distance", "max_angle")
        return {name: float(getattr(self.rule, name)) for name in names}

    def _round(self, todo: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
        """Test located nodes, make ground of those that pass and vertices of some: accepted, put off, number of vertices."""
        tin, verdict = self.tin, self._test(todo)
        passes = verdict["accepted"]
        accepted, put_off = todo[passes], todo[:0]
        if self.growth.one_per_facet:
            level, facet = verdict["height"][passes], tin.where[accepted]
            may = np.flatnonzero(self.choice.could(accepted, tin))
            order = may[np.lexsort((may, level[may], facet[may]))]
            waits = np.zeros(len(accepted), bool)
            waits[may], waits[order[np.diff(facet[order], prepend=-1) != 0]] = True, False
            accepted, put_off = accepted[~waits], accepted[waits]
        self.ground[accepted] = True
        inserted = len(self.choice.add(accepted, tin))
        self._border_follows()
        return accepted, put_off, inserted

    def _again(self, rest: np.ndarray, put_off: np.ndarray) -> np.ndarray:
        """bool[.]: nodes to test again: their facet, or that of their mirror image, has changed, or they were put off."""
        again = self.tin.changed(rest, self.image_in)
        self.tin.locate(rest[again])
        again[np.searchsorted(rest, put_off)] = True
        return again

    def _border_follows(self) -> None:
        """Border nodes take the elevation of the vertex nearest to them that is none."""
        net, tin = self.net, self.tin
        if not self.growth.border_follows:
            return
        near = tin.nearest(net.virtual, net.real)
        node, z = net.virtual[near >= 0], tin.xyz[near[near >= 0], 2]
        tin.touch(node[tin.xyz[node, 2] != z])
        tin.xyz[node, 2] = z

    def _adapt(self, moment: str) -> bool:
        """Make new thresholds if it is the moment for it; whether any is looser than before."""
        adaptive = self.growth.adaptive
        if adaptive is None or adaptive.every != moment:
            return False
        found = self._over_ground() if adaptive.sample == "ground" else self._over_neighbours()
        if len(found["distance"]) == 0:
            return False
        before, self.rule = self.rule, _single(adaptive.rule(np.abs(found["distance"]), np.abs(found["angle"])))
        return any(float(new) > float(old) for new, old in zip(self.rule, before, strict=True))

    def _over_ground(self) -> dict[str, np.ndarray]:
        """Quantities of the ground points that are no vertices, in their facets."""
        nodes = np.flatnonzero(self.ground & ~self.tin.vertex)
        self.tin.locate(nodes)
        return self._judge(nodes, self.tin.corners(self.tin.where[nodes]), _DEVIATION)

    def _over_neighbours(self) -> dict[str, np.ndarray]:
        """Quantities of vertices over the facets across the edge from them; simulated ones left out."""
        tin = self.tin
        least = tin.triangles.min(axis=1)
        step = max(1, 3 * len(tin) // _SAMPLE)
        rows = np.flatnonzero((least >= 0) & (least % step == 0))  # by nodes: rows depend on the history
        corner = np.sort(tin.triangles[rows], axis=1)
        inner = self.net.real[corner].all(axis=1)
        rows, corner = rows[inner], corner[inner]
        there = tin.neighbours[rows]
        behind = (tin.neighbours[there] == rows[:, None, None]).argmax(axis=2)
        apex = np.take_along_axis(tin.triangles[there], behind[:, :, None], 2)[:, :, 0]
        row, edge = np.nonzero((apex >= 0) & self.net.real[apex])
        nodes = apex[row, edge]
        return self._judge(nodes, corner[row], _DEVIATION, tin.xyz[nodes])

    def _test(self, nodes: np.ndarray) -> dict[str, np.ndarray]:
        """Test located nodes against their facets, and keep the tested quantities."""
        facet, mirror = self.tin.where[nodes], self.growth.mirror
        further = ("slope",) * (mirror is not None) + ("height",) * self.growth.one_per_facet
        verdict = self._judge(nodes, self.tin.corners(facet), (*_TESTED, *further))
        if mirror is not None:
            self._mirror(mirror, nodes, facet, verdict)
        if self.scores:
            for name in _TESTED[1:]:
                getattr(self, name)[nodes] = verdict[name]
        return verdict

    def _mirror(self, mirror: Mirror, nodes: np.ndarray, facet: np.ndarray, verdict: dict[str, np.ndarray]) -> None:
        """Test points over steep facets at their mirror position instead, or as a second chance.

        Outside the hull nothing changes. A second test that cannot change the outcome is left out.
        """
        self.image_in[nodes] = -1
        of_use = verdict["slope"] > mirror.slope
        if mirror.nearest:
            of_use &= ~verdict["accepted"]
        steep = np.flatnonzero(of_use)
        if len(steep) == 0:
            return
        corner = self.tin.corners(facet[steep])

        def given(part: slice) -> tuple[np.ndarray, ...]:
            return self.net.xyz[nodes[steep[part]]], np.take(self.tin.xyz, corner[part], axis=0)

        def images(xyz: np.ndarray, corners: np.ndarray) -> dict[str, Any]:
            return {"image": mirrored(xyz, corners, not mirror.nearest)}

        image = self._run(images, len(steep), given)["image"]
        there = self.tin.walk(image, facet[steep])
        inside = there >= 0
        steep, image, there = steep[inside], image[inside], there[inside]
        self.image_in[nodes[steep]] = there
        second = self._judge(nodes[steep], self.tin.corners(there), _TESTED, image)
        replace = second["accepted"] | (not mirror.nearest)
        for name in _TESTED:
            verdict[name][steep[replace]] = second[name][replace]

    def _judge(
        self, nodes: np.ndarray, corner: np.ndarray, names: tuple[str, ...], xyz: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Test nodes, or ``xyz`` f32[n, 3] in their place, over facets with the nodes i32[n, 3] at their corners.

        ``names``: of :data:`jaxfilter.engines.tin.facets.QUANTITIES`, those to return.
        """
        own = [name for name, limit in self.rule._asdict().items() if np.ndim(limit) > 0]

        def tested(part: slice) -> tuple[np.ndarray, ...]:
            here = np.take(self.net.xyz, nodes[part], axis=0) if xyz is None else xyz[part]
            limits = [getattr(self.rule, name)[self.net.sheet[nodes[part]]] for name in own]
            return *limits, self.net.late[nodes[part]], here, np.take(self.tin.xyz, corner[part], axis=0)

        def kernel(*given: np.ndarray) -> dict[str, Any]:
            limits: dict[str, Any] = dict(zip(own, given[: len(own)], strict=True))
            return judge(self.rule._replace(**limits), *given[len(own) :], names=names)

        return self._run(kernel, len(nodes), tested)

    def _run(
        self, kernel: Callable[..., dict[str, Any]], n: int, arguments: Callable[[slice], tuple[np.ndarray, ...]]
    ) -> dict[str, np.ndarray]:
        """What a kernel says of n rows, whose ``arguments`` are made part by part.

        Calls have few sizes, so that nothing is compiled twice, and large ones are prepared in the thread pool.
        """

        def one(part: tuple[int, int]) -> dict[str, np.ndarray]:
            start, size = part
            stop = min(n, start + size)
            given = arguments(slice(start, stop))
            if stop - start < size:
                given = tuple(np.concatenate([v, np.zeros((size - len(v), *v.shape[1:]), v.dtype)]) for v in given)
            return {name: np.asarray(v)[: stop - start] for name, v in kernel(*given).items()}

        parts = _parts(n)
        spread = self.tin.workers > 1 and len(parts) > 2
        found = list(self.tin.pool.map(on_same_device(one), parts) if spread else map(one, parts))
        return {name: np.concatenate([part[name] for part in found]) for name in found[0]}

    def finish(self) -> None:
        """Heights and slopes over the final surface."""
        tin, nodes = self.tin, np.flatnonzero(self.net.real)
        tin.locate(nodes)
        final = self._judge(nodes, tin.corners(tin.where[nodes]), ("height", "slope"))
        self.height[nodes], self.slope[nodes] = final["height"], final["slope"]
        self.height[tin.vertex] = self.net.xyz[tin.vertex, 2] - tin.xyz[tin.vertex, 2]


def _single(rule: Rule) -> Rule:
    """The thresholds in single precision."""
    return Rule(*map(np.float32, rule))  # type: ignore[arg-type]


def _parts(n: int) -> list[tuple[int, int]]:
    """Where parts of n rows begin, and the sizes of calls that hold them; the last may be padded, and there is one at least."""
    small, large = _BATCHES
    many = max(0, -(-(n - large // 2) // large))
    rest = range(many * large, max(n, 1), small)
    return [*((i * large, large) for i in range(many)), *((start, small) for start in rest)]
