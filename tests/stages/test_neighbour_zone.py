"""Stations in a UTM zone whose soundings lie near the same x and y of another zone."""

import numpy as np
import pytest

from tests.block.test_known_places import BLOCK, stations_at
from unbend.atmosphere.estimate.external_readings import TimeAndPlace
from unbend.atmosphere.soundings import Sounding
from unbend.block.known_places import frame_notes
from unbend.messages import Ledger
from unbend.stages.neighbour_zone import zone_findings

PAYERNE_DEG = (46.81, 6.94)
VIENNA_DEG = (48.2, 16.4)
ROME_DEG = (41.7, 12.5)
NOWHERE = (np.nan, np.nan)
LATITUDE_DEG = 47.42


def sounding_at(latitude_deg, longitude_deg):
    return Sounding(
        h_m=np.array([500.0, 1000.0]),
        pressure_pa=np.array([95e3, 90e3]),
        temperature_k=np.array([290.0, 287.0]),
        vapour_pressure_pa=np.zeros(2),
        latitude_rad=np.radians(latitude_deg),
        longitude_rad=np.radians(longitude_deg),
    )


def findings_at(crs, longitude_deg, soundings=(PAYERNE_DEG,), ledger=()):
    flight = TimeAndPlace(
        latitude_rad=np.radians(LATITUDE_DEG),
        longitude_rad=np.radians(longitude_deg),
    )
    placed = [sounding_at(*place) for place in soundings]
    key = "stations.orientation.crs"
    found = tuple(zone_findings(crs, key, placed, flight, Ledger(ledger)))
    assert {finding.code for finding in found} <= {"PLAUSIBLE-ZONE"}
    return [finding.what for finding in found]


@pytest.mark.parametrize(
    ("crs", "longitude_deg", "stated"),
    [
        ("EPSG:25833", 14.66, "by UTM zone 33N, 588 km"),
        ("EPSG:32631", 2.66, "by UTM zone 31N, 331 km"),
    ],
)
def test_the_zone_in_which_a_sounding_is_near_is_named(crs, longitude_deg, stated):
    (what,) = findings_at(crs, longitude_deg)
    assert stated in what
    assert "by zone 32N they would be at longitude 8.66, 147 km from it" in what


@pytest.mark.parametrize(
    ("crs", "longitude_deg", "soundings"),
    [
        ("EPSG:25832", 8.66, [PAYERNE_DEG]),  # the right zone
        ("EPSG:25833", 14.66, [PAYERNE_DEG, VIENNA_DEG]),  # another sounding is near
        ("EPSG:25833", 14.66, [ROME_DEG]),  # far in every zone
        ("EPSG:25833", 14.66, [NOWHERE]),
        ("EPSG:25833", 14.66, []),
        ("EPSG:2056", 14.66, [PAYERNE_DEG]),  # no zone of UTM
        ("", 14.66, [PAYERNE_DEG]),
    ],
)
def test_nothing_speaks_against_a_zone(crs, longitude_deg, soundings):
    assert findings_at(crs, longitude_deg, soundings) == []


def test_a_confirmed_frame_is_in_its_zone():
    places = stations_at(BLOCK)
    position = np.stack([places.lat_rad, places.lon_rad, places.h_ellipsoid_m], axis=1)
    confirmed = frame_notes(
        places,
        [("x", position)],
        must_be_tested=True,
        where="x",
    )
    assert findings_at("EPSG:25833", 14.66, ledger=confirmed) == []


def test_zones_go_round_the_earth():
    (what,) = findings_at("EPSG:32601", -177.0, [(47.0, 177.0)])
    assert "by zone 60N they would be at longitude 177.00" in what
