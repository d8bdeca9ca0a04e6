"""Progressive TIN densification: ground that grows over a triangulation of itself, of all TIN methods.

Each step tests all open points whose facet has changed since they were last tested against one triangulation, accepts
all that pass, or the lowest over each facet, and makes them vertices; the order of the points never matters. Each point
knows the triangle that it lies in, and each triangle the step in which it changed. The network may consist of several
sheets (FPTD's blocks) that share nothing: their triangulations run in a thread pool, and one padded kernel call a step
tests the points of all sheets together.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Self

import numpy as np

from ...core.result import Decision
from ..chunks import in_chunks
from ..ground import GroundNodes
from .facets import judge, mirrored
from .growth import SCORES, Growth, LowestPerCell, Mirror, Network, Spaced
from .triangulation import Tin

_BATCHES = 1024, 8192
"""Sizes of kernel calls."""
_SAMPLE = 65536
"""At most about so many quantities decide adaptive thresholds."""
_DEVIATION = ("distance", "angle")


class GroundTin(GroundNodes):
    """Ground points, and the triangulation of those that are vertices.

    Attributes:
        ground: bool[k], nodes that are ground so far; tin: the triangulation of those that are vertices.
        rule: the thresholds that apply now; choice: which of the ground nodes become vertices.
        angle, elevation, margin: f32[k], and decision: u8[k], of the last test of each node.
        height, slope: f32[k], metres and degrees, of that test, or over the surface as it is after :meth:`finish`.
        image_in: i32[k], the triangle that the mirror image of a node was tested in, or -1.
    """

    STEP = "densify"

    tin: Tin

    @classmethod
    @contextmanager
    def start(
        cls, network: Network, growth: Growth, tin: Tin | None = None, workers: int | None = None
    ) -> Iterator[Self]:
        """The seeds, their triangulation and the border nodes, with all other nodes located in it, and threads to go on with.

        ``tin``: this triangulation, which then grows; None = make it. ``workers``: threads; None = one per core.
        """
        threads = workers or os.cpu_count() or 1
        with ThreadPoolExecutor(threads) as pool:
            ground = cls(network, growth)
            if tin is None:
                vertices = np.sort(np.concatenate([ground.choice.seeds, network.virtual]))
                tin = Tin(network.xyz.copy(), network.sheet, vertices, pool, threads)
            ground.tin, tin.pool, tin.workers = tin, pool, threads
            ground._border_follows()
            ground._adapt(of_ground=False)
            yield ground

    def __init__(self, network: Network, growth: Growth) -> None:
        waiting = network.open & ~network.seed
        super().__init__(network.seed.copy(), np.flatnonzero(waiting & ~network.late), _single(growth.rule))
        choice = LowestPerCell if growth.vertices.grids else Spaced
        self.net, self.growth, self.choice = network, growth, choice(network, growth.vertices)
        k = len(network.xyz)
        self.angle, self.elevation, self.margin = (np.full(k, np.nan, np.float32) for _ in range(3))
        self.height, self.slope = (np.zeros(k, np.float32) for _ in range(2))
        untested = np.where(network.open, Decision.ANGLE, Decision.SET_ASIDE)
        self.decision = np.where(network.seed, Decision.SEED, untested).astype(np.uint8)
        self.image_in = np.full(k, -1, np.int32)
        self._suspects = np.flatnonzero(waiting & network.late)
        self._put_off = self.todo[:0]
        # Without border nodes around them points lie outside the hull, where the way there decides which facet is in sight:
        # all points are located and tested in each step.
        self._outside = len(network.virtual) == 0
        self._stage = self._within = 0

    def change(self, rule: Any, but: np.ndarray | None = None) -> None:
        """Go on with another rule: all that may still become ground are tested by it, without those in ``but``, bool[k]."""
        self.rule = _single(rule)
        self.todo = self.rest if but is None else self.rest[~but[self.rest]]

    def test(self) -> np.ndarray:
        if self._outside:
            self.tin.locate(self.todo)
        verdict = self._test(self.todo)
        passes = verdict["accepted"]
        accepted = self.todo[passes]
        if self.growth.one_per_facet:
            level, facet = verdict["height"][passes], self.tin.where[accepted]
            may = np.flatnonzero(self.choice.could(accepted, self.tin))
            order = may[np.lexsort((may, level[may], facet[may]))]
            waits = np.zeros(len(accepted), bool)
            waits[may], waits[order[np.diff(facet[order], prepend=-1) != 0]] = True, False
            accepted, self._put_off = accepted[~waits], accepted[waits]
        return accepted

    def take(self, accepted: np.ndarray) -> dict[str, Any]:
        choice, policy = self.choice, self.growth.vertices
        self.tin.now += 1
        inserted = len(choice.add(accepted, self.tin))
        self._border_follows()
        few = len(accepted) + len(self._put_off) < policy.stop_share * int(self.net.real.sum())
        found: dict[str, Any] = {"inserted": inserted, "facets": len(self.tin)}
        if self.growth.adaptive is not None:
            found |= {name: float(getattr(self.rule, name)) for name in ("max_distance", "max_angle")}
        if isinstance(choice, LowestPerCell):
            found |= {"cell": choice.cell, "stage": self._stage, "enough": not few}
        self.rest, self._within = self.rest[~self.ground[self.rest]], self._within + 1
        loosened = self._adapt(of_ground=False)
        if self._outside and len(accepted):
            self.todo = self.rest
        else:
            self.todo = self.rest[self._again() | loosened]
        ends = few if policy.rounds is None else self._within >= policy.rounds[self._stage]
        while (ends or len(self.todo) == 0) and self._next_stage(loosened):
            ends = False
        return found

    def _next_stage(self, loosened: bool) -> bool:
        """Go on to the next grid of vertices, and at last to the suspected low outliers; False if there is none of these."""
        self._stage, self._within = self._stage + 1, 0
        if self.choice.finer:
            self.choice.refine(self.ground, self.tin)
            loosened |= self._adapt(of_ground=True)
            self.todo = self.rest[self._again() | loosened]
            return True
        self.todo, self._suspects = self._suspects, self._suspects[:0]
        self.rest = np.sort(np.concatenate([self.rest, self.todo]), kind="stable")  # merges what is sorted
        self.tin.locate(self.todo)
        return len(self.todo) > 0

    def _again(self) -> np.ndarray:
        """bool[.]: nodes to test again: their facet, or that of their mirror image, has changed, or they were put off."""
        again = self.tin.changed(self.rest, self.image_in)
        self.tin.locate(self.rest[again])
        again[np.searchsorted(self.rest, self._put_off)] = True
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

    def _adapt(self, of_ground: bool) -> bool:
        """Make new thresholds if it is the moment for it; whether any is looser than before."""
        adaptive = self.growth.adaptive
        if adaptive is None or adaptive.of_ground != of_ground:
            return False
        found = self._over_ground() if of_ground else self._over_neighbours()
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
        tested = (
            "accepted",
            *(self.growth.kept or SCORES),
        )  # without any the same program runs, since others round differently
        further = ("slope",) * (mirror is not None) + ("height",) * self.growth.one_per_facet
        verdict = self._judge(nodes, self.tin.corners(facet), (*tested, *further))
        if mirror is not None:
            self._mirror(mirror, nodes, facet, verdict, tested)
        for name in self.growth.kept:
            getattr(self, name)[nodes] = verdict[name]
        return verdict

    def _mirror(
        self,
        mirror: Mirror,
        nodes: np.ndarray,
        facet: np.ndarray,
        verdict: dict[str, np.ndarray],
        tested: tuple[str, ...],
    ) -> None:
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

        def given(rows: slice) -> tuple[np.ndarray, ...]:
            return self.net.xyz[nodes[steep[rows]]], np.take(self.tin.xyz, corner[rows], axis=0)

        def images(xyz: np.ndarray, corners: np.ndarray) -> Any:
            return mirrored(xyz, corners, not mirror.nearest)

        image = in_chunks(images, given, len(steep), _BATCHES, self.tin.workers)
        there = self.tin.walk(image, facet[steep])
        inside = there >= 0
        steep, image, there = steep[inside], image[inside], there[inside]
        self.image_in[nodes[steep]] = there
        second = self._judge(nodes[steep], self.tin.corners(there), tested, image)
        replace = second["accepted"] | (not mirror.nearest)
        for name in tested:
            verdict[name][steep[replace]] = second[name][replace]

    def _judge(
        self, nodes: np.ndarray, corner: np.ndarray, names: tuple[str, ...], xyz: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Test nodes, or ``xyz`` f32[n, 3] in their place, over facets with the nodes i32[n, 3] at their corners.

        ``names``: of :data:`jaxfilter.engines.tin.facets.QUANTITIES`, those to return.
        """
        own = {name: limit for name, limit in self.rule._asdict().items() if np.ndim(limit) > 0}

        def given(rows: slice) -> tuple[np.ndarray, ...]:
            here = np.take(self.net.xyz, nodes[rows], axis=0) if xyz is None else xyz[rows]
            limits = (limit[nodes[rows]] for limit in own.values())
            return *limits, self.net.late[nodes[rows]], here, np.take(self.tin.xyz, corner[rows], axis=0)

        def tested(*arrays: np.ndarray) -> dict[str, Any]:
            rule = self.rule._replace(**dict(zip(own, arrays[: len(own)], strict=True)))
            return judge(rule, *arrays[len(own) :], names=names)

        found: dict[str, np.ndarray] = in_chunks(tested, given, len(nodes), _BATCHES, self.tin.workers)
        return found

    def finish(self, nodes: np.ndarray | None = None) -> None:
        """Heights and slopes of nodes, i64, over the surface as it is; None = of all points."""
        tin, nodes = self.tin, np.flatnonzero(self.net.real) if nodes is None else nodes
        tin.locate(nodes)
        final = self._judge(nodes, tin.corners(tin.where[nodes]), ("height", "slope"))
        self.height[nodes], self.slope[nodes] = final["height"], final["slope"]
        vertices = nodes[tin.vertex[nodes]]
        self.height[vertices] = self.net.xyz[vertices, 2] - tin.xyz[vertices, 2]


def _single(rule: Any) -> Any:
    """The thresholds in single precision."""
    return type(rule)(*map(np.float32, rule))
