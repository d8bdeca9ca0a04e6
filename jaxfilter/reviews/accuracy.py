"""A statement of accuracy: what check points say of a terrain model, and what labels say where there are none."""

from __future__ import annotations

import dataclasses
import datetime
import json
import math
import warnings
from collections import Counter
from collections.abc import Iterable
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..core.cloud import GROUND_CLASS
from ..core.errors import DAMAGED, InputError, OutputError
from ..core.reading import Bounds, Reading
from ..core.units import vertical
from ..core.version import __version__
from ..files.disk import check_suffix, new_file
from ..files.header import FLOATS
from ..files.points import read_points
from ..files.reading import open_las
from ..reports.page import PAGE_SUFFIXES
from ..reports.parts import page_of, parameter_table, table
from ..surveys.collection import Collection
from ..surveys.collection import open as open_collection
from ..surveys.options import RunOptions
from ..surveys.report import REPORT
from ..surveys.survey import check_in_place
from ..terrain.raster import Raster
from .survey import LOG, Log, run_review
from .verdicts import PLACE_RIM

EDITIONS = {
    "2014": "ASPRS Positional Accuracy Standards for Digital Geospatial Data, edition 1, version 1.0, November 2014, section 7.4 "
    "and annex C: NVA is 1.96 RMSEz, VVA the 95th percentile of absolute differences, 20 check points at least",
    "2023": "the same, edition 2, version 1.0, August 2023, summary of changes: RMSE, no 95 % confidence level, 30 check points "
    "at least, no limit for VVA",
}
"""What figures are made by."""
_LEAST = {"2014": 20, "2023": 30}
"""Check points that they ask for."""
_COVER, _DATUM = ("land_cover", "landcover", "cover"), ("vertical_datum", "datum", "vertical_crs")
_PLANTS = ("veg", "forest", "(?<!s)tree", "wood", "brush", "shrub", "(?<!out)crop", "weed", "tall", "vva")
_BARE = "non|not veg|unveg"
"""Parts of the names of land covers that are vegetated, if none of these is in them: a street and an outcrop are not."""


def accuracy_statement(
    what: Any,
    model: str | Path | Raster,
    path: str | Path,
    checkpoints: str | Path | None = None,
    *,
    ground: Iterable[int] = (GROUND_CLASS,),
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> dict[str, Any]:
    """State how accurate a terrain model is, on one page for a client, and as JSON beside it.

    Differences are model less check point, metres; the model is bilinear between the centres of its cells. NVA is about points
    whose land cover is not vegetated, VVA about the others (:data:`EDITIONS` cites the standard). The accuracy of the check
    points is not included.

    Args:
        what: classified files that the model was made of, as in :func:`jaxfilter.ground`.
        model: a raster of heights in their coordinates and units, a file or a Raster.
        path: the page, ``.html``. The JSON has the same name with ``.json``.
        checkpoints: a CSV file with the columns ``x``, ``y`` and ``z``, and if you like ``land_cover`` (words such as forest,
            brush, crops, trees, tall weeds or VVA are vegetated) and ``vertical_datum`` (a name or EPSG code).
        ground, reading, run: as in :func:`review_survey`.

    Returns: dict of what the page says: ``checkpoints`` (NVA, VVA, and by land cover), ``labels`` (expected wrong points from the
    extra dimension doubt, area of named places, density of ground points), ``model`` (area, voids), ``made`` (date,
    version, method, parameters, verdicts), ``notes`` and ``standards``.
    Raises: InputError for check points in another vertical datum than that of the model, or without coordinates, for a model
    beside the points, and for a damaged report beside the files; OutputError.

    >>> jf.dtm(cloud, truth).write("model.tif").name
    'model.tif'
    >>> said = jf.accuracy_statement("scene.laz", "model.tif", "accuracy.html", reading=jf.Reading(units="m"))
    >>> said["model"]["cells"], said["checkpoints"] is None
    (3600, True)
    """
    check_suffix(page := Path(path), PAGE_SUFFIXES)
    for target in (page, page.with_suffix(".json")):
        if target.exists() and not run.overwrite:
            raise OutputError(f"{target} exists: name another file, or pass overwrite=True")
    raster = model if isinstance(model, Raster) else Raster.read(model)
    check_in_place(reading)
    collection = what if isinstance(what, Collection) else open_collection(what, units=reading.units, crs=reading.crs)
    name, notes = None if raster is model else str(model), list[str]()
    inner = _find_covered(name or "model", raster, collection)
    made, decided = _read_records(collection)
    points = None if checkpoints is None else _compare(Path(checkpoints), raster, collection, notes)
    if inner is not None:
        notes.append("the model covers a part of the files: points and places in its bounds count")
        reading = dataclasses.replace(reading, aoi=shapely.box(*inner))
    report = run_review(collection, page, None, ground, reading, run)
    open_places = [one for one in report.places if not decided.contains(shapely.Point(one["x"], one["y"]))]
    if known := len(report.places) - len(open_places):
        notes.append(f"{known} places where the terrain may be wrong have a verdict and do not count")
    cells, square = int(np.isfinite(raster.values).sum()), (raster.cell * collection.metre) ** 2
    km2 = cells * square / 1e6
    doubt = _sum_doubt(collection, inner)
    if doubt is None:
        notes.append("files hold no doubt, so wrong points are not estimated: jaxfilter ground --extra doubt writes it")
    facts: dict[str, Any] = {
        "checkpoints": points,
        "labels": {
            "files": len(collection),
            "points": report.points,
            "ground": report.ground,
            "ground_per_m2": report.ground / max(cells * square, 1e-9),
            "expected_wrong_per_km2": None if doubt is None or not km2 else doubt / km2,
            "named_places": len(open_places),
            "named_m2": sum(place["area"] for place in open_places),
        },
        "model": {
            "file": name,
            "cell_m": raster.cell * collection.metre,
            "cells": raster.values.size,
            "km2": km2,
            "void_cells": raster.values.size - cells,
            "void_percent": 100 * (1 - cells / max(raster.values.size, 1)),
            "crs": None if raster.crs is None else raster.crs.name,
        },
        "made": made,
        "notes": [*notes, *(f"{one['file']}: {one['reason']}" for one in (*report.failed, *report.left_out))],
        "standards": EDITIONS,
    }
    _write(page, facts)
    return facts


def _compare(path: Path, model: Raster, collection: Collection, notes: list[str]) -> dict[str, Any]:
    """What check points say. Raises: InputError."""
    import pandas

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", pandas.errors.ParserWarning)  # of lines with more cells than the header
            rows = pandas.read_csv(path, dtype=str, index_col=False)
    except (OSError, ValueError, pandas.errors.ParserWarning) as error:
        raise InputError(f"{path}: cannot be read as CSV: {error}") from error
    rows.columns = rows.columns.str.strip().str.lower()
    if missing := [name for name in "xyz" if name not in rows]:
        raise InputError(f"{path}: has no column {missing[0]}; it has {', '.join(rows)}: name them x, y and z")
    xyz = rows[["x", "y", "z"]].apply(pandas.to_numeric, errors="coerce").to_numpy(np.float64)
    _check_datum(path, rows, model, collection, notes)
    z, inside = _sample(model, xyz[:, :2])
    used = np.isfinite(z - xyz[:, 2])
    outside, unknown = ~inside, inside & ~used
    where = {"lie outside of the model": outside, "lie where the model has no height, or have none": unknown}
    for words, which in where.items():
        if which.any():
            lines = ", ".join(map(str, np.flatnonzero(which) + 2))
            notes.append(f"{path.name}: {which.sum()} check points {words}, and do not count: lines {lines}")
    dz = (z - xyz[:, 2])[used] * collection.units.z
    name = next((one for one in _COVER if one in rows), _COVER[0])
    if name not in rows:
        rows[name] = "not stated"
        notes.append(f"{path.name}: has no column {name}: all check points count as not vegetated")
    covers = rows[name].fillna("not stated")[used]
    named = covers.str.contains("|".join(_PLANTS), case=False)
    plants = (named & ~covers.str.contains(_BARE, case=False)).to_numpy(bool)
    for edition, least in _LEAST.items():
        if (count := int((~plants).sum())) < least:
            notes.append(f"{count} check points for NVA: the {edition} edition asks for {least} at least")
    return {
        "nva": _summarise(dz[~plants]),
        "vva": _summarise(dz[plants]),
        "by_cover": {one: _summarise(dz[covers == one]) for one in sorted(set(covers))},
        "outside": int(outside.sum()),
        "without_height": int(unknown.sum()),
    }


def _summarise(dz: np.ndarray) -> dict[str, Any]:
    """Of differences f64[k], metres; None of no points."""
    names = ("mean_m", "rmse_m", "accuracy_95_m", "p95_m", "largest_m")
    if not len(dz):
        return {"points": 0} | dict.fromkeys(names)
    size, rmse = np.abs(dz), math.sqrt(np.mean(dz**2))
    figures = dz.mean(), rmse, 1.96 * rmse, np.percentile(size, 95), size.max()
    return {"points": len(dz)} | dict(zip(names, map(float, figures), strict=True))


def _sample(model: Raster, xy: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """f64[k]: heights of the model at positions f64[k, 2], bilinear, NaN beside a void; bool[k]: those inside its bounds."""
    from scipy.ndimage import map_coordinates

    x0, y0, x1, y1 = model.bounds
    inside = (xy[:, 0] >= x0) & (xy[:, 0] <= x1) & (xy[:, 1] >= y0) & (xy[:, 1] <= y1)
    at = np.where(inside, [(y1 - xy[:, 1]) / model.cell - 0.5, (xy[:, 0] - x0) / model.cell - 0.5], 0.0)
    z = map_coordinates(model.values.astype(np.float64), at, order=1, mode="nearest")
    return np.where(inside, z, np.nan), inside


def _check_datum(path: Path, rows: Any, model: Raster, collection: Collection, notes: list[str]) -> None:
    """Raises: InputError for check points in another vertical datum than that of the model."""
    name = next((one for one in _DATUM if one in rows), None)
    stated = [] if name is None else sorted(set(rows[name].dropna().str.strip()))
    crs = model.crs if vertical(model.crs) is not None else collection.crs
    known = vertical(crs)
    for text in stated:
        if known is None:
            notes.append(f"the model states no vertical datum: that of check points, {text}, is taken to be the same")
        elif (datum := _name_datum(text)) != known and not known.casefold().startswith(f"{text.casefold()} height"):
            raise InputError(
                f"{path}: check points are in the vertical datum {datum}, and the model is in {known}: transform them first, "
                "such as with cs2cs of PROJ"
            )
    if not stated:
        notes.append(
            f"{path.name}: states no vertical datum ({_DATUM[0]}): it is taken to be that of the model, {known or 'not stated'}"
        )


def _name_datum(text: str) -> str:
    """The name of a vertical CRS by its code, or the text."""
    import pyproj

    try:
        crs = pyproj.CRS.from_user_input(int(float(text)) if text.removesuffix(".0").isdigit() else text)
    except pyproj.exceptions.CRSError:
        return text
    return vertical(crs) or text


def _find_covered(name: str, model: Raster, collection: Collection) -> Bounds | None:
    """The bounds of a model that covers a part of the files only; None if it covers all, but for less than a cell, or if there is
    text, which no area cuts. Raises: InputError if it lies beside them."""
    if not collection.count:
        return None
    (x0, y0, x1, y1), (a0, b0, a1, b1), cell = model.bounds, collection.bounds, model.cell
    if max(x0 - a1, y0 - b1, a0 - x1, b0 - y1) >= cell:
        own, theirs = (", ".join(f"{value:.10g}" for value in box) for box in (model.bounds, collection.bounds))
        raise InputError(f"{name}: lies within {own}, beside the points, within {theirs}: is it in another CRS?")
    text = any(source.format == "text" for source in collection)
    return None if text or max(x0 - a0, y0 - b0, a1 - x1, b1 - y1) < cell else model.bounds


def _sum_doubt(collection: Collection, inner: Bounds | None) -> float | None:
    """The sum of the extra dimension doubt of all points, or of those in bounds; None if a file has none. Raises: InputError."""
    total = 0.0
    for source in collection:
        header = None if source.format == "text" else open_las(source.place).header
        extra = {} if header is None else {one.name: one for one in header.extra_dimensions() or ()}
        if header is None or "doubt" not in extra or (doubt := extra["doubt"]).data_type not in FLOATS:
            return None
        for points, _ in read_points(header, inner):
            column = np.ascontiguousarray(points.array["ExtraBytes"][:, doubt.start : doubt.start + doubt.size])
            total += float(np.nansum(column.view(FLOATS[doubt.data_type]), dtype=np.float64))
    return total


def _read_records(collection: Collection) -> tuple[dict[str, Any], shapely.Geometry]:
    """How the files were made, as far as the reports beside them say, and the places that were decided, with their rims; verdicts
    are those on files that are as they left them. Raises: InputError for a damaged report."""
    found: dict[str, Any] = {"date": datetime.date.today().isoformat(), "jaxfilter": __version__}
    decided: list[shapely.Geometry] = []
    for folder in sorted({Path(uri).parent for uri in collection.uris if "://" not in uri}):
        if (place := folder / REPORT).is_file():
            try:
                facts = json.loads(place.read_text())
                found |= {name: facts.get(name) for name in ("method", "parameters")}
            except DAMAGED as error:
                said = f"{place}: is damaged ({error}): remove it, and nothing is said of what it holds"
                raise InputError(said) from error
        if (folder / LOG).is_file():
            log = Log(folder / LOG, collection)
            own = {log.name_of(uri) for uri in collection.uris}
            entries = [one for one in log.entries if own & set(one["files"])]
            found["verdicts"] = dict(sorted(Counter(one["verdict"] for one in entries).items()))
            decided += [shapely.from_wkt(one["shape"]) for one in entries if "shape" in one]
    return found, shapely.union_all(decided).buffer(PLACE_RIM / collection.metre)


def _write(page: Path, facts: dict[str, Any]) -> None:
    """The page and the JSON. Raises: OutputError."""
    points, labels, model = facts["checkpoints"], facts["labels"], facts["model"]
    sections, wrong = [], labels["expected_wrong_per_km2"]

    def metres(value: float | None) -> str:
        return "none" if value is None else f"{value:.3f}"

    if points is not None:
        figures = (
            ("nva", "Land without plants (NVA), RMSEz (2023)", "rmse_m"),
            ("nva", "Land without plants (NVA), 1.96 RMSEz (2014)", "accuracy_95_m"),
            ("vva", "Land with plants (VVA), RMSEz (2023)", "rmse_m"),
            ("vva", "Land with plants (VVA), 95th percentile (2014)", "p95_m"),
        )
        rows = [(words, points[kind]["points"], metres(points[kind][key])) for kind, words, key in figures]
        said = "<p>How far the model lies from heights that were measured on the ground, in metres.</p>"
        sections.append(f"<h2>Check points</h2>{said}" + table(("figure", "check points", "metres"), rows))
        covers = [(name, one["points"], *(metres(one[key]) for key in ("mean_m", "rmse_m", "p95_m", "largest_m")))
                  for name, one in points["by_cover"].items()]  # fmt: skip
        sections.append(
            table(("land cover", "check points", "mean difference", "RMSEz", "95th percentile", "largest"), covers)
        )
    model_facts: list[tuple[str, Any]] = [
        ("points", labels["points"]), ("ground points", labels["ground"]),
        ("coordinate reference system", model["crs"] or "not stated"),
        ("ground points per m2 of the model", f"{labels['ground_per_m2']:.2f}"),
        ("points per km2 that are expected to have a wrong class", "not known" if wrong is None else f"{wrong:,.0f}"),
        ("places where the terrain may be wrong", labels["named_places"]), ("their area, m2", f"{labels['named_m2']:,.0f}"),
        ("area of the model, km2", f"{model['km2']:.4g}"), ("side of a cell, m", f"{model['cell_m']:g}"),
        ("cells without a height", f"{model['void_cells']:,} ({model['void_percent']:.2f} %)"),
    ]  # fmt: skip
    sections.append("<h2>Points and model</h2>" + table((), model_facts))
    made = facts["made"]
    verdicts = ", ".join(f"{number} as {word}" for word, number in made.get("verdicts", {}).items())
    how = [
        ("date", made["date"]),
        ("software", f"jaxfilter {made['jaxfilter']}"),
        ("ground found by", f"the method {made['method']}" if made.get("method") else "not known"),
        ("places decided by people", verdicts or "none"),
    ]
    sections.append("<h2>How it was made</h2>" + table((), how))
    for title, lines in (("Notes", facts["notes"]), ("Standards", facts["standards"].values())):
        sections.append(f"<h2>{title}</h2><ul>{''.join(f'<li>{escape(line)}</li>' for line in lines)}</ul>")
    if isinstance(parameters := made.get("parameters"), dict):
        title = f"<h2>Parameters of the method {escape(str(made['method']))}</h2>"
        sections.append(title + parameter_table(made["method"], parameters))
    body = "".join(f"<section>{one}</section>" for one in sections)
    text = page_of(page.stem, "accuracy", f"Statement of accuracy · {made['date']}", body)
    for target, content in ((page, text), (page.with_suffix(".json"), json.dumps(facts, indent=1) + "\n")):
        with new_file(target, overwrite=True) as part:
            part.write_text(content, encoding="utf-8", errors="replace")
