"""Windows of files are the masks of whole files, and little is read for them."""

from __future__ import annotations

import struct
import warnings

import laspy
import numpy as np
import pytest
from las_files import OFFSETS, SCALES, las_of, make_copc, make_deep_copc, make_las, patch

import jaxfilter as jf
from jaxfilter.core.reading import Reading
from jaxfilter.core.units import Stated, Units
from jaxfilter.files import points, reading
from jaxfilter.files.sources import describe_file, file_cloud, read_window
from jaxfilter.files.writing import write_cloud

COLUMNS = ("return_number", "number_of_returns", "classification", "withheld", "candidate")
X, Y = OFFSETS[:2]


def source_of(path, **options):
    return jf.open(path, **options)[0]


def whole(path):
    """Coordinates f64[n, 3] of a file and its fields, by laspy."""
    las = laspy.read(path)
    ticks = np.stack([las.X, las.Y, las.Z], axis=1)
    return ticks * las.header.scales + las.header.offsets, las


def assert_is_mask(window, path, box, **options):
    """The window is what a mask of the whole file leaves, by laspy and by ``read``."""
    xyz, las = whole(path)
    inside = (xyz[:, 0] >= box[0]) & (xyz[:, 0] < box[2]) & (xyz[:, 1] >= box[1]) & (xyz[:, 1] < box[3])
    np.testing.assert_array_equal(window.record, np.flatnonzero(inside))
    assert window.record.dtype == np.int64 and len(window.cloud) == inside.sum()
    np.testing.assert_array_equal(window.cloud.classification, np.asarray(las.classification)[inside])
    np.testing.assert_array_equal(window.cloud.withheld, np.asarray(las.withheld)[inside])
    if not inside.any():
        return
    np.testing.assert_allclose(window.cloud.coordinates(), xyz[inside], atol=2**-10 / window.cloud.units.z)
    cut = jf.read(path, bounds=box, **options)
    assert cut.xyz.tobytes() == window.cloud.xyz.tobytes() and cut.origin.tobytes() == window.cloud.origin.tobytes()
    for name in COLUMNS:
        np.testing.assert_array_equal(getattr(window.cloud, name), getattr(cut, name))
    assert window.cloud.crs == cut.crs and window.cloud.units == cut.units


def boxes_of(bounds, seed=0, n=6):
    """Boxes of all sizes in and around bounds, among them all of it, corners, and some that touch nothing."""
    rng = np.random.default_rng(seed)
    low, size = np.array(bounds[:2]), np.array(bounds[2:]) - bounds[:2]
    found = [tuple(np.concatenate([low - size, low + 2 * size])), tuple(np.concatenate([low, low + size / 7]))]
    found += [tuple(np.concatenate([low + 2 * size, low + 3 * size])), tuple(np.concatenate([low - size, low]))]
    for _ in range(n):
        a = low + rng.uniform(-0.2, 1.0, 2) * size
        found.append(tuple(np.concatenate([a, a + rng.uniform(0.01, 0.6, 2) * size])))
    return found


@pytest.mark.parametrize("point_format", [0, 1, 2, 3, 6, 7, 8])
@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_windows_of_every_point_format(tmp_path, monkeypatch, point_format, suffix):
    monkeypatch.setattr(points, "RUN_LENGTH", 100)
    path = tmp_path / f"in{suffix}"
    make_las(path, point_format, n=1500, extra=True)
    source = source_of(path)
    for box in boxes_of(source.bounds):
        assert_is_mask(read_window(source, box), path, box)


@pytest.mark.parametrize("make", [make_copc, lambda path: make_deep_copc(path, 4, 30)], ids=["cube", "flat"])
def test_windows_of_copc(tmp_path, make):
    path = tmp_path / "in.copc.laz"
    make(path)
    source = source_of(path)
    assert source.format == "copc"
    for box in boxes_of(source.bounds):
        assert_is_mask(read_window(source, box), path, box)


def test_windows_of_real_tiles(data, tmp_path):
    for name in ("lff_2_67.laz", "lidR_Topography.laz", "geo1101_Delft_manual.las", "ign_77050_627755.laz"):
        path = data / "tiles" / name
        source = source_of(path)
        for box in boxes_of(source.bounds, n=2)[1:]:
            assert_is_mask(read_window(source, box), path, box)


def test_points_on_borders_belong_to_one_box(tmp_path):
    """A lattice of boxes whose borders go through points: every point is in one window, by integers and scales that
    floating point does not hold exactly."""
    path = tmp_path / "in.laz"
    rng = np.random.default_rng(1)
    make_las(path, 6, n=900, X=rng.integers(0, 30, 900) * 10, Y=rng.integers(0, 30, 900) * 10)
    source = source_of(path)
    xs, ys = (np.arange(31) * 10 * SCALES[axis] + OFFSETS[axis] for axis in (0, 1))
    boxes = [(xs[i], ys[j], xs[i + 3], ys[j + 3]) for i in range(0, 28, 3) for j in range(0, 28, 3)]
    found = [read_window(source, box) for box in boxes]
    np.testing.assert_array_equal(np.sort(np.concatenate([w.record for w in found])), np.arange(900))
    assert max(len(w.record) for w in found) < 100


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.copc.laz"])
def test_a_whole_file_is_read_once(tmp_path, monkeypatch, name):
    """Without a box, or with one that holds it: no pass over the file, and the points of ``read``."""
    path = tmp_path / name
    make_copc(path) if "copc" in name else make_las(path, 6, n=3000)
    source = source_of(path, units="m")
    monkeypatch.setattr(reading.LasFile, "runs", None)
    plain = jf.read(path, units="m")
    low, high = np.array(source.bounds[:2]), np.array(source.bounds[2:])
    for box in (None, tuple(np.concatenate([low, high + 0.001]))):
        window = read_window(source, box)
        np.testing.assert_array_equal(window.record, np.arange(len(plain)))
        assert window.cloud.xyz.tobytes() == plain.xyz.tobytes()
    monkeypatch.undo()
    part = read_window(source, (*low, *(low + 30)))
    assert len(part.record) < len(plain)
    assert read_window(source, None).cloud.xyz.tobytes() == plain.xyz.tobytes()


def test_windows_of_text(tmp_path, monkeypatch):
    """Read once for all boxes, and the points of ``read``."""
    path, rng = tmp_path / "in.csv", np.random.default_rng(1)
    xyz = rng.uniform((X, Y, 0), (X + 100, Y + 80, 20), (500, 3)).round(2)
    classes = rng.integers(0, 8, 500)
    lines = [f"{x:.2f},{y:.2f},{z:.2f},{c}" for (x, y, z), c in zip(xyz, classes, strict=True)]
    path.write_text("\n".join(["x,y,z,class", *lines]) + "\n")
    source = describe_file(path, Stated(Units()))
    assert source.format == "text" and source.count == 500 and source.crs is None
    assert source.bounds == (*xyz[:, :2].min(axis=0), *xyz[:, :2].max(axis=0))
    assert source.z == (xyz[:, 2].min(), xyz[:, 2].max())
    monkeypatch.setattr("jaxfilter.files.text._split", None)
    for box in (None, *boxes_of(source.bounds)):
        window, lag = read_window(source, box, reading=Reading(ignore_classes=(3,))), (0 if box is None else 1)
        monkeypatch.undo()
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            cut = jf.read(path, bounds=box, ignore_classes=(3,))
        x, y = xyz[:, 0], xyz[:, 1]
        inside = np.ones(500, bool) if not lag else (x >= box[0]) & (x < box[2]) & (y >= box[1]) & (y < box[3])
        np.testing.assert_array_equal(window.record, np.flatnonzero(inside))
        assert window.cloud.xyz.tobytes() == cut.xyz.tobytes() and window.cloud.units == cut.units
        np.testing.assert_array_equal(window.cloud.classification, classes[inside])
        np.testing.assert_array_equal(window.cloud.candidate, cut.candidate)
        monkeypatch.setattr("jaxfilter.files.text._split", None)
    monkeypatch.undo()
    path.write_text(path.read_text().replace(lines[7], lines[7].replace(f"{xyz[7, 2]:.2f}", "nan")))
    with pytest.raises(jf.InputError, match=r"in\.csv: the file has changed since the collection was opened"):
        read_window(source)
    with pytest.raises(jf.InputError, match=r"in\.csv: line 9: z is nan"):
        read_window(describe_file(path))
    assert len(read_window(describe_file(path), reading=Reading(drop_invalid=True)).cloud) == 500


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.copc.laz", "in.csv"])
@pytest.mark.parametrize("bounds", [None, (X + 10, Y + 10, X + 60, Y + 70)])
@pytest.mark.parametrize("suffix", [".laz", ".csv"])
def test_a_file_is_written_without_its_cloud(tmp_path, name, bounds, suffix):
    """The same bytes as by its cloud."""
    path = tmp_path / name
    if name == "in.csv":
        make_las(tmp_path / "all.las", 6, n=400)
        xyz, las = whole(tmp_path / "all.las")
        kinds = np.stack([las.classification, las.return_number], axis=1).tolist()
        lines = [f"{x:.3f},{y:.3f},{z:.3f},{c},{r}" for (x, y, z), (c, r) in zip(xyz, kinds, strict=True)]
        path.write_text("\n".join(["x,y,z,class,return_number", *lines]) + "\n")
    else:
        make_copc(path) if "copc" in name else make_las(path, 6, n=400)
    source = describe_file(path, Stated(Units()))
    window = read_window(source, bounds)
    ground = np.arange(len(window.cloud)) % 2 == 0
    write_cloud(tmp_path / f"one{suffix}", window.cloud, ground)
    stand_in = file_cloud(source, window.cloud.candidate, bounds=bounds)
    write_cloud(target := tmp_path / f"two{suffix}", stand_in, ground)
    if suffix == ".csv" or name != "in.csv" or bounds is None:
        assert target.read_bytes() == (tmp_path / f"one{suffix}").read_bytes()
    else:  # offsets are those of the whole file
        for axis in ("x", "y", "z", "classification", "return_number"):
            np.testing.assert_array_equal(whole(target)[1][axis], whole(tmp_path / f"one{suffix}")[1][axis])


def test_feet_and_options_as_in_read(tmp_path):
    path = tmp_path / "in.las"
    make_las(path, 6, n=400, crs=2225)  # US survey feet
    source, box = source_of(path), (X + 10, Y + 10, X + 60, Y + 70)
    assert source.metre == pytest.approx(1200 / 3937)
    options = {"returns": "first", "ignore_classes": (3,), "keep_withheld": True, "anchor": (X, Y)}
    window, cut = read_window(source, box, reading=Reading(**options)), jf.read(path, bounds=box, **options)
    assert window.cloud.xyz.tobytes() == cut.xyz.tobytes()
    np.testing.assert_array_equal(window.cloud.candidate, cut.candidate)
    np.testing.assert_array_equal(window.cloud.anchor, (X, Y))
    assert_is_mask(read_window(source_of(path, units="m"), box), path, box, units="m")


@pytest.mark.parametrize("name", ["in.las", "in.laz"])
def test_the_pass_is_made_once(tmp_path, monkeypatch, name):
    """As long as the file is the same."""
    path, passes, measure = tmp_path / name, [], reading.measure
    monkeypatch.setattr(reading, "measure", lambda header: passes.append(1) or measure(header))
    for seed in (0, 1):
        make_las(path, 6, n=1000, seed=seed)
        for box in ((X, Y, X + 50, Y + 50), (X + 50, Y, X + 80, Y + 50)):
            assert_is_mask(read_window(source_of(path), box), path, box)
    assert len(passes) == 2


@pytest.mark.parametrize("name, n", [("in.las", 500), ("in.laz", 500), ("in.las", 60_000), ("in.laz", 120_000)])
def test_points_that_the_header_denies(tmp_path, name, n):
    """Points decide, in every way that a header can be wrong: none, a part of it, far away, not a number."""
    path = tmp_path / name
    make_las(path, 6, n=n)
    xyz, _ = whole(path)
    true = (*xyz[:, :2].min(axis=0), *xyz[:, :2].max(axis=0))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert describe_file(path, points=True).bounds == pytest.approx(true, abs=1e-9)
    x1, x0, *rest = struct.unpack_from("<6d", path.read_bytes(), 179)
    for wrong in ((x0 + 50, x0), (x1, 0.0), (0.0,) * 6, (1e308, -1e308), (np.nan, x0), (x0, x1)):
        patch(path, "6d", 179, *wrong, *(x1, x0, *rest)[len(wrong) :])
        with pytest.warns(jf.JaxfilterWarning, match=r"in\.la.: its header states the extent .*: their extent is used"):
            source = describe_file(path, points=True)
        assert source.bounds == pytest.approx(true, abs=1e-9)
    assert len(read_window(source, (X, Y, X + 1000, Y + 1000)).record) == n


def test_points_at_one_place_are_no_contradiction(tmp_path):
    las_of(tmp_path / "in.las", np.ones((50, 3)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert describe_file(tmp_path / "in.las", points=True).bounds == (1.0, 1.0, 1.0, 1.0)


def test_a_file_that_changes_is_refused(tmp_path):
    path = tmp_path / "in.laz"
    make_las(path, 6, n=500)
    source, box = source_of(path), (X, Y, X + 50, Y + 50)
    read_window(source, box)
    make_las(path, 6, n=500, seed=1)
    with pytest.raises(jf.InputError, match=r"in\.laz: the file has changed since the collection was opened"):
        read_window(source, box)
    path.unlink()
    with pytest.raises(jf.InputError, match="no such file"):
        read_window(source, box)


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_corner_costs_a_corner(tmp_path, monkeypatch, suffix):
    """Scan lines of 200,000 points: a hundredth of the area at the end of the file is a few runs of them."""
    monkeypatch.setattr(points, "RUN_LENGTH", 1024)
    path, n = tmp_path / f"in{suffix}", 200_000
    row, column = np.divmod(np.arange(n), 400)
    las_of(path, np.column_stack([X + column / 4, Y + row / 5, np.zeros(n)]), scales=SCALES, offsets=OFFSETS)
    source = source_of(path, units="m")
    x1, y1 = source.bounds[2:]
    box = (x1 - 10, y1 - 10, x1 + 1, y1 + 1)
    read_window(source, box)
    counted, pieces = [], points.pieces
    monkeypatch.setattr(points, "pieces", lambda *a: counted.append(a[3]) or pieces(*a))
    window = read_window(source, box)
    assert len(window.record) == 41 * 51
    assert sum(counted) <= path.stat().st_size * (0.13 if suffix == ".las" else 0.26)
