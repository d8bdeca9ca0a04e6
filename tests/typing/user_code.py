"""What users write, for type checkers: `mypy --strict` and pyright must find nothing in it. It is not run."""

from pathlib import Path

import jax
import numpy as np

import jaxfilter as jf


def classify(source: Path, target: Path) -> jf.Scores:
    cloud: jf.PointCloud = jf.read(source, returns="last,only")
    result: jf.FilterResult = jf.SMRF(slope=0.3, window=12.0)(cloud)
    jf.write(target, cloud, result, overwrite=True)
    if result.status is not jf.Status.CONVERGED:
        print(result.status.message)
    return jf.evaluate(result, cloud.reference, candidates_only=True)


def checked(cloud: jf.PointCloud, result: jf.FilterResult) -> Path:
    table: jf.Comparison = jf.compare(["smrf", jf.CSF(), jf.PMF], {"site": cloud}, repeats=0)
    labelled: jf.Comparison = jf.compare({"theirs": [result.ground], "saved": "theirs.npz", "SMRF": "smrf"}, [cloud])
    print(labelled.latex(["type1", "type2", "total", "kappa"]), result.provenance["cloud"] == cloud.digest())
    again: jf.FilterResult = jf.FilterResult.load(result.save("theirs.npz", overwrite=True))
    print(table.markdown(), again, table.significance("kappa", against="CSF"), result.to_xarray().sizes)
    jf.report(cloud, result.ground, "delivered.html", reference=cloud, options=jf.ReportOptions(steps=0))
    return jf.report(cloud, result, "site.html", overwrite=True)


def several_methods(xyz: np.ndarray) -> dict[str, np.ndarray]:
    filters: list[jf.Filter] = [
        jf.CSF(rigidness=2, threshold=0.4),
        jf.FPTD(max_angle=30, noise_floor=0.1, low_clusters=False),
        jf.PTDF(),
        jf.SMRF(cell=0.5, slope=0.2, threshold=0.3, scaling=1.0),
    ]
    return {type(one).__name__: one(xyz, workers=1, key=jax.random.key(0)).ground for one in filters}


def presets(cloud: jf.PointCloud) -> jf.FPTD:
    one = jf.FPTD.preset("paper", max_angle=20.0)
    other = jf.FPTD.for_cloud(cloud, largest_building=40.0)
    slope: float = jf.SMRF().replace(slope=0.2).slope
    return one if one.max_angle < slope else other.replace(max_rounds=50)


def by_name(name: str, xyz: np.ndarray) -> np.ndarray:
    one = jf.FILTERS[name]()
    ground: np.ndarray = one(xyz).ground
    return ground


def terrain(cloud: jf.PointCloud, result: jf.FilterResult) -> float:
    raster: jf.Raster = jf.dtm(cloud, result, cell=1.0, method="idw", max_gap=20.0)
    return float(np.nanmax(raster.values))


def from_elsewhere(points: np.ndarray, raster: jf.Raster) -> jf.Filter:
    one: jf.Filter = jf.SMRF(cell=2.0)
    cloud = jf.PointCloud.from_structured(points, units="us-ft", crs="EPSG:2263")
    result = one(cloud)
    jf.write("out.laz", cloud, result, noise_class=7)
    print(result.low_noise.sum(), jf.class_changes(cloud, result, jf.Classes(noise_class=7)), raster.to_xarray().sizes)
    jf.read("in.laz", progress=lambda fraction, step: print(f"{step} {fraction:.0%}"))
    report = jf.ground("survey/", "classified/", classes=jf.Classes(noise_class=7), review="places.gpkg")
    print(report.complete, report.seconds["filter"], report.measures)
    run = jf.RunOptions(tile=500.0, workers=2, progress=lambda standing: print(f"{standing.rate:.0f}"))
    print(jf.heights("classified/", Path("heights/"), replace_z=True, run=run).uncertain)
    reading, fill = jf.Reading(units="m", bounds=(0, 0, 9, 9)), jf.Interpolation(fill=True)
    work = jf.RunOptions(work="run/")
    target = "s3://bucket/dtm.tif"
    model = jf.terrain_model(["a.laz", "b.laz"], target, jf.SMRF(), interpolation=fill, reading=reading, run=work)
    print(model.empty, model.transform)
    jf.ground("survey/", None, jf.SMRF(), run=jf.RunOptions(in_place=True, measures=report.measures))
    return one


def protected(xyz: np.ndarray, one: jf.GroundFilter) -> np.ndarray | None:
    try:
        return one(xyz).ground
    except (jf.InputError, jf.ParameterError) as error:
        print(error)
        return None


def many_sets(cloud: jf.PointCloud, labels: np.ndarray) -> jf.Filter:
    data = jf.sweep(jf.SMRF(), cloud, {"slope": [0.05, 0.15, 0.3], "threshold": [0.3, 0.5]}, votes=True)
    print(data)
    found: jf.Calibration = jf.calibrate(jf.SMRF(), cloud, labels)
    print(found)
    return jf.SMRF()
