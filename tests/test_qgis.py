"""The plugin of QGIS: its declarations against the command, how it runs the command, and all of it in a real QGIS."""

import ast
import configparser
import contextlib
import importlib
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
import types
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path
from unittest import mock

import click
import geopandas
import laspy
import numpy as np
import pytest
import rasterio
import shapely

import jaxfilter as jf
from jaxfilter.cli import main
from jaxfilter.cli.session import Session
from jaxfilter.files.writing import EXTRAS
from jaxfilter.terrain.layers import LAYERS

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "qgis" / "jaxfilter_provider"
sys.path.insert(0, str(FOLDER.parent))

from jaxfilter_provider import algorithms, command  # noqa: E402

BY_NAME = {one.name: one for one in algorithms.ALGORITHMS}
CHOICES = {"methods": list(jf.FILTERS), "layers": list(LAYERS), "extras": list(EXTRAS)}
COMMAND = shutil.which("jaxfilter", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}")


def options(name):
    """The options of a command, or skip."""
    if name not in main.commands:
        pytest.skip(f"this jaxfilter has no command {name}")
    found = main.commands[name]
    with found.make_context(name, ["--json", "x", "y"], resilient_parsing=True) as context:
        return {flag: one for one in context.command.params for flag in one.opts if flag.startswith("-")}


@pytest.mark.parametrize("name", list(BY_NAME))
def test_every_flag_is_one_of_the_command_with_the_same_default(name):
    known = options(name)
    assert "--progress-every" in known
    for parameter in BY_NAME[name].parameters:
        flag = next((word for word in parameter.words.split() if word.startswith("--")), None)
        if flag is None or parameter.name == "METHOD":
            continue
        assert flag in known, f"{parameter.name}: {name} has no {flag}"
        theirs, value = known[flag].default, parameter.default
        theirs = theirs[0] if isinstance(theirs, tuple) and len(theirs) == 1 else theirs
        theirs = theirs if isinstance(theirs, (int, float, str)) else None
        assert (value or None) in (theirs or None, "as the CRS says"), parameter.name
        assert known[flag].is_flag != ("{}" in parameter.words or parameter.name == "CLASSIFIED")
        if isinstance(known[flag].type, click.Choice):
            assert list(parameter.choices) == list(known[flag].type.choices)


def test_choices_are_those_of_the_library():
    assert [*CHOICES.values()] == [algorithms.METHODS, algorithms.LAYERS, algorithms.EXTRAS], (
        "to make them anew: python tests/test_qgis.py"
    )


@pytest.mark.parametrize("name, values, line", [
    ("ground", {"INPUT": ["/a b/1.laz", "/2.laz"], "OUTPUT": "/out/"}, "ground '/a b/1.laz' /2.laz /out/"),
    ("ground", {"FOLDER": "/in", "METHOD": "smrf", "OUTPUT": "/t/", "OUTPUT_FILE": "/o.laz", "REVIEW": "/p.gpkg"},
     "ground smrf --for-cloud /in /o.laz --review /p.gpkg"),
    ("ground",
     {"INPUT": ["/1"], "METHOD": "default", "EXTRA": ["doubt", "height"], "GROUND_CLASS": 2, "OTHER_CLASS": 3}
     | {"OVERWRITE": True, "RESUME": False, "LOAD": True, "MORE": '--bounds 1 2 3 4 --work "a b"', "OUTPUT": "/o/"}
     | {"CRS": "EPSG:25832", "UNITS": "as the CRS says", "RETURNS": "last,only", "NOISE_CLASS": 0}
     | {"WATER_CLASS": 9, "BRIDGE_CLASS": 17, "BREAKLINES": "/w.gpkg"},
     "ground /1 /o/ --extra doubt --extra height --other-class 3 --noise-class 0 --water-class 9 --bridge-class 17 "
     "--crs EPSG:25832 --overwrite --bounds 1 2 3 4 --work 'a b' --breaklines /w.gpkg"),
    ("products", {"INPUT": ["/1"], "METHOD": "csf", "ONLY": ["dtm", "chm"], "CELL": 0.5, "CELL_UNITS": "m", "OUTPUT": "/o/"},
     "products /1 /o/ --filter csf --for-cloud --only dtm,chm --cell 0.5 --cell-units m"),
    ("products", {"INPUT": ["/1"], "CLASSIFIED": True, "CELL": 1.0, "OUTPUT": "/o/"}, "products /1 /o/ --ground-class 2"),
    ("products", {"INPUT": ["/1"], "ONLY": [""], "MEMORY": "", "OUTPUT": "/o/"}, "products /1 /o/"),  # of widgets
    ("ground", {"INPUT": ["/1"], "EXTRA": [""], "MORE": "", "OUTPUT": "/o/"}, "ground /1 /o/"),
    ("review", {"INPUT": ["/1"], "GROUND_CLASS": 8, "OUTPUT": "/p.gpkg"}, "review /1 /p.gpkg --ground-class 8"),
    ("apply", {"PLACES": "/p.gpkg", "FOLDER": "/in"}, "apply /p.gpkg /in"),
    ("accuracy", {"INPUT": ["/1"], "MODEL": "/d.tif", "CHECKPOINTS": "/c.csv", "OUTPUT": "/o.html"},
     "accuracy /1 /d.tif /o.html --checkpoints /c.csv"),
])  # fmt: skip
def test_parameters_make_the_words_of_a_command_line(name, values, line):
    assert algorithms.command_line(BY_NAME[name], values) == shlex.split(line)


def test_further_options_are_split_as_on_the_command_line_of_the_system(monkeypatch):
    more = algorithms.Parameter("MORE", "words", "")
    said = r'--aoi "C:\a b\new.gpkg" --log=C:\x.txt --units "m"'
    monkeypatch.setattr(algorithms, "os", types.SimpleNamespace(name="nt"))
    assert algorithms.words(more, said) == ["--aoi", r"C:\a b\new.gpkg", r"--log=C:\x.txt", "--units", "m"]
    monkeypatch.setattr(algorithms, "os", types.SimpleNamespace(name="posix"))
    assert algorithms.words(more, r"--aoi /a\ b.gpkg --log 'c # d'") == ["--aoi", "/a b.gpkg", "--log", "c # d"]


def test_a_crs_of_the_user_has_no_code_that_others_know(monkeypatch):
    """Of QGIS there is only what the module needs to be loaded."""
    core = mock.MagicMock(QgsProcessingProvider=object, QgsProcessingAlgorithm=object)
    core.QgsProcessingLayerPostProcessorInterface = object
    parts = "processing processing.core processing.core.ProcessingConfig qgis qgis.PyQt qgis.PyQt.QtGui"
    for part in parts.split():
        monkeypatch.setitem(sys.modules, part, mock.MagicMock(core=core))
    monkeypatch.delitem(sys.modules, "jaxfilter_provider.provider", raising=False)
    provider = importlib.import_module("jaxfilter_provider.provider")
    monkeypatch.delitem(sys.modules, "jaxfilter_provider.provider")
    stated = next(one for one in BY_NAME["ground"].parameters if one.kind == "crs")
    for code, word in (("EPSG:25832", "EPSG:25832"), ("USER:100001", "PROJCS[...]"), ("", "PROJCS[...]")):
        crs = mock.Mock(**{"authid.return_value": code, "toWkt.return_value": "PROJCS[...]"})
        self = mock.Mock(**{"parameterAsCrs.return_value": crs})
        assert provider.Command._value(self, stated, {"CRS": code}, None) == word


def test_a_message_names_the_label_of_a_flag():
    said = algorithms.in_labels(BY_NAME["ground"], "x exists: pass --overwrite; see --reset and --tile-size")
    assert said == 'x exists: pass --overwrite (here: "Replace what exists"); see --reset and --tile-size'


class Feedback:
    """That of QGIS, as far as it is used."""

    def __init__(self, stop=""):
        self.stop, self.said, self.share = stop, [], None

    def isCanceled(self):
        return bool(self.stop) and any(self.stop in text for _, text in self.said)

    def setProgress(self, share):
        self.share = share

    def __getattr__(self, name):
        return lambda text: self.said.append((name, text))


def python(code):
    """The command line of some Python."""
    return [sys.executable, "-c", code]


def test_what_the_command_says_is_sorted():
    code = """import sys
print("densify 3 of 7: 42 %, 1.2 M points/s, 3 s left, 1 GB", file=sys.stderr)
print("warning: \\u00fc", file=sys.stderr); print("in.laz: 50 % of 2 points")"""
    feedback = Feedback()
    assert command.run(python(code), feedback)
    assert feedback.share == 42.0
    assert [name for name, _ in feedback.said] == ["setProgressText", "pushWarning", "pushConsoleInfo"]
    assert feedback.said[1][1] == "warning: ü"


def test_a_line_of_progress_of_the_command_is_understood(capsys):
    with Session(quiet=False, debug=False, progress_every=0) as session, session.step("run", 1e6):
        session.progress(0.42, "densify", "3 of 7", rate=1.2e6)
    (line,) = capsys.readouterr().err.splitlines()
    feedback = Feedback()
    command.tell(line, feedback)
    assert feedback.share == 42.0 and feedback.said == [("setProgressText", line)]


@pytest.mark.parametrize("code, words", [
    (
        "import sys; print('Usage: x'); print('Error: a.laz: no\\nfile', file=sys.stderr); sys.exit(2)",
        "a.laz: no\nfile",
    ),
    ("import sys; print('warning: one was left out'); sys.exit(1)", "warning: one was left out"),
    ("import sys; sys.exit(3)", "it ended with code 3 and said nothing"),
    ("import sys; sys.exit('Error: No such option: --progress-every')", "in a new copy of it, run pip install ."),
])  # fmt: skip
def test_an_error_is_that_of_the_command(code, words):
    with pytest.raises(command.CommandError) as error:
        command.run(python(code), Feedback())
    assert str(error.value).endswith(words)


def test_a_cancelled_command_may_clean_up_and_has_ended(tmp_path):
    code = f"""import signal, sys, time, pathlib
def stop(*_):
    time.sleep(0.5); pathlib.Path({str(tmp_path / "cleaned")!r}).touch(); sys.exit(143)
signal.signal(signal.SIGTERM, stop)
print("begun", flush=True)
while True: time.sleep(0.1)"""
    begun = time.perf_counter()
    assert command.run(python(code), Feedback("begun")) is False
    assert (tmp_path / "cleaned").exists() and time.perf_counter() - begun < 30


def test_variables_of_qgis_are_kept_from_the_command(monkeypatch):
    for name in command.OF_QGIS:
        monkeypatch.setenv(name, "/of/qgis")
    monkeypatch.setenv("OF_THE_USER", "kept")
    feedback = Feedback()
    assert command.run(
        python("import os; print(sorted(v for v in os.environ.values() if v in ('/of/qgis', 'kept')))"), feedback
    )
    assert feedback.said == [("pushConsoleInfo", "['kept']")]


def test_the_command_is_found_by_its_setting_or_path_and_else_pip_is_named(tmp_path, monkeypatch):
    program = tmp_path / "environment" / "bin" / "jaxfilter"
    program.parent.mkdir(parents=True)
    program.write_text("#!/bin/sh\n")
    program.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setattr("site.getuserbase", lambda: str(tmp_path / "user"))
    for setting in (program, program.parent, tmp_path / "environment"):
        assert command.find(f" {setting} ") == str(program)
    for setting in ("", tmp_path / "elsewhere"):
        with pytest.raises(command.CommandError, match=r"pip install \.") as error:
            command.find(str(setting))
        assert str(setting) in str(error.value)
    monkeypatch.setenv("PATH", str(program.parent))
    assert command.find() == str(program)
    scripts = tmp_path / "user" / "Python313" / "Scripts"  # pip install --user on Windows
    scripts.mkdir(parents=True)
    program = program.rename(scripts / "jaxfilter")
    assert command.find() == str(program)
    with pytest.raises(command.CommandError, match="cannot be started"):
        command.run([str(tmp_path / "none")], Feedback())


def test_the_plugin_says_of_itself_what_is_true(tmp_path):
    parser = configparser.ConfigParser()
    parser.read(FOLDER / "metadata.txt", encoding="utf-8")
    about = dict(parser["general"])
    asked = "name qgisMinimumVersion description about version author license icon tags"
    assert all(about.get(name.lower()) for name in asked.split())
    assert about["version"] == jf.__version__ and about["qgisminimumversion"] == "3.22"
    assert about["hasprocessingprovider"] == "yes"
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert about["author"] == project["authors"][0]["name"] and about["license"] == project["license"]
    links = {about[name] for name in ("homepage", "repository", "tracker") if name in about}
    assert links <= set(project.get("urls", {}).values()), "addresses are those of the project"
    assert (FOLDER / "LICENSE").read_bytes() == (ROOT / "LICENSE").read_bytes()
    for drawing in [FOLDER / about["icon"], *FOLDER.glob("styles/*.qml")]:
        ET.parse(drawing)
    for name in BY_NAME:
        text = (FOLDER / "help" / f"{name}.html").read_text()
        ET.fromstring(f"<html>{text}</html>")
    done = subprocess.run([sys.executable, "-m", "zipfile", "-c", tmp_path / "plugin.zip", FOLDER])
    assert done.returncode == 0
    with zipfile.ZipFile(tmp_path / "plugin.zip") as archive:
        names = archive.namelist()
    assert {f"{FOLDER.name}/{name}" for name in ("metadata.txt", "__init__.py", "styles/places.qml")} <= set(names)
    assert {name.split("/")[0] for name in names} == {FOLDER.name}


def test_the_plugin_runs_in_the_python_of_qgis_and_does_not_import_the_library():
    paths = list(FOLDER.glob("*.py"))
    assert sum(len(path.read_text().splitlines()) for path in paths) <= 500
    for path in paths:
        tree = ast.parse(path.read_text(), feature_version=(3, 9))
        names = {
            name.name.split(".")[0] for node in ast.walk(tree) if isinstance(node, ast.Import) for name in node.names
        }
        names |= {n.module.split(".")[0] for n in ast.walk(tree) if isinstance(n, ast.ImportFrom) and not n.level}
        assert names <= {*sys.stdlib_module_names, "qgis", "processing"}, path


# In a real QGIS

PROCESS = shutil.which("qgis_process.bin") or shutil.which(
    "qgis_process"
)  # Debian's script of 3.22 passes a wrong option
PYTHON = "/usr/bin/python3"


@pytest.fixture(scope="module")
def qgis(tmp_path_factory):
    """Environment variables for a QGIS with a profile of its own, in which the plugin is on."""
    if PROCESS is None or COMMAND is None:
        pytest.skip(f"there is no {'qgis_process' if PROCESS is None else 'installed jaxfilter'}: apt-get install qgis")
    folder = tmp_path_factory.mktemp("profile")
    venv = str(Path(sys.executable).parent)  # whose Python is not that of QGIS
    path = os.pathsep.join(one for one in os.environ["PATH"].split(os.pathsep) if one != venv)
    added = {"QT_QPA_PLATFORM": "offscreen", "QGIS_CUSTOM_CONFIG_PATH": folder, "QGIS_PLUGINPATH": FOLDER.parent}
    added |= {"PATH": path, "XDG_RUNTIME_DIR": folder, "QGIS_PROCESSING": "/usr/share/qgis/python/plugins"}
    environment = {**os.environ, **{name: str(value) for name, value in added.items()}}
    environment.pop("VIRTUAL_ENV", None)
    settings = folder / "profiles/default/QGIS/QGIS3.ini"
    settings.parent.mkdir(parents=True)

    def set_command(path):
        settings.write_text(
            f"[PythonPlugins]\njaxfilter_provider=true\n[Processing]\nConfiguration\\JAXFILTER_COMMAND={path}\n"
        )
        return environment

    return set_command


def process(qgis, *words, path=COMMAND):
    """qgis_process, with the path of the command."""
    return subprocess.run([PROCESS, *map(str, words)], env=qgis(path), capture_output=True, text=True, timeout=300)


def run_algorithm(qgis, name, path=COMMAND, **parameters):
    """An algorithm by qgis_process: exit code, results, and what it says."""
    words = [
        f"{key}={one}" for key, value in parameters.items() for one in (value if isinstance(value, list) else [value])
    ]
    done = process(qgis, "--json", "run", f"jaxfilter:{name}", "--", *words, path=path)
    results = {}
    with contextlib.suppress(ValueError):
        results = json.loads(done.stdout[done.stdout.index("{") :])["results"]
    return done.returncode, results, done.stdout + done.stderr


def in_qgis(qgis, function, *arguments):
    """What a function of in_qgis.py finds."""
    if subprocess.run([PYTHON, "-c", "import qgis.core"], env=qgis(COMMAND), capture_output=True).returncode:
        pytest.skip(f"{PYTHON} is not the Python of QGIS")
    done = subprocess.run(
        [PYTHON, ROOT / "tests" / "in_qgis.py", function, COMMAND, *arguments],
        env=qgis(COMMAND), capture_output=True, text=True, timeout=500,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout + done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    """Two folders with two files of steep ground under trees: raw, without classes, and known, with the true ground."""
    folder = tmp_path_factory.mktemp("survey")
    for number, name in enumerate("ab"):
        scene = jf.scenes.make("canopy", size=(60, 80), density=1.3, seed=4 + number)
        moved = scene.cloud.coordinates() + [60.0 * number, 0.0, 0.0]
        cloud = jf.PointCloud.from_arrays(moved, crs="EPSG:25832")
        for kind, labels in (("raw", np.zeros(len(cloud), bool)), ("known", scene.truth)):
            (folder / kind).mkdir(exist_ok=True)
            jf.write(folder / kind / f"{name}.laz", cloud, labels)
    return folder


def classes(path):
    return np.asarray(laspy.read(path).classification)


def test_qgis_lists_every_algorithm_with_its_help(qgis):
    listed = process(qgis, "list").stdout
    for name, declared in BY_NAME.items():
        assert re.search(rf"jaxfilter:{name}\s+{declared.title}\n", listed), listed[-2000:]
    told = process(qgis, "help", "jaxfilter:ground").stdout
    assert "verdict" in told and all(f"\n{one.name}: {one.label}" in told for one in BY_NAME["ground"].parameters)


def test_ground_in_qgis_is_that_of_the_command(qgis, survey, tmp_path):
    files = [survey / "raw" / "a.laz", survey / "raw" / "b.laz"]
    code, results, said = run_algorithm(
        qgis, "ground", INPUT=files, METHOD="fptd", OUTPUT=tmp_path / "out", REVIEW=tmp_path / "places.gpkg"
    )
    assert code == 0, said
    assert Path(results["OUTPUT"]) == tmp_path / "out" and results["REVIEW"] == str(tmp_path / "places.gpkg")
    subprocess.run([COMMAND, "ground", "fptd", "--for-cloud", *files, f"{tmp_path / 'other'}/"], check=True)
    for file in files:
        found = classes(tmp_path / "out" / file.name)
        assert np.array_equal(found, classes(tmp_path / "other" / file.name)) and 0.1 < np.mean(found == 2) < 1
    code, _, said = run_algorithm(qgis, "ground", INPUT=files, METHOD="fptd", OUTPUT=tmp_path / "out")
    assert code == 1 and "is not empty" in said and 'pass --overwrite (here: "Replace what exists")' in said, said


def test_products_in_qgis_are_those_of_the_command(qgis, survey, tmp_path):
    water = tmp_path / "water.gpkg"
    code, results, said = run_algorithm(
        qgis,
        "products",
        FOLDER=survey / "known",
        CLASSIFIED="true",
        ONLY="dtm,hillshade",
        OUTPUT=tmp_path / "p",
        BREAKLINES=water,
    )
    assert code == 0 and results["BREAKLINES"] == str(water) and water.exists(), said
    assert results["DTM"] == str(tmp_path / "p" / "dtm.tif") and Path(results["PAGE"]).exists()
    subprocess.run([COMMAND, "dtm", survey / "known", tmp_path / "dtm.tif"], check=True)
    with rasterio.open(results["DTM"]) as one, rasterio.open(tmp_path / "dtm.tif") as other:
        np.testing.assert_array_equal(one.read(), other.read())
    assert not (tmp_path / "p" / "chm.tif").exists()


def test_an_error_in_qgis_is_that_of_the_command(qgis, tmp_path):
    (tmp_path / "broken.laz").write_bytes(b"no points")
    code, _, said = run_algorithm(qgis, "ground", FOLDER=tmp_path / "broken.laz", OUTPUT=tmp_path / "out")
    assert code == 1 and "broken.laz" in said and "Traceback" not in said, said
    assert not list(tmp_path.glob("out/*"))
    code, _, said = run_algorithm(qgis, "ground", OUTPUT=tmp_path / "out")
    assert code == 1 and "Name the points" in said, said


def test_a_missing_command_is_told_in_qgis_with_the_line_of_pip(qgis, survey, tmp_path):
    code, _, said = run_algorithm(
        qgis, "ground", path=tmp_path / "nowhere", FOLDER=survey / "raw", OUTPUT=tmp_path / "out"
    )
    assert code == 1 and "pip install ." in said and "Traceback" not in said, said
    assert "Settings > Options > Processing" in said and not (tmp_path / "out").exists()


def test_a_run_that_is_cancelled_in_qgis_leaves_nothing(qgis, survey, tmp_path):
    found = in_qgis(qgis, "cancel", survey / "raw", tmp_path / "out")
    assert found["shown"] and found["canceled"] and found["results"] == {}, found
    assert not list(tmp_path.rglob("*.laz"))
    running = subprocess.run(["ps", "-eo", "args"], capture_output=True, text=True).stdout
    assert str(tmp_path) not in running


def test_layers_of_the_project_are_taken_and_results_are_loaded_with_styles(qgis, survey, tmp_path):
    found = in_qgis(qgis, "layers", survey / "raw", tmp_path)
    layers = found["layers"]
    assert {"my area", "dtm", "hillshade"} < set(layers), found["log"]
    inside = laspy.read(tmp_path / "part" / "a.laz")
    assert len(inside) > 0 and inside.x.max() <= 512040 and inside.y.max() <= 5403060
    assert (
        layers["hillshade"]["renderer"] == "singlebandgray" and layers["hillshade"]["blend"] == 13
    )  # QPainter: multiply
    (places,) = (one for one in layers.values() if "places.gpkg" in one["source"])
    assert places["renderer"] == "RuleRenderer" and places["sort"] == '"rank"' and places["label"] == "rank"
    assert places["drawn"] and set(places["drawn"]) == {1}, "each place by one rule"


def test_a_layer_without_a_file_or_with_edits_is_refused(qgis, tmp_path):
    frame = geopandas.GeoDataFrame(
        {"rank": [1], "verdict": ["fine"]}, geometry=[shapely.box(0, 0, 9, 9)], crs="EPSG:25832"
    )
    frame.to_file(tmp_path / "places.gpkg", layer="review")
    edited, memory = in_qgis(qgis, "edits", tmp_path / "places.gpkg")
    assert "my places has edits that are not saved" in edited and "in memory has no file" in memory


def test_classes_have_colours_on_a_point_cloud(qgis, survey, tmp_path):
    las = laspy.read(survey / "known" / "a.laz")
    _write_ept(tmp_path / "ept", np.column_stack([las.x, las.y, las.z]), np.asarray(las.classification))
    found = in_qgis(qgis, "points", tmp_path / "ept" / "ept.json")
    assert found["valid"] and found["type"] == "classified"
    assert set(map(str, np.unique(las.classification))) <= set(found["categories"])
    assert found["categories"]["2"] != found["categories"]["1"]


def _write_ept(folder, xyz, kinds):
    """Points as an Entwine Point Tile of one node, which QGIS reads without PDAL."""
    low, high, offset = xyz.min(axis=0), xyz.max(axis=0), np.floor(xyz.min(axis=0))
    schema = [
        {"name": name, "type": "signed", "size": 4, "scale": 0.001, "offset": off, "minimum": least, "maximum": most}
        | {"mean": least, "stddev": 1, "variance": 1, "count": len(xyz)}
        for name, off, least, most in zip("XYZ", offset.tolist(), low.tolist(), high.tolist(), strict=True)
    ]
    counts = [{"value": int(one), "count": int((kinds == one).sum())} for one in np.unique(kinds)]
    schema.append({"name": "Classification", "type": "unsigned", "size": 1, "counts": counts, "count": len(xyz)})
    rows = np.zeros(len(xyz), [("X", "<i4"), ("Y", "<i4"), ("Z", "<i4"), ("Classification", "u1")])
    for k, name in enumerate("XYZ"):
        rows[name] = np.round((xyz[:, k] - offset[k]) / 0.001)
    rows["Classification"] = kinds
    middle, half = (low + high) / 2, (high - low).max() / 2 + 1
    about = {"bounds": [*(middle - half), *(middle + half)], "boundsConforming": [*low, *high], "dataType": "binary"}
    about |= {"hierarchyType": "json", "points": len(xyz), "schema": schema, "span": 256, "srs": {}, "version": "1.0.0"}
    for name, content in (
        ("ept-data/0-0-0-0.bin", rows.tobytes()),
        ("ept-hierarchy/0-0-0-0.json", json.dumps({"0-0-0-0": len(xyz)}).encode()),
        ("ept-sources/list.json", b"[]"),
        ("ept.json", json.dumps(about).encode()),
    ):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(content)


def test_places_are_listed_carried_out_and_stated_in_qgis(qgis, survey, tmp_path):
    """One after the other, as people do it."""
    for name in ("review", "apply", "accuracy"):
        options(name)
    shutil.copytree(survey / "known", tmp_path / "known")
    places = tmp_path / "places.gpkg"
    code, results, said = run_algorithm(qgis, "review", FOLDER=tmp_path / "known", OUTPUT=places)
    assert code == 0 and results["OUTPUT"] == str(places), said
    frame = geopandas.read_file(places)
    las = laspy.read(tmp_path / "known" / "a.laz")
    ground = np.asarray(las.classification) == 2
    x, y = np.asarray(las.x), np.asarray(las.y)
    middle = np.argmin(np.hypot(x - x.mean(), y - y.mean()) + 1e6 * ~ground)
    box = shapely.Point(x[middle], y[middle]).buffer(8)
    row = {name: (frame[name].iloc[0] if len(frame) else None) for name in frame.columns if name != "geometry"}
    decided = geopandas.GeoDataFrame([row | {"rank": 1, "verdict": "bridge"}], geometry=[box], crs="EPSG:25832")
    decided.to_file(tmp_path / "decided.gpkg", layer="review")
    before = (tmp_path / "known" / "b.laz").read_bytes()
    code, _, said = run_algorithm(qgis, "apply", PLACES=tmp_path / "decided.gpkg", FOLDER=tmp_path / "known")
    assert code == 0, said
    inside = shapely.intersects_xy(box, x, y)
    assert (ground & inside).any() and not (classes(tmp_path / "known" / "a.laz")[inside] == 2).any()
    assert (tmp_path / "known" / "b.laz").read_bytes() == before
    subprocess.run([COMMAND, "dtm", tmp_path / "known", tmp_path / "dtm.tif"], check=True)
    page = tmp_path / "statement.html"
    code, results, said = run_algorithm(
        qgis, "accuracy", FOLDER=tmp_path / "known", MODEL=tmp_path / "dtm.tif", OUTPUT=page
    )
    assert code == 0 and results["OUTPUT"] == str(page), said
    assert page.exists() and json.loads(page.with_suffix(".json").read_text())


if __name__ == "__main__":
    (FOLDER / "choices.json").write_text(json.dumps(CHOICES, indent=1) + "\n")
