import math

import numpy as np
import pytest
from test_pmf import hamlet

from jaxfilter.core.errors import ParameterError
from jaxfilter.methods.msf import MSF


def lowest_points(xyz, cell):
    """Rows of the lowest points of cells that count from zero; their cells, i64[n, 2], for all points."""
    cells = np.floor(xyz[:, :2] / cell).astype(int)
    order = np.lexsort((xyz[:, 1], xyz[:, 0], xyz[:, 2]))
    _, first = np.unique(cells[order], axis=0, return_index=True)
    return order[first], cells


def brute(xyz, f):
    lowest, cells = lowest_points(xyz, f.cell)
    places = cells * f.cell
    distance = np.hypot(*(places[:, None] - places[lowest]).transpose(2, 0, 1))
    allowance = np.minimum(f.max_height, f.initial_distance + f.slope * distance)
    limit = np.where(distance <= f.window + 1e-6, xyz[lowest, 2] + allowance, np.inf).min(axis=1)
    return xyz[:, 2] <= limit


@pytest.mark.parametrize(
    "changes",
    [
        {"slope": 0.231},
        {"slope": 0.45, "max_height": 2.117, "window": 13.0},
        {"cell": 1.5, "window": 9.0, "max_height": 0.203},
    ],
)
def test_equals_brute_force(changes):
    xyz, _ = hamlet()
    f = MSF(low_clusters=False, initial_distance=0.3171, **changes)
    np.testing.assert_array_equal(f(xyz).ground, brute(xyz, f))


@pytest.mark.parametrize("degrees, kept", [(29, True), (34, False)])
def test_a_plane_stays_up_to_the_largest_slope(degrees, kept):
    x, y = np.meshgrid(np.arange(0.25, 60, 0.5), np.arange(0.25, 60, 0.5))
    xyz = np.column_stack([x.ravel(), y.ravel(), math.tan(math.radians(degrees)) * x.ravel()])
    f = MSF(cell=0.5, max_height=99.0, initial_distance=0.05)
    inner = x.ravel() > 12  # nothing lies downhill of the lower edge
    assert f(xyz).ground[inner].mean() == kept


def test_parameters():
    assert math.degrees(math.atan(MSF.preset("paper").slope)) == pytest.approx(15)
    assert math.degrees(math.atan(MSF().slope)) == pytest.approx(30, abs=0.05)
    assert MSF.from_spacing(0.3, 60) == {"cell": 1.0, "window": 30.0, "max_height": 18.0}
    assert MSF.from_spacing(2.2, 10) == {"cell": 1.0, "window": 5.0, "max_height": 6.0}
    assert MSF.from_spacing(8.0, None) == {"cell": 2.0}
    assert MSF.from_spacing(0.3, 300)["cell"] == 1.5
    assert MSF(window=30).halo() >= 30
    with pytest.raises(ParameterError, match="window=500"):
        MSF(window=500.0)
