"""Mount and window of the simulated cameras; their lens is tested with whole missions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from unbend.simulate.optics import cameras, through_window

NADIR, OBLIQUE = cameras(20_000.0)


def test_mounts_point_where_they_say():
    """Rows of the rotation are the camera's axes in body axes: forward, right, down."""
    nadir = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    assert_allclose(NADIR.from_body(), nadir, atol=1e-15)
    half = np.sqrt(0.5)
    oblique = [[0.0, half, -half], [-1.0, 0.0, 0.0], [0.0, half, half]]
    assert_allclose(OBLIQUE.from_body(), oblique, atol=1e-15)


@pytest.mark.parametrize(
    "n_inside",
    [1.00019, 1.00023],
    ids=["same air", "denser in the cabin"],
)
def test_window_obeys_snell(n_inside):
    slope = np.radians([1e-3, 5.0, 19.0])
    rays = np.stack(
        [np.sin(slope), np.zeros(3), np.cos(slope)],
        axis=-1,
    )
    n_outside = np.full(3, 1.00019)
    inside, r_cc = through_window(rays, n_outside, np.full(3, n_inside))
    zeta_f = np.arctan2(
        inside[:, 0],
        inside[:, 2],
    )
    assert_allclose(
        n_inside * np.sin(zeta_f),
        n_outside * np.sin(slope),
        rtol=1e-14,
    )
    assert_allclose(
        r_cc,
        slope - zeta_f,
        rtol=0.0,
        atol=1e-16,
    )


def test_far_rays_are_not_folded_back_by_the_lens():
    rays = np.array([[3.0, 0.1, 1.0], [0.0, 0.0, -1.0], [0.1, 0.1, 1.0]])
    assert NADIR.sees(rays).tolist() == [False, False, True]
