"""The report of a classification: what is counted over all points, and the file."""

from __future__ import annotations

import dataclasses
import os
from concurrent.futures import ThreadPoolExecutor
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from ..citing import citation
from ..core.cloud import GROUND_CLASS, PointCloud, as_cloud
from ..core.errors import InputError, OutputError, ParameterError
from ..core.filter import Filter, check_resources
from ..core.markup import table
from ..core.params import declared
from ..core.points import morton
from ..core.result import Decision, FilterResult, Progress, silent
from ..core.version import __version__
from ..files.disk import new_file
from ..files.reading import class_changes
from ..scoring import Scores, reference_labels
from .layers import Layers, doubt_per_point, layers_of, places
from .packing import pack, script_json
from .steps import Steps, steps_of

SUFFIXES = (".html", ".htm")
SCRIPTS = ("data.js", "map.js", "profile.js", "page.js")
MAX_POINTS = 1_500_000
SCORES = ("type1", "type2", "total", "kappa")
_JUDGED, _TRUE, _COUNTED = 1, 2, 4
"""Bits of a point's flags, as in data.js."""


def report(
    cloud: Any,
    result: FilterResult | np.ndarray,
    path: str | os.PathLike[str],
    *,
    reference: PointCloud | np.ndarray | None = None,
    title: str | None = None,
    steps: int | None = None,
    max_points: int = MAX_POINTS,
    overwrite: bool = False,
    workers: int | None = None,
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
        title: by default the name of the cloud's file.
        steps: positions of the slider, 0 for none; at most 250, and 15 where each is a classification.
        max_points: points to draw; 10 bytes each, or fewer.
        overwrite: replace the file if it exists.
        workers: threads; by default one per core.
        progress: called with the fraction done and the name of the step.

    Returns: the path.
    Raises: ParameterError, InputError (labels of another length or dtype), OutputError (suffix, exists and not ``overwrite``,
    cannot be written); all but the last before anything is computed.

    >>> jf.report(cloud, result, "report.html", reference=cloud, steps=0).name
    'report.html'
    """
    path, notify = Path(path), progress or silent
    check_resources(workers)
    if path.suffix.lower() not in SUFFIXES:
        raise OutputError(f"{path}: the suffix must be one of {', '.join(SUFFIXES)}")
    for name, value, least in (("steps", steps, 0), ("max_points", max_points, 1)):
        if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < least):
            raise ParameterError(f"{name}={value!r}: a whole number from {least} on is needed")
    cloud = as_cloud(cloud)
    ground = result.ground if isinstance(result, FilterResult) else np.asarray(result)
    if ground.shape != (len(cloud),) or ground.dtype != bool:
        raise InputError(f"result: bool[{len(cloud)}] is needed for this cloud, not {ground.dtype}{list(ground.shape)}")
    truth = counted = None
    if reference is not None:
        truth, counted = reference_labels(reference)
        if len(truth) != len(cloud):
            raise InputError(f"reference has {len(truth)} labels for {len(cloud)} points: use the same points")
    with new_file(path, overwrite=overwrite) as temporary:
        notify(0.0, "slider")
        slider = steps_of(
            result if isinstance(result, FilterResult) else ground, steps, workers=workers,
            progress=lambda done, step: notify(0.5 * done, step),
        )  # fmt: skip
        notify(0.5, "maps")
        real = len(cloud) if cloud.valid is None else cloud.valid.sum()
        layers = layers_of(cloud, result, truth, counted) if real else None
        notify(0.7, "points")
        facts, arrays = _contents(cloud, result, truth, counted, slider, layers, max_points)
        notify(0.9, "page")
        name = "the cloud" if cloud.source is None else Path(cloud.source.path).name
        text = _page(cloud, result, title or name, slider, layers, facts, arrays, workers)
        temporary.write_text(text, encoding="utf-8")
    notify(1.0, "done")
    return path


def _contents(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    truth: np.ndarray | None,
    counted: np.ndarray | None,
    slider: Steps,
    layers: Layers | None,
    max_points: int,
) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """What the scripts of the page work on: plain facts, and arrays u8 and u16 by name."""
    facts: dict[str, Any] = {
        "step": slider.now,
        "values": slider.values,
        "nested": slider.nested,
        "threshold": _threshold(result, slider.field),
        "points": len(cloud),
        "frame": {"origin": cloud.origin, "units": [cloud.units.xy, cloud.units.z]},
        **_counts(cloud, slider, truth, counted),
    }
    if layers is None:
        return facts, {}
    facts["grid"] = dataclasses.asdict(layers.grid)
    facts["elevation"] = {"low": layers.z_low, "step": layers.z_step}
    ground = result.ground if isinstance(result, FilterResult) else result
    wrong = None if truth is None or counted is None else (ground != truth) & counted
    facts["places"] = places(cloud, doubt_per_point(result, len(cloud))[0], wrong, layers.grid.cell)
    arrays = {"shade": layers.shade, "elevation": layers.elevation, "height": layers.height}
    facts["doubt_of"] = layers.doubt_of
    if layers.doubt_of:
        arrays["doubt"] = layers.doubt
    if layers.errors is not None:
        arrays["errors"] = layers.errors
    flags: np.ndarray = cloud.candidate * np.uint8(_JUDGED)
    if truth is not None and counted is not None:
        flags = flags + truth * np.uint8(_TRUE) + counted * np.uint8(_COUNTED)
    facts["sample"], sampled = _sample(cloud, slider.code, flags, max_points)
    return facts, arrays | sampled


def _counts(cloud: PointCloud, steps: Steps, truth: np.ndarray | None, counted: np.ndarray | None) -> dict[str, Any]:
    """Of all points, at every step: ground, classes before and after as ``write`` makes them, scores."""
    code, labels = steps.code.astype(np.int64), steps.table
    old = np.zeros(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    known = truth is not None and counted is not None
    kind = np.where(counted, 1 + truth, 0) if known else np.zeros(len(cloud), np.int64)  # type: ignore[arg-type, operator]
    key = ((old.astype(np.int64) * 2 + cloud.candidate) * 3 + kind) * len(labels) + code
    number = np.bincount(key, minlength=256 * 6 * len(labels)).reshape(256, 2, 3, len(labels))
    ground, every = number @ labels.astype(np.int64), number.sum(axis=-1)
    moves: dict[tuple[int, int], np.ndarray] = {}
    for c in np.flatnonzero(every.any(axis=(1, 2))).tolist():
        kept, judged, on_ground = every[c, 0].sum(), every[c, 1].sum(), ground[c, 1].sum(axis=0)
        for new, points in ((c, kept), (GROUND_CLASS, on_ground), (_other(c), judged - on_ground)):
            moves[c, new] = moves.get((c, new), 0) + np.broadcast_to(points, len(steps.values))
    classes = [[*pair, points.tolist()] for pair, points in sorted(moves.items()) if points.any()]
    out: dict[str, Any] = {"ground": ground.sum(axis=(0, 1, 2)).tolist(), "classes": classes}
    if truth is not None:
        total, hit = every.sum(axis=(0, 1)), ground.sum(axis=(0, 1))
        confusions = [
            Scores.from_confusion(np.array([[hit[2, k], total[2] - hit[2, k]], [hit[1, k], total[1] - hit[1, k]]]))
            for k in range(len(steps.values))
        ]
        out["scores"] = {one: [getattr(scores, one) for scores in confusions] for one in SCORES}
        out["confusion"] = [scores.confusion for scores in confusions]
    return out


def _other(old: int) -> int:
    """The class that ``write`` gives a judged point of this class that is not ground."""
    one = PointCloud.from_arrays(np.zeros((1, 3)), classification=np.array([old], np.uint8), ignore_classes=())
    return next(iter(class_changes(one, np.zeros(1, bool))))[1]


def _threshold(result: FilterResult | np.ndarray, field: str | None) -> dict[str, str] | None:
    """What the slider moves, in words."""
    if field is None or not isinstance(result, FilterResult) or result.run is None:
        return None
    meta = next(one.metadata for one in declared(result.run.filter) if one.name == field)
    return {"name": field, "doc": meta["doc"], "unit": meta.get("unit") or "", "symbol": meta.get("symbol") or ""}


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


def _page(
    cloud: PointCloud,
    result: FilterResult | np.ndarray,
    title: str,
    steps: Steps,
    layers: Layers | None,
    facts: dict[str, Any],
    arrays: dict[str, np.ndarray],
    workers: int | None,
) -> str:
    folder = files(__package__)
    with ThreadPoolExecutor(workers or os.cpu_count()) as pool:
        packed = list(pool.map(pack, arrays.values()))
    data = "\n".join(
        f'<script type="application/octet-stream" id="data-{name}" data-bytes="{values.dtype.itemsize}">{text}</script>'
        for (name, values), text in zip(arrays.items(), packed, strict=True)
    )
    run = result.run if isinstance(result, FilterResult) else None
    values = {
        "title": escape(title),
        "style": folder.joinpath("page.css").read_text(encoding="utf-8"),
        "code": "\n".join(folder.joinpath(name).read_text(encoding="utf-8") for name in SCRIPTS),
        "facts": script_json(facts),
        "data": data,
        "method": escape(type(run.filter).__name__ if run else "labels as given"),
        "notes": "".join(f"<p class=note>{escape(note)}</p>" for note in _notes(cloud, result, steps, layers)),
        "about": _about(cloud, result),
        "parameters": _parameters(result),
        "version": escape(__version__),
    }
    return Template(folder.joinpath("page.html").read_text(encoding="utf-8")).substitute(values)


def _notes(cloud: PointCloud, result: FilterResult | np.ndarray, steps: Steps, layers: Layers | None) -> list[str]:
    """What a reader has to know that is not as usual."""
    notes = []
    if not len(cloud):
        notes.append("The cloud has no points: there is nothing to show.")
    elif layers is None:
        notes.append("No point has valid coordinates: there is nothing to show.")
    elif not layers.of_ground:
        notes.append("No point is ground: relief and heights are those of the surface through all points.")
    if isinstance(result, FilterResult) and result.status.value > 0 and len(cloud):
        notes.append(f"How the run ended: {result.status.message}.")
    if steps.field is None and len(cloud):
        notes.append(f"There is no slider: {steps.reason}.")
    return notes


def _about(cloud: PointCloud, result: FilterResult | np.ndarray) -> str:
    """A table on the run and the cloud."""
    rows: list[tuple[str, Any]] = []
    if cloud.source is not None:
        rows.append(("file", Path(cloud.source.path).name))
    rows += [("points", len(cloud)), ("judged", int(cloud.candidate.sum()))]
    rows += [("CRS", "unknown" if cloud.crs is None else cloud.crs.name), ("units", str(cloud.units))]
    if isinstance(result, FilterResult):
        counts = np.bincount(result.decision, minlength=len(Decision))
        rows += [(one.name.lower().replace("_", " "), int(counts[one])) for one in Decision if counts[one]]
        rows.append(("ended", result.status.message))
        if result.run is not None:
            rows.append(("seconds", f"{result.run.seconds:.2f}"))
    return table((), [*rows, ("jaxfilter", __version__)])


def _parameters(result: FilterResult | np.ndarray) -> str:
    """A section on the filter: its fields, and what to cite."""
    if not isinstance(result, FilterResult) or result.run is None or not isinstance(result.run.filter, Filter):
        return ""
    filter_ = result.run.filter
    name = type(filter_).__name__
    cited = f"<h3>To cite</h3><pre>{escape(citation(filter_))}</pre>" if filter_.BIBTEX else ""
    return f"<section><h2>Parameters of {escape(name)}</h2>{filter_._repr_html_()}{cited}</section>"
