"""Verdicts on places are carried out on classified files, and the places of such files are listed."""

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
from ..core.version import __version__
from ..files.classes import Classes, Finding, Found
from ..files.disk import Seal, check_suffix, new_file, seal_file
from ..files.sources import file_cloud
from ..files.storage import Remote, place_of
from ..files.vectors import VECTOR_SUFFIXES
from ..files.writing import LAS_SUFFIXES, Replacing, write_cloud
from ..methods.ost import OST
from ..reports.places import SIDE
from ..surveys.claim import Claim, claim_of
from ..surveys.collection import Collection
from ..surveys.collection import open as open_collection
from ..surveys.kept import list_places, suspects_in
from ..surveys.measures import Recipe
from ..surveys.options import RunOptions
from ..surveys.product import CANDIDATE, KEPT, Cut, FileTask, Product, found_in, gathered, packed
from ..surveys.report import REPORT, RunReport, Summary
from ..surveys.small import carry_out
from ..surveys.store import Store
from ..surveys.surroundings import ground_by_class
from ..surveys.survey import Survey, check_in_place, open_files
from ..surveys.targets import Targets
from ..surveys.tiles import Tile
from .repair import repair
from .verdicts import FINE, HALO, PLACE_RIM, WORDS, PlaceVerdict, VerdictSite, read_verdicts, sites_of

LOG = "verdicts.json"
"""Name of the file, beside the files of points, that lists the verdicts that were carried out on them."""
_CHANGED = f"{KEPT}changed"
"""Name of the array of the numbers of the files of points that change."""
_FEW = 200
"""Sites up to which one process is enough: others take longer to start."""


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
        """Whether every file was written that a verdict changes, and a verdict was carried out, unless there is none."""
        return super().complete and not (self.problems and not self.applied and not self.before)


@dataclasses.dataclass(frozen=True, kw_only=True)
class VerdictProduct(Product):
    """Files in which some classes follow verdicts; a tile is a site. ``new``: verdicts for the file ``log``, which is the output
    behind those of points."""

    REPORT = VerdictReport
    sites: tuple[VerdictSite, ...]
    classes: Classes
    new: list[PlaceVerdict]
    log: Path

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
        found = repair(cloud, ground, site, filter_)
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
        assert isinstance(report, VerdictReport) and isinstance(targets, Claim)
        changed = [arrays[_CHANGED] for arrays in self.kept(report, (_CHANGED,))]
        files, counts = np.concatenate([np.zeros((2, 0), int), *changed], axis=1)
        written = {str(targets.places[number]) for number in files}
        report.files, report.changed = [name for name in report.files if name in written], int(counts.sum())
        if not (report.set_aside or report.failed or report.left_out):
            log, (*files, last) = Log(self.log, collection), map(targets.part, range(len(targets.places)))
            named = zip(collection.uris, files, strict=True)
            log.add(self.new, {log.name_of(uri): part for uri, part in named if part and part.exists()}, last)

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
        log = Log(targets.store.path.parent / LOG, collection)
        for name, words in log.broken.items():
            warn(f"{name}: {words} since verdicts were carried out on it, so those of it are carried out anew")
        new = [one for one in verdicts if not log.holds(one)]
        keys = {one.key for one in new if one.word != FINE}
        every = sites_of(verdicts, collection.metre)  # verdicts of before that meet a new one are kept to
        acting = (site for site in every if any(one.key in keys for one in site.verdicts))
        found = tuple(sorted(acting, key=lambda site: collection.within(site.window).tolist()))  # file by file
        report = VerdictReport(elapsed=0.0)
        if found:
            if run.workers is None and run.client is None and len(found) <= _FEW:
                run = dataclasses.replace(run, workers=1)
            unmeasured = dataclasses.replace(run, tile=HALO, measures={})  # nothing but what the filter needs
            logged = dataclasses.replace(targets, places=[*files, log.path])
            survey = Survey(collection, logged, _recipe_of(collection), reading, unmeasured)
            product = VerdictProduct(
                reading=reading, halo=run.halo, sites=found, classes=classes, new=new, log=log.path
            )
            report = carry_out(survey, product)
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


class Log:
    """The list of verdicts that were carried out on files of a folder.

    Attributes:
        entries: a dict for each verdict, whose ``files`` are those that are as they were left then.
        broken: what is wrong with other files, by name.
    """

    def __init__(self, path: Path, collection: Collection) -> None:
        """``collection``: files of this folder. Raises: InputError if it is damaged."""
        self.path, self.collection, self.entries = path, collection, []
        try:
            facts: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {"files": {}, "verdicts": []}
            found = ((name, Seal(**seal).broken(path.parent / name)) for name, seal in sorted(facts["files"].items()))
            self.broken = {name: words for name, words in found if words is not None}
            for one in facts["verdicts"]:  # what is used of it later is a point, words and names
                shapely.Point(one["x"], one["y"])
                shapely.from_wkt(one.get("shape"))
                "".join((one["verdict"], one["key"], *one["files"]))
                if files := [name for name in one["files"] if name not in self.broken]:
                    self.entries.append(one | {"files": files})
        except DAMAGED as error:
            raise InputError(f"{path}: is damaged ({error}): remove it, and all verdicts are done anew") from error
        self._known = {entry["key"]: entry["files"] for entry in self.entries}

    def name_of(self, uri: str) -> str:
        """Of a file, as the log has it."""
        return os.path.relpath(uri, self.path.parent)

    def files_of(self, one: PlaceVerdict) -> set[str]:
        """Names of the files whose points a verdict may change."""
        near = self.collection.within(one.shape.buffer(PLACE_RIM / self.collection.metre).bounds)
        return {self.name_of(self.collection.uris[number]) for number in near}

    def holds(self, one: PlaceVerdict) -> bool:
        """Whether a verdict was carried out on all its files, and these are as they were left."""
        key = one.key
        return key in self._known and self.files_of(one) <= set(self._known[key])

    def add(self, verdicts: Sequence[PlaceVerdict], parts: Mapping[str, Path] = {}, into: Path | None = None) -> None:
        """Write down verdicts, and how their files are now. Others are known no more if something else is said now of a point
        inside their place.

        ``parts``: files that will take the places of those of such names; ``into``: as of ``new_file``.

        Raises: OutputError.
        """
        if not verdicts:
            return
        keys, today = {one.key for one in verdicts}, datetime.date.today().isoformat()
        entries = []
        for entry in self.entries:
            inner, word = shapely.Point(entry["x"], entry["y"]), entry["verdict"]
            replaced = any(one.word != word and one.shape.intersects(inner) for one in verdicts)
            if entry["key"] not in keys and not replaced:
                entries.append(entry)
        for one in verdicts:
            inner, area = one.shape.representative_point(), one.shape.area * self.collection.metre**2
            files = sorted({*self.files_of(one), *self._known.get(one.key, ())})
            facts = {
                "verdict": one.word,
                "place": one.name,
                "x": inner.x,
                "y": inner.y,
                "area": area,
                "shape": one.shape.wkt,
            }
            entries.append(facts | {"date": today, "version": __version__, "files": files, "key": one.key})
        names = sorted({name for one in entries for name in one["files"]})
        seals = {name: dataclasses.asdict(seal_file(parts.get(name, self.path.parent / name))) for name in names}
        with new_file(self.path, overwrite=True, into=into) as part:
            part.write_text(json.dumps({"verdicts": entries, "files": seals}, indent=1) + "\n")


@dataclasses.dataclass(frozen=True, kw_only=True)
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
    return run_review(what, target, target, ground, reading, run)


def run_review(
    what: Any, out: Path, path: Path | None, ground: Iterable[int], reading: Reading, run: RunOptions
) -> RunReport:
    """:func:`review_survey`, with a list that is written only if it has a ``path``; ``out``: what the run is for."""
    classes = class_numbers(ground)
    collection, reading = open_files(what, reading)
    product = ReviewProduct(reading=reading, halo=run.halo, ground=classes, path=path)
    return carry_out(Survey(collection, Targets([out]), None, reading, run), product)
