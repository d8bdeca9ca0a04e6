"""Growths that are nearly alike, one after the other: the first rounds of each begin with what the one before has left."""

from __future__ import annotations

import dataclasses
from typing import Any, NamedTuple

import numpy as np

from ...core.compilation import bucket
from ..chunks import in_chunks
from .facets import FacetScore, passing
from .ground import GroundTin
from .growth import Growth, Network
from .triangulation import Tin

_DOUBT = {"angle": 0.05, "length": 0.002}
"""Degrees and metres from a limit within which a node is tested anew: other programs round a little differently."""


class Foothold(NamedTuple):
    """Where a growth goes on from.

    Attributes:
        network: with the ground so far as seeds; tin: their triangulation.
        passing: i64, nodes that are known to pass in the next step; todo: i64, others that are to be tested in it. At the start
            there are none, and all are tested.
    """

    network: Network
    tin: Tin
    passing: np.ndarray = np.zeros(0, np.int64)
    todo: np.ndarray = np.zeros(0, np.int64)


class Trail:
    """The first rounds of growths from networks with the same nodes, of one sheet.

    Each round has a triangulation of its own, which moves from the vertices of one growth to those of the next. Only nodes
    whose facet has changed by that are measured anew, and only those near to a limit are tested.
    """

    def __init__(self, tin: Tin, rounds: int) -> None:
        """``tin``: of any of the networks; it is copied."""
        self._rounds = [_Round(Tin.joined([tin])) for _ in range(rounds)]

    def follow(self, network: Network, growth: Growth) -> Foothold:
        """Where a growth stands before the last of these rounds."""
        first, *others = self._rounds
        ground, sure = first.decided(network, growth)
        for one in others:
            seed = network.seed.copy()
            seed[sure], seed[ground.test()] = True, True
            network = dataclasses.replace(network, seed=seed)
            ground, sure = one.decided(network, growth)
        return Foothold(network, Tin.joined([ground.tin]), sure, ground.todo)


class _Round:
    def __init__(self, tin: Tin) -> None:
        self.tin, self.known = tin, np.zeros(len(tin.xyz), bool)
        self.score = {name: np.zeros(len(tin.xyz), np.float32) for name in FacetScore._fields}

    def decided(self, network: Network, growth: Growth) -> tuple[GroundTin, np.ndarray]:
        """The seeds, on their triangulation; those that may pass over it are left to be tested, and others, i64, do pass."""
        ground = GroundTin(network, growth)
        self.known[ground.move(self.tin)] = False
        rest = ground.todo
        new = rest[~self.known[rest]]
        for name, values in ground.measured(new).items():
            self.score[name][new] = values
        self.known[new] = True
        rules = [_shifted(ground.rule, sign) for sign in (-1, 1)]
        passes, may_pass = in_chunks(
            lambda *score: passing(rules, FacetScore(*score)),
            lambda rows: tuple(values[rest[rows]] for values in self.score.values()),
            len(rest),
            min(bucket(len(self.known)), 65536),
        )
        doubtful = passes != may_pass
        if growth.mirror is not None:
            doubtful |= self.score["level"][rest] < np.cos(np.radians(growth.mirror.slope)) + 1e-3
        ground.todo = rest[doubtful]
        return ground, rest[passes & ~doubtful]


def _shifted(rule: Any, sign: int) -> Any:
    """Limits that are a little stricter or looser; what is zero is switched off, and stays so."""
    shift = {name: _DOUBT["angle" if "angle" in name else "length"] * sign for name in rule._fields}
    return rule._replace(**{name: v + np.float32(shift[name] * (v != 0)) for name, v in rule._asdict().items()})
