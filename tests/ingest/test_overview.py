"""What a log says of its flight and of its receivers: numbers that stand in JSON only."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from tests.helpers import channel
from unbend.ingest.flight_log import describe
from unbend.ingest.overview import flight_of, receivers_of, roles_of

BEGIN_S = 1_700_000_000.0  # in November 2023
SECONDS = BEGIN_S + np.arange(1001.0)
LATITUDE = np.radians(47.3977 + 1e-5 * np.arange(1001.0))
LONGITUDE = np.radians(-122.25)
HEIGHTS = 500.0 + np.arange(1001.0)


def receiver(name, seconds=SECONDS, **columns):
    places = {"lat_rad": LATITUDE[: len(seconds)], "lon_rad": LONGITUDE}
    heights = {"h_ellipsoid_m": HEIGHTS[: len(seconds)]}
    return channel(name, seconds, "position", "height", **places | heights | columns)


def test_the_flight_of_known_channels():
    latitude = LATITUDE.copy()
    latitude[:2] = np.nan
    fixes = receiver("GPS", lat_rad=latitude)
    assert flight_of(fixes, fixes, home_m=437.26) == {
        "lat_deg": 47.398,
        "lon_deg": -122.25,
        "date_utc": "2023-11-14",
        "duration_s": 1000.0,
        "height_reference": "ellipsoid",
        "lowest_m": 501.0,
        "highest_m": 1499.0,
        "take_off_m": 437.3,
        "take_off_reference": "sea level",
        "take_off_by": "home of the autopilot",
    }


REPORTS = yaml.safe_load("""
- [{sigma_h_m: 0.42, hdop: 1.2}, '± 0.42 m, as reported']
- [{hdop: 1.2}, HDOP 1.2]
- [{}, no report of its accuracy]
""")


@pytest.mark.parametrize(("columns", "report"), REPORTS)
def test_why_a_receiver_is_good_or_not(columns, report):
    first = replace(receiver("GPS", sigma_h_m=0.3), rank=20)
    moved = LATITUDE[:981] + 5.0 / 6_367_400.0
    second = receiver("GPS2", SECONDS[:981], lat_rad=moved, **columns)
    chosen, spare = receivers_of([first, replace(second, rank=30)])
    assert chosen == {
        "channel": "GPS",
        "vehicle": "",
        "good_for": "position, height",
        "why": "± 0.3 m, as reported",
    }
    assert spare["good_for"] == "spare of GPS"
    apart = "5.0 m from GPS in the median"
    assert spare["why"] == f"{report}, {apart}, silent in the last 20 s"


def test_the_channel_of_each_role():
    barometer = channel("BARO", SECONDS, "pressure", "cabin_pressure", pressure_pa=9e4)
    _, rows = roles_of([receiver("GPS"), barometer])
    by_role = {row["role"]: row for row in rows}
    assert by_role["pressure"]["channel"] is None
    assert by_role["pressure"]["others"] == ["BARO"]
    height = by_role["height"]
    assert height["channel"] == "GPS"
    assert height["rate_hz"] == pytest.approx(1.0)
    assert height["samples"] == 1001
    assert height["others"] == []
    assert height["remark"] == "plausible"
    assert by_role["cabin_pressure"]["remark"] == "only if a camera has a window"
    assert by_role["airspeed"]["remark"] == "none in the log"


def test_a_gap_begins_with_the_last_sample_before_it():
    barometer = channel("BARO", np.delete(SECONDS, slice(100, 130)), "pressure", pressure_pa=9e4)
    summary = describe(barometer)
    assert summary["gaps"] == [{"start_utc": "2023-11-14T22:14:59.000000Z", "seconds": 31.0}]
    assert summary["start_utc"] == "2023-11-14T22:13:20.000000Z"
    assert summary["end_utc"] == "2023-11-14T22:30:00.000000Z"
    assert summary["samples"] == 971
