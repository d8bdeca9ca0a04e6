import numpy as np
import pytest

from jaxfilter.steps.planes import fit_planes, plane_residuals


def blocks(count=20, size=30, seed=0):
    rng = np.random.default_rng(seed)
    xyz = rng.random((count, size, 3)) * [20, 20, 3] + rng.random((count, 1, 3)) * [4000, 4000, 900]
    mask = rng.random((count, size)) < 0.7
    mask[:, :4] = True
    return xyz.astype(np.float32), mask


def test_equals_least_squares_in_double_precision():
    xyz, mask = blocks()
    planes = fit_planes(xyz, mask)
    centres, gradients, residuals, slopes = map(
        np.asarray, (planes.centre, planes.gradient, plane_residuals(planes, xyz), planes.slope)
    )
    for b in range(len(xyz)):
        p = xyz[b, mask[b]].astype(float)
        centre = p.mean(axis=0)
        gradient = np.linalg.lstsq(p[:, :2] - centre[:2], p[:, 2] - centre[2], rcond=None)[0]
        np.testing.assert_allclose(gradients[b], gradient, atol=2e-4)
        np.testing.assert_allclose(centres[b], centre, atol=1e-3)
        normal = np.append(-gradient, 1) / np.hypot(1, np.hypot(*gradient))
        np.testing.assert_allclose(residuals[b, mask[b]], (p - centre) @ normal, atol=2e-3)
        assert slopes[b] == pytest.approx(np.degrees(np.arctan(np.hypot(*gradient))), abs=0.02)


def test_padding_values_and_length_do_not_matter():
    xyz, mask = blocks()
    other = np.where(mask[..., None], xyz, np.float32(1e5))
    longer = np.concatenate([other, np.zeros_like(other)], axis=1), np.concatenate([mask, np.zeros_like(mask)], axis=1)
    np.testing.assert_allclose(fit_planes(*longer).gradient, fit_planes(xyz, mask).gradient, atol=1e-5)


def test_collinear_and_short_blocks_determine_no_plane():
    xyz = np.zeros((4, 5, 3), np.float32)
    xyz[0, :, 0] = xyz[0, :, 1] = np.arange(5)
    xyz[3] = xyz[0] + np.array([0, 2, -2, 2, -2])[:, None] * [0, 0.001, 1]  # nearly on the diagonal
    xyz[1] = np.random.default_rng(0).random((5, 3))
    mask = np.ones((4, 5), bool)
    mask[1, 2:] = False
    planes = fit_planes(xyz, mask)
    assert not np.asarray(planes.determined).any() and np.isfinite(planes.gradient).all()
