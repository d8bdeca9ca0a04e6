"""Operations on arrays beside those of SciPy, scikit-image, OpenCV and NumPy: times, first and later calls. See README.md."""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import shlex
import statistics
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
PEERS = {"SciPy": "scipy", "scikit-image": "skimage", "OpenCV": "cv2", "NumPy": "numpy"}
RADII = (4, 18)
"""Of disks, cells: as at the beginning and at the end of SMRF."""
MILLIONS = (1.0, 4.0)
REPEATS = 3
Call = Callable[[], Any]


def main(arguments: list[str] | None = None) -> None:
    """Measure all operations at all sizes, each in a process of its own, and write the table."""
    given = sys.argv[1:] if arguments is None else arguments
    if given[:1] == ["--task"]:
        print(json.dumps(measured(*json.loads(given[1]))))
        return
    sys.path.insert(0, str(ROOT))
    from experiments.report import Column, Row, markdown, write_csv, write_page

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--millions", type=float, nargs="+", default=MILLIONS, help="millions of cells [%(default)s]")
    parser.add_argument("--out", type=Path, default=Path(__file__).parent / "out", help="folder for ops.md and ops.csv")
    options = parser.parse_args(given)
    options.out.mkdir(parents=True, exist_ok=True)
    missing = [name for name, module in PEERS.items() if importlib.util.find_spec(module) is None]
    rows: list[Row] = []
    for millions in options.millions:
        for operation, (title, makers) in OPERATIONS.items():
            row: Row = {"operation": title, "millions": millions}
            for who in makers.keys() - set(missing):
                row |= _in_process(operation, who, millions)
            rows.append(row)
            print(row, flush=True)
    columns: list[Column] = [("operation", "operation", ""), ("millions", "M cells", "g")]
    columns += [("jaxfilter_first", "jaxfilter, first call", ".3g")]
    columns += [(who, who, ".3g") for who in ("jaxfilter", *PEERS) if any(who in row for row in rows)]
    columns += [("differ", "cells that differ", "")]
    text = [
        "# Operations beside those of other libraries",
        f'CPU seconds of all threads, median of {REPEATS} calls after a first one; "first call" is with compilation. Each row '
        "and library has a process of its own. A cell is empty where the library has no such operation. The last column counts "
        "the cells in which a library differs from jaxfilter by more than 1e-4: other rules of borders, of equally near cells, "
        "and of when an iteration ends. Of triangulations it counts the points that are corners of more or fewer triangles.",
        markdown(columns, rows),
        *([f"Not installed, so left out: {', '.join(missing)}."] if missing else []),
    ]
    write_csv(options.out / "ops.csv", rows)
    write_page(options.out / "ops.md", "\n\n".join(text), shlex.join(["python", "experiments/bench/ops.py", *given]))


def _in_process(operation: str, who: str, millions: float) -> dict[str, Any]:
    """What :func:`measured` finds, in a new process; the cells that differ are those of all libraries."""
    environment = os.environ | {"JAXFILTER_CACHE": "off"}
    environment.pop("JAX_COMPILATION_CACHE_DIR", None)
    call = [sys.executable, __file__, "--task", json.dumps([operation, who, millions])]
    done = subprocess.run(call, env=environment, capture_output=True, text=True)
    if done.returncode:
        raise SystemExit(f"{operation} by {who} at {millions:g} M cells failed:\n{done.stderr[-2000:]}")
    return dict(json.loads(done.stdout.splitlines()[-1]))


def measured(operation: str, who: str, millions: float) -> dict[str, Any]:
    """CPU seconds of the first call and of later ones, and in how many cells another library differs."""
    sys.path.insert(0, str(ROOT))
    data, makers = grid(millions), OPERATIONS[operation][1]
    call = makers[who](data)
    start = time.process_time()
    found = np.asarray(call())
    first, later = time.process_time() - start, []
    for _ in range(REPEATS):
        start = time.process_time()
        np.asarray(call())
        later.append(time.process_time() - start)
    out: dict[str, Any] = {who: statistics.median(later)}
    if who == "jaxfilter":
        return out | {"jaxfilter_first": first}
    compared = COMPARED.get(operation, lambda values: values.reshape(found.shape))
    found, own = compared(found), compared(np.asarray(makers["jaxfilter"](data)()))
    differ = int((~np.isclose(found, own, atol=1e-4, rtol=0, equal_nan=True)).sum())
    return out | ({"differ": f"{who} {differ:,}"} if differ else {})


def grid(millions: float) -> dict[str, Any]:
    """A square surface with buildings, 30 % of its cells empty, and points over it: the same for all libraries."""
    side, rng = round((1e6 * millions) ** 0.5), np.random.default_rng(0)
    row, column = np.mgrid[:side, :side].astype(np.float32)
    z = 5 * np.sin(row / 90) + 4 * np.cos(column / 70) + rng.normal(0, 0.05, (side, side))
    z += 6 * ((row % 60 < 20) & (column % 75 < 30))
    z, known = z.astype(np.float32), rng.random((side, side)) < 0.7
    xyz = np.column_stack([rng.random((side * side, 2)) * side, rng.random(side * side)]).astype(np.float32)
    return {"z": z, "known": known, "inside": np.ones_like(known), "xyz": xyz, "side": side}


def disk(radius: int) -> Any:
    """bool[2 r + 1, 2 r + 1]: cells within the radius."""
    row, column = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    return row**2 + column**2 <= radius**2


def _openings(radius: int) -> dict[str, Callable[[dict[str, Any]], Call]]:
    def own(data: dict[str, Any]) -> Call:
        from jaxfilter.engines.grid.morphology import opening

        return lambda: opening(data["z"], radius, reach=radius)

    def scipy(data: dict[str, Any]) -> Call:
        from scipy import ndimage

        def call() -> Any:
            low = ndimage.grey_erosion(data["z"], footprint=disk(radius), mode="constant", cval=np.inf)
            return ndimage.grey_dilation(low, footprint=disk(radius), mode="constant", cval=-np.inf)

        return call

    def skimage(data: dict[str, Any]) -> Call:
        from skimage import morphology

        return lambda: morphology.opening(data["z"], disk(radius))

    def opencv(data: dict[str, Any]) -> Call:
        import cv2

        return lambda: cv2.morphologyEx(data["z"], cv2.MORPH_OPEN, disk(radius).astype("uint8"))

    return {"jaxfilter": own, "SciPy": scipy, "scikit-image": skimage, "OpenCV": opencv}


def _own_minima(data: dict[str, Any]) -> Call:
    from jaxfilter.core.grid import Grid
    from jaxfilter.engines.grid.cells import lowest_in_cells

    side, xyz = -(-data["side"] // 2), data["xyz"]
    grid = Grid(0.0, 0.0, 2.0, side, side)
    return lambda: lowest_in_cells(grid.flat(xyz), xyz[:, 2], side * side, rows=False)[0]


def _numpy_minima(data: dict[str, Any]) -> Call:
    side, xyz = -(-data["side"] // 2), data["xyz"]

    def call() -> Any:
        at = np.clip((xyz[:, 1] / 2).astype(np.int64), 0, side - 1) * side
        at += np.clip((xyz[:, 0] / 2).astype(np.int64), 0, side - 1)
        lowest = np.full(side * side, np.inf, np.float32)
        np.minimum.at(lowest, at, xyz[:, 2])
        return lowest

    return call


def _own_nearest(data: dict[str, Any]) -> Call:
    from jaxfilter.engines.grid.inpaint import fill_nearest

    return lambda: fill_nearest(data["z"], data["known"], data["inside"])


def _scipy_nearest(data: dict[str, Any]) -> Call:
    from scipy import ndimage

    def call() -> Any:
        row, column = ndimage.distance_transform_edt(~data["known"], return_distances=False, return_indices=True)
        return data["z"][row, column]

    return call


def _own_membrane(data: dict[str, Any]) -> Call:
    from jaxfilter.engines.grid.inpaint import fill_membrane

    return lambda: fill_membrane(data["z"], data["known"], data["inside"], 1e-5).z


def _scipy_membrane(data: dict[str, Any]) -> Call:
    """Laplace's equation in the holes by a sparse direct solver."""
    from scipy import sparse
    from scipy.sparse.linalg import spsolve

    z, hole = data["z"], ~data["known"]

    def call() -> Any:
        number = np.full(z.shape, -1)
        number[hole] = np.arange(hole.sum())
        total, right, ends = np.zeros(hole.sum()), np.zeros(hole.sum()), []
        for shift, axis in ((1, 0), (-1, 0), (1, 1), (-1, 1)):
            there, height = np.roll(number, shift, axis), np.roll(z, shift, axis)
            exists = np.ones_like(hole)
            exists[tuple([slice(None)] * axis + [0 if shift == 1 else -1])] = False
            total += exists[hole]
            right += np.where(exists & (there < 0), height, 0)[hole]
            pair = hole & exists & (there >= 0)
            ends.append((number[pair], there[pair]))
        a, b = np.concatenate(ends, axis=1)
        matrix = sparse.csc_matrix((-np.ones(len(a)), (a, b)), (len(total), len(total))) + sparse.diags(total)
        out = z.copy()
        out[hole] = spsolve(matrix.tocsc(), right)
        return out

    return call


def _batches(data: dict[str, Any]) -> tuple[Any, Any]:
    """A sixteenth as many blocks of 16 points as there are cells, and which of their rows count."""
    rng, count = np.random.default_rng(1), data["side"] ** 2 // 16
    return rng.random((count, 16, 3), np.float32), np.arange(16) < rng.integers(8, 17, count)[:, None]


def _own_planes(data: dict[str, Any]) -> Call:
    from jaxfilter.steps.planes import fit_planes

    xyz, mask = _batches(data)
    return lambda: fit_planes(xyz, mask).gradient


def _numpy_planes(data: dict[str, Any]) -> Call:
    """The normal equations about the mean, all blocks at once."""
    xyz, mask = _batches(data)

    def call() -> Any:
        weight = mask[..., None] / mask.sum(axis=1)[:, None, None]
        centred = (xyz - (xyz * weight).sum(axis=1, keepdims=True)) * mask[..., None]
        products = np.einsum("nij,nik->njk", centred, centred)
        return np.linalg.solve(products[:, :2, :2], products[:, :2, 2:])[..., 0]

    return call


def _scattered(data: dict[str, Any]) -> Any:
    """f64[n, 3]: as many points as there are cells, in no order."""
    rng, count = np.random.default_rng(3), data["side"] ** 2
    return rng.random((count, 3)) * [data["side"], data["side"], 5]


def _own_delaunay(data: dict[str, Any]) -> Call:
    import jaxfilter as jf

    xyz = _scattered(data)
    return lambda: jf.ops.delaunay(xyz).triangles


def _bare_delaunay(data: dict[str, Any]) -> Call:
    """The engine alone, of positions that are sorted."""
    from concurrent.futures import ThreadPoolExecutor

    from jaxfilter.core.points import morton
    from jaxfilter.engines.tin.triangulation import Tin

    xyz = np.float32(np.rint(_scattered(data) * 1024) / 1024)
    xyz = xyz[np.unique(morton(xyz), return_index=True)[1]]
    sheet, every = np.zeros(len(xyz), np.int32), np.arange(len(xyz))

    def call() -> Any:
        with ThreadPoolExecutor(1) as pool:
            return Tin(xyz, sheet, every, pool).triangles

    return call


def _scipy_delaunay(data: dict[str, Any]) -> Call:
    from scipy.spatial import Delaunay

    xy = np.ascontiguousarray(_scattered(data)[:, :2])
    return lambda: Delaunay(xy).simplices


def _facet_parts(data: dict[str, Any]) -> tuple[Any, Any]:
    rng, count = np.random.default_rng(2), data["side"] ** 2
    corners = np.stack([rng.random((3, count)), rng.random((3, count)), rng.random((3, count))], axis=1)
    return corners.astype(np.float32), rng.random((3, count), np.float32)


def _own_facets(data: dict[str, Any]) -> Call:
    import jax
    import jax.numpy as jnp

    from jaxfilter.engines.tin import facets

    corners, points = _facet_parts(data)
    rule = facets.Rule(max_angle=jnp.float32(6.0), max_distance=jnp.float32(1.4))
    judge = jax.jit(lambda points, corners: facets.judge(rule, jnp.zeros(points.shape[-1], bool), points, corners))
    return lambda: np.asarray(jax.block_until_ready(judge(points, corners))["accepted"])


def _numpy_facets(data: dict[str, Any]) -> Call:
    """Distance to the plane, and angles to the corners, as in Axelsson (2000)."""
    corners, points = _facet_parts(data)

    def call() -> Any:
        a, b, c = corners
        normal = np.cross(b - a, c - a, axis=0)
        normal /= np.linalg.norm(normal, axis=0)
        distance = np.abs((normal * (points - a)).sum(axis=0))
        reach = np.linalg.norm(points[None] - corners, axis=1)
        angle = np.degrees(np.arcsin(np.clip(distance / reach, 0, 1))).max(axis=0)
        return (angle <= 6.0) & (distance <= 1.4)

    return call


OPERATIONS: dict[str, tuple[str, dict[str, Callable[[dict[str, Any]], Call]]]] = {
    **{f"opening{r}": (f"opening, disk of radius {r}", _openings(r)) for r in RADII},
    "minima": ("lowest of a point per cell, cells of 2 x 2", {"jaxfilter": _own_minima, "NumPy": _numpy_minima}),
    "nearest": ("30 % filled with the nearest", {"jaxfilter": _own_nearest, "SciPy": _scipy_nearest}),
    "membrane": ("30 % filled by a membrane, to 1e-5", {"jaxfilter": _own_membrane, "SciPy": _scipy_membrane}),
    "delaunay": ("a triangulation, a point per cell", {"jaxfilter": _own_delaunay, "SciPy": _scipy_delaunay}),
    "engine": ("the same by the bare engine, of sorted points", {"jaxfilter": _bare_delaunay}),
    "facets": ("a point and its facet per cell", {"jaxfilter": _own_facets, "NumPy": _numpy_facets}),
    "planes": ("a plane through 8 to 16 points per 16 cells", {"jaxfilter": _own_planes, "NumPy": _numpy_planes}),
}
"""What is measured, and how each library does it."""
COMPARED = {"delaunay": lambda triangles: np.bincount(triangles.ravel())}
"""What is compared in place of the values: here how many triangles each point has."""


if __name__ == "__main__":
    main()
