"""What is known of a run: of each tile, and of all together."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import json
import warnings
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, cast

import numpy as np

from ..core.errors import JaxfilterWarning
from ..core.result import plain
from ..files.disk import new_file
from ..files.storage import Place

if TYPE_CHECKING:
    from ..terrain.levels import WaterRuns

REPORT, MAP = "jaxfilter-run.json", "jaxfilter-run.png"
_MOST_DRAWN = 100_000  # tiles


@dataclasses.dataclass
class Summary:
    """What is known of a tile, or of several together.

    Attributes:
        points, candidates, ground: of the core; read: with the halo.
        low_noise: low outliers.
        uncertain: points or cells whose height may be another in the whole.
        seconds: by step.
        classes: points by (old class, new class).
        overlap: ``points`` that the producer has marked as overlap of flight lines, how many were ``judged``, and how many are
            ``ground``; ``kept``: of these ground points those that keep class 12.
        statuses: tiles by the filter's status; remarks: what was warned of, with how often.
        heights: lowest and highest height above ground, units of Z, where these were asked for.
        unread: numbers of files that could not be read, with the reason.
    """

    points: int = 0
    candidates: int = 0
    ground: int = 0
    low_noise: int = 0
    read: int = 0
    uncertain: int = 0
    seconds: dict[str, float] = dataclasses.field(default_factory=cast(Any, collections.Counter))
    classes: collections.Counter[tuple[int, int]] = dataclasses.field(default_factory=collections.Counter)
    overlap: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    statuses: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    remarks: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    heights: tuple[float, float] | None = None
    unread: dict[int, str] = dataclasses.field(default_factory=dict)

    def add(self, other: Summary) -> None:
        """Take in what is known of another tile."""
        for field in dataclasses.fields(Summary):
            mine, others = getattr(self, field.name), getattr(other, field.name)
            if isinstance(mine, int):
                setattr(self, field.name, mine + others)
            elif isinstance(mine, (collections.Counter, dict)):
                mine.update(others)
            elif others is not None:
                low, high = others if mine is None else (min(mine[0], others[0]), max(mine[1], others[1]))
                self.heights = low, high

    def as_json(self) -> str:
        """As text; what counts by other keys than text becomes pairs."""
        pairs = {name: list(getattr(self, name).items()) for name in ("classes", "unread")}
        return json.dumps(vars(self) | pairs, default=plain)

    @classmethod
    def of_json(cls, text: str) -> Self:
        """From what :meth:`as_json` returned."""
        facts, found = json.loads(text), cls()
        classes = {(old, new): count for (old, new), count in facts["classes"]}
        found.add(cls(**(facts | {"classes": classes, "unread": dict(facts["unread"])})))
        return found


class Forecast(NamedTuple):
    """What a run would do, by the headers of the files. The largest tile decides on ``memory``; ``seconds`` are those of
    the points that are read, at a rate that was measured for the method on a server. Both are estimates.

    Attributes:
        points: of the files; tiles: number of them; side, halo: metres, NaN of a run in one piece.
        times_read: how many times each point is read, halos included.
        workers: processes, or threads of a run in one piece; memory: bytes for all of them; seconds: until it ends.
        files: that would be written.
    """

    points: int
    tiles: int
    side: float
    halo: float
    times_read: float
    workers: int
    memory: float
    seconds: float
    files: list[str]


TILE = np.dtype([("core", "f8", 4), ("ground", "f8"), ("points", "i8")])
"""A row of the table of tiles: xmin, ymin, xmax, ymax in file units; the share of ground of the points, NaN where there are none,
-1 for tiles that were set aside; and the number of points."""


@dataclasses.dataclass
class RunReport:
    """What a run, with those that it went on from, has done. The fields of ``total`` are fields of the report as well, such as
    ``report.points``.

    Attributes:
        total: of all tiles together.
        table: :data:`TILE`[t], a row for each tile.
        files: written, but for lists of places and breaklines.
        set_aside: tiles that failed: number, core and reason. failed: URI and reason of files that were not written.
        left_out: URI and reason of files that could not be read, so that tiles beside them had no halo there.
        elapsed: seconds of this process. None: an earlier run had done all, and this one did nothing; then nothing else here is
            known but ``files`` and ``failed``.
        places: where the terrain may be wrong, largest expected error volume first: a dict each of ``x``, ``y``, ``area``,
            ``volume``, ``chance`` and ``reason``, see :func:`jaxfilter.review`.
        water: the bodies of water, where they were asked for.
        method, parameters: of the filter; None if the ground was taken from classes.
        measures: of the scene, which the parts share: see :class:`jaxfilter.core.cloud.Whole`; None for a single tile.
        forecast: what the run would do, of one that was not to write; then nothing else here is known.
    """

    total: Summary = dataclasses.field(default_factory=Summary)
    table: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros(0, TILE))
    files: list[str] = dataclasses.field(default_factory=list)
    set_aside: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    failed: list[dict[str, str]] = dataclasses.field(default_factory=list)
    left_out: list[dict[str, str]] = dataclasses.field(default_factory=list)
    elapsed: float | None = None
    places: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    water: WaterRuns | None = None
    method: str | None = None
    parameters: dict[str, Any] = dataclasses.field(default_factory=dict)
    measures: dict[str, Any] | None = None
    forecast: Forecast | None = None

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_") or name == "total":
            raise AttributeError(name)
        return getattr(self.total, name)

    @property
    def tiles(self) -> int:
        """Number of tiles."""
        return len(self.table)

    @property
    def complete(self) -> bool:
        """Whether every file was written and none was left out."""
        return not (self.set_aside or self.failed or self.left_out)

    @property
    def was_complete(self) -> bool:
        """Whether an earlier run had done all."""
        return self.elapsed is None and self.forecast is None

    def add_tile(self, number: int, summary: Summary) -> None:
        """Take in a tile that is done."""
        self.total.add(summary)
        self.table["points"][number] = summary.points
        if summary.points:
            self.table["ground"][number] = summary.ground / summary.points

    def add_file(self, place: Place, remarks: Iterable[str], seconds: float = 0.0) -> None:
        """Take in a file that is written, what was warned of, and how long it took."""
        self.files.append(str(place))
        self.total.remarks.update(remarks)
        self.total.seconds["write"] += seconds

    def as_dict(self) -> dict[str, Any]:
        """For JSON, without the arrays."""
        found = vars(self.total) | vars(self) | {"tiles": self.tiles, "was_complete": self.was_complete}
        for name in ("total", "table", "unread", "forecast", "water"):
            del found[name]
        found["classes"] = [{"before": old, "after": new, "points": n} for (old, new), n in self.total.classes.items()]
        found["water_bodies"] = 0 if self.water is None else len(np.unique(self.water.body))
        return found | {"seconds": dict(self.total.seconds), "complete": self.complete}

    def put_into(self, folder: Place) -> None:
        """Put the report, as JSON, and a map into a folder. Raises: OutputError."""
        with new_file(folder / REPORT, overwrite=True) as part:
            part.write_text(json.dumps(self.as_dict(), indent=1, default=plain) + "\n")
        self.draw(folder / MAP)

    def recalled(self, folder: Place) -> Self:
        """Of a run that an earlier one had done: with the points, classes, places and method that stand in its folder."""
        if not isinstance(place := folder / REPORT, Path) or not place.is_file():
            return self
        try:
            facts = json.loads(place.read_text())
            moves = {(one["before"], one["after"]): one["points"] for one in facts["classes"]}
            total = Summary(points=facts["points"], ground=facts["ground"], classes=collections.Counter(moves))
            known = {name: facts[name] for name in ("places", "method", "parameters")}
        except (ValueError, KeyError):  # of an older version, or edited by hand
            return self
        return dataclasses.replace(self, total=total, **known)

    def draw(self, place: Place) -> None:
        """Write a map: share of ground of each tile, those set aside with dashes, and places where the terrain may be wrong as
        dots, large ones for large volumes; above it what was found. Raises: OutputError."""
        if not 0 < self.tiles <= _MOST_DRAWN:
            return
        from ..plots import footprints

        cores, ground = self.table["core"], self.table["ground"]
        shares = np.where(ground >= 0, 100 * ground, np.nan)
        aside = cores[ground < 0].tolist()
        one = self.tiles == 1  # a scale of one colour would say nothing
        ax = footprints(cores, None if one else shares, label="ground, % of the points", gaps=aside)
        share = 100 * self.ground / max(self.points, 1)
        found = f"{self.ground:,} of {self.points:,} points are ground ({share:.1f} %)"
        parts = f"tiles: {self.tiles:,}, set aside: {len(aside):,}, files: {len(self.files):,}"
        ax.set_title(f"{found}\n{self.method or 'ground by class'}; {parts}", fontsize=8)
        if self.places:
            x, y, volume = np.array([[one["x"], one["y"], one["volume"]] for one in self.places]).T
            size, words = 5 + 55 * volume / volume.max(), f"terrain may be wrong: {len(x):,} places"
            ax.scatter(x, y, s=size, c="red", edgecolors="black", linewidths=0.5, label=words)
            ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), frameon=False)
        with new_file(place, overwrite=True) as part:
            ax.figure.savefig(part, format="png", dpi=150, bbox_inches="tight")


@dataclasses.dataclass
class Standing:
    """How far a run is: what progress is made of.

    Attributes:
        step: ``"survey"`` or ``"tiles"``; of a run in this process, the step of the filter.
        share: of the step that is done, 0 to 1.
        tiles, tiles_done: all, and those that are done or set aside.
        points: of the cores done in this process; seconds: since it began.
        times_read: how many times each point is read, halos included, by the plan.
    """

    step: str
    tiles: int
    tiles_done: int = 0
    points: int = 0
    seconds: float = 0.0
    share: float = 0.0
    times_read: float = 1.0

    @property
    def rate(self) -> float:
        """Points per second."""
        return self.points / self.seconds if self.seconds > 0 else 0.0


@contextlib.contextmanager
def collected_warnings() -> Iterator[list[str]]:
    """A block whose warnings of this package are listed, each once, instead of being shown."""
    remarks: list[str] = []
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("ignore")
        warnings.simplefilter("always", JaxfilterWarning)
        yield remarks
        remarks += dict.fromkeys(str(w.message) for w in caught)
