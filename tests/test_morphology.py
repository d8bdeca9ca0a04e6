import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

import jaxfilter as jf
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
def test_equals_scipy_bit_for_bit_whatever_lies_beyond_the_valid_cells(radius, element):
    z, cells = surface(), footprint(radius, element)
    eroded = ndimage.grey_erosion(z, footprint=cells, mode="constant", cval=np.inf)
    dilated = ndimage.grey_dilation(z, footprint=cells, mode="constant", cval=-np.inf)
    opened = ndimage.grey_dilation(eroded, footprint=cells, mode="constant", cval=-np.inf)
    np.testing.assert_array_equal(erosion(z, radius, REACH, element), eroded)
    np.testing.assert_array_equal(dilation(z, radius, REACH, element), dilated)
    padded, valid = np.full((64, 80), -1e6, np.float32), np.zeros((64, 80), bool)
    padded[:41, :57], valid[:41, :57] = z, True
    found = np.asarray(opening(padded, radius, REACH, element, valid))
    np.testing.assert_array_equal(found[:41, :57], opened)
    np.testing.assert_array_equal(found[~valid], padded[~valid])


@pytest.mark.parametrize("element", ["disk", "diamond"])
@pytest.mark.parametrize("columns", [31, 300])
def test_strips_of_a_tall_grid_join(element, columns, monkeypatch):
    monkeypatch.setattr(morphology, "_STRIP", 700)
    z, cells = surface((67, columns)), footprint(7, element)
    expected = ndimage.grey_erosion(z, footprint=cells, mode="constant", cval=np.inf)
    np.testing.assert_array_equal(erosion(z, 7, REACH, element), expected)


@pytest.mark.parametrize("element", ["disk", "square", "diamond"])
@pytest.mark.parametrize("radii", [[0, 1, 2, 3], [2, 2, 5, 11], [1, 4, 7, 12]])
def test_progressive_opening_shows_each_opening_of_the_one_before(element, radii):
    z, valid = surface(), np.zeros((41, 57), bool)
    valid[3:35, 2:50] = True

    def look(k, before, opened, found):
        return found.at[k].set(before - opened)

    nothing = jnp.zeros((len(radii), *z.shape))
    last, drops = progressive_opening(z, valid, np.array(radii), look, nothing, reach=12, element=element)
    for radius, drop in zip(radii, drops, strict=True):
        opened = opening(z, radius, 12, element, valid)
        np.testing.assert_array_equal(drop, z - opened)
        z = opened
    np.testing.assert_array_equal(last, z)


def test_disk_wider_than_the_grid():
    z = surface((5, 8))
    expected = ndimage.grey_erosion(z, footprint=footprint(30, "disk"), mode="constant", cval=np.inf)
    np.testing.assert_array_equal(erosion(z, 30, 49), expected)


WHOLE = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
NUMBERS = [*WHOLE, "float16", "bfloat16", "float32", "float64"]
OPENED = {
    "erosion": lambda z, element: erosion(z, 1, 2, element),
    "dilation": lambda z, element: dilation(z, 1, 2, element),
    "opening": lambda z, element: opening(z, 1, 2, element),
    "progressive_opening": lambda z, element: progressive_opening(
        z, np.ones(z.shape, bool), [1], lambda k, before, opened, found: found, 0, reach=2, element=element
    )[0],
}


def extreme(name, shape=(4, 5)):
    """Numbers of a type, its least and largest among them; of 64 bits those of 32, which is what JAX has without x64."""
    kind = jnp.dtype(name)
    if name in WHOLE:
        ends = np.iinfo(name.replace("64", "32"))
        values = [ends.min, ends.max, 0, 5, 7, ends.max - 1, ends.min + 1]
    else:
        values = [-np.inf, -3.5, -0.0, 0.0, 0.25, 2.5, np.inf]
    return np.random.default_rng(3).choice(np.array(values, kind), shape)


def scipy_of(name, z, cells):
    """In float64, which holds all numbers of 32 bits; nothing lies beyond the border."""
    out = z.astype(np.float64)
    if name != "dilation":
        out = ndimage.grey_erosion(out, footprint=cells, mode="constant", cval=np.inf)
    if name != "erosion":
        out = ndimage.grey_dilation(out, footprint=cells, mode="constant", cval=-np.inf)
    return out


@pytest.mark.parametrize("name", NUMBERS)
def test_numbers_of_all_types_are_those_of_scipy(name):
    """All operations for one type of each kind, and for others the opening, which is made of an erosion and a dilation."""
    shapes = [((4, 5), "disk"), ((4, 5), "square"), ((1, 1), "disk")]
    for operation in OPENED if name in ("int8", "uint16", "bfloat16", "float32") else ["opening"]:
        for shape, element in shapes if name == "float32" else shapes[:1]:
            z = extreme(name, shape)
            made = np.asarray(OPENED[operation](z, element))
            np.testing.assert_array_equal(made.astype(np.float64), scipy_of(operation, z, footprint(1, element)))
            assert made.dtype.name == name.replace("64", "32")


@pytest.mark.parametrize(
    "name, ends", [("int64", [-(2**62), 2**62 + 1]), ("uint64", [1, 2**64 - 2]), ("float64", [-1e300, 1 + 1e-12])]
)
def test_numbers_of_64_bits_count_where_jax_has_them_and_are_refused_where_they_do_not_fit(name, ends):
    z = np.random.default_rng(5).choice(np.array([*ends, 3], name), (3, 4))
    wide = np.pad(z, 1, mode="edge")
    jax.config.update("jax_enable_x64", True)
    try:
        for made, pick in ((erosion(z, 1, 1), np.minimum), (dilation(z, 1, 1), np.maximum)):
            cross = (wide[1:-1, 1:-1], wide[:-2, 1:-1], wide[2:, 1:-1], wide[1:-1, :-2], wide[1:-1, 2:])
            np.testing.assert_array_equal(made, functools.reduce(pick, cross))
            assert made.dtype == name
        np.testing.assert_array_equal(opening(z, 1, 1), dilation(erosion(z, 1, 1), 1, 1))
    finally:
        jax.config.update("jax_enable_x64", False)
    if name != "float64":
        with pytest.raises(jf.InputError, match=rf"z holds .*{z.max()}: more than u?int32"):
            dilation(z, 1, 1)


@pytest.mark.parametrize("call", [*OPENED.values(), lambda z, element: morphology.run_minima(z, 1, 1, 0)])
def test_what_is_no_grid_of_numbers_is_refused_by_name(call):
    wrong = [np.zeros(shape) for shape in ((0, 0), (0, 5), (5, 0), (4,), (2, 3, 4))]
    wrong += [np.ones((2, 3), kind) for kind in (bool, complex, object, "U3", "M8[s]")]
    wrong += [
        np.ma.array(np.ones((2, 2)), mask=np.eye(2, dtype=bool)),
        np.array([[1.0, np.nan]]),
        jnp.array([[jnp.nan]]),
    ]
    for z in wrong:
        with pytest.raises(jf.InputError, match=r"^z "):
            call(z, "disk")
    with pytest.raises(jf.InputError, match=r"^z is bool"):
        jax.jit(jax.vmap(lambda z: call(z, "disk")))(np.ones((2, 3, 4), bool))


def test_lists_are_arrays_and_other_arguments_are_refused_by_name():
    assert dilation([[0, 5, 0]], 1, reach=1).tolist() == [[5, 5, 5]]
    np.testing.assert_array_equal(opening([[0.0, 5.0, 0.0]], 1, 1, valid=[[True, True, False]]), [[0.0, 0.0, 0.0]])
    z = np.zeros((2, 3), np.float32)
    for arguments, name in (
        ({"radius": 1.5}, "radius"), ({"radius": [1]}, "radius"), ({"radius": None}, "radius"), ({"radius": 2**40}, "radius"),
        ({"reach": -1}, "reach"), ({"reach": 1.0}, "reach"), ({"reach": True}, "reach"),
        ({"element": 3}, "element"), ({"element": "hexagon"}, "element"),
        ({"valid": np.ones((2, 3), int)}, "valid"), ({"valid": np.ones((3, 2), bool)}, "valid"),
    ):  # fmt: skip
        with pytest.raises(jf.JaxfilterError, match=f"^{name}"):
            opening(z, **{"radius": 1, "reach": 1} | arguments)
    with pytest.raises(jf.InputError, match=r"^z is int64"):  # their differences need not fit
        morphology.raised_cells(z.astype(int), z == 0, [1], [0.5], reach=1)
    with pytest.raises(jf.InputError, match=r"^heights of shape \(2,\).*here \(1\)"):
        morphology.raised_cells(z, z == 0, [1], [0.5, 1.0], reach=1)
