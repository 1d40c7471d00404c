"""The grid over an image: where its nodes lie, and that nothing is approximated there."""

from __future__ import annotations

import numpy as np
import pytest

from unbend.refraction.camera.camera import Camera
from unbend.refraction.image import lattice_nodes

CAMERA = Camera(14000, 10600, 20000.0, 20000.0, 7000.0, 5300.0)


def test_nodes_go_from_corner_to_corner_row_by_row():
    x, y = lattice_nodes(CAMERA, 21, 15)
    assert x.shape == y.shape == (315,)
    assert (x[0], y[0]) == (0.0, 0.0)
    assert (x[20], y[20]) == (14000.0, 0.0)
    assert (x[21], y[21]) == (0.0, pytest.approx(10600.0 / 14.0))
    assert (x[-1], y[-1]) == (14000.0, 10600.0)
    assert np.allclose(np.diff(x[:21]), 700.0, rtol=1e-12)


@pytest.mark.parametrize(("columns", "rows"), [(1, 5), (5, 1), (0, 0)])
def test_a_lattice_of_one_line_is_none(columns, rows):
    with pytest.raises(ValueError, match="two columns"):
        lattice_nodes(CAMERA, columns, rows)
