"""The relief of the map: its shape in metres, and which slopes are bright."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import yaml

from unbend.report.figure_data import relief_of

LIMITS_DEG = (10.0, 10.02, 59.995, 60.005)  # west, east, south, north
EAST_M = 55_600.0  # a degree at 60 degrees of latitude
NORTH_M = 111_200.0
STEP_DEG = 1e-4  # of the nodes


@dataclass
class Terrain:
    """Heights as a function of degrees east of 10 and north of 60."""

    height: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def nodes(self, lat_rad, lon_rad):
        south = 60.0 - np.degrees(lat_rad)
        east = np.degrees(lon_rad) - 10.0
        return south / STEP_DEG, east / STEP_DEG

    def heights(self, row, column):
        east = column * STEP_DEG
        north = -row * STEP_DEG
        return self.height(east, north)


def plane(east_slope, north_slope) -> Terrain:
    """A plane that rises by so many metres a metre to the east and to the north."""

    def height(east, north):
        rise = east_slope * EAST_M * east
        return rise + north_slope * NORTH_M * north

    return Terrain(height)


SLOPES = yaml.safe_load("""
- [0.1, 0.0, 1.0]  # it faces the west, near the light
- [0.0, -0.1, 1.0]
- [-0.1, 0.0, -1.0]
- [0.0, 0.1, -1.0]
- [0.3, -0.4, 1.4]  # (0.3 + 0.4) / 0.5
- [0.3, 0.4, -0.2]
- [0.0001, 0.0, 0.1]  # level land is not exaggerated to hills
""")


@pytest.mark.parametrize(("east", "north", "light"), SLOPES)
def test_slopes_towards_the_north_west_are_bright(east, north, light):
    limits, drawn = relief_of(plane(east, north), LIMITS_DEG)
    np.testing.assert_allclose(drawn, np.tanh(light), atol=0.003)
    assert limits == pytest.approx((9.9998, 10.0202, 59.9948, 60.0052))


def test_a_node_of_the_relief_is_as_wide_as_high():
    """0.0204 degrees of longitude are 1134 m, 0.0104 of latitude 1156 m."""
    slope = plane(0.1, 0.1)
    _, drawn = relief_of(slope, LIMITS_DEG)
    assert drawn.shape == (220, 216)
    _, wide = relief_of(slope, (10.0, 10.06, 59.995, 60.005))
    assert wide.shape == (76, 220)  # 3358 m


def test_north_is_at_the_top_and_west_on_the_left():
    def corner(east, north):
        return 100.0 * ((east > 0.01) & (north > 0.0))

    _, drawn = relief_of(Terrain(corner), LIMITS_DEG)
    is_edge = np.abs(drawn) > 0.1
    rows, columns = np.nonzero(is_edge)
    assert rows.max() < 115
    assert columns.min() > 100


def test_without_heights_there_is_no_relief():
    def unknown(east, _):
        return np.full(east.shape, np.nan)

    assert relief_of(Terrain(unknown), LIMITS_DEG) is None
