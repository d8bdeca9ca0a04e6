"""Many files as one survey: named in any way, read by their headers only, and held against each other."""

from __future__ import annotations

import dataclasses
import functools
import glob
import math
import os
import warnings
from collections.abc import Iterable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import pyproj

from ..core.errors import InputError, warn
from ..core.reading import Bounds, Reading
from ..core.units import Stated, Units, vertical
from ..files.sources import Source, describe_file, stated_bounds, with_true_extent
from ..files.storage import Remote, place_of
from ..files.text import TEXT_SUFFIXES as TEXT
from ..files.writing import LAS_SUFFIXES
from .findings import OVERLAP, Findings, Footprints, refuse_mixture

if TYPE_CHECKING:
    import pandas as pd
    import shapely


__all__ = ["Collection", "Source", "open"]

_THREADS = 16  # headers that are read at a time: what waits is the disk, or a server
Entry = str | Source
"""The name of a file whose header is to be read, or what a virtual point cloud says of it."""


class Collection(tuple[Source, ...]):
    """n files in the order in which they were named, a tuple; see :func:`open`. What is planned with is there as arrays as well.

    Attributes:
        unreadable: (name, reason) of files that were named and cannot be read.
        repeated: names that were given more than once; they count once.

    >>> survey = jf.open("survey", units="m")
    >>> len(survey), [source.count for source in survey] == survey.counts.tolist()
    (2, True)
    """

    unreadable: tuple[tuple[str, str], ...]
    repeated: tuple[str, ...]
    extent: Bounds | None = None
    """Of :meth:`clipped` files: the bounds of all of them before."""

    def __new__(
        cls, sources: Iterable[Source], unreadable: Iterable[tuple[str, str]] = (), repeated: Iterable[str] = ()
    ) -> Self:
        made = super().__new__(cls, sources)
        made.unreadable, made.repeated = tuple(unreadable), tuple(repeated)
        return made

    def __repr__(self) -> str:
        return f"Collection({len(self)} files, {self.count} points)"

    @property
    def name(self) -> str:
        """For messages: that of its file, or the number of files.

        >>> jf.open("survey", units="m").name
        '2 files'
        """
        return self.uris[0] if len(self) == 1 else f"{len(self):,} files"

    @functools.cached_property
    def uris(self) -> list[str]:
        """Their names.

        >>> [uri.rpartition("/")[2] for uri in jf.open("survey", units="m").uris]
        ['east.laz', 'west.laz']
        """
        return [source.uri for source in self]

    @functools.cached_property
    def footprints(self) -> np.ndarray:
        """f64[n, 4], file coordinates: the bounds that each header states; NaN for files without points.

        >>> jf.open("survey", units="m").footprints.shape
        (2, 4)
        """
        return np.array([source.bounds for source in self], np.float64).reshape(-1, 4)

    @functools.cached_property
    def counts(self) -> np.ndarray:
        """i64[n]: points of each file.

        >>> int(jf.open("survey", units="m").counts.sum()) == len(cloud)
        True
        """
        return np.array([source.count for source in self], np.int64)

    @property
    def bounds(self) -> Bounds:
        """(xmin, ymin, xmax, ymax) around all points, closed, file coordinates; NaN where there are none.

        >>> [round(v) for v in jf.open("survey", units="m").bounds]
        [512000, 5403000, 512060, 5403060]
        """
        known = self.footprints[self.counts > 0]
        if not len(known):
            return (math.nan,) * 4  # type: ignore[return-value]
        return (*known[:, :2].min(axis=0).tolist(), *known[:, 2:].max(axis=0).tolist())

    @property
    def count(self) -> int:  # type: ignore[override]
        """Number of points.

        >>> jf.open("survey", units="m").count == len(cloud)
        True
        """
        return int(self.counts.sum())

    @property
    def areas(self) -> np.ndarray:
        """f64[n], square metres, of the bounds of each file; 0 for files without points.

        >>> jf.open("survey", units="m").areas.round(-2).tolist()
        [1800.0, 1800.0]
        """
        sides = self.footprints[:, 2:] - self.footprints[:, :2]
        return np.nan_to_num(sides.prod(axis=1) * np.array([source.metre for source in self]) ** 2)

    @functools.cached_property
    def crs(self) -> pyproj.CRS | None:
        """The CRS of all files, with heights if a file states them; None if no file states one.

        Raises: InputError as :attr:`units`.

        >>> print(jf.open("survey", units="m").crs)
        None
        """
        refuse_mixture(self)
        stated = [pyproj.CRS.from_wkt(wkt) for wkt in dict.fromkeys(source.wkt for source in self) if wkt is not None]
        return next((crs for crs in stated if vertical(crs)), stated[0] if stated else None)

    @functools.cached_property
    def units(self) -> Units:
        """Metres per unit of all files. Raises InputError if files differ in CRS or units, naming two of them.

        >>> jf.open("survey", units="m").units.name
        'metre'
        """
        refuse_mixture(self)
        return self[0].units

    @property
    def metre(self) -> float:
        """Metres per unit of X and Y. Raises InputError as :attr:`units`.

        >>> jf.open("survey", units="m").metre
        1.0
        """
        return self.units.xy

    @property
    def assumes_metres(self) -> bool:
        """Whether units are metres since LAS files state no CRS. Raises InputError as :attr:`units`.

        >>> jf.open("survey", units="ft").assumes_metres
        False
        """
        states = self.crs is not None and len(self.crs.axis_info) > 1  # heights alone do not say it
        return not states and self.units == Units() and any(source.format != "text" for source in self)

    def with_true_extents(self) -> Collection:
        """The same files, each with the extent of its points where some of them show that the header states another; see
        :func:`jaxfilter.files.sources.with_true_extent`. Warns: of wrong extents."""
        with ThreadPoolExecutor(_THREADS) as pool:
            return Collection(pool.map(with_true_extent, self), self.unreadable, self.repeated)

    def clipped(self, box: Bounds) -> Collection:
        """The files that may hold points of a half-open box, with their bounds as far as it; all if they have no points.

        Raises: InputError if none of them can hold points there.

        >>> len(jf.open("survey", units="m").clipped((512000, 5403000, 512010, 5403010)))
        1
        """
        sources = []
        for number in self.within(box).tolist() if len(self) > 1 and self.count else range(len(self)):
            source = self[number]
            bounds = common(source.bounds, box)
            if not source.count:
                sources.append(source)
            elif bounds[0] <= bounds[2] and bounds[1] <= bounds[3]:
                sources.append(dataclasses.replace(source, bounds=bounds))
        if not sources:
            raise self.nothing_in(box)
        made = Collection(sources, self.unreadable, self.repeated)
        made.extent = self.bounds
        return made

    def nothing_in(self, box: Bounds) -> InputError:
        """The error of bounds in which there is no point."""
        words, data = (", ".join(f"{v:.10g}" for v in one) for one in (box, self.extent or self.bounds))
        return InputError(f"{self.name}: no point is in bounds {words}: pass other bounds= within {data}")

    def uncovered(self, names: Iterable[str]) -> shapely.Geometry | None:
        """What files cover by their headers that cannot be read, and no other file covers; None if that is nothing."""
        import shapely

        lost = set(names)
        boxes = np.array([stated_bounds(place_of(name)) for name in sorted(lost)]).reshape(-1, 4)
        others = self.footprints[[source.count > 0 and source.uri not in lost for source in self]]
        area = shapely.union_all(shapely.box(*boxes[np.isfinite(boxes).all(axis=1)].T))
        area = area.difference(shapely.union_all(shapely.box(*others.T)))
        return None if area.is_empty else area

    def probed(self) -> Collection:
        """The same files, without those that show damage where their first points and the tables of their chunks are read: these
        are ``unreadable`` as well. Remote files, and those that only a .vpc describes, are not looked at."""
        local = [source.uri if source.identity and "://" not in source.uri else source for source in self]
        with ThreadPoolExecutor(_THREADS) as pool, warnings.catch_warnings():
            warnings.simplefilter("ignore")
            found = list(pool.map(lambda entry: _source_of(entry, Stated(), True), local))
        wrong = [one for one in found if not isinstance(one, Source)]
        return Collection(
            [source for source, one in zip(self, found, strict=True) if isinstance(one, Source)],
            [*self.unreadable, *wrong],
            self.repeated,
        )

    @functools.cached_property
    def _index(self) -> Footprints:
        return Footprints(self.footprints)

    def within(self, box: Bounds) -> np.ndarray:
        """i64[m], ascending: the files that may hold points with xmin <= x < xmax and ymin <= y < ymax, by their headers.

        >>> jf.open("survey", units="m").within((512000, 5403000, 512010, 5403010)).tolist()
        [1]
        """
        return self._index.meeting(box)

    def check(self) -> Findings:
        """What does not fit together: overlaps, gaps, doubles, mixed CRS or units, files without points or CRS.

        >>> findings = jf.open("survey", units="m").check()
        >>> findings.overlaps, findings.gaps, len(findings.no_crs)
        ((), (), 2)
        """
        mixed = None
        try:
            refuse_mixture(self)
        except InputError as error:
            mixed = str(error)
        pairs, share = self._index.overlaps(OVERLAP)
        met = [(self[i], self[j], s) for (i, j), s in zip(pairs.tolist(), share.tolist(), strict=True)]
        same = [(a.count, a.bounds) == (b.count, b.bounds) for a, b, _ in met]
        return Findings(
            mixed=mixed,
            unreadable=self.unreadable,
            repeated=self.repeated,
            doubles=tuple((a.uri, b.uri) for (a, b, _), twice in zip(met, same, strict=True) if twice),
            overlaps=tuple((a.uri, b.uri, s) for (a, b, s), twice in zip(met, same, strict=True) if not twice),
            gaps=tuple(self._index.holes()),
            empty=tuple(source.uri for source in self if not source.count),
            no_crs=tuple(source.uri for source in self if source.wkt is None),
        )

    def table(self) -> pd.DataFrame:
        """A row for each file: uri, format, points, xmin, ymin, xmax, ymax, zmin, zmax (file units), area (m2), density
        (points per m2), crs (its name), metre, point_format, date.

        >>> jf.open("survey", units="m").table()[["points", "density"]].shape
        (2, 2)
        """
        import pandas as pd

        columns = ("uri", "format", "points", "xmin", "ymin", "xmax", "ymax", "zmin", "zmax", "crs", "metre")
        rows = [
            (s.uri, s.format, s.count, *s.bounds, *s.z, s.crs and s.crs.name, s.metre, s.point_format, s.date)
            for s in self
        ]
        table = pd.DataFrame(rows, columns=[*columns, "point_format", "date"]).astype({"point_format": "Int64"})
        table.insert(9, "area", self.areas)
        table.insert(10, "density", table["points"] / table["area"].where(self.areas > 0))
        return table

    def plot(self, ax: Any = None) -> Any:
        """Draw the bounds of the files, coloured by density, with overlaps and gaps; see ``plots.footprints``.

        >>> jf.open("survey", units="m").plot().get_aspect()
        1.0
        """
        from ..plots import footprints

        pairs, _ = self._index.overlaps(OVERLAP)
        gaps, label = self._index.holes(), "points per m2"
        density = self.table()["density"].to_numpy()
        return footprints(self.footprints, density, label=label, overlaps=pairs, gaps=gaps, ax=ax)

    def to_vpc(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write a virtual point cloud, see ``vpc.py``; files without points are left out.

        Returns: the path. Warns: JaxfilterWarning if files are left out. Raises: OutputError.

        >>> path = jf.open("survey", units="m").to_vpc("survey.vpc")
        >>> jf.open(path, units="m").count == len(cloud)
        True
        """
        from .vpc import write_vpc

        left_out = int((self.counts == 0).sum())
        if left_out:
            warn(f"{path}: {left_out} files without points are left out")
        return write_vpc(self, Path(path), overwrite)


def common(box: Bounds, limits: Bounds) -> Bounds:
    """What two boxes share; its low edges are not below the high ones where that is nothing."""
    (x0, y0, x1, y1), (west, south, east, north) = box, limits
    return max(x0, west), max(y0, south), min(x1, east), min(y1, north)


def open(
    what: str | os.PathLike[str] | Iterable[str | os.PathLike[str]],
    *,
    units: str | Units | None = None,
    crs: Any = None,
) -> Collection:
    """Open a survey: read the headers of its files, and nothing of their points.

    Args:
        what: a LAS, LAZ, COPC or text file; a folder, which stands for all LAS, LAZ and COPC files directly in it; a pattern
            (``"*"``, ``"?"``, ``"[...]"``, ``"**"`` for any depth), which finds text if it ends with .txt, .xyz or .csv; a
            virtual point cloud (``.vpc``), whose entries are believed and whose files are not touched; or a list of these.
            Any of them may be a URL that fsspec knows (``s3://``, ``https://``, ``file://``), but text is read from local
            disks only.
        units: of the coordinates, as in :func:`jaxfilter.read`; by default what each CRS says, and metres where there is
            none.
        crs: that of files which state none, as in :func:`jaxfilter.read`. A file with another one is ``unreadable``.

    Returns: Collection. Files that cannot be read are in its ``unreadable``, those without points are members.
    Raises: InputError if nothing is named, a name stands for nothing, or no file can be read.

    >>> jf.open("survey/*.laz", units="m")
    Collection(2 files, 5033 points)
    """
    stated = Reading(units=units, crs=crs).stated
    listed = [what] if isinstance(what, (str, os.PathLike)) else list(what)
    if not listed:
        raise InputError("no files are named")
    entries: dict[str, Entry] = {}
    repeated: list[str] = []
    for one in listed:
        for entry in _expanded(os.fspath(one), stated):
            uri = entry.uri if isinstance(entry, Source) else entry
            if uri in entries:
                repeated.append(uri)
            entries.setdefault(uri, entry)
    with ThreadPoolExecutor(_THREADS) as pool:
        found = list(pool.map(lambda entry: _source_of(entry, stated, len(entries) == 1), entries.values()))
    unreadable = [one for one in found if not isinstance(one, Source)]
    collection = Collection((one for one in found if isinstance(one, Source)), unreadable, dict.fromkeys(repeated))
    if not collection:
        raise InputError(unreadable[0][1] if unreadable else f"{what}: names no files")
    return collection


def _expanded(name: str, stated: Stated) -> Iterable[Entry]:
    """The files that a name means, in alphabetical order; ``stated``: of the coordinates of members. Raises: InputError if there
    are none."""
    place, pattern = place_of(name), any(c in name for c in "*?[")
    suffix = place.suffix.lower()
    if suffix == ".vpc":
        from .vpc import read_vpc

        return read_vpc(place, stated)
    if isinstance(place, Remote):
        if suffix in (*LAS_SUFFIXES, *TEXT) and not any(c in name for c in "*["):
            return [name]
        found = place.listed(LAS_SUFFIXES)
    else:
        place = Path(os.path.abspath(place))  # which other processes understand as well
        if place.is_dir():
            found = sorted(str(p) for p in place.iterdir() if _is_member(p))
        elif pattern and not place.exists():
            found = sorted(p for p in glob.glob(str(place), recursive=True) if _is_member(Path(p), suffix))
        else:
            return [str(place)]
    if not found and pattern:
        raise InputError(f"{name}: matches no .las or .laz file")
    if not found:
        raise InputError(
            f"{name}: holds no .las or .laz file; for those in folders below, name {name.rstrip('/')}/**/*.laz"
        )
    return found


def _is_member(path: Path, asked: str = "") -> bool:
    """Files of LAS, and of text if a pattern asks for their suffix."""
    known = (*LAS_SUFFIXES, asked) if asked in TEXT else LAS_SUFFIXES
    return path.suffix.lower() in known and not path.name.startswith(".") and path.is_file()


def _source_of(entry: Entry, stated: Stated, points: bool) -> Source | tuple[str, str]:
    """The source of a file, or its name and why there is none."""
    if isinstance(entry, Source):
        return entry
    try:
        return describe_file(place_of(entry), stated, points)
    except InputError as error:
        return entry, str(error)
