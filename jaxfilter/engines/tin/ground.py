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
from functools import partial
from typing import Any, Self

import numpy as np

from ...core.compilation import on_processor
from ...core.frame import QUANTUM, perturbed
from ...core.result import Decision
from ..chunks import in_chunks
from ..grid.sparse import merged
from ..ground import GroundNodes
from .facets import judge, loosened, mirrored, of_nodes, single
from .growth import KEPT_QUANTITIES, Growth, LowestPerCell, Mirror, Network, Spaced
from .reference import TRIANGULATIONS
from .triangulation import Tin

_BATCH = 8192
"""Points of a kernel call: a second, smaller size takes longer to trace than it saves."""
_SAMPLE = 65536
"""At most about so many quantities decide adaptive thresholds."""
_DEVIATION = ("distance", "angle")


class GroundTin(GroundNodes):
    """Ground points, and the triangulation of those that are vertices.

    Attributes:
        ground: bool[k], nodes that are ground so far; tin: the triangulation of those that are vertices.
        rule: the thresholds that apply now; choice: which of the ground nodes become vertices.
        angle, elevation, margin: f32[k], and decision: u8[k], of the last test of each node, as far as they are kept.
        height, slope: f32[k], metres and degrees, of that test, or over the surface as it is after :meth:`finish`.
        image_in: i32[k], the triangle that the mirror image of a node was tested in, or -1; empty without mirrors.
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
                xyz = network.xyz.copy() if growth.moves else network.xyz
                tin = TRIANGULATIONS[growth.triangulation](xyz, network.sheet, vertices, pool, threads)
            ground.tin, tin.pool, tin.workers = tin, pool, threads
            if len(network.virtual) == 0:
                beyond = tin.triangles[tin.where[ground.todo]].min(axis=1) < 0
                ground._outside, ground._loose = ground.todo[beyond], ground.todo[~beyond]
            ground._border_follows()
            ground._adapt(of_ground=False)
            yield ground

    def __init__(self, network: Network, growth: Growth) -> None:
        waiting = network.open & ~network.seed
        self._open = waiting & ~network.late
        super().__init__(network.seed.copy(), np.flatnonzero(self._open), single(growth.rule))
        choice = LowestPerCell if growth.vertices.grids else Spaced
        self.net, self.growth, self.choice = network, growth, choice(network, growth.vertices)
        k = len(network.xyz)
        known = (k if name in growth.kept else 0 for name in ("angle", "elevation", "margin"))
        self.angle, self.elevation, self.margin = (np.full(count, np.nan, np.float32) for count in known)
        self.height, self.slope = (np.zeros(k, np.float32) for _ in range(2))
        untested = np.where(network.open, np.uint8(Decision.ANGLE), np.uint8(Decision.SET_ASIDE))
        self.decision = np.where(network.seed, np.uint8(Decision.SEED), untested)
        self.image_in = np.full(0 if growth.mirror is None else k, -1, np.int32)
        self._suspects = np.flatnonzero(waiting & network.late)
        self._put_off = self._imaged = self._outside = self.todo[:0]
        self._loose = self.todo
        self._stage = self._within = 0

    @property
    def rest(self) -> np.ndarray:
        """i64, nodes that may still become ground."""
        return np.flatnonzero(self._open & ~self.ground)

    def change(self, rule: Any, but: np.ndarray | None = None) -> None:
        """Go on with another rule: all that may still become ground are tested by it, without those in ``but``, bool[k]."""
        self.rule = single(rule)
        rest = self.rest
        self.todo = rest if but is None else rest[~but[rest]]

    def locate_outside(self) -> None:
        """Locate nodes outside the hull anew: a nearer edge of it may be new, though their own has not changed."""
        self.tin.locate(self._outside)

    def test(self) -> np.ndarray:
        self.locate_outside()
        verdict = self._test(self.todo)
        passes = verdict["accepted"] & ~self._too_far()
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
        least = policy.stop_share and policy.stop_share * int(self.net.real.sum())
        few = len(accepted) + len(self._put_off) < least
        found: dict[str, Any] = {"inserted": inserted, "facets": len(self.tin)}
        if self.growth.adaptive is not None:
            known = [name for name in ("max_distance", "max_angle") if np.ndim(getattr(self.rule, name, [])) == 0]
            found |= {name: float(getattr(self.rule, name)) for name in known}
        if isinstance(choice, LowestPerCell):
            found |= {"cell": choice.cell, "stage": self._stage, "enough": not few}
        self.left, self._within = self.left - len(accepted), self._within + 1
        looser = self._adapt(of_ground=False)
        self._again(looser)
        ends = few if policy.rounds is None else self._within >= policy.rounds[self._stage]
        while (ends or len(self.todo) == 0) and self._next_stage(looser):
            ends = False
        return found

    def drop(self, nodes: np.ndarray) -> None:
        """Make vertices, i64, not on the hull, ordinary nodes that are no ground: they are to be tested, with those around."""
        self.ground[nodes], self._open[nodes], self.left = False, True, self.left + len(nodes)
        self._loose, self._put_off = merged(self._loose, nodes), self.todo
        self.tin.now += 1
        self.tin.remove(nodes)
        self._again()

    def _next_stage(self, looser: bool) -> bool:
        """Go on to the next grid of vertices, and at last to the suspected low outliers; False if there is none of these."""
        self._stage, self._within = self._stage + 1, 0
        if self.choice.finer:
            self.choice.refine(self.ground, self.tin)
            looser |= self._adapt(of_ground=True)
            self._again(looser)
            return True
        self.todo, self._suspects = self._suspects, self._suspects[:0]
        self._open[self.todo], self.left = True, self.left + len(self.todo)
        self._loose = merged(self._loose, self.todo)
        self.tin.locate(self.todo)
        return len(self.todo) > 0

    def _again(self, every: bool = False) -> None:
        """Test nodes again of which the facet, or that of their mirror image, has changed, or that were put off, or all.

        Where anything has changed, what lies outside the hull is tested, too.
        """
        tin, lists = self.tin, (self._loose, self._outside, self._imaged)
        loose, self._outside, imaged = (nodes[~self.ground[nodes]] for nodes in lists)
        changed = tin.changed(loose)
        self._loose = changed[~self.ground[changed]]
        tin.locate(self._loose)
        if every:
            self.todo = self.rest
            return
        self._imaged = imaged = imaged[self.image_in[imaged] >= 0]
        further = [self._put_off, imaged[tin.stamp[self.image_in[imaged]] == tin.now]]
        if len(self._loose) or (tin.stamp[tin.where[self._outside]] == tin.now).any():
            further.append(self._outside)
        self.todo = merged(self._loose, np.concatenate(further))

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
        if of_ground:  # of the ground points that are no vertices, in their facets
            nodes = np.flatnonzero(self.ground & ~self.tin.vertex)
            self.tin.locate(nodes)
            found = self._judge(nodes, self.tin.where[nodes], _DEVIATION)
        else:
            found = self._over_neighbours()
        if len(found["distance"]) == 0:
            return False
        before, self.rule = self.rule, single(adaptive.rule(np.abs(found["distance"]), np.abs(found["angle"])))
        return loosened(self.rule, before)

    def _over_neighbours(self) -> dict[str, np.ndarray]:
        """Quantities of vertices over the facets across the edge from them; simulated ones left out."""
        tin = self.tin
        step = max(1, 3 * len(tin) // _SAMPLE)
        rows = np.flatnonzero((tin.triangles >= 0).all(axis=1))
        at = tin.xyz[tin.triangles[rows], :2].sum(axis=1, dtype=np.float64)
        moved = perturbed(at)[:, 0] - at[:, 0]  # by position: rows depend on the history
        rows = rows[moved < (1 / step - 0.5) * QUANTUM]
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
        # without any that are kept the same program runs, since others round differently
        tested = ("accepted", *(self.growth.kept or KEPT_QUANTITIES))
        further = ("level",) * (mirror is not None) + ("height",) * self.growth.one_per_facet
        verdict = self._judge(nodes, facet, (*tested, *further))
        if mirror is not None:
            self._mirror(mirror, nodes, facet, verdict, tested)
        for name in self.growth.kept:
            getattr(self, name)[nodes] = verdict[name]
        return verdict

    def over(self, xyz: np.ndarray, near: np.ndarray) -> dict[str, np.ndarray]:
        """Test positions f32[n, 3] that are no nodes, by the limits of nodes near them, on the triangulation as it is.

        Outside the hull the planes say nothing: there one passes within the limits of ``beyond`` of its node if that is ground.

        ``near``: located nodes, i32[n]. Returns: "ground" bool[n], "margin" and "height", metres, and "slope", degrees, f32[n].
        """
        facet, beyond = self.tin.walk(xyz, self.tin.where[near]), self.growth.beyond
        rows = np.flatnonzero(facet < 0)
        facet[rows] = -1 - facet[rows]
        found = self._judge(near, facet, ("accepted", "margin", "height", "slope"), xyz)
        found["ground"] = found.pop("accepted")
        if beyond is not None:
            node = near[rows]
            x, y, z = (xyz[rows] - self.net.xyz[node]).T
            margin = np.abs(z) - beyond.height - beyond.slope[node] * np.hypot(x, y)
            found["ground"][rows], found["margin"][rows] = (margin <= 0) & self.ground[node], margin
        return found

    def _too_far(self) -> np.ndarray:
        """bool: which nodes of ``todo`` lie outside the hull and beyond the limits there; by how much becomes their margin."""
        out, beyond = np.zeros(len(self.todo), bool), self.growth.beyond
        if beyond is None:
            return out
        corner = self.tin.triangles[self.tin.where[self.todo]]
        rows = np.flatnonzero(corner.min(axis=1) < 0)
        nodes = self.todo[rows]
        one, other, p = (self.tin.xyz[i].astype(np.float64) for i in (*np.sort(corner[rows], axis=1)[:, 1:].T, nodes))
        edge, to = other - one, p - one
        along = np.clip((to * edge)[:, :2].sum(axis=1) / (edge * edge)[:, :2].sum(axis=1), 0, 1)
        x, y, z = (to - along[:, None] * edge).T
        margin = np.abs(z) - beyond.height - beyond.slope[nodes] * np.hypot(x, y)
        far = margin > 0
        out[rows] = far
        if "margin" in self.growth.kept:
            self.margin[nodes[far]] = np.fmax(self.margin[nodes[far]], margin[far])
        return out

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
        of_use = verdict["level"] < np.cos(np.radians(mirror.slope)) + 1e-4  # which angle it is takes longer
        if mirror.nearest:
            of_use &= ~verdict["accepted"]
        steep = np.flatnonzero(of_use)
        if len(steep):
            steep = steep[self._judge(nodes[steep], facet[steep], ("slope",))["slope"] > mirror.slope]
        if len(steep) == 0:
            return
        corner = self.tin.corners(facet[steep])

        def given(rows: slice) -> tuple[np.ndarray, ...]:
            return self.net.xyz[nodes[steep[rows]]], np.take(self.tin.xyz, corner[rows], axis=0)

        with on_processor():
            image = in_chunks(partial(mirrored, about_highest=not mirror.nearest), given, len(steep), _BATCH)
        there = self.tin.walk(image, facet[steep])
        inside = there >= 0
        steep, image, there = steep[inside], image[inside], there[inside]
        self.image_in[nodes[steep]] = there
        self._imaged = merged(self._imaged, nodes[steep])
        second = self._judge(nodes[steep], there, tested, image)
        replace = second["accepted"] | (not mirror.nearest)
        for name in tested:
            verdict[name][steep[replace]] = second[name][replace]

    def _judge(
        self, nodes: np.ndarray, facet: np.ndarray, names: tuple[str, ...], xyz: np.ndarray | None = None
    ) -> dict[str, np.ndarray]:
        """Test nodes, or ``xyz`` f32[n, 3] in their place, over facets, i32[n], or those with the nodes i32[n, 3] as corners.

        ``names``: of :data:`jaxfilter.engines.tin.facets.FACET_QUANTITIES`, those to return.
        """

        def given(rows: slice) -> tuple[Any, ...]:
            here = np.take(self.net.xyz, nodes[rows], axis=0) if xyz is None else xyz[rows]
            at = self.tin.planes(facet[rows]) if facet.ndim == 1 else np.moveaxis(self.tin.xyz[facet[rows]], 0, 2)
            return of_nodes(self.rule, nodes[rows]), self.net.late[nodes[rows]], np.ascontiguousarray(here.T), at

        with on_processor():
            return in_chunks(partial(judge, names=names), given, len(nodes), _BATCH, axis=-1)  # type: ignore[no-any-return]

    def finish(self, nodes: np.ndarray | None = None) -> None:
        """Heights and slopes of nodes of ``todo``, i64, over the surface as it is; None = of all points."""
        tin = self.tin
        if nodes is None:
            nodes = np.flatnonzero(self.net.real)
            tin.locate(nodes)
        self.locate_outside()
        kept = self.growth.kept  # with these there is a program already
        names = ("accepted", *kept) if {"height", "slope"} <= {*kept} else ("height", "slope")
        final = self._judge(nodes, tin.where[nodes], names)
        self.height[nodes], self.slope[nodes] = final["height"], final["slope"]
        vertices = nodes[tin.vertex[nodes]]
        self.height[vertices] = self.net.xyz[vertices, 2] - tin.xyz[vertices, 2]
