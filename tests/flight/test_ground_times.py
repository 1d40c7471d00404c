"""When an aircraft stands on the ground."""

from __future__ import annotations

import numpy as np

from unbend.flight.channels import Channel, Source
from unbend.flight.ground_times import times_on_the_ground

SECOND_NS = 1_000_000_000


def test_a_longitude_that_is_unknown_hides_no_landing():
    """A minute on the ground, a flight of ten minutes to the east, a minute on the ground."""
    seconds = np.arange(720)
    flown_s = np.clip(seconds - 60, 0, 600)
    height_m = 400.0 + np.minimum(np.minimum(flown_s, 600 - flown_s) * 2.0, 100.0)
    lon_rad = 0.15 + flown_s * 20.0 / 6.37e6
    lon_rad[300] = np.nan
    columns = {"lat_rad": np.full(720, 0.8), "lon_rad": lon_rad, "h_msl_m": height_m}
    position = Channel("GPS", seconds * SECOND_NS, columns, Source("GPS"))
    on_the_ground_s = times_on_the_ground(position) // SECOND_NS
    assert set(range(61)) <= set(on_the_ground_s.tolist())
    assert set(range(661, 720)) <= set(on_the_ground_s.tolist())
    assert not set(range(70, 650)) & set(on_the_ground_s.tolist())
