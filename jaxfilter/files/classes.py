"""Which class each point gets when it is written: by what was found of it, and by the class that it had."""

from __future__ import annotations

import dataclasses
import enum
from typing import Any, ClassVar, Self

import numpy as np

from ..core.cloud import GROUND_CLASS, OVERLAP_CLASS, PointCloud
from ..core.errors import InputError, ParameterError, warn
from ..core.result import FilterResult

CLASS_NAMES = (
    "never classified", "unclassified", "ground", "low vegetation", "medium vegetation", "high vegetation", "building",
    "low noise", "model key point", "water", "rail", "road surface", "overlap", "wire guard", "wire conductor",
    "transmission tower", "wire connector", "bridge deck", "high noise", "overhead structure", "ignored ground", "snow",
    "temporal exclusion",
)  # fmt: skip
"""Names of ASPRS classes (LAS 1.4 R15, table 17), short; from 23 on they are reserved or of the user."""


class Finding(enum.IntEnum):
    """What has been found of a point."""

    KEPT = 0  # nothing: it is not judged
    OTHER = 1  # it is judged, and is none of these
    GROUND = 2
    LOW_NOISE = 3
    WATER = 4
    DECK = 5


@dataclasses.dataclass(frozen=True)
class Classes:
    """Which classes points get when they are written.

    Water and decks are written over classes that say nothing (0 and 1), and over those that are reset; ground and low noise
    over every class. Points that are set aside keep theirs, so what somebody has edited stays.

    Attributes:
        ground_class: class of ground. other_class: class of candidates that are not ground and whose old class is reset.
        reset: which old classes those are: ``"ground"`` (0, 2 and ``ground_class``), ``"all"`` or ``"none"``.
        only_ground: the same as ``reset="none"``: change only ground candidates, and what fields below ask for.
        noise_class: class of low outliers (``FilterResult.low_noise``), 7 by the ASPRS; None: they are points like others.
        water: class of points of water (``FilterResult.water``), 9 by the ASPRS; None: they are ground.
        bridge: class of points of decks (``FilterResult.deck``), 17 by the ASPRS; None: they are points like others.
        unjudged: class of points of class 0 that are not judged, such as echoes above the last one; None: they keep it.
        overlap_flag: points of class 12 that are judged get another class and the overlap flag, which stands for it since LAS
            1.4; in point formats that have no such flag they keep class 12. False: they are points like others.

    Raises: ParameterError for classes that are no numbers from 0 to 255, and another ``reset``.

    >>> changes = jf.class_changes(cloud, result, jf.Classes(ground_class=8))
    >>> bool(changes[0, 8] == result.ground.sum())
    True
    """

    ground_class: int = GROUND_CLASS
    other_class: int = 1
    reset: str = "ground"
    only_ground: bool = False
    noise_class: int | None = None
    water: int | None = None
    bridge: int | None = None
    unjudged: int | None = None
    overlap_flag: bool = False

    PRESETS: ClassVar[dict[str, dict[str, Any]]] = {
        "ground": {},
        "usgs": {"noise_class": 7, "water": 9, "bridge": 17, "unjudged": 1, "overlap_flag": True},
    }
    """Named sets of classes: ``"ground"``, ground and no more; ``"usgs"``, what the USGS asks for in its Lidar Base Specification
    2.1, table 5, as far as it is found (1, 2, 7, 9, 17, and the overlap flag instead of class 12)."""

    def __post_init__(self) -> None:
        if self.reset not in ("ground", "all", "none"):
            raise ParameterError(f"reset={self.reset!r}: choose one of ground, all, none")
        for name in ("ground_class", "other_class", *_OPTIONAL):
            value = getattr(self, name)
            if value is not None and not 0 <= value <= 255:
                raise ParameterError(f"{name}={value!r}: ASPRS classes run from 0 to 255")

    @classmethod
    def preset(cls, name: str, **changes: Any) -> Self:
        """A named set of classes out of ``PRESETS``, and with ``changes`` on top. Raises ParameterError.

        >>> jf.Classes.preset("usgs", water=None).bridge
        17
        """
        if name not in cls.PRESETS:
            raise ParameterError(f"classes={name!r}: choose one of {', '.join(cls.PRESETS)}")
        return cls(**{**cls.PRESETS[name], **changes})


_FOUND = (
    (Finding.WATER, "water", "water", "water"),
    (Finding.DECK, "bridge", "deck", "decks of bridges"),
    (Finding.LOW_NOISE, "noise_class", "low_noise", "outliers"),
)
"""What methods find, the field of :class:`Classes` that asks for it, that of the result, and words."""
_OPTIONAL = ("noise_class", "water", "bridge", "unjudged")


def asked(classes: Classes) -> list[str]:
    """The settings that give points other classes than ground and ``other_class``, as text, for messages."""
    return [f"{name}={value!r}" for name in _OPTIONAL if (value := getattr(classes, name)) is not None]


def table_of(classes: Classes) -> np.ndarray:
    """u8[6, 256]: the new class, by :class:`Finding` and by the old class."""
    old = np.arange(256, dtype=np.uint8)
    reset = "none" if classes.only_ground else classes.reset
    resets = np.full(256, reset == "all")
    if reset == "ground":
        resets[[0, GROUND_CLASS, classes.ground_class]] = True
    resets[OVERLAP_CLASS] |= classes.overlap_flag
    open_ = resets | (old < 2)
    table = np.tile(np.where(resets, np.uint8(classes.other_class), old), (len(Finding), 1))
    table[Finding.KEPT] = old
    table[Finding.KEPT, 0] = classes.unjudged or 0
    table[[Finding.GROUND, Finding.WATER]] = classes.ground_class
    table[Finding.LOW_NOISE] = table[Finding.LOW_NOISE] if classes.noise_class is None else classes.noise_class
    for kind, given in ((Finding.WATER, classes.water), (Finding.DECK, classes.bridge)):
        if given is not None:
            table[kind, open_] = given
    return table


@dataclasses.dataclass(frozen=True, eq=False)
class Found:
    """``ground``: bool[n]; ``code``: u8[n], a :class:`Finding` of each point, as far as classes depend on it."""

    ground: np.ndarray
    code: np.ndarray


def findings_of(cloud: PointCloud, result: FilterResult | np.ndarray, classes: Classes = Classes()) -> Found:
    """What a filter has found of the points of a cloud. Raises: InputError for labels of another length; ParameterError if
    labels alone do not tell what is asked for. Warns: if the method does not look for it."""
    found = result if isinstance(result, FilterResult) else None
    ground = np.asarray(result) if found is None else found.ground
    if ground.shape != (len(cloud),) or ground.dtype != bool:
        given = f"{ground.dtype}{list(ground.shape)}"
        raise InputError(f"result: bool[{len(cloud)}] is needed for this cloud, not {given}")
    judged, code = cloud.candidate, cloud.candidate.astype(np.uint8)
    code[judged & ground] = Finding.GROUND
    for kind, name, source, what in _FOUND:
        if (number := getattr(classes, name)) is None:
            continue
        if found is None:
            raise ParameterError(f"{name}={number}: labels alone tell no {what}; pass the FilterResult")
        if (points := getattr(found, source)) is None:
            warn(f"no point gets class {number}: the method does not look for {what}; leave that class out")
        else:
            code[judged & points & (ground | (kind != Finding.WATER))] = kind
    if classes.overlap_flag and cloud.overlap is None and cloud.classification is not None:
        overlap = cloud.classification == OVERLAP_CLASS
        if (judged & overlap).any():
            warn(
                "points of class 12 keep their class, even if they are ground, since this point format has no overlap flag: "
                "convert the input to point format 6 or above"
            )
        code[overlap] = Finding.KEPT
    return Found(ground, code)


def class_changes(
    cloud: PointCloud, result: FilterResult | np.ndarray | Found, classes: Classes = Classes()
) -> dict[tuple[int, int], int]:
    """What :func:`write` makes of the classes: number of points by (old class, new class), in order.

    Points of a cloud without classes count as class 0, never classified. Raises: as :func:`write`.

    >>> changes = jf.class_changes(cloud, result)
    >>> bool(changes[0, 2] == result.ground.sum()), sum(changes.values()) == len(cloud)
    (True, True)
    """
    found = result if isinstance(result, Found) else findings_of(cloud, result, classes)
    old = np.zeros(len(cloud), np.uint8) if cloud.classification is None else cloud.classification
    pairs = np.bincount(old.astype(np.int64) * 256 + table_of(classes)[found.code, old], minlength=1)
    return {divmod(int(pair), 256): int(pairs[pair]) for pair in np.flatnonzero(pairs)}  # type: ignore[misc]


def class_name(number: int) -> str:
    """A class with its name, such as "2 ground"; the number alone where it has none."""
    return f"{number} {CLASS_NAMES[number]}" if number < len(CLASS_NAMES) else str(number)
