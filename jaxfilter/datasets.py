"""Labelled clouds by name, and folders of them, read when they are used. Nothing is downloaded.

>>> list(jf.datasets.folder("survey"))
['east', 'west']
"""

from __future__ import annotations

import dataclasses
import fnmatch
import os
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path

import numpy as np

from .core.cloud import PointCloud
from .core.errors import InputError
from .core.inputs import GROUND_CLASS, class_numbers
from .core.reading import Reading
from .files.reading import read
from .files.writing import CLOUD_SUFFIXES
from .scoring import NEVER_CLASSIFIED

HOW_TO_GET = """\
Data sets lie in the folder that JAXFILTER_DATA names. Those of ISPRS Working Group III/3 (Sithole and Vosselman 2004, ISPRS J.
Photogramm. Remote Sens. 59, 85-101; the ISPRS benchmark pages distribute them) are isprs/samp11.txt to samp71.txt there (columns
x, y, z, label; 0 = ground) and isprs_sites/CSite1*.laz to FSite8*.laz. Other labelled files go into a folder of any name."""


def home(path: str | os.PathLike[str] | None = None) -> Path:
    """The folder with the data sets: ``path``, else what the environment variable JAXFILTER_DATA names.

    Raises: InputError that says what to put where.

    >>> str(jf.datasets.home("survey"))
    'survey'
    """
    folder = Path(path or os.environ.get("JAXFILTER_DATA") or "JAXFILTER_DATA")
    if not folder.is_dir():
        raise InputError(f"{folder} is no folder. {HOW_TO_GET}")
    return folder


def load(name: str, *, data: str | os.PathLike[str] | None = None, reading: Reading = Reading()) -> PointCloud:
    """A cloud with reference labels by its name, which is its path in the folder of data sets without the ending.

    Args:
        name: such as "isprs/samp12"; the path of a file will do.
        data: the folder, see :func:`home`.
        reading: as for :func:`jaxfilter.read`.

    Raises: InputError that says what to put where, and which names there are.

    >>> len(jf.datasets.load("scene", data=".", reading=jf.Reading(units="m"))) == len(cloud)
    True
    """
    path = Path(name)
    if not path.is_file():
        folder = home(data) / path.parent
        there = {p.stem: p for p in sorted(folder.glob("*")) if p.suffix.lower() in CLOUD_SUFFIXES}
        if path.name not in there:
            names = ", ".join([*there][:20]) or "no clouds"
            raise InputError(f"there is no data set {name!r}: {folder} has {names}. {HOW_TO_GET}")
        path = there[path.name]
    return _read(path, reading)


def folder(
    path: str | os.PathLike[str],
    *,
    ground: Iterable[int] = (GROUND_CLASS,),
    ignore: Iterable[int] = (7, 9, 12, 18),
    splits: Mapping[str, Iterable[str]] | None = None,
    reading: Reading = Reading(ignore_classes=(7, 18)),
) -> Labelled:
    """The labelled files of a folder: a mapping from names to clouds, each of which is read when it is used.

    Args:
        path: the folder, or its name among the data sets (:func:`home`), such as "isprs". Files may lie in folders of it.
        ground: classes that are ground in the reference.
        ignore: classes without a reference, which are not scored: by default noise, water and overlap. Class 0 has none either.
        splits: name of each part to the names of its clouds; ``*`` stands for anything. By default each folder in it is a part.
        reading: as for :func:`jaxfilter.read`. By default only noise is set aside, so that no method profits from what a
            producer has classified.

    The ``classification`` of a cloud says what the reference is: 2 = ground, 0 = without; other classes are as in the file.
    Labels of text are taken as they are.

    Raises: InputError for a folder without clouds, a part that has none, and two files of one name.

    >>> data = jf.datasets.folder(".", splits={"test": ["*/west"]}, reading=jf.Reading(units="m"))
    >>> list(data), bool(data["scene"].reference.any())
    (['scene', 'survey/east', 'survey/west'], True)
    """
    root = Path(path) if Path(path).is_dir() else home() / path
    files: dict[str, Path] = {}
    for file in sorted(p for p in root.rglob("*") if p.suffix.lower() in CLOUD_SUFFIXES):
        name = file.relative_to(root).with_suffix("").as_posix()
        if files.setdefault(name, file) != file:
            raise InputError(f"{root}: two files are called {name}: give them different names")
    if not files:
        raise InputError(f"{root} holds no file that ends with {', '.join(CLOUD_SUFFIXES)}. {HOW_TO_GET}")
    parts = splits or {name.split("/")[0]: [name.split("/")[0] + "/*"] for name in files if "/" in name}
    found = {part: tuple(n for n in files if any(fnmatch.fnmatch(n, p) for p in some)) for part, some in parts.items()}
    for part, some in found.items():
        if not some:
            raise InputError(f"splits: no file of {root} is in {part!r}; there are {', '.join([*files][:20])}")
    classes = np.arange(256, dtype=np.uint8)
    classes[GROUND_CLASS] = 1  # an object, unless it is listed
    classes[list(class_numbers(ground))] = GROUND_CLASS
    classes[list(class_numbers(ignore))] = NEVER_CLASSIFIED
    return Labelled(files, classes, found, reading)


@dataclasses.dataclass(frozen=True, eq=False)
class Labelled(Mapping[str, PointCloud]):
    """Labelled clouds by name, from :func:`folder`. :func:`jaxfilter.compare` reads one at a time.

    Attributes:
        paths: of the files.
        classes: u8[256], what each class counts as: 2 = ground, 0 = without a reference.
        splits: names of the clouds in each part.
        reading: how they are read.

    >>> sorted(jf.datasets.folder(".").splits)
    ['survey']
    """

    paths: dict[str, Path]
    classes: np.ndarray
    splits: dict[str, tuple[str, ...]]
    reading: Reading

    def __getitem__(self, name: str) -> PointCloud:
        cloud = _read(self.paths[name], self.reading)
        if cloud.classification is None:
            return cloud
        classes = self.classes[cloud.classification]
        return dataclasses.replace(cloud, classification=classes, reference=classes == GROUND_CLASS)

    def __iter__(self) -> Iterator[str]:
        return iter(self.paths)

    def __len__(self) -> int:
        return len(self.paths)

    def split(self, name: str) -> Labelled:
        """The clouds of a part. Raises: InputError naming the parts.

        >>> list(jf.datasets.folder(".").split("survey"))
        ['survey/east', 'survey/west']
        """
        if name not in self.splits:
            raise InputError(f"split({name!r}): there are {', '.join(self.splits) or 'no parts'}")
        return dataclasses.replace(self, paths={one: self.paths[one] for one in self.splits[name]})


def _read(path: Path, reading: Reading) -> PointCloud:
    how = {name: value for name, value in vars(reading).items() if name not in ("aoi", "drop_duplicates")}
    return read(path, **how)
