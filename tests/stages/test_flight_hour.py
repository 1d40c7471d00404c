"""The hour of a flight: of its exposures or of a stated time, never of a day alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from unbend.config.dates import nanoseconds_of_date
from unbend.flight.stations import NO_TIME
from unbend.stages.flight_date import flight_hour

EAST = np.radians(15.0)  # an hour ahead of UTC


def hour(stated: str | None, utc_ns: int = NO_TIME, longitude_rad: float = EAST) -> float | None:
    mission = SimpleNamespace(
        mission=SimpleNamespace(date=stated), stations=SimpleNamespace(orientation=None)
    )
    stations = SimpleNamespace(utc_ns=np.array([utc_ns]), median_longitude_rad=longitude_rad)
    flight_ns = nanoseconds_of_date(stated) if utc_ns == NO_TIME else utc_ns
    return flight_hour(mission, stations, flight_ns)


def test_exposures_tell_the_hour():
    at_eight = nanoseconds_of_date("2026-05-14T08:00")
    assert hour(None, at_eight) == pytest.approx(9.0)
    assert hour("2026-05-14", at_eight) == pytest.approx(9.0)


def test_a_stated_time_tells_the_hour_and_a_day_does_not():
    assert hour("2026-05-14T08:00") == pytest.approx(9.0)
    assert hour("2026-05-14") is None
    assert hour(None) is None


def test_without_a_longitude_there_is_no_hour():
    assert hour("2026-05-14T08:00", longitude_rad=np.nan) is None
