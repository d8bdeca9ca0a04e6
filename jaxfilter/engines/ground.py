"""Ground that grows from seeds: the one loop of all methods that test points over the ground that they have found so far."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar

import numpy as np

from ..core.result import Progress, Status, silent


class GroundNodes(ABC):
    """Nodes that are ground, and those that are to be tested over them.

    A kind of them says how they are tested, and over what: facets of a triangulation, planes through the ground around.

    Attributes:
        ground: bool[k]. left: how many may still become ground. todo: i64, those of them to be tested in the next step;
            the others would fail again, since nothing that they are tested over has changed.
        rule: the limits of the tests.
        trace: a record of each step.
    """

    STEP: ClassVar[str]
    """What progress is reported as."""

    def __init__(self, ground: np.ndarray, todo: np.ndarray, rule: Any) -> None:
        self.ground, self.left, self.todo, self.rule = ground, len(todo), todo, rule
        self.trace: list[dict[str, Any]] = []

    @abstractmethod
    def test(self) -> np.ndarray:
        """i64: nodes of ``todo`` that become ground."""

    @abstractmethod
    def take(self, accepted: np.ndarray) -> dict[str, Any]:
        """Test others over these from now on, and find out which: sets ``left`` and ``todo``. What the record also holds."""

    def step(self) -> None:
        """Test all of ``todo`` at once, and make ground of those that pass: the order of nodes never matters."""
        tested, accepted = len(self.todo), self.test()
        self.ground[accepted] = True
        self.trace.append({"tested": tested, "accepted": len(accepted), **self.take(accepted)})


def grow(ground: GroundNodes, max_rounds: int, progress: Progress = silent, keep_labels: bool = False) -> Status:
    """Steps until nothing is left to be tested, or so many. ``keep_labels``: with the labels after each in the trace."""
    total = max(1, ground.left)
    for _ in range(max_rounds):
        progress(1.0 - ground.left / total, ground.STEP)
        ground.step()
        if keep_labels:
            ground.trace[-1]["ground"] = ground.ground.copy()
        if len(ground.todo) == 0:
            return Status.CONVERGED
    return Status.ROUND_LIMIT
