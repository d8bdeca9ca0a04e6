"""What a filter returns, and what it has to offer to be one."""

from __future__ import annotations

import dataclasses
import enum
import json
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from .errors import DAMAGED_ARRAYS, InputError, OutputError, warn
from .output import output_errors, replacing
from .version import __version__
from .water import WaterCells

if TYPE_CHECKING:
    import pandas
    import xarray

Progress = Callable[[float, str], None]
"""Called with the fraction done (0..1) and the name of the step."""


def silent(fraction: float, step: str) -> None:
    """A :data:`Progress` that reports to no one."""


class Status(enum.IntEnum):
    """How a run ended; ``message`` says it in words.

    >>> result.status == jf.Status.CONVERGED, result.status.message
    (True, 'finished')
    """

    message: str

    def __new__(cls, number: int, message: str) -> Status:
        one = int.__new__(cls, number)
        one._value_, one.message = number, message
        return one

    CONVERGED = 0, "finished"
    ROUND_LIMIT = 1, "the limit of rounds was reached before densification ended"
    NO_POINTS = 2, "the cloud has no points"
    NO_CANDIDATES = 3, "no point is a candidate: all are set aside by echo, class or withheld flag"
    TOO_FEW_POINTS = 4, "fewer than four distinct positions, or all on a line: the lowest per position are ground"
    FLAT = 5, "all points have one elevation: all are ground"


class Decision(enum.IntEnum):
    """Which test decided a point.

    >>> jf.Decision(int(result.decision[~cloud.candidate][0])).name
    'SET_ASIDE'
    """

    SET_ASIDE = 0  # never tested: no candidate (echo, class, flag, invalid coordinate), or taken out by the method
    SEED = 1
    ACCEPTED = 2  # passed every test
    NOISE_FLOOR = 3  # within the noise floor of its facet
    ANGLE = 4  # failed the angle test
    ELEVATION = 5  # failed the test of elevation or distance
    LOW = 6  # too far below the surface
    SURFACE = 7  # failed the test against a gridded surface


QUANTITIES = ("height", "slope", "angle", "elevation", "margin")
"""What a method measures of points, f32 each; see :class:`FilterResult`."""


@dataclasses.dataclass(frozen=True, eq=False)
class Call:
    """What a result is the result of: the filter, the PointCloud that it was called with, the wall time of the call, and the
    random key in whole numbers."""

    filter: Any
    cloud: Any
    seconds: float
    key: list[Any] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class FilterResult:
    """Labels and the quantities behind them; all arrays have the length and the order of the cloud.

    Attributes:
        ground: bool[n].
        height: f32[n], metres above the final surface (negative below); NaN where no surface was tested.
        slope: f32[n], degrees; slope of that surface under the point.
        angle: f32[n], degrees; last tested angle to the facet (TIN filters), else NaN.
        elevation: f32[n], metres; last tested elevation over the highest vertex, or distance to the facet; else NaN.
        margin: f32[n]; tested quantity minus its threshold in the unit of the deciding test: ground has zero or less.
            It may be infinite; NaN if untested.
        decision: u8[n], see :class:`Decision`.
        barred: bool[n]; points kept out of the seeds as outliers (they were tested again later).
        status: how the run ended; ``status.message`` in words.
        info: counts of the run (seeds, rounds, facets, ...).
        trace: a dict of counts per round, in order; with ``trace=True`` also ``"ground"``: bool[n] after that round.
        doubt: f32[n] or None; probability that the label is wrong, by methods that state it (OST); NaN if never judged.
        settled: bool[n] or None; points that are ground before the thresholds are applied that a method applies last.
        water: bool[n] or None; points of the surface of a water body, which stay ground. None = the method looks for none.
        deck: bool[n] or None; points of a bridge deck, which are no ground. None = the method looks for none.
        water_cells: where the water bodies are, voids included; None = there are none, or the method looks for none.
        low_noise: bool[n]; low outliers: barred from the seeds, not ground in the end, and below the final surface, unless they
            are given. Methods that bar no points, such as SMRF, which bars cells, have none.
        run: the filter and the cloud; None for a result that was put together by hand, or comes from a file.
        loaded: the provenance that :meth:`load` has read.

    >>> len(result) == len(cloud), result.ground.dtype
    (True, dtype('bool'))
    >>> bool(result.info["candidates"] == cloud.candidate.sum())
    True
    """

    ground: np.ndarray
    height: np.ndarray
    slope: np.ndarray
    angle: np.ndarray
    elevation: np.ndarray
    margin: np.ndarray
    decision: np.ndarray
    barred: np.ndarray
    status: Status
    info: dict[str, Any]
    trace: list[dict[str, Any]]
    settled: np.ndarray | None = None
    doubt: np.ndarray | None = None
    water: np.ndarray | None = None
    deck: np.ndarray | None = None
    water_cells: WaterCells | None = None
    low_noise: np.ndarray = None  # type: ignore[assignment]
    run: Call | None = dataclasses.field(default=None, repr=False)
    loaded: dict[str, Any] | None = dataclasses.field(default=None, repr=False)

    def __post_init__(self) -> None:
        low = self.barred & (self.height < 0) if self.low_noise is None else self.low_noise
        object.__setattr__(self, "low_noise", np.asarray(low & ~self.ground))

    @classmethod
    def of_labels(
        cls, ground: np.ndarray, low_noise: np.ndarray | None = None, **quantities: np.ndarray | None
    ) -> FilterResult:
        """A result of labels alone, bool[n], with low outliers, bool[n], and what else is known of the points: f32[n] by name, in
        metres and degrees. Raises: InputError for what are no labels.

        >>> made = jf.FilterResult.of_labels(np.array([True, False]), low_noise=np.array([False, True]))
        >>> made.low_noise.tolist(), bool(np.isnan(made.height).all()), made.run
        ([False, True], True, None)
        """
        ground, n = np.asarray(ground), len(ground)
        low = np.zeros(n, bool) if low_noise is None else np.asarray(low_noise)
        for name, values in (("ground", ground), ("low_noise", low)):
            if values.shape != (n,) or values.dtype != bool:
                raise InputError(f"{name}: bool[{n}] is needed, not {values.dtype}{list(values.shape)}")
        facts: dict[str, Any] = dict.fromkeys(QUANTITIES, np.broadcast_to(np.float32(np.nan), n))
        facts |= {"decision": np.broadcast_to(np.uint8(Decision.SET_ASIDE), n), "barred": low, "low_noise": low}
        return cls(ground, status=Status.CONVERGED, info={}, trace=[], **{**facts, **quantities})

    def __len__(self) -> int:
        return len(self.ground)

    def __repr__(self) -> str:
        share = 100 * float(self.ground.mean()) if len(self) else float("nan")
        return f"FilterResult({int(self.ground.sum())} of {len(self)} ground, {share:.1f} %; {self.status.message})"

    @property
    def provenance(self) -> dict[str, Any]:
        """What is needed to make the labels again: ``jaxfilter``, its version; ``method``, ``parameters`` by name, and the random
        ``key`` (None: the default one); ``cloud``, see :meth:`PointCloud.digest`, which is computed now; ``seconds`` of the call.
        Plain values, as JSON holds them. Empty for a result that was put together by hand.

        >>> result.provenance["method"], result.provenance["cloud"] == cloud.digest()
        ('OST', True)
        """
        if self.run is None:
            return dict(self.loaded or {})
        run = self.run
        facts: dict[str, Any] = {
            "jaxfilter": __version__,
            "method": type(run.filter).__name__,
            "parameters": dataclasses.asdict(run.filter),
            "key": run.key,
            "cloud": run.cloud.digest(),
            "seconds": run.seconds,
        }
        found: dict[str, Any] = json.loads(json.dumps(facts, default=plain))
        return found

    def save(self, path: str | os.PathLike[str], *, overwrite: bool = False) -> Path:
        """Write the result to a file of NumPy (``.npz``): all arrays, and status, counts and :attr:`provenance` as JSON in
        ``facts``. The file appears whole or not at all. The cloud is not in it.

        Returns: the path. Raises: OutputError if it exists and not ``overwrite``, or if the operating system refuses.

        >>> result.save("result.npz").name
        'result.npz'
        """
        path, trace = Path(path), [dict(step) for step in self.trace]
        arrays = {f"trace_{i}": step.pop("ground") for i, step in enumerate(trace) if "ground" in step}
        arrays |= {name: values for name, values in vars(self).items() if isinstance(values, np.ndarray)}
        if self.water_cells is not None:
            arrays |= {f"water_{name}": np.asarray(values) for name, values in vars(self.water_cells).items()}
        facts = {"format": _FORMAT, "status": self.status.name, "info": self.info, "trace": trace}
        text = json.dumps(facts | {"provenance": self.provenance}, default=plain)
        with output_errors(path):
            if path.exists() and not overwrite:
                raise OutputError(f"{path}: the file exists; pass overwrite=True to replace it")
            with replacing(Path(os.path.realpath(path))) as part, part.open("wb") as file:
                np.savez(file, facts=np.array(text), **arrays)
        return path

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> FilterResult:
        """The result that :meth:`save` has written: arrays bit for bit, without the cloud. Whether a cloud is the one that it was
        made of says ``cloud.digest() == result.provenance["cloud"]``.

        Raises: InputError for a file that cannot be read, or is of another kind.

        >>> again = jf.FilterResult.load(result.save("result.npz"))
        >>> bool((again.ground == result.ground).all()), again.provenance == result.provenance
        (True, True)
        """
        try:
            with np.load(path) as file:
                arrays = dict(file)
            facts = json.loads(str(arrays.pop("facts")))
            if facts["format"] != _FORMAT:
                raise ValueError(f"its format is {facts['format']!r}, not {_FORMAT!r}")
            water = [arrays.pop(f"water_{name}") for name in ("side", "at", "z")] if "water_side" in arrays else []
            cells = WaterCells(float(water[0]), *water[1:]) if water else None
            for i, step in enumerate(facts["trace"]):
                step |= {"ground": arrays.pop(f"trace_{i}")} if f"trace_{i}" in arrays else {}
            if wrong := [name for name, values in arrays.items() if values.shape != arrays["ground"].shape]:
                raise ValueError(f"{wrong[0]} has another length than ground")
            more = {"info": facts["info"], "trace": facts["trace"], "loaded": facts["provenance"], "water_cells": cells}
            return cls(**arrays, status=Status[facts["status"]], **more)
        except DAMAGED_ARRAYS as error:
            raise InputError(f"{path}: is no result that FilterResult.save has written ({error})") from error

    def to_xarray(self) -> xarray.Dataset:
        """All quantities over the dimension ``point``, with their units, and what the cloud says of the points.

        Coordinates ``x``, ``y`` and ``z`` are in file units, f64: those of the file, which is read again, or, of a cloud that was
        made of arrays or whose file has changed (which is warned of), rounded to a millimetre; ``classification`` and
        ``reference`` are there if the cloud has them. ``decision`` holds numbers; its attributes name them. Attributes of the
        whole: method, parameters, status. A result that was put together by hand has neither coordinates nor parameters.

        >>> data = result.to_xarray()
        >>> data.height.attrs["units"], data.sizes["point"] == len(cloud)
        ('m', True)
        """
        import xarray

        facts = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        arrays = {name: ("point", values) for name, values in facts.items() if isinstance(values, np.ndarray)}
        out = xarray.Dataset(arrays, attrs={"status": self.status.name})
        for name, unit in {"height": "m", "slope": "degrees", "angle": "degrees", "elevation": "m"}.items():
            out[name].attrs["units"] = unit
        names = " ".join(one.name for one in Decision)
        out["decision"].attrs = {"flag_values": [int(one) for one in Decision], "flag_meanings": names}
        if self.run is None:
            return out
        cloud, filter_ = self.run.cloud, self.run.filter
        out = out.assign_coords({axis: ("point", v) for axis, v in zip("xyz", _coordinates(cloud).T, strict=True)})
        for name in ("classification", "reference"):
            if getattr(cloud, name) is not None:
                out[name] = ("point", getattr(cloud, name))
        crs = {} if cloud.crs is None else {"crs": cloud.crs.to_string()}
        return out.assign_attrs(method=type(filter_).__name__, parameters=repr(filter_), **crs)

    def to_pandas(self) -> pandas.DataFrame:
        """A row per point: what :meth:`to_xarray` holds, coordinates first, ``decision`` in words.

        >>> result.to_pandas()[["ground", "height", "decision"]].dtypes.astype(str).tolist()
        ['bool', 'float32', 'category']
        """
        import pandas

        data = self.to_xarray()
        table = pandas.DataFrame({str(name): data[name].to_numpy() for name in [*data.coords, *data.data_vars]})
        names = [one.name.lower() for one in Decision]
        table["decision"] = pandas.Categorical.from_codes(self.decision.astype(int), names)
        table.attrs = dict(data.attrs)
        return table


_FORMAT = "jaxfilter.FilterResult 1"


def key_words(key: Any) -> list[Any] | None:
    """A JAX random key in whole numbers; None for None."""
    import jax  # `--help` does not wait for it

    return None if key is None else np.asarray(jax.random.key_data(key)).tolist()


def plain(value: Any) -> Any:
    """What JSON does not hold, as what it holds."""
    return value.tolist() if hasattr(value, "tolist") else str(value)


def _coordinates(cloud: Any) -> np.ndarray:
    """f64[n, 3] in file units: those of the file that the cloud was read from, if it is still there; NaN for invalid points."""
    if cloud.source is not None:
        try:
            return np.asarray(cloud.source.coordinates())
        except InputError as error:
            warn(f"{error}; until then coordinates are given to a millimetre")
    xyz = np.asarray(cloud.coordinates())
    return xyz if cloud.valid is None else np.where(cloud.valid[:, None], xyz, np.nan)


@runtime_checkable
class GroundFilter(Protocol):
    """A ground filter: call it on a cloud; ask how far its decisions reach.

    >>> isinstance(jf.SMRF(), jf.GroundFilter), isinstance(len, jf.GroundFilter)
    (True, False)
    """

    def __call__(
        self, cloud: Any, *, key: Any = None, workers: int | None = None, progress: Progress | None = None
    ) -> FilterResult: ...

    def halo(self) -> float:
        """Metres around a tile that are filtered with it: farther away next to nothing changes labels inside."""
