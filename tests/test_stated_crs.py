"""A CRS that the user states for files without one: it decides on units, is written to all outputs, and contradicts nothing."""

from __future__ import annotations

import laspy
import numpy as np
import pyproj
import pytest
import rasterio
from click.testing import CliRunner
from las_files import make_las

import jaxfilter as jf
from jaxfilter.cli import main

pytestmark = pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")
FEET = pyproj.CRS.from_epsg(2225).axis_info[0].unit_conversion_factor


@pytest.mark.parametrize(
    "version, point_format", [("1.2", 0), ("1.2", 3), ("1.3", 5), ("1.4", 1), ("1.4", 6), ("1.4", 8)]
)
@pytest.mark.parametrize("suffix", [".las", ".laz"])
@pytest.mark.parametrize("crs", ["EPSG:25832", "EPSG:2225", "EPSG:25832+5783"])
def test_every_version_states_it_and_keeps_all_else(tmp_path, version, point_format, suffix, crs):
    before = make_las(tmp_path / "in.las", point_format, version, crs=None, extra=True)
    cloud = jf.read(tmp_path / "in.las", crs=crs)
    stated = pyproj.CRS.from_user_input(crs)
    assert cloud.crs == stated and cloud.units.xy == stated.axis_info[0].unit_conversion_factor
    ground = np.arange(len(cloud)) % 3 == 0
    after = laspy.read(jf.write(tmp_path / f"out{suffix}", cloud, ground))
    if version == "1.4":
        assert after.header.global_encoding.wkt and bytes(after.evlrs[0].record_data_bytes()) == bytes(range(256)) * 300
        assert after.header.parse_crs().name == stated.name
    else:
        (keys,) = after.header.vlrs.get("GeoKeyDirectoryVlr")
        codes = {key.id: key.value_offset for key in keys.geo_keys}
        parts = stated.sub_crs_list or [stated]
        assert codes == dict(zip((1024, 3072, 4096), (1, *(part.to_epsg() for part in parts)), strict=False))
    assert [vlr.record_data_bytes() for vlr in after.header.vlrs.get_by_id("someone")] == [b"\x00\x01\xfe\xff"]
    for name in before.point_format.dimension_names:
        if name != "classification":
            np.testing.assert_array_equal(after[name], before[name], err_msg=name)
    assert jf.read(tmp_path / f"out{suffix}").crs.is_projected, "it is read back without a word on units"


def test_what_no_old_version_can_hold_is_left_out_and_said(tmp_path):
    make_las(tmp_path / "in.las", 1, crs=None)
    own = pyproj.CRS.from_proj4("+proj=tmerc +lat_0=3 +lon_0=7 +k=0.9 +x_0=1000 +y_0=2000 +ellps=GRS80 +units=m")
    cloud = jf.read(tmp_path / "in.las", crs=own)
    with pytest.warns(jf.JaxfilterWarning, match="no EPSG code, which LAS 1.2 needs.*convert the input to LAS 1.4"):
        jf.write(tmp_path / "out.las", cloud, np.zeros(len(cloud), bool))
    assert laspy.read(tmp_path / "out.las").header.parse_crs() is None


def test_text_and_laspy_take_it(tmp_path):
    las = make_las(tmp_path / "in.las", 6, crs=None)
    assert jf.read(las, crs=2225).units.xy == FEET
    np.savetxt(tmp_path / "in.xyz", np.column_stack([las.x, las.y, las.z]))
    cloud = jf.read(tmp_path / "in.xyz", crs=2225)
    assert cloud.crs.to_epsg() == 2225 and cloud.units.xy == FEET
    assert jf.read(tmp_path / "in.xyz", crs=2225, units="m").units.xy == 1.0, "units go before it"
    written = jf.write(tmp_path / "out.laz", cloud, np.zeros(len(cloud), bool))
    assert laspy.read(written).header.parse_crs().to_epsg() == 2225


def test_it_contradicts_no_file(tmp_path):
    make_las(tmp_path / "a.las", 6, crs=25832)
    make_las(tmp_path / "b.las", 6, crs=None, seed=1)
    assert jf.read(tmp_path / "a.las", crs="EPSG:25832+5783").crs.to_epsg() == 25832, (
        "the file's own, which is the same"
    )
    with pytest.raises(
        jf.InputError, match=r"a\.las: crs='EPSG:25833': the file states another CRS, ETRS89 / UTM zone 32N"
    ):
        jf.read(tmp_path / "a.las", crs=25833)
    survey = jf.open(tmp_path, crs=25833)
    assert survey.uris == [str(tmp_path / "b.las")] and "states another CRS" in survey.unreadable[0][1]
    assert jf.open(tmp_path, crs=25832).crs.to_epsg() == 25832 and len(jf.open(tmp_path, crs=25832)) == 2
    jf.open(tmp_path, crs=25832).to_vpc(tmp_path / "all.vpc")
    assert jf.open(tmp_path / "all.vpc", crs=25832).crs.to_epsg() == 25832
    with pytest.raises(jf.InputError, match="states another CRS"):
        jf.open(tmp_path / "all.vpc", crs=25833)


@pytest.mark.parametrize(
    "crs, words", [("EPSG:4326", "not in a projected system"), ("EPSG:1", "no coordinate reference")]
)
def test_one_in_which_nothing_can_be_measured_is_refused(tmp_path, crs, words):
    make_las(tmp_path / "in.las", 6, crs=None)
    with pytest.raises(jf.InputError, match=words):
        jf.read(tmp_path / "in.las", crs=crs)
    result = CliRunner().invoke(
        main, ["ground", "smrf", str(tmp_path / "in.las"), str(tmp_path / "o.las"), "--crs", crs]
    )
    assert result.exit_code and "crs=" in result.stderr and len(result.stderr.strip().splitlines()) == 1


def test_all_outputs_of_a_survey_state_it(tmp_path, monkeypatch):
    scene = jf.scenes.make("town", size=(60.0, 40.0), density=2.0, seed=3)
    x = scene.cloud.coordinates()[:, 0]
    (tmp_path / "in").mkdir()
    for name, rows in (("west", x < np.median(x)), ("east", x >= np.median(x))):
        part = jf.PointCloud.from_arrays(scene.cloud.coordinates()[rows])
        jf.write(tmp_path / f"in/{name}.laz", part, np.zeros(rows.sum(), bool), other_class=0)
    monkeypatch.chdir(tmp_path)
    for arguments in (
        ("ground", "smrf", "in", "out", "--crs", "EPSG:25832", "--workers", "1", "--review", "places.gpkg"),
        ("height", "in", "heights", "--filter", "smrf", "--crs", "EPSG:25832", "--workers", "1"),
        ("dtm", "in", "dtm.tif", "--filter", "smrf", "--crs", "EPSG:25832", "--workers", "1"),
    ):
        result = CliRunner().invoke(main, list(arguments))
        assert result.exit_code == 0, result.output
        assert "no CRS" not in result.output
    for file in (*(tmp_path / "out").glob("*.laz"), *(tmp_path / "heights").glob("*.laz")):
        assert laspy.read(file).header.parse_crs().to_epsg() == 25832
    with rasterio.open(tmp_path / "dtm.tif") as raster:
        assert raster.crs.to_epsg() == 25832
    result = CliRunner().invoke(main, ["info", "in", "--crs", "EPSG:25832", "--json"])
    assert '"crs": "ETRS89 / UTM zone 32N"' in result.stdout
