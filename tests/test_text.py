"""Text: cells are those that a CSV reader sees, and rewriting changes label cells and no other cell. Comments are not kept."""

from __future__ import annotations

import csv
import itertools
import math
import re
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from las_files import Effort

from jaxfilter.core.errors import InputError, JaxfilterWarning
from jaxfilter.files import text
from jaxfilter.files.reading import read, write
from jaxfilter.reports.info import info

EVERY = {"returns": "all", "ignore_classes": (), "keep_withheld": True, "units": "m"}  # all points are candidates


def rewrite(folder, content, ground, name="in.csv", **options):
    """The cloud of a text, and the bytes that writing it with these labels gives."""
    source, target = folder / name, folder / f"out{Path(name).suffix}"
    source.write_bytes(content if isinstance(content, bytes) else content.encode())
    cloud = read(source, **options)
    write(target, cloud, np.asarray(ground(cloud) if callable(ground) else ground, bool), overwrite=True)
    return cloud, target.read_bytes()


# any file, made cell by cell


WORDS = ["oak", "caf\xe9", "\u9805\udcff", "5'", '6"', "b#7", "1_000", "nan", "1.5", "\\"]
QUOTED = ["oak, old", "a;b", "a b", "a\tb", '5"" pipe', '""', '"",1,""', "#1", " ", "", "7", "caf\udce9, \udc85"]
NAMES = {"word": ["intensity", '"a, b"', "h\udcf6he"], "label": ["label", '"Label"'], "x": ["X", "x"],
         "class": ["class", "Classification"]}  # fmt: skip


def cells_of(content, delimiter):
    """The cells of all lines, by another reader."""
    lines = csv.reader(content.split("\n")[:-1], delimiter=delimiter, skipinitialspace=True)
    return [[cell.strip(" \t") for cell in line] for line in lines]


@settings(max_examples=150, deadline=None, derandomize=True, database=None)
@given(drawn=st.data(), cut=st.booleans())
def test_only_labels_change(drawn, cut):
    pick = lambda values: drawn.draw(st.sampled_from(values))  # noqa: E731
    delimiter, labels = pick([",", ";", "\t", " "]), pick([[], ["label"], ["class"], ["label", "class"]])
    columns = drawn.draw(st.permutations(["x", "y", "z", *labels, *pick([[], ["word"], ["word", "word", "withheld"]])]))
    words = [*WORDS, *(f'"{word}"' for word in QUOTED), *["", "old oak", 'say "a"'] * (delimiter != " ")]

    def cell(name):
        if name == "word":
            return pick(words)
        if name in "xyz":
            value = pick(["{:.2f}", "{:+.3f}", "{:.8e}", "{:.12G}"]).format(drawn.draw(st.integers(-999, 5000)) / 100)
        else:
            value = pick(["0", "1", "1.0", "0e3", *["2", "5", "+18"] * (name == "class")])
        return pick(["{}", '"{}"']).format(value)

    rows = [[cell(name) for name in columns] for _ in range(drawn.draw(st.integers(1, 10)))]
    header = [pick(NAMES.get(name, [name])) for name in columns]
    content = "".join(delimiter.join(line) + pick(["\n", "\r\n"]) for line in (header, *rows))
    names, *before = cells_of(content, delimiter)
    points = np.array([[float(row[columns.index(axis)]) for axis in "xyz"] for row in before])
    kept, bounds = np.ones(len(points), bool), None
    if cut:
        x, y = np.median(points[:, :2], axis=0)
        kept, bounds = (points[:, 0] >= x) & (points[:, 1] < y), (x, -math.inf, math.inf, y)
    ground = np.random.default_rng(len(content)).random(int(kept.sum())) < 0.5
    expected = [names if labels else [*names, "label"]]
    for row, is_ground in zip(itertools.compress(before, kept), ground.tolist(), strict=True):
        old = int(float(row[columns.index("class")])) if "class" in labels else 0
        new = {"label": f"{not is_ground:d}", "class": str(2 if is_ground else 1 if old in (0, 2) else old)}
        found = [new.get(name, value) for name, value in zip(columns, row, strict=True)]
        expected.append(found if labels else [*found, new["label"]])
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*holds no points")
        folder = Path(folder)
        given = content.encode("utf-8", "surrogateescape")
        cloud, written = rewrite(folder, given, ground, bounds=bounds, **EVERY)
        again = read(folder / "out.csv", **EVERY)
    assert cells_of(written.decode("utf-8", "surrogateescape"), delimiter) == expected
    np.testing.assert_allclose(cloud.coordinates(), points[kept], atol=5e-4)
    assert again.xyz.tobytes() == cloud.xyz.tobytes() and again.origin.tolist() == cloud.origin.tolist()
    assert (np.zeros(len(cloud), bool) if again.reference is None else again.reference).tolist() == ground.tolist()


@pytest.mark.parametrize("content, expected", [
    ("1.50 2 3\n4 5.0 6", "1.50 2 3 0\n4 5.0 6 1\n"),
    ("# made by hand\n\n1.50 2 3\n# half way\n \t\n4 5.0 6\n", "1.50 2 3 0\n4 5.0 6 1\n"),
    ("# a\n" * 5000 + "1.50 2 3\n4 5 6\n", "1.50 2 3 0\n4 5 6 1\n"),
    ("# X Y Z\n1.50 2 3\n4 5 6\n", "#X Y Z label\n1.50 2 3 0\n4 5 6 1\n"),
    ("1.5 2 3\r4 5 6\r", "1.5 2 3 0\n4 5 6 1\n"),
    ("1.5\t2\t3\t1\r\n4.00\t5\t6\t0\r\n", "1.5\t2\t3\t0\r\n4.00\t5\t6\t1\r\n"),
    ("//X Y Z\n1.50 2 3\n4 5 6\n", "//X Y Z label\n1.50 2 3 0\n4 5 6 1\n"),
    ("x,y,z\n1.50,2,3\n4,5,6\n", "x,y,z,label\n1.50,2,3,0\n4,5,6,1\n"),
    ('"name";"X";"Y";"Z"\na;1.50;2;3\nb;4;5;6\n', 'name;X;Y;Z;label\na;1.50;2;3;0\nb;4;5;6;1\n'),
    ("x,label,y,z\n1.50,1,2,3\n4,1,5,6\n", "x,label,y,z\n1.50,0,2,3\n4,1,5,6\n"),
    ("\ufeffx\ty\tz\n1.50\t2\t3\n4\t5\t6\n", "\ufeffx\ty\tz\tlabel\n1.50\t2\t3\t0\n4\t5\t6\t1\n"),
    ("X;Y;Z;Classification\n1.50;2;3;5\n4;5;6;2\n", "X;Y;Z;Classification\n1.50;2;3;2\n4;5;6;1\n"),
    ('name,x,y,z,label\n"oak, old",1.5,2,3,1\n"5"" pipe",4,5,6,1\n',
     'name,x,y,z,label\n"oak, old",1.5,2,3,0\n"5"" pipe",4,5,6,1\n'),
    ("tree name\tx\ty\tz\told oak\n\t1.5\t2\t3\t\nan ash\t4\t5\t6\t\n",
     "tree name\tx\ty\tz\told oak\tlabel\n\t1.5\t2\t3\t\t0\nan ash\t4\t5\t6\t\t1\n"),
    ("x\ty\tz\ta, b\n1.50\t2\t3\toak, old\n4\t5\t6\tash\n", "x\ty\tz\ta, b\tlabel\n1.50\t2\t3\toak, old\t0\n4\t5\t6\tash\t1\n"),
    ("x y z label note\n1.5 2 3 1 a\u00a0b\n4 5 6 1 #7\n", "x y z label note\n1.5 2 3 0 a\u00a0b\n4 5 6 1 #7\n"),
    ("x, y, z, note\n1.50, 2, 3, a;b\n4, 5, 6, \"c, d\"\n", "x,y,z,note,label\n1.50,2,3,a;b,0\n4,5,6,\"c, d\",1\n"),
    ("  1.50   2\t3 \r\n  4  5 6\r\n", "1.50 2 3 0\r\n4 5 6 1\r\n"),
    ('x y z n\n1.5 2 3 "a b"\n4 5 6 ""\n', '"x" "y" "z" "n" "label"\n"1.5" "2" "3" "a b" "0"\n"4" "5" "6" "" "1"\n'),
    ('n;x;y;z\n"#1";1.5;2;3\n"c";4;5;6\n', '"n";"x";"y";"z";"label"\n"#1";"1.5";"2";"3";"0"\n"c";"4";"5";"6";"1"\n'),
])  # fmt: skip
def test_layouts(tmp_path, content, expected):
    cloud, written = rewrite(tmp_path, content, [True, False])
    np.testing.assert_array_equal(cloud.coordinates(), [[1.5, 2, 3], [4, 5, 6]])
    assert written == expected.encode()


def test_attributes(tmp_path):
    (tmp_path / "in.csv").write_text(
        "Return Number,NumberOfReturns,x,y,z,class,withheld,overlap\n"
        "1,1,0,0,0,1,0,1\n1,2,1,0,0,2,0,0\n2,2,2,0,0,2,1,1\n1,1,3,0,0,18,0,0\n"
    )
    cloud = read(tmp_path / "in.csv")
    assert cloud.return_number.tolist() == [1, 1, 2, 1] and cloud.number_of_returns.tolist() == [1, 2, 2, 1]
    assert cloud.candidate.tolist() == [True, False, False, False]
    assert read(tmp_path / "in.csv", returns="all", keep_withheld=True, ignore_classes=()).candidate.all()
    assert cloud.overlap.tolist() == cloud.in_overlap.tolist() == [True, False, True, False]
    assert not read(tmp_path / "in.csv", ignore_overlap=True).candidate.any()
    assert cloud.reference.tolist() == [False, True, True, False] and cloud.classification.tolist() == [1, 2, 2, 18]


# numbers


@pytest.mark.parametrize("delimiter", [";", " "])
def test_numbers_are_those_of_python(tmp_path, delimiter):
    rng = np.random.default_rng(5)
    values = rng.uniform(-1, 1, 300) * 10.0 ** rng.integers(-6, 7, 300)
    cells = [repr(v) for v in values.tolist()] + ["1E+05", "+.5", "5.", "-0", "00012.50", "1e-400", "1e0005", "9" * 30]
    (tmp_path / "in.xyz").write_text("".join(delimiter.join(["0", cell, "0"]) + "\n" for cell in cells))
    together = text.open_text(tmp_path / "in.xyz").xyz
    np.testing.assert_array_max_ulp(together[:, 1], np.array(list(map(float, cells))), 1)


@pytest.mark.parametrize("cell", [
    "1_000", "0x10", "0x1p3", "1d5", "1D5", "1e", ".", "", "NA", "None", "True", "--1", "1 234", "1'234", "1,234.5", "1,5",
    "1.2.3", "1f", "(1)", "nan(1)", "1\u00a0", "\u0661", "1#2", '"1,5"', '"1 234"', '""', "1?5",
])  # fmt: skip
def test_what_is_no_number(tmp_path, cell):
    """As the label of all lines, and as z of the last; other parsers take some of these, pandas True throughout."""
    for name, lines in (("label", [f"1;2;3;{cell}"] * 2), ("z", ["1;2;3;0", f"1;2;{cell};0"])):
        (tmp_path / "in.csv").write_text("\n".join(["x;y;z;label", *lines]))
        line, shown = 2 if name == "label" else 3, re.escape(repr(cell.strip('"')))
        with pytest.raises(InputError, match=f"in.csv: line {line}: {name} is {shown}, not a number"):
            read(tmp_path / "in.csv", drop_invalid=True)


@pytest.mark.parametrize("token", ["nan", "NaN", "-nan", "inf", "-Infinity", "1e400"])
def test_coordinates_that_are_not_finite(tmp_path, token):
    content = f"0 0 0\n1 {token} 0\n2 2 2\n3 0 {token}\n"
    (tmp_path / "in.xyz").write_text(content)
    value = f"{float(token):g}"
    with pytest.raises(InputError, match=f"in.xyz: line 2: y is {value}; .*drop_invalid=True"):
        read(tmp_path / "in.xyz")
    with pytest.raises(InputError, match=f"line 2: y is {value}"):  # who knows where it is
        read(tmp_path / "in.xyz", bounds=(0, 0, 3, 3))
    (tmp_path / "in.xyz").write_text(content.replace(f"1 {token}", "1 1"))
    assert len(read(tmp_path / "in.xyz", bounds=(0, 0, 3, 3))) == 3
    with pytest.raises(InputError, match=f"line 4: z is {value}"):
        read(tmp_path / "in.xyz", bounds=(0, 0, 4, 3))
    with pytest.warns(JaxfilterWarning, match="2 points with NaN"):
        _, written = rewrite(tmp_path, content, lambda cloud: cloud.candidate, "in.xyz", drop_invalid=True)
    assert written.decode() == f"0 0 0 0\n1 {token} 0 1\n2 2 2 0\n3 0 {token} 1\n"


# refused


NAMED = "x,y,z,label\n1,2,3,0\n"


@pytest.mark.parametrize("content, message", [
    ("1 2 3\n4 five 6\n", "line 2: y is 'five', not a number"),
    ("1 2 3\n4 5\n", "line 2 has 2 columns, .*4 5.* and line 1 has 3"),
    ("a,b,c\n1,2,3\n", "line 1, .* names no columns x, y and z"),
    ("1 2 3 4 5\n", "line 1, .*1 2 3 4 5.*, holds no point"), ("1;2,3\n", "line 1, .*, holds no point"),
    ("1 2\n", "line 1, .*, holds no point"), ("hello\nworld\n", "line 2, .*world.*, holds no point"),
    ("x,y,z\na,b,c\n", "line 2, .* names no columns"), ("word\n" * 2000 + "1 2 3\n", "line 2000, .* names no columns"),
    ("1 2 3 7\n", "line 1: label is 7; whole numbers from 0 to 1"), ("1 2 3 0\n\n1 2 3 nan\n", "line 3: label is nan"),
    ("x,y,z,class\n1,2,3,300\n", "classification is 300"), ("x,y,z,return_number\n1,2,3,1.5\n", "return_number is 1.5"),
    ("\x00\x01\x02" * 500, "zero bytes"), (NAMED + "1,2,3,0\n\x1a", "line 4 has 1 columns"),
    (NAMED + '1,2,3,"0\r"\n', "line 3 has 0 columns"), (NAMED + "1,2,\x003,0\n", "zero bytes"),
    ("\ufeff1 2 3\n".encode("utf-16-le"), "UTF-16"), ("9" * 2_000_000 + "x", "line 1, .*, holds no point"),
    # decimal commas, rows of another width than the names, comments behind cells
    (NAMED + "1,5,2,5,3,5,0\n", "line 3 has 7 columns, .*1,5,2,5,3,5,0.*, and line 1 has 4: .*decimals with a point"),
    ("x,y,z\n1,5,2,5,3,5\n", "line 2 has 6 columns, .* and line 1 has 3.*decimals with a point"),
    ("1,5 2,5 3,5\n", "line 1: y is '5 2', not a number; write decimals with a point"),
    ("x;y;z\n1,5;2,5;3,5\n", "line 2: x is '1,5', not a number; write decimals with a point"),
    ('x;y;z\n"1,5";"2,5";"3,5"\n', "line 2: x is '1,5', not a number"),
    (NAMED + "1,2,3\n", "line 3 has 3 columns, .* line 1 has 4"),
    ("x y z\n1 512 540 30\n", "line 2 has 4 columns, .* line 1 has 3"),
    (NAMED + "1,2,3,0,\n", "line 3 has 5"),
    ("# columns: x y z class\n1 2 3 1\n", "line 2 has 4 columns, .* and line 1 has 5: .*comments lines of their own"),
    ("1 2 3\n4 5 6 # tree\n", "line 2 has 5 columns, .*4 5 6 # tree.*give comments lines of their own"),
    ("1,2,3 # tree\n", "line 1: z is '3 # tree', not a number"), (NAMED + "1,2,3,0 # tree\n", "label is '0 # tree'"),
    ("1;2;3\n1,2,3\n", "line 2 has 1 columns, .* line 1 has 3"),
    # quotes
    ('n,x,y,z\n"oak,\nold",1,2,3\n', "line 2, .* names no columns"),
    ('n,x,y,z\na,1,2,3\n"oak,\nold",1,2,3\n', "line 3 has 0 columns"),
    ('x,y,z,n\n1,2,3, "a" b\n', "line 2 has 0 columns, .*quotes"),
    ('x y z n\n1 2 3 a\n1 2 3 "a\n', "line 3 has 0 columns"),
    ("x,y,z,n\n1,2,3,'a,b'\n", "line 2 has 5 columns, .* line 1 has 4.*around cells that hold commas"),
    # names
    ("x,y,z,class,classification\n1,2,3,1,2\n", "line 1: two columns name the classification"),
    ("# X Y Z x\n1 2 3 1\n", "line 1: two columns name the x"),
    ('x,y,z,"Number of Returns",NumReturns\n1,2,3,1,2\n', "two columns name the number of returns"),
])  # fmt: skip
def test_refused(tmp_path, content, message):
    path = tmp_path / "in.txt"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with Effort() as effort, pytest.raises(InputError, match=message) as caught:
        read(path)
    assert str(path) in str(caught.value) and len(str(caught.value)) < 500
    assert effort.calls < 100_000 and effort.peak < 20e6
    with pytest.raises(InputError):
        info(path)


@pytest.mark.parametrize("line", [
    ",".join(["x"] * 40_000), "x,y,z," + " " * 100_000 + "a", "1,2,3," + "9" * 100_000 + "x", ',"a' * 40_000, '"' * 100_001,
    "x y z " + '" ' * 40_000, "1;2;3;" + " \t" * 40_000 + '"',
])  # fmt: skip
def test_long_lines_take_no_longer(tmp_path, line):
    """A search that went back and forth in such a line would take hundreds of seconds, and there is nothing to count."""
    (tmp_path / "in.txt").write_text(4 * line + "\n1,2,3,4\n" + 4 * line + "\n")
    began = time.process_time()
    with pytest.raises(InputError):
        read(tmp_path / "in.txt")
    assert time.process_time() - began < 60


# nothing in it


@pytest.mark.parametrize("content, expected", [
    ("", ""), ("\n\n", ""), ("# nothing yet\n\n", ""), ("\ufeff", ""), ("# x,y,z", "#x,y,z,label\n"),
    ("x,y,z\n", "x,y,z,label\n"), ("# by hand\nx y z label", "x y z label\n"), ("#\n" * 3000, ""),
])  # fmt: skip
def test_no_points(tmp_path, content, expected):
    with pytest.warns(JaxfilterWarning, match="in.csv: holds no points"):
        cloud, written = rewrite(tmp_path, content, [])
    assert len(cloud) == 0 and written == expected.encode()
    with pytest.warns(JaxfilterWarning, match="holds no points"):
        assert len(read(tmp_path / "out.csv")) == 0
    with pytest.warns(JaxfilterWarning, match="holds no points"):
        assert info(tmp_path / "in.csv")["bounds"] is None
