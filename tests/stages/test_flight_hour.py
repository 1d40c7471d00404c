"""The hour of a flight: of its exposures or of a stated time, never of a day alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from unbend.config.dates import nanoseconds_of_date
from unbend.flight.stations import NO_TIME
from unbend.stages.flight_date import flight_hour

EAST = np.radians(15.0)  # an hour ahead of UTC
AT_EIGHT = "2026-05-14T08:00"
THAT_DAY = "2026-05-14"


@pytest.mark.parametrize(
    ("date", "exposed", "longitude_rad", "expected"),
    [
        (None, AT_EIGHT, EAST, 9.0),
        (THAT_DAY, AT_EIGHT, EAST, 9.0),
        (AT_EIGHT, None, EAST, 9.0),
        (AT_EIGHT, None, -EAST, 7.0),
        (THAT_DAY, None, EAST, None),
        (None, None, EAST, None),
        (AT_EIGHT, None, np.nan, None),
    ],
)
def test_the_hour_is_that_of_the_exposures_or_of_a_stated_time(
    date, exposed, longitude_rad, expected
):
    mission = SimpleNamespace(
        mission=SimpleNamespace(date=date),
        stations=SimpleNamespace(orientation=None),
    )
    utc_ns = NO_TIME
    if exposed is not None:
        utc_ns = nanoseconds_of_date(exposed)
    stations = SimpleNamespace(
        utc_ns=np.array([utc_ns]),
        median_longitude_rad=longitude_rad,
    )
    flight_ns = nanoseconds_of_date(exposed or date)
    assert flight_hour(mission, stations, flight_ns) == pytest.approx(expected)
