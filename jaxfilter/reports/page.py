"""The report of a classification: what is counted over all points, and the file."""

from __future__ import annotations

import base64
import dataclasses
import json
import os
import zlib
from concurrent.futures import ThreadPoolExecutor
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..core.cloud import GROUND_CLASS, PointCloud, as_cloud
from ..core.errors import InputError, check_whole
from ..core.filter import Filter, check_resources
from ..core.params import declared
from ..core.points import morton
from ..core.result import Decision, FilterResult, Progress, silent
from ..core.version import __version__
from ..files.classes import Classes, Finding, class_name, table_of
from ..files.disk import check_suffix, new_file
from ..methods.papers import citation
from ..scoring import Scores, reference_labels
from ..sweeps.best import SCORES
from .layers import map_layers, places_to_look_at
from .parts import table
from .places import as_result
from .steps import Steps, steps_of

PAGE_SUFFIXES = (".html", ".htm")
SCRIPTS = ("data.js", "map.js", "profile.js", "page.js")
_JUDGED, _TRUE, _COUNTED = 1, 2, 4
"""Bits of a point's flags, as in data.js."""
_COMPRESSION = 4
"""Level of that of arrays."""


@dataclasses.dataclass(frozen=True)
class ReportOptions:
    """What a page of :func:`report` shows.

    Attributes:
        title: by default the name of the cloud's file.
        steps: positions of the slider, 0 for none; at most 250, and 15 where each is a classification.
        max_points: points to draw; 10 bytes each, or fewer.
        workers: threads; by default one per core.

    Raises: ParameterError for numbers that are none.

    >>> jf.ReportOptions(steps=0).max_points
    1500000
    """

    title: str | None = None
    steps: int | None = None
    max_points: int = 1_500_000
    workers: int | None = None

    def __post_init__(self) -> None:
        check_resources(self.workers)
        check_whole(0, steps=0 if self.steps is None else self.steps)
        check_whole(max_points=self.max_points)


def report(
    cloud: Any,
    result: FilterResult | np.ndarray,
    path: str | os.PathLike[str],
    *,
    reference: PointCloud | np.ndarray | None = None,
    options: ReportOptions = ReportOptions(),
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a page on a classification, for people who check terrain models: one HTML file that needs no network.

    It has maps (relief of the ground, labels, heights above ground, doubt, and errors against a reference), the places to
    look at first, a profile between two clicks, and a slider that labels the points anew at other values of a threshold,
    with counts, classes and scores of **all** points at each of its steps. That is the threshold that the method applies
    last (``LAST`` and ``TESTED`` of its class), in about fifty steps; of other methods the one that decides most, in the few
    steps, each a classification, that four million points times steps allow: none for larger clouds. Maps are rasters of at
    most two million cells; the points that are drawn are a random sample, the same in every call.

    Args:
        cloud: n points, a PointCloud or a ``laspy.LasData``.
        result: FilterResult; or bool[n], True = ground, of any origin, for which there is no slider.
        path: the file, ``.html`` or ``.htm``.
        reference: as in :func:`jaxfilter.evaluate`: bool[n], or a PointCloud with reference labels, such as ``cloud``.
        options: what the page shows.
        overwrite: replace the file if it exists.
        progress: called with the fraction done and the name of the step.

    Returns: the path.
    Raises: InputError (labels of another length or dtype), OutputError (suffix, exists and not ``overwrite``,
    cannot be written); all but the last before anything is computed.

    >>> jf.report(cloud, result, "report.html", reference=cloud, options=jf.ReportOptions(steps=0)).name
    'report.html'
    """
    path, notify = Path(path), progress or silent
    check_suffix(path, PAGE_SUFFIXES)
    cloud = as_cloud(cloud)
    result, truth = as_result(cloud, result), None
    if reference is not None:
        labels, counted = reference_labels(reference)
        if len(labels) != len(cloud):
            raise InputError(f"reference has {len(labels)} labels for {len(cloud)} points: use the same points")
        truth = np.where(counted, labels, -1).astype(np.int8)
    with new_file(path, overwrite=overwrite) as temporary:
        notify(0.0, "slider")
        slider = steps_of(result, options.steps, options.workers, lambda done, step: notify(0.5 * done, step))
        facts, arrays = _collect(cloud, result, truth, slider, options.max_points, notify)
        notify(0.9, "page")
        with ThreadPoolExecutor(options.workers or os.cpu_count()) as pool:
            data = "\n".join(
                f'<script type="application/octet-stream" id="data-{name}" data-bytes="{values.dtype.itemsize}">{text}</script>'
                for (name, values), text in zip(arrays.items(), pool.map(pack, arrays.values()), strict=True)
            )
        name = "the cloud" if cloud.source is None else Path(cloud.source.path).name
        values = {"title": escape(options.title or name), "facts": script_json(facts), "data": data}
        page = Template(_read_piece("page.html")).substitute(values | _write_texts(cloud, result, slider))
        temporary.write_text(page, encoding="utf-8")
    notify(1.0, "done")
    return path


def _collect(
    cloud: PointCloud,
    result: FilterResult,
    truth: np.ndarray | None,
    slider: Steps,
    max_points: int,
    notify: Progress,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the scripts of the page work on: plain facts, and arrays u8 and u16 by name."""
    facts: dict[str, Any] = {
        "step": slider.now,
        "values": slider.values,
        "nested": slider.nested,
        "threshold": None,
        "points": len(cloud),
        "frame": {"origin": cloud.origin, "units": [cloud.units.xy, cloud.units.z]},
        **_count(cloud, truth, slider),
    }
    if result.run is not None and slider.field is not None:
        meta = next(one.metadata for one in declared(result.run.filter) if one.name == slider.field)
        words = {name: meta.get(name) or "" for name in ("unit", "symbol")}
        facts["threshold"] = {"name": slider.field, "doc": meta["doc"]} | words
    notify(0.5, "maps")
    if not len(cloud) or (cloud.valid is not None and not cloud.valid.any()):
        return facts, {}
    found, arrays = map_layers(cloud, result, truth)
    wrong = None
    flags: np.ndarray = cloud.candidate * np.uint8(_JUDGED)
    if truth is not None:
        wrong = (result.ground != (truth == 1)) & (truth >= 0)
        flags = flags + (truth == 1) * np.uint8(_TRUE) + (truth >= 0) * np.uint8(_COUNTED)
    found["places"] = places_to_look_at(cloud, result, wrong, found["grid"]["cell"])
    notify(0.7, "points")
    found["sample"], sampled = _sample(cloud, slider.code, flags, max_points)
    return facts | found, arrays | sampled


def _count(cloud: PointCloud, truth: np.ndarray | None, steps: Steps) -> dict[str, Any]:
    """Of all points, at every step: ground, classes before and after as ``write`` makes them, scores."""
    code, labels = steps.code.astype(np.int64), steps.table
    old = np.zeros(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    kind = 0 if truth is None else truth + 1
    key = ((old.astype(np.int64) * 2 + cloud.candidate) * 3 + kind) * len(labels) + code
    number = np.bincount(key, minlength=256 * 6 * len(labels)).reshape(256, 2, 3, len(labels))
    ground, every = number @ labels.astype(np.int64), number.sum(axis=-1)
    moves: dict[tuple[int, int], np.ndarray] = {}
    lost = table_of(Classes())[Finding.OTHER].tolist()  # by the old class, that of a judged object
    for c in np.flatnonzero(every.any(axis=(1, 2))).tolist():
        kept, judged, on_ground = every[c, 0].sum(), every[c, 1].sum(), ground[c, 1].sum(axis=0)
        for new, points in ((c, kept), (GROUND_CLASS, on_ground), (lost[c], judged - on_ground)):
            moves[c, new] = moves.get((c, new), 0) + np.broadcast_to(points, len(steps.values))
    classes = [[*pair, points.tolist()] for pair, points in sorted(moves.items()) if points.any()]
    names = {number: class_name(number) for pair in moves for number in pair}
    out: dict[str, Any] = {"ground": ground.sum(axis=(0, 1, 2)).tolist(), "classes": classes, "class_names": names}
    if truth is not None:
        total, hit = every.sum(axis=(0, 1)), ground.sum(axis=(0, 1))
        confusions = [
            Scores.from_confusion(np.array([[hit[2, k], total[2] - hit[2, k]], [hit[1, k], total[1] - hit[1, k]]]))
            for k in range(len(steps.values))
        ]
        out["scores"] = {one: [getattr(scores, one) for scores in confusions] for one in SCORES}
        out["confusion"] = [scores.confusion for scores in confusions]
    return out


def _sample(
    cloud: PointCloud, code: np.ndarray, flags: np.ndarray, limit: int
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Points to draw, neighbours beside each other, quantised over their extent."""
    rows = np.arange(len(cloud)) if cloud.valid is None else np.flatnonzero(cloud.valid)
    total = len(rows)
    if total > limit:
        rows = np.sort(np.random.default_rng(0).choice(rows, limit, replace=False, shuffle=False))
    xyz = cloud.xyz[rows]
    low, span = xyz.min(axis=0), np.ptp(xyz, axis=0)
    step = np.maximum([max(span[:2])] * 2 + [span[2]], 0.001).astype(np.float64) / 65535
    ticks = np.rint((xyz - low) / step).astype(np.uint16)
    order = np.argsort(morton(ticks[:, :2] / 4096.0), kind="stable")
    ticks, rows = ticks[order], rows[order]
    arrays = dict(zip(("x", "y", "z"), ticks.T, strict=True))
    arrays["flags"] = flags[rows].astype(np.uint8)
    arrays["code"] = code[rows]
    return {"number": len(rows), "of": total, "low": low, "step": step}, arrays


def _read_piece(name: str) -> str:
    return files(__package__).joinpath(name).read_text(encoding="utf-8")


def _write_texts(cloud: PointCloud, result: FilterResult, steps: Steps) -> dict[str, str]:
    """The parts of the page that are HTML."""
    filter_, parameters = None if result.run is None else result.run.filter, ""
    if isinstance(filter_, Filter):
        rows = []
        for field in declared(filter_):
            value, meta = getattr(filter_, field.name), field.metadata
            default = "" if value == field.default else f" (default {field.default})"
            rows.append((field.name, f"{value}{default}", meta["symbol"], meta["unit"], meta["doc"]))
        fields = table(("parameter", "value", "symbol", "unit", "meaning"), rows)
        cited = f"<h3>To cite</h3><pre>{escape(citation(filter_))}</pre>" if filter_.BIBTEX else ""
        title = f"<h2>Parameters of {escape(type(filter_).__name__)}</h2>"
        parameters = f"<section class=parameters>{title}{fields}{cited}</section>"
    notes = _list_notes(cloud, result, steps)
    return {
        "style": _read_piece("page.css"),
        "code": "\n".join(map(_read_piece, SCRIPTS)),
        "method": escape("labels as given" if filter_ is None else type(filter_).__name__),
        "notes": "".join(f"<p class=note>{escape(note)}</p>" for note in notes),
        "about": _describe(cloud, result),
        "parameters": parameters,
        "version": escape(__version__),
    }


def _list_notes(cloud: PointCloud, result: FilterResult, steps: Steps) -> list[str]:
    """What a reader has to know that is not as usual."""
    if not len(cloud):
        return ["The cloud has no points: there is nothing to show."]
    notes = []
    if cloud.valid is not None and not cloud.valid.any():
        notes.append("No point has valid coordinates: there is nothing to show.")
    elif not result.ground.any():
        notes.append("No point is ground: relief and heights are those of the surface through all points.")
    if result.status.value > 0:
        notes.append(f"How the run ended: {result.status.message}.")
    if steps.field is None:
        notes.append(f"There is no slider: {steps.reason}.")
    return notes


_DECIDED = {
    Decision.SET_ASIDE: "not judged",
    Decision.SEED: "ground: a seed",
    Decision.ACCEPTED: "ground: passed all tests",
    Decision.NOISE_FLOOR: "ground: within the noise",
    Decision.ANGLE: "non-ground: steep above its facet",
    Decision.ELEVATION: "non-ground: far above the ground",
    Decision.LOW: "non-ground: far below the ground",
    Decision.SURFACE: "non-ground: part of an object",
}
"""What the page calls each decision."""


def _describe(cloud: PointCloud, result: FilterResult) -> str:
    """A table on the run and the cloud."""
    rows: list[tuple[str, Any]] = [] if cloud.source is None else [("file", Path(cloud.source.path).name)]
    rows += [("points", len(cloud)), ("judged", int(cloud.candidate.sum()))]
    rows += [("CRS", "unknown" if cloud.crs is None else cloud.crs.name), ("units", str(cloud.units))]
    counts = np.bincount(result.decision, minlength=len(Decision))
    if result.run is not None or counts[1:].any():  # not labels alone
        rows += [(_DECIDED[one], int(counts[one])) for one in Decision if counts[one]]
        rows.append(("ended", result.status.message))
    if result.run is not None:
        rows.append(("seconds", f"{result.run.seconds:.2f}"))
    return table((), [*rows, ("jaxfilter", __version__)])


def pack(values: np.ndarray) -> str:
    """An array of u8 or u16 as base64: differences from one element to the next, byte by byte, deflated.

    Neighbours are mostly alike, so most differences are small and their upper bytes zero.
    """
    flat = values.ravel()
    difference = np.diff(flat, prepend=flat.dtype.type(0)).astype(flat.dtype.newbyteorder("<"), copy=False)
    planes = difference.view(np.uint8).reshape(-1, flat.dtype.itemsize).T
    return base64.b64encode(zlib.compress(planes.tobytes(), _COMPRESSION)).decode("ascii")


def script_json(value: Any) -> str:
    """A value as JSON for the inside of a ``<script>``; NaN and infinities become null."""
    text = json.dumps(value, default=lambda array: array.tolist())
    finite = json.loads(text, parse_constant=lambda name: None)
    return json.dumps(finite, separators=(",", ":")).replace("<", "\\u003c")
