import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxfilter.core.compilation import compilations, watch_compilations
from jaxfilter.engines.grid import morphology
from jaxfilter.engines.grid.morphology import dilation, erosion, opening, progressive_opening

REACH = 9


def footprint(radius, element):
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1]
    if element == "diamond":
        return abs(x) + abs(y) <= radius
    return x * x + y * y <= radius * radius if element == "disk" else np.ones(x.shape, bool)


def surface(shape=(41, 57), seed=0):
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@pytest.mark.parametrize("element", ["disk", "square", "diamond"])
@pytest.mark.parametrize("radius", [0, 1, 2, 3, 5, 8, 9])
def test_equals_scipy_bit_for_bit(radius, element):
    z, cells = surface(), footprint(radius, element)
    eroded = ndimage.grey_erosion(z, footprint=cells, mode="constant", cval=np.inf)
    dilated = ndimage.grey_dilation(z, footprint=cells, mode="constant", cval=-np.inf)
    opened = ndimage.grey_dilation(eroded, footprint=cells, mode="constant", cval=-np.inf)
    np.testing.assert_array_equal(erosion(z, radius, REACH, element), eroded)
    np.testing.assert_array_equal(dilation(z, radius, REACH, element), dilated)
    np.testing.assert_array_equal(opening(z, radius, REACH, element), opened)


@pytest.mark.parametrize("element", ["disk", "diamond"])
@pytest.mark.parametrize("columns", [31, 300])
def test_strips_of_a_tall_grid_join(element, columns, monkeypatch):
    monkeypatch.setattr(morphology, "_STRIP", 700)
    z, cells = surface((67, columns)), footprint(7, element)
    expected = ndimage.grey_erosion(z, footprint=cells, mode="constant", cval=np.inf)
    np.testing.assert_array_equal(erosion(z, 7, REACH, element), expected)


def test_negative_infinite_and_double_precision_values_keep_their_order(rng):
    z = rng.choice(np.array([-np.inf, -3.5, -0.0, 0.0, 1e-38, 2.5, np.inf], np.float32), (30, 40))
    expected = ndimage.grey_erosion(z, footprint=footprint(2, "disk"), mode="constant", cval=np.inf)
    np.testing.assert_array_equal(erosion(z, 2, REACH), expected)


@pytest.mark.parametrize("element", ["disk", "square", "diamond"])
@pytest.mark.parametrize("radii", [[1, 2], [1, 3, 4], range(1, 13), [0, 2, 2, 11]])
def test_progressive_opening_shows_each_opening_of_the_one_before(element, radii):
    z, valid = surface(), np.zeros((41, 57), bool)
    valid[3:35, 2:50] = True

    def look(k, before, opened, found):
        return found.at[k].set(before - opened)

    nothing = jnp.zeros((len(radii), *z.shape))
    last, drops = progressive_opening(z, valid, np.array(radii), look, nothing, reach=max(radii), element=element)
    for radius, drop in zip(radii, drops, strict=True):
        opened = opening(z, radius, 12, element, valid)
        np.testing.assert_array_equal(drop, z - opened)
        z = opened
    np.testing.assert_array_equal(last, z)


def test_disk_wider_than_the_grid():
    z = surface((5, 8))
    expected = ndimage.grey_erosion(z, footprint=footprint(30, "disk"), mode="constant", cval=np.inf)
    np.testing.assert_array_equal(erosion(z, 30, 49), expected)


def test_radius_one_disk_is_the_cross():
    z = np.zeros((5, 5), np.float32)
    z[2, 2] = -1
    cross = np.zeros((5, 5), bool)
    cross[2, 1:4] = cross[1:4, 2] = True
    np.testing.assert_array_equal(np.asarray(erosion(z, 1, 1)) < 0, cross)


@pytest.mark.parametrize("element", ["disk", "square", "diamond"])
def test_opening_is_below_its_input_and_idempotent(element):
    z = surface(seed=3)
    opened = np.asarray(opening(z, 4, REACH, element))
    assert (opened <= z).all() and (opened < z).any()
    np.testing.assert_array_equal(opening(opened, 4, REACH, element), opened)


def test_opening_with_a_smaller_disk_lies_above():
    z = surface(seed=4)
    small, large = (np.asarray(opening(z, r, REACH, "square")) for r in (2, 5))
    assert (large <= small).all()


def test_padding_beyond_the_valid_cells_changes_nothing():
    z = surface()
    padded = np.full((64, 80), -1e6, np.float32)
    valid = np.zeros(padded.shape, bool)
    padded[:41, :57], valid[:41, :57] = z, True
    opened = np.asarray(opening(padded, 6, REACH, valid=valid))
    np.testing.assert_array_equal(opened[:41, :57], opening(z, 6, REACH))
    np.testing.assert_array_equal(opened[~valid], padded[~valid])


def test_all_radii_share_one_compilation():
    watch_compilations()
    z = surface((33, 35))
    erosion(z, 1, 7).block_until_ready()
    before = compilations()[0]
    for radius in range(8):
        erosion(z, radius, 7).block_until_ready()
    assert compilations()[0] == before


def test_unknown_element_is_named():
    with pytest.raises(ValueError, match="hexagon"):
        erosion(surface(), 1, 1, "hexagon")


@pytest.mark.parametrize("shape", [(5,), (2, 5, 5)])
def test_arrays_that_are_no_grid_are_refused_by_shape(shape):
    z = jnp.zeros(shape)
    for call in (morphology.erosion, morphology.dilation, morphology.opening):
        with pytest.raises(ValueError, match=rf"z of shape \({shape[0]},.*\[rows, columns\]"):
            call(z, 1, 2)
    with pytest.raises(ValueError, match=rf"z of shape \({shape[0]},"):
        morphology.progressive_opening(z, z == 0, jnp.array([1]), lambda k, before, opened, found: found, z, reach=1)
    with pytest.raises(ValueError, match=r"valid of shape .*\(4, 6\)"):
        morphology.opening(jnp.zeros((4, 6)), 1, 2, valid=z == 0)
