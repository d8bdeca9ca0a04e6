"""What a filter returns, and what it has to offer to be one."""

from __future__ import annotations

import dataclasses
import enum
from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

Progress = Callable[[float, str], None]
"""Called with the fraction done (0..1) and the name of the step."""


def silent(fraction: float, step: str) -> None:
    """A :data:`Progress` that reports to no one."""


class Status(enum.IntEnum):
    """How a run ended; ``message`` says it in words."""

    CONVERGED = 0
    ROUND_LIMIT = 1
    NO_POINTS = 2
    NO_CANDIDATES = 3
    TOO_FEW_POINTS = 4
    FLAT = 5

    @property
    def message(self) -> str:
        return _MESSAGES[self]


_MESSAGES = {
    Status.CONVERGED: "finished",
    Status.ROUND_LIMIT: "the limit of rounds was reached before densification ended",
    Status.NO_POINTS: "the cloud has no points",
    Status.NO_CANDIDATES: "no point is a candidate: all are set aside by echo, class or withheld flag",
    Status.TOO_FEW_POINTS: "fewer than four distinct positions, or all on a line: the lowest per position are ground",
    Status.FLAT: "all points have one elevation: all are ground",
}


class Decision(enum.IntEnum):
    """Which test decided a point."""

    SET_ASIDE = (
        0  # never tested: no candidate (echo, class, withheld flag, invalid coordinate), or taken out by the method
    )
    SEED = 1
    ACCEPTED = 2  # passed every test
    NOISE_FLOOR = 3  # within the noise floor of its facet
    ANGLE = 4  # failed the angle test
    ELEVATION = 5  # failed the test of elevation or distance
    LOW = 6  # too far below the surface
    SURFACE = 7  # failed the test against a gridded surface


@dataclasses.dataclass(frozen=True)
class FilterResult:
    """Labels and the quantities behind them; all arrays have the length and the order of the cloud.

    Attributes:
        ground: bool[n].
        height: f32[n], metres above the final surface (negative below); NaN where no surface was tested.
        slope: f32[n], degrees; slope of that surface under the point.
        angle: f32[n], degrees; last tested angle to the facet (TIN filters), else NaN.
        elevation: f32[n], metres; last tested elevation over the highest vertex, or distance to the facet; else NaN.
        margin: f32[n]; tested quantity minus its threshold in the unit of the deciding test: negative = ground. NaN if untested.
        decision: u8[n], see :class:`Decision`.
        barred: bool[n]; points kept out of the seeds as outliers (they were tested again later).
        status: how the run ended; ``status.message`` in words.
        info: counts of the run (seeds, rounds, facets, ...).
        trace: a dict of counts per round, in order; with ``trace=True`` also ``"ground"``: bool[n] after that round.
    """

    ground: np.ndarray
    height: np.ndarray
    slope: np.ndarray
    angle: np.ndarray
    elevation: np.ndarray
    margin: np.ndarray
    decision: np.ndarray
    barred: np.ndarray
    status: Status
    info: dict[str, Any]
    trace: list[dict[str, Any]]

    def __len__(self) -> int:
        return len(self.ground)

    def __repr__(self) -> str:
        share = 100 * float(self.ground.mean()) if len(self) else float("nan")
        return f"FilterResult({int(self.ground.sum())} of {len(self)} ground, {share:.1f} %; {self.status.message})"


@runtime_checkable
class GroundFilter(Protocol):
    """A ground filter: call it on a cloud; ask how far its decisions reach."""

    def __call__(
        self, cloud: Any, *, key: Any = None, workers: int | None = None, progress: Progress | None = None
    ) -> FilterResult: ...

    def halo(self) -> float:
        """Metres beyond a region that can change labels inside it: the buffer a tile needs."""
        ...
