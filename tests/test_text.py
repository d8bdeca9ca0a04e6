"""Text: cells are those that a CSV reader sees, and rewriting changes label cells, no other cell, and no comment."""

from __future__ import annotations

import csv
import dataclasses
import io
import math
import re
import time
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from las_files import Effort

from jaxfilter.core.errors import InputError, JaxfilterWarning
from jaxfilter.files import text
from jaxfilter.files.reading import info, read, write

EVERY = {"returns": "all", "ignore_classes": (), "keep_withheld": True, "units": "m"}  # all points are candidates


def rewrite(folder, content, ground, name="in.csv", **options):
    """The cloud of a text, and the bytes that writing it with these labels gives."""
    source, target = folder / name, folder / f"out{Path(name).suffix}"
    source.write_bytes(content if isinstance(content, bytes) else content.encode())
    cloud = read(source, **options)
    write(target, cloud, np.asarray(ground(cloud) if callable(ground) else ground, bool), overwrite=True)
    return cloud, target.read_bytes()


# any file, made cell by cell


@dataclasses.dataclass
class Cell:
    name: str
    before: bytes
    core: bytes
    after: bytes

    def __bytes__(self):
        return self.before + self.core + self.after


@dataclasses.dataclass
class Line:
    """``cells`` is None for a comment or blank line, whose bytes are ``lead``; ``separators`` follow all cells but one."""

    cells: list[Cell] | None
    lead: bytes
    separators: list[bytes]
    tail: bytes
    ending: bytes
    is_header: bool = False

    def __bytes__(self):
        if self.cells is None:
            return self.lead + self.ending
        cells = b"".join(map(bytes.__add__, map(bytes, self.cells), [*self.separators, b""]))
        return self.lead + cells + self.tail + self.ending


COMMENTS = [b"#", b"# half way", b'  # 1,2,3 "', b"#;,\t\xff", b'\t#"', b"# x and y", b"", b"  ", b" \t"]
WORDS = [b"oak", b"caf\xc3\xa9", b"\xe9\xa0\x85\xff", b"5'", b'6"', b"b#7", b"1_000", b"nan", b"1.5", b"\\"]
QUOTED = [b"oak, old", b"a;b", b"a b", b"a\tb", b'5"" pipe', b'""', b'"",1,""', b"#1", b" ", b"",
          b"7", b"caf\xe9, \x85"]  # fmt: skip
NAMES = {"word": [b"intensity", b'"a, b"', b"h\xf6he"], "label": [b"label", b'"Label"'], "x": [b"X", b"x"],
         "class": [b"class", b"Classification"]}  # fmt: skip


@st.composite
def files(draw):
    """Lines, the delimiter that their layout should have, and the names of their columns."""
    pick = lambda values: draw(st.sampled_from(values))  # noqa: E731
    written, named = pick([b",", b";", b"\t", None]), draw(st.booleans())
    delimiter = None if written == b"\t" and not named else written
    columns = ["x", "y", "z"]
    if named:
        extra = draw(st.lists(st.sampled_from(["word", "word", "withheld"]), max_size=3))
        extra = [name for i, name in enumerate(extra) if name == "word" or name not in extra[:i]]
        columns = draw(st.permutations(columns + pick([[], ["label"], ["class"], ["label", "class"]]) + extra))
    elif draw(st.booleans()):
        columns.append("label")
    pads = [b""] if delimiter is None else [b"", b"", b" ", b"  "]
    separators = [b" ", b"  ", b"\t", b" \t"] if written is None else [written]
    endings = pick([[b"\n"], [b"\r\n"], [b"\n", b"\r\n"]])
    decimals = pick([0, 2, 3])

    def cell(name):
        if name == "word" and draw(st.booleans()):
            return Cell(name, pick(pads) + b'"', pick(QUOTED), b'"' + pick(pads))
        if name == "word":
            words = WORDS + [b"", b"old oak", b'say "a"'] * (written is not None)
            return Cell(name, pick(pads), pick(words), pick(pads))
        if name in "xyz":
            value = draw(st.integers(-999, 5000)) / 10**decimals
            core = pick([f"{value:.{decimals}f}", f"{value:+.{decimals}f}", f"{value:.8e}", f"{value:.12G}"]).encode()
        else:
            core = pick([b"0", b"1", b"1.0", b"0e3"] + [b"2", b"5", b"+18"] * (name == "class"))
        quote = pick([b"", b"", b'"'])
        return Cell(name, pick(pads) + quote, core, quote + pick(pads))

    def comments(most):
        return [Line(None, pick(COMMENTS), [], b"", pick(endings)) for _ in range(draw(st.integers(0, most)))]

    lines = comments(2)
    if named:
        cells = [Cell(name, b"", pick(NAMES.get(name, [name.encode()])), b"") for name in columns]
        between = [b" " if written is None else written] * (len(columns) - 1)  # tabs throughout would make tabs count
        lines.append(Line(cells, pick([b"", b"//", b"# ", b"#"]), between, b"", pick(endings), True))
    for _ in range(draw(st.integers(1, 10))):
        cells, between = [cell(name) for name in columns], [pick(separators) for _ in columns[1:]]
        blank = [b"", b"", b" "] if delimiter is None else [b""]
        lines += [*comments(1), Line(cells, pick(blank), between, pick(blank), pick(endings))]
    lines += comments(1)
    if draw(st.booleans()):
        lines[-1].ending = b""
    return lines, delimiter, columns


def plain(cell):
    """What a cell holds."""
    core = cell.core.replace(b'""', b'"') if cell.before.strip() else cell.core
    return core.decode("utf-8", "surrogateescape").strip(" \t")


def cells_of(line, delimiter):
    """Cells of a line of output, by another reader."""
    text = line.decode("utf-8", "surrogateescape").rstrip("\r\n")
    if delimiter is None:
        found = re.findall(r'"((?:[^"]|"")*)"(?=[ \t]|$)|([^ \t]+)', text)
        return [(quoted.replace('""', '"') or other).strip(" \t") for quoted, other in found]
    [cells] = csv.reader([text], delimiter=delimiter.decode(), skipinitialspace=True)
    return [cell.strip(" \t") for cell in cells]


@settings(max_examples=60, deadline=None, derandomize=True, database=None)
@given(
    made=files(), mark=st.booleans(), cut=st.booleans(), block=st.sampled_from([1, 50, 10**6]), seed=st.integers(0, 9)
)
def test_only_labels_change(made, mark, cut, block, seed):
    lines, delimiter, columns = made
    points = np.array([[float(c.core) for n in "xyz" for c in line.cells if c.name == n]
                       for line in lines if line.cells and not line.is_header])  # fmt: skip
    kept, bounds = np.ones(len(points), bool), None
    if cut:
        x, y = np.median(points[:, :2], axis=0)
        kept, bounds = (points[:, 0] >= x) & (points[:, 1] < y), (x, -math.inf, math.inf, y)
    ground = np.random.default_rng(seed).random(int(kept.sum())) < 0.5
    replaced = {"label", "class"} & set(columns)
    expected, row, labels = [], -1, iter(ground.tolist())
    for line in lines:
        values = None if line.cells is None or line.is_header else [plain(c) for c in line.cells]
        if values is None:
            more = line.is_header and not replaced
            expected.append((bytes(dataclasses.replace(line, ending=b"")), more, line.ending))
            continue
        row += 1
        if kept[row]:
            is_ground = next(labels)
            for i, name in enumerate(columns):
                old = int(float(values[i])) if name == "class" else 0
                new = 2 if is_ground else 1 if old in (0, 2) else old
                values[i] = {"label": f"{not is_ground:d}", "class": str(new)}.get(name, values[i])
            expected.append((values if replaced else [*values, f"{not is_ground:d}"], False, line.ending))
    start = b"\xef\xbb\xbf" * mark
    with TemporaryDirectory() as folder, mock.patch.object(text, "_BLOCK", block), warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".*holds no points")
        folder = Path(folder)
        cloud, written = rewrite(folder, start + b"".join(map(bytes, lines)), ground, bounds=bounds, **EVERY)
        assert written.startswith(start)
        out = io.BytesIO(written[len(start) :]).readlines()
        expected = [one for one in expected if one[0] or one[2]]  # a last line without bytes is none
        for line, (known, more, ending) in zip(out, expected, strict=True):
            assert line.endswith(ending) and (ending or not line.endswith(b"\n"))
            if isinstance(known, bytes):
                added = [b" label", b"\tlabel"] if delimiter is None else [delimiter + b"label"]
                assert line[: len(line) - len(ending)] in ([known + end for end in added] if more else [known])
            else:
                assert cells_of(line, delimiter) == known
        np.testing.assert_allclose(cloud.coordinates(), points[kept], atol=5e-4)
        again = read(folder / "out.csv", **EVERY)
    assert again.xyz.tobytes() == cloud.xyz.tobytes() and again.origin.tolist() == cloud.origin.tolist()
    assert (np.zeros(len(cloud), bool) if again.reference is None else again.reference).tolist() == ground.tolist()
    if delimiter is not None:  # Python's reader sees the same cells
        given = [line for line in lines if line.cells and not line.is_header]
        for point, line in zip(points, given, strict=True):
            cells = cells_of(bytes(line), delimiter)
            assert [float(cells[columns.index(axis)]) for axis in "xyz"] == point.tolist() and len(cells) == len(
                columns
            )


@pytest.mark.parametrize("content, expected", [
    ("1.50 2 3\n4 5.0 6", "1.50 2 3 0\n4 5.0 6 1"),
    ("# made by hand\n\n1.50 2 3\n# half way\n4 5.0 6\n", "# made by hand\n\n1.50 2 3 0\n# half way\n4 5.0 6 1\n"),
    ("# a\n" * 5000 + "1.50 2 3\n4 5 6\n", "# a\n" * 5000 + "1.50 2 3 0\n4 5 6 1\n"),
    ("1.5\t2\t3\t1\r\n4.00\t5\t6\t0\r\n", "1.5\t2\t3\t0\r\n4.00\t5\t6\t1\r\n"),
    ("//X Y Z\n1.50 2 3\n4 5 6\n", "//X Y Z label\n1.50 2 3 0\n4 5 6 1\n"),
    ("x,y,z\n1.50,2,3\n4,5,6\n", "x,y,z,label\n1.50,2,3,0\n4,5,6,1\n"),
    ('"name";"X";"Y";"Z"\na;1.50;2;3\nb;4;5;6\n', '"name";"X";"Y";"Z";label\na;1.50;2;3;0\nb;4;5;6;1\n'),
    ("x,label,y,z\n1.50,1,2,3\n4,1,5,6\n", "x,label,y,z\n1.50,0,2,3\n4,1,5,6\n"),
    ("\ufeffx\ty\tz\n1.50\t2\t3\n4\t5\t6\n", "\ufeffx\ty\tz\tlabel\n1.50\t2\t3\t0\n4\t5\t6\t1\n"),
    ("X;Y;Z;Classification\n1.50;2;3;5\n4;5;6;2\n", "X;Y;Z;Classification\n1.50;2;3;2\n4;5;6;1\n"),
    ('name,x,y,z,label\n"oak, old",1.5,2,3,1\n"5"" pipe",4,5,6,1\n',
     'name,x,y,z,label\n"oak, old",1.5,2,3,0\n5" pipe,4,5,6,1\n'),
    ("tree name\tx\ty\tz\told oak\n\t1.5\t2\t3\t\nan ash\t4\t5\t6\t\n",
     "tree name\tx\ty\tz\told oak\tlabel\n\t1.5\t2\t3\t\t0\nan ash\t4\t5\t6\t\t1\n"),
    ("x y z label note\n1.5 2 3 1 a\u00a0b\n4 5 6 1 #7\n", "x y z label note\n1.5 2 3 0 a\u00a0b\n4 5 6 1 #7\n"),
    ("x, y, z, note\n1.50, 2, 3, a;b\n4, 5, 6, \"c, d\"\n", "x, y, z, note,label\n1.50,2,3,a;b,0\n4,5,6,\"c, d\",1\n"),
    ("  1.50   2\t3 \n  4  5 6\r\n", "1.50\t2\t3\t0\n4\t5\t6\t1\r\n"),
    ('x y z n\n1.5 2 3 "a b"\n4 5 6 ""\n', 'x y z n label\n1.5 2 3 "a b" 0\n4 5 6 "" 1\n'),
    ('x;y;z;n\n1.5;2;3;"#1"\n4;5;6;"c"\n', 'x;y;z;n;label\n1.5;2;3;"#1";0\n4;5;6;c;1\n'),
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
    """Alone (each cell in Python) and together (by pandas) they are the same."""
    rng = np.random.default_rng(5)
    values = rng.uniform(-1, 1, 300) * 10.0 ** rng.integers(-6, 7, 300)
    cells = [repr(v) for v in values.tolist()] + ["1E+05", "+.5", "5.", "-0", "00012.50", "1e-400", "1e0005", "9" * 30]
    (tmp_path / "in.xyz").write_text("".join(delimiter.join(["0", cell, "0"]) + "\n" for cell in cells))
    layout = text.layout_of(tmp_path / "in.xyz")
    read_values = np.concatenate([xyz for xyz, _ in text.read_text(layout)])
    np.testing.assert_array_max_ulp(read_values[:, 1], np.array(list(map(float, cells))), 1)
    with mock.patch("pandas.read_csv", side_effect=ValueError):
        np.testing.assert_array_max_ulp(next(text.read_text(layout))[0], read_values, 1)


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
    ("1 2 3\n4 5\n", "line 1 has 3 columns, line 2 has 2, '4 5'"),
    ("a,b,c\n1,2,3\n", "line 1, 'a,b,c', names no columns x, y and z"),
    ("1 2 3 4 5\n", "5 columns without names"), ("1;2,3\n", "columns without names|no line holds"),
    ("1 2\n", "no line holds three numbers"), ("hello\nworld\n", "no line holds three numbers"),
    ("x,y,z\na,b,c\n", "no line holds three numbers"), ("word\n" * 2000 + "1 2 3\n", "no line holds three numbers"),
    ("1 2 3 7\n", r"line 1: label 7: whole numbers, 0 \(ground\) or 1"), ("1 2 3 0\n\n1 2 3 nan\n", "line 3: label nan"),
    ("x,y,z,class\n1,2,3,300\n", "classification 300"), ("x,y,z,return_number\n1,2,3,1.5\n", "return_number 1.5"),
    ("\x00\x01\x02" * 500, "no line holds three numbers"), (NAMED + "1,2,3\x0b,0\n", "line 3 holds the control character 0x0b"),
    (NAMED + "1,2,3,0\n\x1a", "line 4 holds the control character 0x1a"),
    (NAMED + '1,2,3,"0\r"\n', "line 3 holds the control character 0x0d"), ("1 2 3\r4 5 6\r", "carriage returns alone"),
    (NAMED + "1,2,\x003,0\n", "control character 0x00"),
    ("\ufeff1 2 3\n".encode("utf-16-le"), "UTF-16"), ("9" * 2_000_000 + "x", "line 1 has more than 1000000 bytes"),
    # decimal commas, rows of another width than the names, comments behind cells
    (NAMED + "1,5,2,5,3,5,0\n", "line 1 has 4 columns, line 3 has 7, '1,5,2,5,3,5,0'; .*decimals with a point"),
    ("x,y,z\n1,5,2,5,3,5\n", "line 1 names 3 columns, line 2 has 6.*decimals with a point"),
    ("1,5 2,5 3,5\n", "line 1: y is '5 2', not a number; write decimals with a point"),
    ("x;y;z\n1,5;2,5;3,5\n", "line 2: x is '1,5', not a number; write decimals with a point"),
    ('x;y;z\n"1,5";"2,5";"3,5"\n', "line 2: x is '1,5', not a number"),
    (NAMED + "1,2,3\n", "line 1 has 4 columns, line 3 has 3"), ("x y z\n1 512 540 30\n", "line 1 names 3 columns, line 2 has 4"),
    (NAMED + "1,2,3,0,\n", "line 3 has 5"), ("# columns: x y z class\n1 2 3 1\n", "line 1 names 5 columns .*mere comment"),
    ("1 2 3\n4 5 6 # tree\n", "line 2 has 5, '4 5 6 # tree'.*give comments lines of their own"),
    ("1,2,3 # tree\n", "line 1: z is '3 # tree', not a number"), (NAMED + "1,2,3,0 # tree\n", "label is '0 # tree'"),
    ("1;2;3\n1,2,3\n", "line 1 has 3 columns, line 2 has 1"),
    # quotes
    ('n,x,y,z\n"oak,\nold",1,2,3\n', r"line 2 cannot be split .*line breaks out|no columns"),
    ('n,x,y,z\na,1,2,3\n"oak,\nold",1,2,3\n', "line 3 cannot be split .*line breaks out"),
    ('x,y,z,n\n1,2,3, "a" b\n', "line 2 cannot be split"),
    ('x y z n\n1 2 3 a\n1 2 3 "a\n', "line 3 cannot be split"),
    ("x,y,z,n\n1,2,3,'a,b'\n", "line 1 names 4 columns, line 2 has 5.*put quotes around cells that hold commas"),
    # names
    ("x,y,z,class,classification\n1,2,3,1,2\n", "line 1: the columns 'class' and 'classification' both name the classification"),
    ("# X Y Z x\n1 2 3 1\n", "line 1: the columns 'X' and 'x' both name the x"),
    ('x,y,z,"Number of Returns",NumReturns\n1,2,3,1,2\n', "'Number of Returns' and 'NumReturns' both name the number of returns"),
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
    ("", ""), ("\n\n", "\n\n"), ("# nothing yet\n\n", "# nothing yet\n\n"), ("\ufeff", "\ufeff"), ("# x,y,z", "# x,y,z"),
    ("x,y,z\n", "x,y,z,label\n"), ("# by hand\nx y z label", "# by hand\nx y z label"), ("#\n" * 3000, "#\n" * 3000),
])  # fmt: skip
def test_no_points(tmp_path, content, expected):
    with pytest.warns(JaxfilterWarning, match="in.csv: holds no points"):
        cloud, written = rewrite(tmp_path, content, [])
    assert len(cloud) == 0 and written == expected.encode()
    with pytest.warns(JaxfilterWarning, match="holds no points"):
        assert len(read(tmp_path / "out.csv")) == 0
    with pytest.warns(JaxfilterWarning, match="holds no points"):
        assert info(tmp_path / "in.csv")["bounds"] is None
