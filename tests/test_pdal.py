"""Pipelines of PDAL as filters and command lines, and the arrays that its Python package gives."""

import itertools
import json
import shlex
import types

import numpy as np
import pytest
from click.testing import CliRunner

import jaxfilter as jf
from jaxfilter.cli import flags, main
from jaxfilter.core.cloud import as_cloud
from jaxfilter.pdal import STAGES, translate

FOOT = 0.3048
# defaults in PDAL's sources (SMRFilter.cpp, PMFFilter.cpp, CSFilter.cpp), where filters.csf has the step of 0.3 m as a constant
DEFAULTS = {
    "filters.smrf": {"cell": 1.0, "slope": 0.15, "window": 18.0, "scalar": 1.25, "threshold": 0.5, "cut": 0.0},
    "filters.pmf": {
        "cell_size": 1.0, "exponential": True, "initial_distance": 0.15, "max_distance": 2.5, "max_window_size": 33.0,
        "slope": 1.0,
    },
    "filters.csf": {
        "resolution": 1.0, "threshold": 0.5, "rigidness": 3, "smooth": True, "step": 0.65, "iterations": 500, "hdiff": 0.3,
    },
}  # fmt: skip


@pytest.fixture
def pipeline(tmp_path):
    def write(*stages):
        path = tmp_path / "pipeline.json"
        path.write_text(json.dumps({"pipeline": list(stages)}))
        return path

    return write


@pytest.mark.parametrize("stage", list(STAGES))
def test_defaults_are_those_of_pdal(stage):
    found = jf.from_pdal({"type": stage})
    options = STAGES[stage].options
    assert {name: getattr(found, options[name].field) for name in options} == DEFAULTS[stage]
    assert jf.from_pdal({"type": stage, **{k: str(v).lower() for k, v in DEFAULTS[stage].items()}}) == found


def test_the_window_of_smrf_is_18_cells():
    assert jf.from_pdal({"type": "filters.smrf", "cell": 2}).window == 36
    assert jf.from_pdal({"type": "filters.smrf", "cell": 2, "window": 10}).window == 10
    assert jf.from_pdal({"type": "filters.smrf"}, units="ft").window == pytest.approx(18 * FOOT)


def test_lengths_are_in_units_of_the_coordinates():
    """Thresholds computed as PDAL does it, in feet, are those of the filter in metres; X and Y may have another unit than Z."""
    pmf = jf.from_pdal({"type": "filters.pmf", "slope": 0.2, "max_distance": 9}, units="ft")
    windows = [2.0 * 2**k + 1 for k in range(5)]
    feet = [0.15, *(min(9.0, 0.2 * (b - a) + 0.15) for a, b in itertools.pairwise(windows))]
    np.testing.assert_allclose(pmf.thresholds(), np.array(feet) * FOOT, rtol=1e-6)
    smrf = jf.from_pdal({"type": "filters.smrf", "slope": 0.3, "scalar": 2}, units="ft,m")
    rise = 0.7  # metres per foot
    assert smrf.threshold + smrf.scaling * rise / FOOT == pytest.approx(0.5 + 2 * rise)
    assert smrf.slope == pytest.approx(0.3 / FOOT) and smrf.cell == FOOT
    csf = jf.from_pdal({"type": "filters.csf", "step": 0.5}, units="ft")
    assert 0.2 * csf.time_step**4 == pytest.approx(0.2 * 0.5**4 * FOOT)


def test_a_pipeline_may_be_text_a_file_a_list_or_a_stage(pipeline):
    stage = {"type": "filters.csf", "rigidness": 1}
    path = pipeline("in.laz", stage, "out.laz")
    text = '["in.laz", /* soft */ {"type": "filters.csf", "rigidness": 1}] // "x'
    expected = jf.CSF.preset("wheel", rigidness=1)
    assert [jf.from_pdal(what) for what in (stage, [stage], path, str(path), path.read_text(), text)] == [expected] * 6


@pytest.mark.parametrize(
    "option, value, words",
    [
        ("where", "Z < 3", "where='Z < 3' has no counterpart"),
        ("dir", "/tmp", "dir='/tmp' has no counterpart"),
        ("tag", "one", "no effect on labels"),
        ("classbits", "synthetic,withheld", "classbits=synthetic has no counterpart"),
        ("ignore", "NumberOfReturns[2:]", r"ignore=NumberOfReturns\[2:\] has no counterpart"),
        ("ignore", "Classification[7:7]", r"pass ignore_classes=\(7,\) to jaxfilter.read"),
        ("returns", "first,only", "pass returns='first,only' to jaxfilter.read"),
        ("only_ground", "true", "pass only_ground=True to jaxfilter.write"),
        ("ground_class", 8, "pass ground_class=8 to jaxfilter.write"),
    ],
)
def test_what_a_filter_does_not_have_is_said(option, value, words):
    with pytest.warns(jf.JaxfilterWarning, match=words):
        assert jf.from_pdal({"type": "filters.smrf", option: value}) == jf.SMRF()


def test_windows_of_other_cells_are_said_to_differ():
    with pytest.warns(jf.JaxfilterWarning, match="cell_size=2 PDAL opens with other windows"):
        jf.from_pdal({"type": "filters.pmf", "cell_size": 2})


@pytest.mark.parametrize(
    "what, error, words",
    [
        ({"type": "filters.smrf", "celll": 1}, jf.ParameterError, "no option celll=1"),
        ({"type": "filters.smrf", "cell": "wide"}, jf.ParameterError, "cell='wide'"),
        ({"type": "filters.smrf", "cell": -1}, jf.ParameterError, r"filters.smrf: SMRF\(cell=-1.0\)"),
        ({"type": "filters.csf", "rigidness": 2.5}, jf.ParameterError, "rigidness=2.5: must be a whole number"),
        ({"type": "filters.csf", "rigidness": 4}, jf.ParameterError, "rigidness=4"),
        ({"type": "filters.csf", "smooth": "maybe"}, jf.ParameterError, "smooth='maybe': must be true or false"),
        ({"type": "filters.smrf", "ignore": "Classification"}, jf.ParameterError, "ignore='Classification'"),
        ({"type": "filters.smrf", "returns": "last, lst"}, jf.ParameterError, "returns='lst'"),
        ({"type": "filters.range"}, jf.InputError, "its stages are filters.range"),
        ([{"type": "filters.smrf"}, {"type": "filters.pmf"}], jf.InputError, "it has 2"),
        ([], jf.InputError, "it has 0; its stages are none"),
        ([{"cell": 1}], jf.InputError, "neither a type"),
        ("[{]", jf.InputError, "is no JSON: .*line 1"),
        ("no/such.json", jf.InputError, "no/such.json: cannot be read"),
        ({"pipeline": 3}, jf.InputError, "but int"),
    ],
)
def test_what_is_no_ground_stage_is_refused(what, error, words):
    with pytest.raises(error, match=words):
        jf.from_pdal(what)


@pytest.mark.parametrize(
    "ranges, wanted",
    [
        ("Classification[7:7]", {7}),
        (["Classification[7:7]", "Classification[18:18]"], {7, 18}),
        ("Classification![2:2]", set(range(256)) - {2}),
        ("Classification(6:9]", {7, 8, 9}),
        ("Classification[:2), Classification[254:]", {0, 1, 254, 255}),
    ],
)
def test_ranges_of_classes(ranges, wanted):
    assert set(translate({"type": "filters.csf", "ignore": ranges}).reading["ignore_classes"]) == wanted


def test_the_printed_command_does_what_the_pipeline_asks_for(tmp_path, pipeline, scene):
    classes = np.where(np.arange(len(scene)) % 7 == 0, 9, 5).astype(np.uint8)  # water, which PDAL judges too
    cloud = jf.PointCloud.from_arrays(
        scene.cloud.coordinates(), classification=classes, return_number=scene.cloud.return_number,
        number_of_returns=scene.cloud.number_of_returns,
    )  # fmt: skip
    source, target = str(tmp_path / "in.laz"), str(tmp_path / "out.laz")
    jf.write(source, cloud, None)
    stage = {"type": "filters.smrf", "scalar": 1.2, "window": 20, "returns": "first,only", "dir": "x"}
    path = pipeline(
        source, {"type": "filters.elm"}, stage, {"type": "writers.las", "filename": target, "forward": "all"}
    )
    said = CliRunner().invoke(main, ["from-pdal", str(path)])
    assert said.exit_code == 0, said.output
    for words in ("dir='x' has no", "filters.elm is not done", "--noise-class", "writers.las: forward='all'"):
        assert words in said.stderr
    words = shlex.split(said.stdout)
    assert words[:3] == ["jaxfilter", "ground", "smrf"]
    done = CliRunner().invoke(main, [*words[1:], "-q"])
    assert done.exit_code == 0, done.output
    judged = cloud.select(returns="first,only", ignore_classes=(), keep_withheld=True)
    ground = jf.SMRF(scaling=1.2, window=20.0)(judged).ground
    expected = np.where(judged.candidate, np.where(ground, 2, 1), classes)
    np.testing.assert_array_equal(jf.read(target, units="m").classification, expected)
    as_json = json.loads(CliRunner().invoke(main, ["from-pdal", str(path), "--json", "--units", "ft"]).stdout)
    assert as_json["parameters"]["window"] == pytest.approx(20 * FOOT) and "--units ft" in as_json["command"]


def test_names_of_pdal_are_flags_as_well():
    for stage in STAGES.values():
        method = jf.FILTERS[stage.method]
        words = {option: parameter for parameter in flags.options(method) for option in parameter.opts}
        for name, option in stage.options.items():
            assert words["--" + name.replace("_", "-")].name == option.field


def test_arrays_of_pdal_are_clouds(scene):
    names = [(name, "f8") for name in "XYZ"] + [("Intensity", "u2"), ("ReturnNumber", "u1"), ("NumberOfReturns", "u1")]
    points = np.zeros(len(scene), [*names, ("Classification", "u1"), ("Withheld", "u1")])
    for axis, column in zip("XYZ", scene.cloud.coordinates().T, strict=True):
        points[axis] = column
    points["ReturnNumber"], points["NumberOfReturns"] = scene.cloud.return_number, scene.cloud.number_of_returns
    points["Classification"], points["Withheld"] = scene.classes, np.arange(len(scene)) % 50 == 0
    cloud = jf.PointCloud.from_structured(points, crs="EPSG:32632")
    assert cloud.crs.to_epsg() == 32632 and cloud.withheld.sum() == -(-len(scene) // 50)
    np.testing.assert_array_equal(cloud.reference, scene.classes == 2)
    np.testing.assert_array_equal(
        cloud.candidate, scene.cloud.select().candidate & ~cloud.withheld & (scene.classes < 7)
    )
    labels = jf.SMRF()(points).ground
    np.testing.assert_array_equal(labels, jf.SMRF()(cloud).ground)
    assert labels.any() and jf.dtm(points).values.shape == jf.dtm(cloud).values.shape
    x, y, z = scene.cloud.coordinates().T
    echoes = {"return_number": points["ReturnNumber"], "number_of_returns": points["NumberOfReturns"]}
    likewise = as_cloud(types.SimpleNamespace(x=x, y=y, z=z, intensity=z, **echoes))  # as the points of laspy
    np.testing.assert_array_equal(likewise.xyz, scene.cloud.xyz)
    np.testing.assert_array_equal(likewise.candidate, scene.cloud.candidate)
    wrong = points.astype([(n, "i4" if n == "Classification" else points.dtype[n]) for n in points.dtype.names])
    wrong["Classification"][7] = 300
    with pytest.raises(jf.InputError, match=r"classification of point 7 is .*300.*: whole numbers from 0 to 255"):
        jf.PointCloud.from_structured(wrong)
    with pytest.raises(jf.InputError, match=r"withheld of point 1 is .*2.*: True or False"):
        jf.PointCloud.from_arrays(np.zeros((2, 3)), withheld=[1, 2])
    with pytest.raises(jf.InputError, match="there is no field Z"):
        jf.SMRF()(points[["X", "Y", "Intensity"]])
