"""Where a run puts its files, and what it keeps beside them: the journal, labels on their way, the report."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ..core.errors import InputError, JaxfilterError, OutputError, ParameterError
from ..core.version import __version__
from ..files.disk import existing, remove, remove_dead
from ..files.storage import Place, Remote, place_of
from ..files.text import SUFFIXES
from ..files.writing import LAS_SUFFIXES
from .capacity import Layout
from .collection import Collection
from .dask import Cluster
from .journal import NAME, Journal, discard
from .options import RunOptions
from .outputs import target_names
from .plan import Plan
from .pool import Executor, Pool
from .run import Run, RunReport, Step, report_of, write_report
from .task import Job

SCRATCH = ".jaxfilter-run"
"""Folder beside the journal that holds labels until their files are complete; removed with the last of them."""
REPORT, MAP = "jaxfilter-run.json", "jaxfilter-run.png"


@dataclasses.dataclass(frozen=True)
class Folder:
    """``out``: where the files go, in the order of the collection by ``names``; ``work``: the local folder of the journal."""

    out: Place
    work: Path
    names: list[str]

    @classmethod
    def prepared(cls, out: str | os.PathLike[str], collection: Collection, run: RunOptions) -> Folder:
        """The folders of a run, made, and empty but for what may stay.

        Raises: OutputError if one holds something and neither ``resume`` nor ``overwrite`` is asked for, or holds an input;
        ParameterError for the name of a file, and as :func:`work_of`.
        """
        place = place_of(out)
        if place.suffix.lower() in (*LAS_SUFFIXES, *SUFFIXES) and not (isinstance(place, Path) and place.is_dir()):
            raise ParameterError(
                f"{place}: a collection is written into a folder, and this is the name of a file: name a folder as OUT; "
                "what a filter finds in one cloud is written by jaxfilter.write(OUT, cloud, filter(cloud))"
            )
        folder = cls(place, work_of(run, place, place), target_names(list(collection.uris)))
        folder._prepare(collection, run.get("resume", False), run.get("overwrite", False))
        return folder

    @property
    def targets(self) -> list[Place]:
        """Where each file of the collection is written."""
        return [self.out / name for name in self.names]

    @property
    def scratch(self) -> Path:
        """Where labels are kept."""
        return self.work / SCRATCH

    def _prepare(self, collection: Collection, resume: bool, overwrite: bool) -> None:
        for place in {str(self.work): self.work, str(self.out): self.out}.values():
            if isinstance(place, Path):
                try:
                    place.mkdir(parents=True, exist_ok=True)
                except OSError as error:
                    raise OutputError(f"{place}: cannot be made: {error.strerror}") from error
        inputs = {os.path.realpath(uri) if "://" not in uri else uri for uri in collection.uris}
        for target in self.targets:
            if (os.path.realpath(target) if isinstance(target, Path) else target.uri) in inputs:
                raise OutputError(f"{target}: is an input; name another folder")
        begun = (self.work / NAME).exists()
        held = _held(self.out) if self.out == self.work else _held(self.out) + [NAME] * begun
        if not held or (resume and begun):
            return
        there = [name for name in self.names if name in held]
        if resume:
            if there:
                raise OutputError(
                    f"{self.out / there[0]}: exists, and no run was begun in {self.work}: name another folder, or pass "
                    "overwrite=True to begin anew"
                )
            return
        if not overwrite:
            more = f" and {len(held) - 1} more" if len(held) > 1 else ""
            where = self.work if held[0] == NAME else self.out
            raise OutputError(
                f"{where}: is not empty, it holds {held[0]}{more}: name another folder, pass resume=True to go on with a "
                "run, or pass overwrite=True to begin anew"
            )
        ours = [*self.names, REPORT, MAP]
        if isinstance(self.out, Path):  # what cannot be replaced is told before anything is removed
            ours = [name for name in ours if existing(self.out / name) is not None]
        discard(self.work / NAME)
        remove(self.scratch)
        for name in ours:
            if isinstance(self.out, Path):
                remove(self.out / name)
            elif name in held:
                (self.out / name).remove()


def work_of(run: RunOptions, target: Place, beside: Place) -> Path:
    """The local folder for the journal of a run: ``beside`` its ``target``, or that which is named.

    Raises: ParameterError if none is named and the target is remote, or if that is.
    """
    work = run.get("work")
    if work is None and isinstance(beside, Remote):
        raise ParameterError(
            f"work=None: {target} is not on a local disk, and the journal needs a folder that all workers see: pass work=..."
        )
    local = beside if work is None else place_of(work)
    if isinstance(local, Remote):
        raise ParameterError(f"work={work!r}: must be a local folder")
    return local


def _held(folder: Place) -> list[str]:
    """Names in a folder, sorted. Raises OutputError."""
    try:
        if isinstance(folder, Remote):
            return folder.held()
        return sorted(entry.name for entry in os.scandir(folder))
    except JaxfilterError as error:
        raise OutputError(str(error)) from error
    except OSError as error:
        raise OutputError(f"{folder}: cannot be read: {error.strerror}") from error


def run_in(
    folder: Folder,
    collection: Collection,
    step: Step,
    prepared: Callable[[float | None], tuple[Job, Layout, Plan, dict[str, Any]]],
    run: RunOptions,
) -> RunReport:
    """Set up a run over a collection, do it, and put its report beside the files.

    ``prepared`` is given the ``most_points`` of the run that goes on, if there is one, and returns the job, the layout, the plan,
    and what else decides the outcome.

    Raises: OutputError, ParameterError, InputError.
    """
    if not folder.scratch.is_dir():
        remove(folder.scratch)
    with Journal(folder.work / NAME) as journal:
        with _taken_back(folder.scratch, journal):
            if journal.fact("version") is None:
                _refuse_outputs(folder)
            most = (journal.fact("tiles") or {}).get("most_points")  # what is free changes, the tiles of a run do not
            job, cut, plan, more = prepared(most)
            executor = executor_of(run, cut)
            try:
                journal.begin(facts_of(collection, job, cut, plan) | more)
                if isinstance(folder.out, Remote):  # a store that refuses is found out before anything is done
                    write_report({"complete": False}, folder.out / REPORT)
            except JaxfilterError:
                executor.close()
                raise
        this = Run(
            job,
            plan,
            collection,
            folder.targets,
            journal,
            executor,
            step=step,
            overwrite=True,
            progress=run.get("progress"),
        )
        this()
        report = report_of(this)
    if report.complete:
        shutil.rmtree(folder.scratch, ignore_errors=True)
    report.failed += [{"file": name, "reason": reason} for name, reason in collection.unreadable]
    for place in {str(folder.work): folder.work, str(folder.out): folder.out}.values():
        if isinstance(place, Path):
            remove_dead(place)
    write_report(report.as_dict(), folder.out / REPORT)
    report.draw(folder.out / MAP)
    return report


def _refuse_outputs(folder: Folder) -> None:
    """Raises: InputError if there are outputs and the journal knows of none."""
    held = _held(folder.out)
    if there := [name for name in folder.names if name in held]:
        raise InputError(
            f"{folder.work / NAME}: the journal holds no run, and {folder.out / there[0]} exists: pass overwrite=True to begin "
            "anew, or name another folder"
        )


def executor_of(run: RunOptions, cut: Layout) -> Executor:
    """What does the work: what is given, a cluster, or processes of this machine."""
    executor, client = run.get("executor"), run.get("client")
    if executor is not None:
        return executor
    return Pool(cut.workers) if client is None else Cluster(client)


@contextlib.contextmanager
def _taken_back(scratch: Path, journal: Journal) -> Iterator[None]:
    """A block that sets a run up; what it has made goes if the run is refused."""
    there = scratch.exists()
    try:
        yield
    except JaxfilterError:
        if not there:
            shutil.rmtree(scratch, ignore_errors=True)
        if journal.fact("version") is None:
            journal.close()
            journal.path.unlink()
        raise


def facts_of(collection: Collection, job: Job, cut: Layout, plan: Plan) -> dict[str, Any]:
    """What decides the outcome of a run, to be told from another."""
    whole = dataclasses.asdict(job.whole)
    filter_ = {"method": type(job.filter).__name__, **dataclasses.asdict(job.filter)}  # type: ignore[call-overload]
    return {
        "version": __version__,
        "inputs": _digest(collection),
        "units": [collection.units.xy, collection.units.z],
        "filter": filter_,
        "reading": {**job.reading, "ignore_classes": list(job.reading["ignore_classes"])},
        "classes": job.classes,
        "extra": list(job.extra),
        "spacing": whole["spacing"],
        "rounds": whole["rounds"],
        "tiles": {
            "width": plan.width,
            "height": plan.height,
            "halo": plan.halo,
            "number": len(plan),
            "digest": plan.digest(),
            "most_points": cut.most_points,
        },
    }


def _digest(collection: Collection) -> str:
    """Tells the files of a collection, by name and content, from others."""
    found = hashlib.sha256()
    for source in collection:
        found.update(json.dumps([source.uri, source.count, source.identity]).encode())
    return found.hexdigest()
