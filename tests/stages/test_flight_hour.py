"""The hour of a flight, of its exposures or of a stated time; and dates that sources contradict."""

from types import SimpleNamespace

import numpy as np
import pytest

from unbend.config.dates import nanoseconds_of_date
from unbend.flight.stations import NO_TIME
from unbend.stages.flight_date import doubt_of_date, flight_hour

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


# ---- dates that sources contradict

STATED_DAY = "2025-12-06"
JUNE_12 = "2025-06-12T12:00"
METAR_OF_THE_12TH = "LSZH 120950Z 24008KT CAVOK 17/10 Q1021"
METAR_OF_THE_5TH = "LSZH 052350Z 24008KT CAVOK 17/10 Q1021"
OR_WRONG = "; or the stated date 2025-12-06 (mission.date) is wrong"
OR_EXCHANGED = (
    "; or the stated date 2025-12-06 (mission.date) is wrong: with day and month exchanged, "
    "2025-06-12, it fits"
)


def doubt(date, launches=(), metars=(), *, exposed=None):
    """What is said of a stated date beside soundings of some times, and METARs."""
    surface = [SimpleNamespace(metar=metar, time_ns=None) for metar in metars]
    mission = SimpleNamespace(
        mission=SimpleNamespace(date=date),
        stations=SimpleNamespace(orientation=None),
        atmosphere=SimpleNamespace(surface=surface),
    )
    utc_ns = NO_TIME if exposed is None else nanoseconds_of_date(exposed)
    stations = SimpleNamespace(utc_ns=np.array([utc_ns]))
    soundings = [SimpleNamespace(time_ns=nanoseconds_of_date(launch)) for launch in launches]
    return doubt_of_date(mission, stations, soundings)


@pytest.mark.parametrize(
    ("date", "launches", "metars", "expected"),
    [
        (STATED_DAY, [JUNE_12], [METAR_OF_THE_12TH], OR_EXCHANGED),
        (f"{STATED_DAY}T09:40:00Z", [JUNE_12, None], [], OR_EXCHANGED),
        (STATED_DAY, [], [METAR_OF_THE_12TH], OR_EXCHANGED),
        (STATED_DAY, [JUNE_12], ["LSZH 200950Z 24008KT CAVOK 17/10 Q1021"], OR_WRONG),
        (STATED_DAY, [JUNE_12, "2025-01-12"], [], OR_WRONG),
        (STATED_DAY, ["2025-12-08T00:10"], [], OR_WRONG),  # 36 h from its noon, and 10 min
        (STATED_DAY, ["2025-12-07T23:50", JUNE_12], [], ""),
        (STATED_DAY, [JUNE_12], [METAR_OF_THE_5TH], ""),  # confirms the day
        (STATED_DAY, [None], [], ""),
        (STATED_DAY, [], [], ""),
        (None, [], [], ""),
    ],
)
def test_a_stated_date_that_no_source_is_near_is_in_doubt(date, launches, metars, expected):
    assert doubt(date, launches, metars) == expected


def test_a_date_of_exposures_is_not_in_doubt():
    assert doubt(STATED_DAY, [JUNE_12], exposed=STATED_DAY) == ""
    assert doubt("2025-12-16", [JUNE_12]).endswith("(mission.date) is wrong")
