"""SciPy's triangulation, made anew in each round, is the oracle of the one that grows in place: labels differ by ties only."""

import sys
from pathlib import Path

import numpy as np
import pytest

import jaxfilter as jf
from jaxfilter.core.filter import ground_each
from jaxfilter.core.params import filter_params, param, static
from jaxfilter.core.points import canonical_points
from jaxfilter.engines.tin.facets import Rule
from jaxfilter.engines.tin.growth import Growth
from jaxfilter.engines.tin.network import one_network
from jaxfilter.engines.tin.reference import SciPyTin
from jaxfilter.engines.tin.triangulation import triangulated
from jaxfilter.steps.seeds import lowest_per_cell
from jaxfilter.steps.tin_filter import TinFilter, surrounded

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from experiments.bench.triangulation import METHODS, compared


@filter_params
class Bender(TinFilter):
    """A user's filter, whose growth does not know of triangulations."""

    BIBTEX = "@misc{bender, title = {A filter of one's own}}"
    max_angle: float = param("the angle to a facet is at most this", "> 0 and < 90 degrees", default=12.0)
    seed_cell: float = static("a square cell of this size has one seed", "> 0 m", default=40.0)

    def start(self, points, workers, progress, trace=False):
        outliers = self.outliers(points, workers)
        seeds = lowest_per_cell(points, self.seed_cell, outliers.barred)
        return surrounded(self, points, seeds, outliers, self.seed_cell)

    def growth(self, network):
        return Growth(Rule(max_angle=self.max_angle, max_distance=1.0))


jf.FILTERS.pop("bender")  # other tests list the methods of the library


FILTERS = [
    *(
        jf.FILTERS[method].preset(preset)
        for method in (*METHODS, "ptdf", "iptd")
        for preset in ("recommended", "paper")
    ),
    jf.FPTD(window=20.0, stride=5.0, blocks="independent", vertex_spacing=1.5),
    Bender(),
]


class WithoutBorder(Bender):
    """Points beyond the seeds lie outside the hull."""

    def start(self, points, workers, progress, trace=False):
        outliers = self.outliers(points, workers)
        seeds = lowest_per_cell(points, 15.0, outliers.barred)
        return one_network(points, seeds, np.zeros((0, 2), np.float32), outliers)


def crowded(cloud, step):
    """The cloud on a lattice, where points coincide, lie on edges and on circles."""
    xyz = cloud.coordinates()
    return jf.PointCloud.from_arrays(np.column_stack([np.rint(xyz[:, :2] / step) * step, xyz[:, 2]]))


def check_explained(filter_, cloud, most):
    """Each difference is by a tie or follows from one; they are at most so many percent; labels are those of plain calls."""
    labels, counts = compared(filter_, cloud)
    assert counts["rounding"] == counts["else"] == 0, counts
    assert counts["differ"] == counts["tie"] + counts["after a tie"] <= most / 100 * len(cloud), counts
    for kind, ground in labels.items():
        assert np.array_equal(filter_.replace(triangulation=kind)(cloud).ground, ground), kind
    return counts["differ"]


@pytest.mark.parametrize("filter_", [*FILTERS, WithoutBorder()], ids=lambda f: type(f).__name__)
def test_scipy_is_asked(filter_, town, monkeypatch):
    monkeypatch.setattr("scipy.spatial.Delaunay", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        filter_.replace(triangulation="scipy")(town.cloud)
    filter_(town.cloud)


@pytest.mark.parametrize("filter_", [*FILTERS, WithoutBorder()], ids=lambda f: type(f).__name__)
def test_labels_differ_from_those_of_scipy_by_ties_only(filter_, town):
    check_explained(filter_, town.cloud, most=0.05)


def test_where_ties_are_everywhere_they_explain_all_differences(town):
    found = [check_explained(one, crowded(town.cloud, 1.0), most=5.0) for one in (jf.PTD(), jf.ATIN(), WithoutBorder())]
    assert sum(found) > 0, "the count of ties counts something"


@pytest.mark.parametrize("filter_", [jf.PTD(), jf.IPTD(), jf.STIN()], ids=lambda f: type(f).__name__)
def test_a_sweep_has_the_labels_of_single_calls(filter_, scene):
    sets = [filter_.replace(triangulation="scipy", max_angle=angle) for angle in (6.0, 15.0, 30.0)]
    points = canonical_points(scene.cloud)
    swept = dict(ground_each(sets[0], points, sets, key=None, workers=2, memory=2e9))
    for number, one in enumerate(sets):
        assert np.array_equal(points.spread(swept[number], False), one(scene.cloud).ground)


def test_facets_are_those_of_the_own_triangulation(rng):
    xyz = np.column_stack([rng.uniform(0, 100, (400, 2)), rng.uniform(0, 5, 400)]).astype(np.float32)
    one, other = triangulated(xyz).facets(), triangulated(xyz, kind=SciPyTin).facets()
    assert all(np.array_equal(*tables) for tables in zip(one, other, strict=True))


def test_what_is_beyond_double_precision_is_refused_by_name():
    near = np.stack(np.meshgrid(np.arange(6), np.arange(6)), axis=-1).reshape(-1, 2) * 2.0**-10
    xy = np.concatenate([[[1.3e5, 0.5], [0.5, 1.3e5], [1.3e5, 1.3e5]], near])
    cloud = np.column_stack([xy, np.linspace(0, 1e-3, len(xy))])
    jf.PTD(seed_cell=5000.0)(cloud)
    with pytest.raises(jf.ParameterError, match=r"triangulation='scipy': Qhull leaves out .*use triangulation='own'"):
        jf.PTD(seed_cell=5000.0, triangulation="scipy")(cloud)


@pytest.mark.data
@pytest.mark.parametrize("number", (24, 54))
@pytest.mark.parametrize("method", ("ptd", "fptd", "atin"))
def test_labels_of_the_samples_differ_by_ties_only(method, number, sample):
    cloud = sample(number)
    for filter_ in (jf.FILTERS[method].preset("paper"), jf.FILTERS[method].for_cloud(cloud)):
        check_explained(filter_, cloud, most=0.05)
