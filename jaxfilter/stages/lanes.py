"""Densification with many sets of thresholds at once.

Every set has a lane: a copy of the network, as further sheets of one triangulation. All lanes advance together, round by
round: one kernel call tests the points of all of them, each against the thresholds of its lane, and their triangulations
are updated in one thread pool. A lane whose set is done leaves.

What sets have in common is made once: the network, the triangulation of the seeds, and most of the first round, in which
all sets test the same facets and accept much the same points. Points that all sets accept are inserted once; then the sets
part into two halves, and what is common to a half is inserted into a copy, and so on. Since a triangulation does not depend
on the order in which its vertices came, each lane has the labels of :func:`jaxfilter.stages.densify.densify`.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax.numpy as jnp
import numpy as np

from ..host.tin import Tin
from ..ops.facets import Rule, Verdict, judge_each
from .densify import Growth, Mirror, Network

MOST = 128
"""Lanes at a time; the kernel is compiled for so many rules."""
_BYTES = 220
"""About so many of memory per point and lane."""
_LEAVING = 0.5
"""Lanes that are done are dropped when they are this share of all: it copies the others."""


def densify_each(
    network: Network,
    rules: Sequence[Rule],
    *,
    mirror: Mirror | None = None,
    refresh_border: bool = False,
    vertex_spacing: float = 0.0,
    border_in_tests: bool = True,
    max_rounds: int = 100,
    workers: int | None = None,
    memory: float = 2e9,
) -> Iterator[tuple[int, np.ndarray]]:
    """Grow the ground from the same seeds with each of several rules, by batches of points.

    Args:
        memory: bytes; as many lanes are computed at a time as fit into it, one at least.
        others: as for :func:`jaxfilter.stages.densify.densify`.

    Yields: number of the rule, and bool[k], the nodes that are ground; in the order in which they are done.
    """
    threads = workers or os.cpu_count() or 1
    at_once = max(1, min(MOST, int(memory // (_BYTES * len(network.xyz)))))
    with ThreadPoolExecutor(threads) as pool:
        one = Growth(
            network,
            rules[0],
            mirror,
            refresh_border,
            vertex_spacing,
            None,
            None,
            "batch",
            pool,
            threads,
            False,
            border_in_tests,
        )
        alike = np.lexsort(np.array(rules, np.float64).T)
        for start in range(0, len(rules), at_once):
            yield from _Lanes(one, alike[start : start + at_once], rules).run_all(max_rounds)


class _Lanes(Growth):
    """Lanes of one growth that has not begun; the nodes of every lane are its nodes, lane after lane."""

    batches = (16384,)

    def __init__(self, one: Growth, numbers: np.ndarray, rules: Sequence[Rule]) -> None:
        self.__dict__.update(one.__dict__)
        self.size = len(one.ground)
        self.numbers = numbers  # per row of the table: its rule among ``rules``
        table = np.array([rules[i] for i in np.resize(numbers, MOST)], np.float32)
        self.rules = Rule(*jnp.asarray(table.T))
        self.lanes, self.squares, self.borders = 1, len(one.taken), len(one.virtual)
        self.waiting = one.net.open & ~one.ground
        self.admitted = np.array([not one.net.late.any()])
        self.row = np.zeros(1, np.int64)  # per lane: its row in the table of rules
        self.sheets = int(one.net.sheet[-1]) + 1
        self._first_round(one, [rules[i] for i in numbers])
        self.row = np.arange(len(numbers))
        self.done = np.zeros(len(numbers), bool)

    def _first_round(self, one: Growth, rules: Sequence[Rule]) -> None:
        """All sets test the facets of the seeds, and part."""
        todo, count = np.flatnonzero(self.waiting & ~one.net.late), len(rules)
        accepted = []
        for rule in rules:
            one.rule = Rule(*(jnp.float32(limit) for limit in rule))
            accepted.append(one._test(todo)[0])
        self._keep(np.zeros(count, np.int64))
        self.image_in = np.full(count * self.size, -1, np.int32)
        nodes = np.concatenate([passed + lane * self.size for lane, passed in enumerate(accepted)])
        self.ground[nodes] = True
        self.waiting[nodes] = False
        inserted = self._to_insert(nodes)
        new = np.zeros((count, self.size), bool)
        new.ravel()[inserted] = True
        self.tin = self._parted(one.tin, new)
        self._refresh(inserted)
        self._lower(nodes)

    def _parted(self, tin: Tin, new: np.ndarray) -> Tin:
        """Copies of a triangulation of one lane, with new vertices bool[lanes, size] in each."""
        groups = [slice(0, len(new))]
        tin = self._copied(tin, np.zeros(1, np.int64))
        have = np.zeros((1, self.size), bool)
        while True:
            common = np.stack([new[group].all(axis=0) for group in groups])
            tin.insert(np.flatnonzero(common & ~have))
            if len(groups) == len(new):
                return tin
            parts = [_halves(group) for group in groups]
            lanes = np.repeat(np.arange(len(groups)), [len(part) for part in parts])
            groups = [half for part in parts for half in part]
            have = common[lanes]
            tin = self._copied(tin, lanes)

    def _copied(self, tin: Tin, lanes: np.ndarray) -> Tin:
        sheets = (lanes[:, None] * self.sheets + np.arange(self.sheets)).ravel()
        return tin.copies(sheets, np.full(len(tin.xyz), -1, np.int32))[0]

    def _keep(self, lanes: np.ndarray) -> None:
        """Go on with copies of these lanes."""
        count, size, net, sheets = len(lanes), self.size, self.net, self.sheets

        def of(values: np.ndarray, width: int = size) -> np.ndarray:
            return values.reshape(self.lanes, width, *values.shape[1:])[lanes].reshape(count * width, *values.shape[1:])

        def moved(values: np.ndarray, step: int, width: int = size) -> np.ndarray:
            """The same for numbers that differ by ``step`` from lane to lane; -1 = none."""
            shift = np.repeat((np.arange(count) - lanes) * step, width)
            taken = of(values, width)
            return np.where(taken < 0, taken, taken + shift.astype(taken.dtype))

        self.net = Network(
            xyz=of(net.xyz),
            sheet=moved(net.sheet, sheets),
            row=of(net.row),
            seed=of(net.seed),
            open=of(net.open),
            late=of(net.late),
        )
        self.ground, self.waiting = of(self.ground), of(self.waiting)
        self.head, self.vertex_at = moved(self.head, size), moved(self.vertex_at, size)
        self._find_shared()
        self.virtual = moved(self.virtual, size, self.borders)
        self.border_gap = of(self.border_gap, self.borders)
        if self.square is not None:
            self.square = moved(self.square, self.squares)
            self.taken = of(self.taken, self.squares)
        self.admitted = self.admitted[lanes]
        self.row, self.lanes = self.row[lanes], count

    def run_all(self, max_rounds: int) -> Iterator[tuple[int, np.ndarray]]:
        """Number of the rule and bool[k], ground, of every lane as soon as it is done."""
        todo = np.flatnonzero(self.waiting & ~self.net.late)
        for turn in range(max_rounds):
            if turn > 0:
                accepted, _ = self._test(todo)
                self.ground[accepted] = True
                self.waiting[accepted] = False
                changed, _ = self._grow(accepted)
                rest = np.flatnonzero(self.waiting & ~(self.net.late & np.repeat(~self.admitted, self.size)))
                todo = rest[self._again(rest, rest[:0], changed)]
            idle = self._idle(todo)
            if (idle & ~self.admitted).any():
                admits = idle & ~self.admitted
                late = self.waiting & self.net.late & np.repeat(admits, self.size)
                todo = np.union1d(todo, np.flatnonzero(late))
                self.admitted |= admits
                idle = self._idle(todo)
            yield from self._labels(idle & ~self.done)
            if idle.all():
                return
            self.done |= idle
            if self.done.mean() >= _LEAVING:
                todo = self._leave(np.flatnonzero(~self.done), todo)
        yield from self._labels(~self.done)

    def _labels(self, lanes: np.ndarray) -> Iterator[tuple[int, np.ndarray]]:
        for lane in np.flatnonzero(lanes):
            ground = self.ground[lane * self.size : (lane + 1) * self.size]
            yield int(self.numbers[self.row[lane]]), ground.copy()

    def _idle(self, todo: np.ndarray) -> np.ndarray:
        """bool[lanes]: nothing is left to test in them."""
        return np.bincount(todo // self.size, minlength=self.lanes) == 0

    def _leave(self, staying: np.ndarray, todo: np.ndarray) -> np.ndarray:
        """Drop all lanes but some; ``todo`` under the new numbers of the nodes."""
        marked = np.zeros(len(self.ground), bool)
        marked[todo] = True
        marked = marked.reshape(self.lanes, self.size)[staying].ravel()
        sheets = (staying[:, None] * self.sheets + np.arange(self.sheets)).ravel()
        self.tin, self.image_in = self.tin.copies(sheets, self.image_in)
        self._keep(staying)
        self.done = self.done[staying]
        return np.flatnonzero(marked)

    def _test(self, nodes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        facet = self._facets(nodes)
        verdict = self._judge(nodes, facet)
        if self.mirror is not None and self.mirror.slope < 90.0:
            self._mirror(nodes, facet, verdict)
        return nodes[verdict["accepted"]], nodes[:0]

    def _verdict(self, nodes: np.ndarray, *arguments: np.ndarray) -> Verdict:
        which = self._padded(self.row[nodes // self.size].astype(np.int32))
        return judge_each(self.rules, which, *arguments)


def _halves(group: slice) -> list[slice]:
    """Two halves of a range, or the range itself if it has one element."""
    if group.stop - group.start == 1:
        return [group]
    middle = (group.start + group.stop) // 2
    return [slice(group.start, middle), slice(middle, group.stop)]
