"""Batches: clouds of unlike size in a few padded blocks on the device, under many sets of parameters at once."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from ..core.errors import ParameterError
from ..core.filter import check_resources, watch
from ..core.points import Points
from ..engines.grid.cells import padded_length
from .grid_filter import CELL_BYTES, POINT_BYTES, check_width
from .surfaces import Cells

_STEP = 16
"""Rows, columns of blocks are multiples of this many, and points of so many times 64."""
_CELL_COST = 4
"""A cell takes about as long as so many points."""


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["cells", "xyz", "real", "truth", "counted", "totals"], meta_fields=[]
)
@dataclasses.dataclass(frozen=True, eq=False)
class Block:
    """Clouds in arrays of one shape, or one of them, then without the first axis; a pytree.

    Attributes:
        cells: of each cloud, with the axis of clouds first in each array.
        xyz: f32[clouds, n, 3], local metres: the rows of ``Filter.points_of``, and zeros.
        real: bool[clouds, n], rows that are points.
        truth: bool[clouds, n], reference labels, True = ground; counted: bool[clouds, n], points that have one.
        totals: i32[clouds, 2], how many points of the whole cloud have the reference label ground, and object.
    """

    cells: Cells
    xyz: jax.Array
    real: jax.Array
    truth: jax.Array
    counted: jax.Array
    totals: jax.Array


@functools.partial(
    jax.tree_util.register_dataclass, data_fields=["filter", "blocks"], meta_fields=["points", "names", "order"]
)
@dataclasses.dataclass(frozen=True, eq=False)
class Batch:
    """Clouds in padded blocks, for a method on a grid; made by :func:`jaxfilter.batch`. A pytree, for ``jax.jit`` and ``vmap``.

    ``ground``, ``soft`` and ``confusion`` take sets of parameters: a mapping from traced fields to arrays f32[sets]; without, the
    filter counts alone. They are pure. One program for each block goes over clouds and sets. What no traced field decides, such
    as the openings of SMRF, is computed once a cloud. A surface is computed once for all sets that differ only in what ``test``
    reads: ``threshold`` and ``scaling`` of SMRF. ``memory``: bytes that sets computed at the same time may hold. Static fields
    (``cell``, ``window``, ...) fix shapes: make a batch for each value. Raises: ParameterError for a field that is static or
    unknown, a value out of its limits, or sets of unlike length.

    Attributes:
        filter: the method; its traced fields hold where ``sets`` has none.
        blocks: the clouds.
        points: of every cloud. names: of the clouds, or None. order: of every cloud its block, and its place there.

    >>> batch = jf.batch([cloud, cloud.coordinates()[:2000]], jf.MSF(), blocks=1)
    >>> [labels.shape for labels in batch.unstack(batch.ground())] == [(len(cloud),), (2000,)]
    True
    """

    filter: Any
    blocks: tuple[Block, ...]
    points: tuple[Points, ...]
    names: tuple[str, ...] | None
    order: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.order)

    def ground(self, sets: Mapping[str, Any] | None = None, *, memory: float = 1e9) -> tuple[jax.Array, ...]:
        """Labels of each block: bool[clouds, sets, n], or bool[clouds, n] without sets; False for rows that are no points.
        ``memory``: bytes; see the class.

        >>> batch = jf.batch([cloud], jf.MSF())
        >>> [labels] = batch.unstack(batch.ground({"slope": [0.2, 0.4]}))
        >>> bool((labels[1] == jf.MSF(slope=0.4)(cloud).ground).all())
        True
        """
        return self._of_blocks("ground", sets, 0.0, memory)

    def soft(
        self, sets: Mapping[str, Any] | None = None, *, width: jax.Array | float = 0.1, memory: float = 1e9
    ) -> tuple[jax.Array, ...]:
        """:func:`jaxfilter.soft_labels` of each block: f32[clouds, sets, n], or f32[clouds, n]; 0 for rows that are no points.
        ``width``: metres; ``memory``: bytes.

        >>> batch = jf.batch([cloud], jf.PMF())
        >>> [soft] = batch.soft(width=0.2)
        >>> bool(((soft >= 0) & (soft <= 1)).all())
        True
        """
        check_width(width)
        return self._of_blocks("soft", sets, width, memory)

    def confusion(self, sets: Mapping[str, Any] | None = None, *, memory: float = 1e9) -> jax.Array:
        """Counts as in :class:`jaxfilter.Scores`, of all points with a reference label: i32[clouds, sets, 2, 2], in the order
        of the clouds, or i32[clouds, 2, 2] without sets. Points that are no candidates are labelled object. A cloud without
        labels has zeros. ``memory``: bytes.

        >>> batch = jf.batch([cloud], jf.MSF(), [truth])
        >>> counts = batch.confusion({"slope": [0.2, 0.4]})
        >>> counts.shape, int(counts[0, 1].sum()) == len(cloud)
        ((1, 2, 2, 2), True)
        """
        first = np.cumsum([0, *(len(block.real) for block in self.blocks)])
        places = np.array([first[block] + place for block, place in self.order])
        return jnp.concatenate(self._of_blocks("confusion", sets, 0.0, memory))[places]

    def unstack(self, values: tuple[Any, ...], empty: Any = 0) -> Any:
        """Values of points [clouds, ..., n] of each block, back to the clouds: NumPy arrays [..., points], in input order.

        ``empty``: for points that are no candidates. Returns: a list, or a dict where the clouds have names.

        >>> batch = jf.batch({"a": cloud}, jf.MSF())
        >>> bool((batch.unstack(batch.ground())["a"] == jf.MSF()(cloud).ground).all())
        True
        """
        arrays, found = [np.asarray(part) for part in values], []
        for points, (block, place) in zip(self.points, self.order, strict=True):
            own = arrays[block][place][..., : len(points)]
            rows = [points.spread(row, empty) for row in own.reshape(-1, len(points))]
            found.append(np.stack(rows).reshape(*own.shape[:-1], len(points.cloud)))
        return found if self.names is None else dict(zip(self.names, found, strict=True))

    def _of_blocks(self, what: str, sets: Any, width: Any, memory: float) -> tuple[jax.Array, ...]:
        check_resources(None, memory)
        if sets is not None and not sets:
            raise ParameterError("sets: name at least one field and its values, or pass None for the filter as it is")
        fields = None if sets is None else {name: jnp.asarray(values, jnp.float32) for name, values in sets.items()}
        if unknown := set(fields or ()) - {field.name for field in dataclasses.fields(self.filter)}:
            raise ParameterError(f"sets: {type(self.filter).__name__} has no field {min(unknown)!r}")
        shapes = {name: values.shape for name, values in (fields or {"": jnp.zeros(1)}).items()}
        count = max(map(math.prod, shapes.values()))
        if set(shapes.values()) != {(count,)}:
            raise ParameterError(f"sets: {shapes}: arrays of one length are needed, a value for each set")
        for name, values in (fields or {}).items():
            for value in () if isinstance(values, jax.core.Tracer) else set(np.asarray(values).tolist()):
                self.filter.replace(**{name: value})
        return tuple(
            _known(self.filter, b, fields, width, what=what, at_once=_at_once(b, count, memory)) for b in self.blocks
        )


def stack_clouds(
    filter_: Any, taken: list[Points], ready: list[tuple[Any, ...]], names: tuple[str, ...] | None, blocks: int
) -> Batch:
    """A batch of clouds: of each its points, and cells, coordinates, truth, counted and totals as in :class:`Block`."""
    groups = _grouped([(*cells.grid.shape, len(xyz)) for cells, xyz, *_ in ready], blocks)
    order = {c: (b, place) for b, group in enumerate(groups) for place, c in enumerate(group)}
    padded = tuple(_block([ready[c] for c in group]) for group in groups)
    return Batch(filter_, padded, tuple(taken), names, tuple(order[c] for c in range(len(taken))))


def _block(clouds: list[tuple[Any, ...]]) -> Block:
    rows, columns = (-(-max(cells.grid.shape[a] for cells, *_ in clouds) // _STEP) * _STEP for a in range(2))
    most = -(-max(len(xyz) for _, xyz, *_ in clouds) // (64 * _STEP)) * 64 * _STEP

    def fitted(values: Any, lengths: tuple[int, ...]) -> np.ndarray:
        part = np.asarray(values)[tuple(slice(n) for n in lengths)]
        widths = [(0, n - have) for n, have in zip(lengths, part.shape, strict=False)]
        return np.pad(part, widths + [(0, 0)] * (part.ndim - len(widths)))

    def of_grid(values: Any) -> Any:
        return values if np.ndim(values) < 2 else fitted(values, (rows, columns))

    grids = [jax.tree.map(of_grid, cells) for cells, *_ in clouds]
    of_points = [
        [fitted(values, (most,)) for values in (xyz, np.ones(len(xyz), bool), t, c)] for _, xyz, t, c, _ in clouds
    ]
    each = [(grid, *values, one[-1]) for grid, values, one in zip(grids, of_points, clouds, strict=True)]
    return Block(*jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *each))


def _grouped(sizes: list[tuple[int, int, int]], most: int) -> list[list[int]]:
    """Numbers of clouds by block, given their rows, columns and points. The two blocks whose union costs least are joined, until
    there are few enough. Clouds whose membranes have other levels stay apart, so that each has the one that it has alone."""

    def size(group: list[int]) -> tuple[int, ...]:
        return tuple(max(sizes[c][axis] for c in group) for axis in range(3))

    def cost(group: list[int]) -> int:
        rows, columns, points = size(group)
        return len(group) * (_CELL_COST * rows * columns + points)

    def joinable(a: list[int], b: list[int]) -> bool:
        return padded_length(max(size(a)[:2])) == padded_length(max(size(b)[:2]))

    groups = [[c] for c in range(len(sizes))]
    while len(groups) > most:
        pairs = [
            (cost(a + b) - cost(a) - cost(b), a, b) for a, b in itertools.combinations(groups, 2) if joinable(a, b)
        ]
        if not pairs:
            break
        _, a, b = min(pairs)
        groups = [group for group in groups if group not in (a, b)] + [sorted(a + b)]
    return sorted(groups)


def _at_once(block: Block, sets: int, memory: float) -> int:
    """How many sets are computed together: on a processor one, whose grid stays in the cache; else a divisor of their number."""
    if jax.default_backend() == "cpu":
        return 1
    room = int(memory // (CELL_BYTES * block.cells.lowest[0].size + POINT_BYTES * block.xyz.shape[1]))
    return next(n for n in range(max(1, min(sets, room)), 0, -1) if sets % n == 0)


@functools.partial(jax.jit, static_argnames=("what", "at_once"))
def _known(filter_: Any, block: Block, sets: Any, width: jax.Array | float, what: str, at_once: int) -> jax.Array:
    """Of every cloud of a block with every set: labels, soft labels or counts."""

    def prepare(one: Any, cells: Cells) -> Any:
        return lax.optimization_barrier(one.prepare(cells.checked()))

    (one, early), (other, late) = watch(filter_), watch(filter_)
    jax.eval_shape(lambda cells: other.surface(prepare(one, cells)), jax.tree.map(lambda leaf: leaf[0], block.cells))

    def of_cloud(cloud: Block) -> jax.Array:
        prepared = prepare(filter_, cloud.cells)

        def ready(one: Any, fields: Any) -> Any:
            return prepare(one, cloud.cells) if early & set(fields) else prepared

        def surface(fields: Any) -> Any:
            one = dataclasses.replace(filter_, **fields)
            return one.surface(ready(one, fields))._replace(counts={})

        def soft(fields: Any) -> jax.Array:
            one = dataclasses.replace(filter_, **fields)
            return jnp.where(cloud.real, one._soft(ready(one, fields), cloud.xyz, width), 0)

        def classify(fields: Any, model: Any) -> jax.Array:
            # Those of the surface would be the same, but places in the grid would be found anew for each set.
            model = model._replace(grid=cloud.cells.grid)
            ground = cloud.real & (dataclasses.replace(filter_, **fields).test(model, cloud.xyz).margin <= 0)
            if what == "ground":
                return ground
            kinds = cloud.counted & cloud.truth, cloud.counted & ~cloud.truth
            hits = jnp.stack([(ground & kind).sum(dtype=jnp.int32) for kind in kinds])
            return jnp.stack([hits, cloud.totals - hits], axis=-1)

        def after(last: Any, given: Any) -> tuple[Any, jax.Array]:
            (key, fields), (other, model) = given, last
            model = lax.cond((key == other).all(), lambda: model, lambda: surface(fields))
            return (key, model), classify(fields, model)

        if what == "soft":
            return lax.map(lambda given: soft(given[1]), (keys, shared))
        if at_once > 1:
            return lax.map(lambda given: classify(given[1], surface(given[1])), (keys, shared), batch_size=at_once)
        empty = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(lambda: surface({})))
        return lax.scan(after, (jnp.full(keys.shape[1], jnp.nan), empty), (keys, shared))[1]

    # Sets that differ in nothing that ``prepare`` and ``surface`` read follow each other, so that they share their surface.
    count = 1 if sets is None else len(next(iter(sets.values())))
    untested = [values for name, values in (sets or {}).items() if name in early | late]
    keys = jnp.stack([jnp.zeros(count), *untested], axis=1)
    order = jnp.lexsort(keys.T)
    keys, shared = jax.tree.map(lambda values: values[order], (keys, sets or {}))
    found = lax.map(of_cloud, block)
    return found[:, 0] if sets is None else jnp.take(found, jnp.argsort(order), axis=1)
