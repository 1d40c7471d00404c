"""The relief of the map: its shape in metres, and which slopes are bright."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from unbend.report.flown import relief_of

LIMITS_DEG = (10.0, 10.02, 59.995, 60.005)  # west, east, south, north: a degree is 55.6 by 111.2 km


class SlopingTerrain:
    """Heights as a function of degrees east of 10 and north of 60, stored every 1e-4 degrees."""

    def __init__(self, height_of: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> None:
        self.height_of = height_of

    def nodes(self, lat_rad: np.ndarray, lon_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return (60.0 - np.degrees(lat_rad)) * 1e4, (np.degrees(lon_rad) - 10.0) * 1e4

    def heights(self, row: np.ndarray, column: np.ndarray) -> np.ndarray:
        return self.height_of(column * 1e-4, -row * 1e-4)


def plane(east: float, north: float) -> SlopingTerrain:
    """A plane that rises by so many metres a metre to the east and to the north."""
    return SlopingTerrain(lambda x, y: east * x * 55_600.0 + north * y * 111_200.0)


@pytest.mark.parametrize(
    ("east", "north", "light"),
    [
        (0.1, 0.0, math.tanh(1.0)),  # it faces the west, near the light
        (0.0, -0.1, math.tanh(1.0)),
        (-0.1, 0.0, -math.tanh(1.0)),
        (0.0, 0.1, -math.tanh(1.0)),
        (0.3, -0.4, math.tanh(1.4)),  # (0.3 + 0.4) / 0.5
        (0.3, 0.4, math.tanh(-0.2)),
        (1e-4, 0.0, math.tanh(0.1)),  # level land is not exaggerated to hills
    ],
)
def test_slopes_towards_the_north_west_are_bright(east, north, light):
    limits, drawn = relief_of(plane(east, north), LIMITS_DEG)
    np.testing.assert_allclose(drawn, light, atol=0.003)
    assert limits == pytest.approx((9.9998, 10.0202, 59.9948, 60.0052))


def test_a_node_of_the_relief_is_as_wide_as_high():
    """0.0204 degrees of longitude are 1134 m, 0.0104 of latitude 1156 m."""
    _, drawn = relief_of(plane(0.1, 0.1), LIMITS_DEG)
    assert drawn.shape == (220, 216)
    _, wide = relief_of(plane(0.1, 0.1), (10.0, 10.06, 59.995, 60.005))
    assert wide.shape == (76, 220)  # 3358 m


def test_north_is_at_the_top_and_west_on_the_left():
    corner = SlopingTerrain(lambda x, y: 100.0 * ((x > 0.01) & (y > 0.0)))
    _, drawn = relief_of(corner, LIMITS_DEG)
    edge = np.abs(drawn) > 0.1
    rows, columns = np.nonzero(edge)
    assert rows.max() < 115
    assert columns.min() > 100


def test_without_heights_there_is_no_relief():
    nowhere = SlopingTerrain(lambda x, y: np.full(x.shape, np.nan))
    assert relief_of(nowhere, LIMITS_DEG) is None
