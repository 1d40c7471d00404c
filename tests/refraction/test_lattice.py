"""The grid over an image: where its nodes are."""

import numpy as np
import pytest

from tests.refraction.comparing import assert_close
from unbend.refraction import Camera
from unbend.refraction.image import lattice_nodes

CAMERA = Camera(14000, 10600, 20000.0, 20000.0, 7000.0, 5300.0)


def test_nodes_go_from_corner_to_corner_row_by_row():
    x, y = lattice_nodes(CAMERA, 21, 15)
    across = np.arange(21) * 700.0
    down = np.arange(15) * 10600.0 / 14.0
    assert_close(x, np.tile(across, 15), rtol=1e-12)
    assert_close(y, np.repeat(down, 21), rtol=1e-12)


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        (1, 5),
        (5, 1),
        (0, 0),
    ],
)
def test_a_lattice_of_one_line_is_none(columns, rows):
    with pytest.raises(ValueError, match="two columns"):
        lattice_nodes(CAMERA, columns, rows)
