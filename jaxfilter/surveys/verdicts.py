"""Verdicts on places are carried out, on a result in memory or on classified files; and places of such files are listed."""

from __future__ import annotations

import dataclasses
import datetime
import json
import os
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import shapely

from ..core.cloud import GROUND_CLASS
from ..core.errors import DAMAGED, InputError, JaxfilterError, ParameterError, warn
from ..core.inputs import class_numbers
from ..core.reading import Reading
from ..core.result import Decision, FilterResult
from ..core.version import __version__
from ..files.classes import Classes, Finding, Found
from ..files.disk import Seal, check_suffix, new_file, seal_file
from ..files.sources import file_cloud
from ..files.storage import Remote, place_of
from ..files.vectors import VECTOR_SUFFIXES
from ..files.writing import LAS_SUFFIXES, Replacing, write_cloud
from ..methods.default import default_filter
from ..methods.ost import OST
from ..reports.places import SIDE
from ..reports.verdicts import FINE, HALO, RIM, WORDS, PlaceVerdict, Repair, read_verdicts, repaired, sites
from ..terrain.layer import extent_of
from .claim import Claim, claim_of
from .collection import Collection
from .collection import open as open_collection
from .kept import list_places, suspects_in
from .measures import Recipe
from .options import RunOptions
from .product import CANDIDATE, KEPT, Cut, FileTask, Product, found_in, gathered, packed
from .report import REPORT, RunReport, Summary
from .small import carry_out
from .store import Store
from .surroundings import ground_by_class
from .survey import Survey, check_in_place, open_files
from .targets import Targets
from .tiles import Tile, inside, part_of

LOG = "verdicts.json"
"""Name of the file, beside the files of points, that lists the verdicts that were carried out on them."""
_CHANGED = f"{KEPT}changed"
"""Name of the array of the numbers of the files of points that change."""
_FEW = 200
"""Sites up to which one process is enough: others take longer to start."""


def apply(result: FilterResult, places: Any) -> FilterResult:
    """Carry out what people have decided at places: labels inside these and at their rim become what follows from it.

    ============  ========================================================================================================
    verdict       what is done
    ============  ========================================================================================================
    ``ground``    the lowest points of cells of 2 m are ground as well, unless they stand on something steeper than terrain
    ``object``    ground that sticks out of the plane of its neighbours by more than 0.5 m goes, from the outside inwards
    ``bridge``    no point is ground; points that were are marked as ``deck``
    ``water``     ground are the points within 0.3 m of the plane of its lowest points, which are marked as ``water``
    ``fine``      nothing changes, here and where the rim of another place meets it
    ============  ========================================================================================================

    The ground around the place is known. From it and from what is left or new, the ground grows again through the place and the
    4 m around it, by the rules of OST. Around a bridge, ground in these 4 m must pass again. All other labels stay as they are.
    Places whose rims meet are done together, and each sees the ground up to 40 m away.

    Args:
        result: of any filter; the limits are those of OST, as set up for the cloud if another method has found the ground.
        places: what :func:`jaxfilter.review` returns or has written, with its column ``verdict`` filled in; or any other polygons
            with such a column. Empty ones are passed over. Places in another CRS are transformed.

    Returns: FilterResult with other ``ground`` and ``decision``, ``water`` and ``deck``; ``doubt`` is NaN where labels changed.
    Raises: InputError for places that cannot be read or have no such column, and for a result without its cloud. Warns: of each
        verdict that is left out, since it is none, lies beside the data, or contradicts one that overlaps it.

    >>> places = jf.review(cloud, result)
    >>> places["verdict"] = "fine"
    >>> bool((jf.apply(result, places).ground == result.ground).all())
    True
    """
    if result.run is None:
        raise InputError(
            "result: was put together by hand, so its points are not known: pass what a filter has returned"
        )
    cloud = result.run.cloud
    verdicts, _ = read_verdicts(places, cloud.crs, extent_of(cloud))
    filter_: Any = result.run.filter
    filter_ = filter_.replace() if isinstance(filter_, OST) else default_filter(cloud)
    if filter_.spacing is None:
        filter_ = filter_.replace(spacing=filter_.points_of(cloud).spacing())
    ground, decision = result.ground.copy(), np.array(result.decision)
    doubt = None if result.doubt is None else result.doubt.copy()
    water, deck = (np.zeros(len(cloud), bool) if old is None else old.copy() for old in (result.water, result.deck))
    for site in sites(verdicts, cloud.units.xy):
        rows = np.flatnonzero(inside(cloud, site.window))
        found = repaired(part_of(cloud, rows), result.ground[rows], site, filter_)
        changed = rows[found.changed]
        ground[changed] = found.ground[found.changed]
        decision[changed] = np.where(ground[changed], Decision.ACCEPTED, Decision.SURFACE)
        water[rows[found.water]], deck[rows[found.deck]] = True, True
        if doubt is not None:
            doubt[changed] = np.nan
    return dataclasses.replace(
        result, ground=ground, decision=decision, doubt=doubt, water=water & ground, deck=deck & ~ground
    )


@dataclasses.dataclass
class VerdictReport(RunReport):
    """What :func:`apply_survey` has done: of :class:`RunReport`, and

    Attributes:
        changed: points whose class was changed. applied: number of verdicts by word.
        before: verdicts that were carried out by an earlier run. problems: in words, of verdicts that were left out.
    """

    changed: int = 0
    applied: dict[str, int] = dataclasses.field(default_factory=dict)
    before: int = 0
    problems: list[str] = dataclasses.field(default_factory=list)

    @property
    def complete(self) -> bool:
        """Whether every verdict was carried out, and every file written that it changes."""
        return super().complete and not self.problems


@dataclasses.dataclass(frozen=True)
class VerdictProduct(Product):
    """Files in which some classes follow verdicts; a tile is a site."""

    REPORT = VerdictReport
    sites: tuple[Repair, ...]
    classes: Classes

    def cut(self) -> Cut:
        """A tile for each site."""
        return Cut(0.0, 1.0, boxes=np.array([[site.touched, site.window] for site in self.sites]))

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """The points of a site that change. Raises: InputError."""
        summary = Summary()
        around = self.read(tile, summary)
        cloud, (filter_, site) = around.cloud, (self.filter, self.sites[tile.number])
        assert isinstance(filter_, OST)
        if cloud.classification is None:
            return {}, summary
        ground, start = cloud.classification == self.classes.ground_class, time.perf_counter()
        cloud = dataclasses.replace(cloud, candidate=cloud.candidate | ground, core=None)  # whatever echoes were judged
        found = repaired(cloud, ground, site, filter_)
        summary.seconds["filter"] = time.perf_counter() - start
        summary.ground = int(found.ground[around.core].sum())
        touched = found.changed if self.classes.water is None else found.changed | found.water
        some = dataclasses.replace(around, cloud=cloud, core=touched)
        code = np.full(len(cloud), Finding.OTHER, np.uint8)
        code[found.ground], code[found.deck] = Finding.GROUND, Finding.DECK
        code[found.water & found.ground] = Finding.WATER
        changed = np.stack(np.unique(around.file[touched], return_counts=True))
        return packed(some, Found(found.ground, code), {}) | {_CHANGED: changed}, summary

    def file(self, task: FileTask) -> None:
        """Write a file whose points have changed. Raises: InputError, OutputError."""
        label, *_ = gathered(self.store, task, {})
        if label.any():
            cloud = file_cloud(task.source, (label & CANDIDATE) > 0)
            write_cloud(task.target, cloud, found_in(label), self.classes, replacing=Replacing(**task.how))

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Say which files have changed, and write the log, which takes its place together with them."""
        assert isinstance(report, VerdictReport) and isinstance(targets, _Targets)
        changed = [arrays[_CHANGED] for arrays in self.kept(report, (_CHANGED,))]
        files, counts = np.concatenate([np.zeros((2, 0), int), *changed], axis=1)
        written = {str(targets.places[number]) for number in files}
        report.files, report.changed = [name for name in report.files if name in written], int(counts.sum())
        if not (report.set_aside or report.failed or report.left_out):
            *files, last = map(targets.part, range(len(targets.places)))
            named = zip(collection.uris, files, strict=True)
            parts = {targets.log.name_of(uri): part for uri, part in named if part is not None and part.exists()}
            targets.log.add(targets.new, parts, last)

    def facts(self) -> dict[str, Any]:
        """Classes and verdicts."""
        keys = sorted(one.key for site in self.sites for one in site.verdicts)
        return {"classes": dataclasses.asdict(self.classes), "verdicts": keys}


def apply_survey(
    places: Any,
    what: Any,
    *,
    classes: Classes = Classes(),
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> VerdictReport:
    """Carry out verdicts on classified files, as :func:`apply` does in memory; the files are changed in place.

    Only windows around places are read. Of the points of a place and its rim only those that become ground, or are no more,
    change their class; noise, water, bridges and what else is not judged keep theirs. A file in which a point changes is written
    anew, whole or not at all. Other files are not touched. ``verdicts.json`` beside the files lists what was carried out. A
    verdict that stands there is not carried out again, unless its files were changed by something else since. If OST has
    found the ground, ``jaxfilter-run.json`` beside the files states its parameters, which are used; else a sample is measured.

    Args:
        places: as in :func:`apply`. what: the LAS and LAZ files, a :class:`Collection`, or what :func:`jaxfilter.open` takes.
        classes: what is ground in the files; the classes of points that are no more, of points of bridges that were ground
            (``bridge``, ASPRS: 17), and of water (``water``, ASPRS: 9).
        reading: which points are judged, as when the ground was found.
        run: how it is carried out. With ``resume`` a run that was stopped goes on.

    Returns: VerdictReport, in which verdicts that were left out are named.
    Raises: as :func:`jaxfilter.ground`; InputError for places that cannot be read, or have no verdicts.

    >>> report = jf.ground("survey", "classified", review="places.gpkg", reading=jf.Reading(units="m"))
    >>> made = jf.apply_survey("places.gpkg", "classified", reading=jf.Reading(units="m"))
    >>> made.complete, made.files  # no verdict was filled in
    (True, [])
    """
    run = dataclasses.replace(run, in_place=True)
    check_in_place(reading)
    collection, reading = open_files(what, reading)
    files = [place_of(uri) for uri in collection.uris]
    if wrong := [file for file in files if isinstance(file, Remote) or file.suffix.lower() not in LAS_SUFFIXES]:
        raise ParameterError(f"{wrong[0]}: verdicts change .las and .laz files on a disk; pass such")
    verdicts, problems = read_verdicts(places, collection.crs, collection.bounds)
    targets = claim_of(Targets(list(files), in_place=True, called="verdicts"), run, len(files) == 1)
    with Store(targets.store.path.with_name(f".{LOG}.jaxfilter-run")).locked():  # nobody else notes verdicts meanwhile
        if run.resume and targets.store.done:  # what was renamed is listed in the log
            with targets.store.locked():
                targets.finish()
            collection = open_collection(collection.uris, units=reading.units, crs=reading.crs)
        log = _Log(targets.store.path.parent / LOG, collection)
        new = [one for one in verdicts if not log.holds(one)]
        keys = {one.key for one in new if one.word != FINE}
        every = sites(verdicts, collection.metre)  # verdicts of before that meet a new one are kept to
        acting = (site for site in every if any(one.key in keys for one in site.verdicts))
        found = tuple(sorted(acting, key=lambda site: collection.within(site.window).tolist()))  # file by file
        report = VerdictReport()
        if found:
            if run.workers is None and run.client is None and len(found) <= _FEW:
                run = dataclasses.replace(run, workers=1)
            unmeasured = dataclasses.replace(run, tile=HALO, measures={})  # nothing but what the filter needs
            logged = _Targets([*files, log.path], in_place=True, store=targets.store, log=log, new=new)
            survey = Survey(collection, logged, _recipe_of(collection), reading, unmeasured)
            report = carry_out(survey, VerdictProduct, sites=found, classes=classes)
        if not run.dry_run:
            targets.discard()  # the log tells what is done
        if not (run.dry_run or report.set_aside or report.failed or report.left_out):
            log.add(new)
    report.problems, report.before = problems, len(verdicts) - len(new)
    report.applied = {word: n for word in WORDS if (n := sum(one.word == word for one in new))}
    return report


def _recipe_of(collection: Collection) -> Recipe:
    """OST as it has found the ground, if the report of that run lies beside the files; else set up for a sample of them."""
    try:
        (folder,) = {Path(uri).parent for uri in collection.uris}
        facts = json.loads((folder / REPORT).read_text())
        if facts["method"] == OST.__name__:
            fields, measures = facts["parameters"], facts["measures"] or {}
            recipe = Recipe(OST, fields | {"spacing": fields["spacing"] or measures.get("spacing")})
            recipe.alone()
            return recipe
    except (*DAMAGED, JaxfilterError):  # none, of other files, or of another version
        pass
    return Recipe()


class _Log:
    """The list of verdicts that were carried out on files of a folder."""

    def __init__(self, path: Path, collection: Collection) -> None:
        """``collection``: files of this folder. Raises: InputError if it is damaged."""
        self.path, self.collection = path, collection
        try:
            empty: dict[str, Any] = {"files": {}, "verdicts": []}
            self.facts = json.loads(path.read_text()) if path.exists() else empty
            self._known = {one["key"]: one["files"] for one in self.facts["verdicts"]}
            for one in self.facts["verdicts"]:  # what is used of it later is a point, a word and names
                shapely.Point(one["x"], one["y"])
                "".join((one["verdict"], *one["files"]))
            broken = {name: Seal(**seal).broken(path.parent / name) for name, seal in self.facts["files"].items()}
        except DAMAGED as error:
            raise InputError(f"{path}: is damaged ({error}): remove it, and all verdicts are done anew") from error
        self._broken = {name for name, words in broken.items() if words is not None}
        for name in sorted(self._broken):
            warn(f"{name}: {broken[name]} since verdicts were carried out on it, so those of it are carried out anew")

    def files_of(self, one: PlaceVerdict) -> list[str]:
        """Names of the files whose points a verdict may change."""
        near = self.collection.within(one.shape.buffer(RIM / self.collection.metre).bounds)
        return [self.name_of(self.collection.uris[n]) for n in near]

    def name_of(self, uri: str) -> str:
        """Of a file, as the log has it."""
        return os.path.relpath(uri, self.path.parent)

    def holds(self, one: PlaceVerdict) -> bool:
        """Whether a verdict was carried out on all its files, and these are as they were left."""
        files = set(self.files_of(one))
        return one.key in self._known and files <= set(self._known[one.key]) and not files & self._broken

    def add(self, verdicts: Sequence[PlaceVerdict], parts: Mapping[str, Path] = {}, into: Path | None = None) -> None:
        """Write down verdicts, and how their files are now. Others are known no more on files that have changed since, and none
        is in whose place something else is said now.

        ``parts``: files that will take the places of those of such names; ``into``: as of ``new_file``.

        Raises: OutputError.
        """
        if not verdicts:
            return
        keys, today = {one.key for one in verdicts}, datetime.date.today().isoformat()
        entries, kept = [], {}
        for entry in self.facts["verdicts"]:
            files = [name for name in entry["files"] if name not in self._broken and (self.path.parent / name).exists()]
            kept[entry["key"]] = files
            if files and entry["key"] not in keys and not self._replaced(entry, verdicts):
                entries.append(entry | {"files": files})
        for one in verdicts:
            inner, area = one.shape.representative_point(), one.shape.area * self.collection.metre**2
            files = sorted({*self.files_of(one), *kept.get(one.key, ())})
            facts = {"verdict": one.word, "place": one.name, "x": inner.x, "y": inner.y, "area": area}
            entries.append(facts | {"date": today, "version": __version__, "files": files, "key": one.key})
        names = sorted({name for one in entries for name in one["files"]})
        seals = {name: dataclasses.asdict(seal_file(parts.get(name, self.path.parent / name))) for name in names}
        with new_file(self.path, overwrite=True, into=into) as part:
            part.write_text(json.dumps({"verdicts": entries, "files": seals}, indent=1) + "\n")

    @staticmethod
    def _replaced(entry: dict[str, Any], verdicts: Sequence[PlaceVerdict]) -> bool:
        """Whether a place of before, known by a point inside, has another verdict now."""
        inner = shapely.Point(entry["x"], entry["y"])
        return any(one.word != entry["verdict"] and one.shape.intersects(inner) for one in verdicts)


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Targets(Claim):
    """Files, and behind them the log of their verdicts, which lists ``new`` ones when they are replaced."""

    log: _Log
    new: Sequence[PlaceVerdict]


@dataclasses.dataclass(frozen=True)
class ReviewProduct(Product):
    """The places of files that have classes; ``ground``: those of ground points; ``path``: of the list."""

    ground: tuple[int, ...]
    path: Path | None

    def cut(self) -> Cut:
        """Tiles of whole cells."""
        return Cut(HALO, SIDE)

    def tile(self, tile: Tile) -> tuple[dict[str, np.ndarray], Summary]:
        """Cells of a tile whose terrain may be wrong. Raises: InputError if points have no classes."""
        summary = Summary()
        around = self.read(tile, summary)
        ground = ground_by_class(around.cloud, self.ground, tile)
        summary.ground = int(ground[around.core].sum())
        return suspects_in(around, ground, tile, self.reading), summary

    def finish(self, report: RunReport, collection: Collection, targets: Targets, options: RunOptions) -> None:
        """Write the list. Raises: InputError, OutputError."""
        list_places(self, report, collection, self.path, True)

    def facts(self) -> dict[str, Any]:
        """Classes of ground points."""
        return {"classes_of_ground": self.ground}


def review_survey(
    what: Any,
    path: str | Path,
    ground: Iterable[int] = (GROUND_CLASS,),
    *,
    reading: Reading = Reading(),
    run: RunOptions = RunOptions(),
) -> RunReport:
    """List the places to look at in files that have classes, as :func:`review` does for one cloud.

    Labels alone state no doubt: the list of ``jf.ground(..., review=...)`` is better, where OST finds the ground.

    Args:
        what, reading, run: as in :func:`jaxfilter.ground`. path: a GeoPackage (.gpkg) or GeoJSON (.geojson).
        ground: classes of the points that are ground, less withheld ones. In text it is label 0.

    Returns: RunReport, whose ``places`` are listed. Raises: as :func:`jaxfilter.ground`.

    >>> report = jf.review_survey("survey", "places.geojson", reading=jf.Reading(units="m"))
    >>> report.complete, report.points == len(cloud)
    (True, True)
    """
    check_suffix(target := Path(path), VECTOR_SUFFIXES)
    check_in_place(reading)
    return reviewed(what, target, target, ground, reading, run)


def reviewed(
    what: Any, out: Path, path: Path | None, ground: Iterable[int], reading: Reading, run: RunOptions
) -> RunReport:
    """:func:`review_survey`, with a list that is written only if it has a ``path``; ``out``: what the run is for."""
    classes = class_numbers(ground)
    collection, reading = open_files(what, reading)
    return carry_out(Survey(collection, Targets([out]), None, reading, run), ReviewProduct, ground=classes, path=path)
