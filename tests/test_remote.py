"""Files behind URLs: by ranges from a web server, in and out of an object store, and what fails on the way."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import re
import tempfile

import fsspec
import numpy as np
import pytest
from las_files import OFFSETS, las_of, make_copc, make_las, patch
from servers import Faulty, RangeServer
from test_cli_runs import run
from test_places import ROOF, field
from test_read_window import assert_is_mask, boxes_of
from test_tiles_run import Here

import jaxfilter as jf
from jaxfilter.files import storage
from jaxfilter.files.sources import read_window

pytestmark = [pytest.mark.usefixtures("plain_maps"), pytest.mark.filterwarnings("ignore::jaxfilter.JaxfilterWarning")]
pytest.importorskip("aiohttp", reason="aiohttp is not installed: https:// is not tested")
X, Y = OFFSETS[:2]


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(storage, "WAITS", (0.001,) * 4)


@pytest.fixture
def server(tmp_path):
    with RangeServer(tmp_path) as server:
        yield server


@pytest.mark.parametrize("name", ["in.las", "in.laz", "in.copc.laz"])
def test_windows_are_those_of_the_local_file(tmp_path, server, name):
    path = tmp_path / name
    make_copc(path) if "copc" in name else make_las(path, 7, n=3000, extra=True)
    remote, local = jf.open(f"{server.url}/{name}")[0], jf.open(path)[0]
    same = dataclasses.replace(remote, uri=local.uri, identity=local.identity, bounds=local.bounds, z=local.z)
    assert same == local and remote.identity
    for box in boxes_of(local.bounds, n=2):
        window = read_window(remote, box)
        assert_is_mask(window, path, box)
    again = jf.read(f"{server.url}/{name}", bounds=box)
    assert again.xyz.tobytes() == window.cloud.xyz.tobytes()
    whole = jf.read(f"{server.url}/{name}")
    assert whole.xyz.tobytes() == jf.read(path).xyz.tobytes()


@pytest.mark.parametrize("failures, words", [
    ([503], None), ([503, 502, 429], None), ([0], None), ([0, 503, 0], None),
    ([503] * 100, "cannot be reached: .*503"), ([403] * 100, "cannot be reached: .*403"),
], ids=str)  # fmt: skip
def test_what_passes_is_tried_again_and_else_the_uri_is_named(tmp_path, server, failures, words):
    make_copc(tmp_path / "in.copc.laz")
    source, box = jf.open(f"{server.url}/in.copc.laz")[0], (X, Y, X + 40, Y + 40)
    server.failures, server.requests = list(failures), 0
    if words is None:
        assert_is_mask(read_window(source, box), tmp_path / "in.copc.laz", box)
        assert server.failures == []
        return
    with pytest.raises(jf.InputError, match=f"{server.url}/in.copc.laz: {words}"):
        read_window(source, box)
    assert server.requests == (1 if 403 in failures else 5)


@pytest.mark.parametrize("scheme", ["dir", "generic", "github", "no-such"])
@pytest.mark.parametrize("act", [jf.read, jf.open])
def test_odd_urls_are_named(scheme, act):
    for url in (f"{scheme}://host/in.laz", f"{scheme}://host/*.laz", f"{scheme}://[host/in.laz"):
        with pytest.raises(jf.InputError) as caught:
            act(url)
        assert str(caught.value).startswith(f"{url}: ")


@pytest.mark.parametrize("url", ["Reference://in.laz", "memory://in.laz::file:///r.json"])
def test_chains_of_stores_are_refused_whoever_names_them(tmp_path, url, monkeypatch):
    cloud = jf.PointCloud.from_arrays(np.random.default_rng(0).uniform(0, 30, (50, 3)))
    jf.write(tmp_path / "in.laz", cloud, None)
    fsspec.filesystem("memory").put_file(str(tmp_path / "in.laz"), "/chained/reference::a.laz")
    known = fsspec.core.url_to_fs
    monkeypatch.setattr(fsspec.core, "url_to_fs", lambda uri: pytest.fail(uri) if "::" in uri else known(uri))
    for act in (jf.read, jf.open, lambda name: jf.write(name, cloud, None)):
        with pytest.raises(jf.InputError, match=f"{url}: chains of stores"):
            act(url)
    done = run("ground", url, tmp_path / "out.laz")
    assert done.exit_code in (1, 2) and "chains of stores" in done.output and not (tmp_path / "out.laz").exists()
    with pytest.raises(jf.InputError, match=r"chained/reference::a\.laz: chains of stores"):
        jf.open("memory://chained/")  # a name that the store tells


def test_missing_changed_and_without_ranges(tmp_path, server):
    make_copc(tmp_path / "in.copc.laz")
    make_copc(tmp_path / "large.copc.laz", n=20_000)
    with pytest.raises(jf.InputError, match=r"absent\.laz: no such file"):
        jf.open(f"{server.url}/absent.laz")
    source, box = jf.open(f"{server.url}/in.copc.laz")[0], (X, Y, X + 40, Y + 40)
    make_copc(tmp_path / "in.copc.laz", seed=1)
    with pytest.raises(jf.InputError, match="has changed"):
        read_window(source, box)
    make_las(tmp_path / "small.laz", 6)
    server.knows_ranges = False
    for name, what in (("large.copc.laz", jf.open), ("small.laz", jf.read)):
        with pytest.raises(jf.InputError, match=rf"{name}: the server does not support range requests.* download"):
            what(f"{server.url}/{name}")
    with pytest.raises(jf.InputError, match="text is read from local disks only"):
        jf.read(f"{server.url}/points.txt")


def test_cubes_that_do_not_hold_their_points(tmp_path, server):
    """Over the net not every node is looked into beforehand."""
    path = tmp_path / "in.copc.laz"
    make_copc(path)
    patch(path, "d", 375 + 54 + 24, 20.0)  # half the side of the cube is 50
    remote = jf.open(f"{server.url}/in.copc.laz")[0]
    with pytest.raises(
        jf.InputError, match=r"in\.copc\.laz: points lie outside the cubes of its octree.*without bounds"
    ):
        read_window(remote, (X + 40, Y + 40, X + 50, Y + 50))


def test_a_survey_of_urls(tmp_path, server):
    for k in range(3):
        make_las(tmp_path / f"{k}.laz", 6, n=50 + k)
    survey = jf.open([f"{server.url}/{k}.laz" for k in (2, 0, 1)])
    assert [s.count for s in survey] == [52, 50, 51]
    survey.to_vpc(tmp_path / "all.vpc")
    assert list(jf.open(f"{server.url}/all.vpc").uris) == list(survey.uris)
    local = jf.open([tmp_path / f"{k}.laz" for k in range(3)])
    local.to_vpc(tmp_path / "local.vpc")
    assert list(jf.open(f"{server.url}/local.vpc").uris) == [f"{server.url}/{k}.laz" for k in range(3)]


@pytest.fixture(scope="module")
def bucket():
    """A bucket of moto's S3 server."""
    pytest.importorskip("s3fs", reason="s3fs is not installed: s3:// is not tested")
    server = pytest.importorskip("moto.server", reason="moto is not installed: s3:// is not tested")
    import s3fs

    running = server.ThreadedMotoServer(port=0, verbose=False)
    running.start()
    with pytest.MonkeyPatch.context() as patch:
        host, port = running.get_host_and_port()
        names = {"AWS_ACCESS_KEY_ID": "testing", "AWS_SECRET_ACCESS_KEY": "testing", "AWS_DEFAULT_REGION": "us-east-1"}
        for name, value in (names | {"AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_MAX_ATTEMPTS": "1"}).items():
            patch.setenv(name, value)
        patch.setattr(s3fs.S3FileSystem, "retries", 1)  # beside our own
        system = s3fs.S3FileSystem(skip_instance_cache=True)
        system.mkdir("surveys")
        system.faults = running._server.app = Faulty(running._server.app)
        yield system
    running.stop()


@pytest.fixture(scope="module")
def west_and_east(tmp_path_factory):
    """A survey of two files."""
    folder, xyz = tmp_path_factory.mktemp("survey"), field(ROOF, (35, 20, 45, 30))
    west = xyz[:, 0] < 30
    for name, rows in (("west", west), ("east", ~west)):
        las_of(folder / f"{name}.laz", xyz[rows])
    return folder


FIELDS = {"max_window": 9.0, "low_clusters": False}
PMF = jf.PMF(**FIELDS)


def options(executor=None, **how):
    return jf.RunOptions(tile=30.0, wide_halos=True, executor=executor or Here(), **how)


def into(west_and_east, out, **how):
    return jf.ground(west_and_east, out, PMF, run=options(**how))


def test_a_run_into_an_object_store(tmp_path, bucket, west_and_east):
    """What passes is tried again; what does not leaves nothing of the file, and the run goes on later."""
    local, out, work = tmp_path / "local", "s3://surveys/run/2024", tmp_path / "work"
    into(west_and_east, local)

    def names():
        bucket.invalidate_cache()
        return sorted(path.rpartition("/")[2] for path in bucket.ls("surveys/run/2024", detail=False))

    with pytest.raises(jf.ParameterError, match="pass work="):
        into(west_and_east, out)
    bucket.faults.failures, bucket.faults.suffix = [503] * 500, "east.laz"
    report = into(west_and_east, out, work=work)
    assert [one["file"] for one in report.failed] == [str(west_and_east / "east.laz")]
    assert "s3://surveys/run/2024/east.laz: cannot be reached" in report.failed[0]["reason"]
    assert names() == ["jaxfilter-run.json", "jaxfilter-run.png", "west.laz"]
    with pytest.raises(jf.OutputError, match="is not empty"):
        into(west_and_east, out, work=work)
    bucket.faults.failures, bucket.faults.suffix = [503, 0, 500, 0], "east.laz"
    assert into(west_and_east, out, work=work, resume=True).complete and bucket.faults.failures == []
    assert names() == ["east.laz", "jaxfilter-run.json", "jaxfilter-run.png", "west.laz"]
    for path in local.glob("*.laz"):
        assert bucket.cat_file(f"surveys/run/2024/{path.name}") == path.read_bytes()
    assert [path.name for path in work.iterdir()] == [".jaxfilter-run"]
    assert list(jf.open("s3://surveys/*/2024/[w]*.la*").uris) == [f"{out}/west.laz"]
    for missing in (f"{out}/absent.laz", "s3://surveys/empty/", "s3://no-such-bucket/"):
        with pytest.raises(jf.InputError, match=missing):
            jf.open(missing)
    assert into(west_and_east, out, work=work, overwrite=True).complete
    with pytest.raises(jf.OutputError, match="s3://no-such-bucket"):
        into(west_and_east, "s3://no-such-bucket/run", work=tmp_path / "other")


@pytest.fixture
def state(tmp_path, monkeypatch):
    """Where programs keep what they need to go on is a folder of the test; and so is where they put what is temporary."""
    for name in ("state", "temporary"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr("platformdirs.user_state_path", lambda name: tmp_path / "state" / name)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    return tmp_path / "state"


def test_a_run_of_one_file_into_a_store_is_kept_in_a_folder_of_the_user(tmp_path, west_and_east, state, monkeypatch):
    """What others have put where such runs were once kept is neither read nor removed; the run is found again from anywhere."""
    target = "memory://runs/west.laz"
    planted = tmp_path / "temporary" / f".{hashlib.sha256(target.encode()).hexdigest()[:16]}.jaxfilter-run"
    planted.mkdir()
    (planted / "run.json").write_text("not ours")
    planted.parent.chmod(0o1777)
    planted.chmod(0o777)

    def one(target, executor, **more):
        run = jf.RunOptions(tile=15.0, wide_halos=True, executor=executor, **more)
        return jf.ground(west_and_east / "west.laz", target, PMF, run=run)

    tiles = one(tmp_path / "west.laz", Here()).tiles
    assert tiles > 2

    umask = os.umask(0)
    try:
        with pytest.raises(KeyboardInterrupt):
            one(target, Here(stop_after=2))
    finally:
        os.umask(umask)
    made = state / "jaxfilter"
    (kept,) = made.iterdir()
    assert [place.stat().st_mode & 0o777 for place in (made, kept)] == [0o700, 0o700]
    assert (planted / "run.json").read_text() == "not ours" and len(list(planted.iterdir())) == 1
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    again = Here()
    assert one(target, again, resume=True).complete
    assert sum(name == "do_tile" for name, _ in again.calls) == tiles - 2
    assert fsspec.filesystem("memory").cat_file("/runs/west.laz") == (tmp_path / "west.laz").read_bytes()
    assert list(made.iterdir()) == [] and (planted / "run.json").read_text() == "not ours"


@pytest.mark.parametrize("plant", ["link", "another"])
def test_a_folder_of_the_user_that_somebody_else_has_made_is_refused(tmp_path, west_and_east, state, plant):
    """In a place that all may write to."""
    if not hasattr(os, "getuid") or (plant == "another" and os.getuid()):
        pytest.skip("only root can give a folder to another user")
    state.chmod(0o777)
    made, other = state / "jaxfilter", tmp_path / "other"
    other.mkdir()
    (other / "precious.txt").write_text("precious")
    if plant == "link":
        made.symlink_to(other)
    else:
        other.rename(made)
        os.chown(made, 12345, 12345)
    with pytest.raises(jf.OutputError, match="remove it if nobody needs it") as caught:
        run = jf.RunOptions(tile=15.0, wide_halos=True)
        jf.ground(west_and_east / "west.laz", "memory://runs/refused.laz", PMF, run=run)
    assert str(caught.value).startswith(f"{made}: ") and os.listdir(made) == ["precious.txt"]
    assert (made / "precious.txt").read_text() == "precious"


def test_a_terrain_model_into_an_object_store(tmp_path, bucket, west_and_east):
    """It appears whole; where the store fails, no tile is made twice; a store that refuses is found out before any is made."""
    target, work, local = "s3://surveys/dtm/all.tif", tmp_path / "work", tmp_path / "local.tif"

    def model(target, executor, **how):
        return jf.terrain_model(west_and_east, target, PMF, cell=0.5, run=options(executor, **how))

    def stored():
        bucket.invalidate_cache()
        return [path.rpartition("/")[2] for path in bucket.find("surveys/dtm")]

    assert model(local, Here()).complete
    with pytest.raises(jf.ParameterError, match=r"s3://surveys/dtm/all\.tif is not on a local disk.* pass work="):
        model(target, Here())
    with pytest.raises(jf.OutputError, match=r"all\.png: the suffix must be one of \.tif, \.tiff"):
        model("s3://surveys/dtm/all.png", Here(), work=work)
    refused = Here()
    with pytest.raises(jf.OutputError, match=r"s3://no-such-bucket/all\.tif.*no such bucket"):
        model("s3://no-such-bucket/all.tif", refused, work=work)
    assert refused.calls == [] and list(work.iterdir()) == []
    bucket.faults.failures, bucket.faults.suffix = [503] * 500, "all.tif"
    with pytest.raises(jf.OutputError, match=r"s3://surveys/dtm/all\.tif: cannot be reached"):
        model(target, Here(), work=work)
    assert stored() == []
    again, bucket.faults.failures = Here(), [503, 0, 500]
    assert model(target, again, work=work, resume=True).complete
    assert again.calls == [] and bucket.faults.failures == [] and list(work.iterdir()) == []
    assert stored() == ["all.tif"] and bucket.cat_file("surveys/dtm/all.tif") == local.read_bytes()
    with pytest.raises(jf.OutputError, match=r"all\.tif: the file exists"):
        model(target, refused, work=work)
    assert refused.calls == []


@pytest.mark.slow
def test_products_into_an_object_store(tmp_path, bucket, west_and_east):
    """The files that a local folder has, byte for byte; the page has no pictures of what is elsewhere."""
    only = ["hillshade", "voids", "contours"]

    def into_store(out, **how):
        return jf.products(west_and_east, out, PMF, only=only, run=options(**how))

    assert into_store(tmp_path / "local").complete
    with pytest.raises(jf.ParameterError, match="pass work="):
        into_store("s3://surveys/products")
    assert into_store("s3://surveys/products", work=tmp_path / "work").complete
    bucket.invalidate_cache()
    names = [f"classified/{side}.laz" for side in ("east", "west")] + ["hillshade.tif", "voids.tif", "contours.gpkg"]
    for name in names:
        assert bucket.cat_file(f"surveys/products/{name}") == (tmp_path / "local" / name).read_bytes(), name
    assert b'href="voids.tif"' in bucket.cat_file("surveys/products/survey.html")
    with pytest.raises(jf.OutputError, match=r"products/hillshade\.tif: the file exists"):
        into_store("s3://surveys/products", work=tmp_path / "work")


def test_commands_on_one_file_take_urls(tmp_path, bucket, west_and_east):
    source, out = west_and_east / "west.laz", "s3://surveys/one"
    fields = ["ground", "pmf", "--max-window=9.0", "--no-low-clusters"]
    how = ["--filter", "pmf", *(f"--set={name}={value}" for name, value in FIELDS.items())]
    pairs = ((fields, "a.laz", "b.laz"), (["height", *how], "h.laz", "i.laz"), (["dtm", *how], "c.tif", "d.tif"))
    for words, there, here in pairs:
        for target in (f"{out}/{there}", tmp_path / here):
            result = run(*words, source, target, "--quiet")
            assert result.exit_code == 0, result.output
        assert bucket.cat_file(f"surveys/one/{there}") == (tmp_path / here).read_bytes(), there
        wrong = run(*words, source, f"{out}/{there}")
        assert wrong.exit_code == 2 and re.search(rf"{out}/{there}:?.* exists", wrong.stderr), wrong.output
    cloud = jf.read(f"{out}/a.laz")
    jf.write(f"{out}/w.laz", cloud, None)
    jf.write(tmp_path / "w.laz", cloud, None)
    assert bucket.cat_file("surveys/one/w.laz") == (tmp_path / "w.laz").read_bytes()
    for name, how, words in (("w", {}, "the file exists"), ("a", {"overwrite": True}, "output and input are one file")):
        with pytest.raises(jf.OutputError, match=words):
            jf.write(f"{out}/{name}.laz", cloud, None, **how)
    back = run(*fields, f"{out}/a.laz", tmp_path / "again.laz", "--quiet")
    assert back.exit_code == 0 and (tmp_path / "again.laz").read_bytes() == (tmp_path / "b.laz").read_bytes()
    for words, code, said in (
        (("ground", "pmf", f"{out}/a.laz", f"{out}/a.laz"), 2, "is an input"),
        (("dtm", west_and_east, f"{out}/e.tif"), 2, "e.tif is not on a local disk.*--work"),
        (("ground", "pmf", f"{out}/absent.laz", tmp_path / "new.laz"), 1, "absent.laz: no such file"),
    ):
        wrong = run(*words)
        assert wrong.exit_code == code and re.search(said, " ".join(wrong.stderr.split())), wrong.output
