"""Heights above the sea, the ellipsoid and the take-off, and places of local positions."""

import numpy as np
import pyproj
import pytest

from tests.flight.made_channels import instants, located, usable_stations
from tests.helpers import channel, refused, with_code
from unbend.errors import MissionError
from unbend.flight.heights import (
    GeodeticOrigin,
    HeightSystem,
    ground_offsets,
    height_system,
    heights_at,
    to_geodetic,
)
from unbend.geodesy import GeoidGrid

SECONDS = np.arange(10.0)
LATITUDE = np.radians(47.0)
LONGITUDE = np.radians(8.0)
PLACE = {"lat_rad": LATITUDE, "lon_rad": LONGITUDE}
NORTH_BY_HALF_A_DEGREE = (np.radians([47.5]), np.radians([8.0]))
# 40 m at the parallel of the place, and 2 m more in each degree to the north.
PLANE = np.outer([-2.0, 0.0, 2.0], np.ones(360)) + 40.0
GRID = GeoidGrid("plane", PLANE.astype(np.float32), 46.0, -180.0, 1.0, 1.0)


def gnss(**heights):
    return channel("GPS", SECONDS, **PLACE, **heights)


def test_a_geoid_gives_the_undulation_place_by_place():
    height = gnss(h_ellipsoid_m=1048.0)
    system, notes = height_system({"height": height}, None, GRID)
    assert notes == ()
    assert system.source == "plane"
    assert system.undulation(*NORTH_BY_HALF_A_DEGREE) == pytest.approx(41.0)
    h_msl_m, _ = heights_at(height, instants(5.0), system, 1.0)
    assert h_msl_m == pytest.approx([1008.0], abs=1e-3)


def test_two_heights_of_the_log_move_the_geoid():
    """They are 41.5 m apart here: 1.5 m more than the grid."""
    both = gnss(h_ellipsoid_m=1041.5, h_msl_m=1000.0)
    system, _ = height_system({"height": both}, None, GRID)
    assert system.undulation(*NORTH_BY_HALF_A_DEGREE) == pytest.approx(42.5)
    assert "GPS" in system.source


def test_the_undulation_of_the_mission_file_comes_before_that_of_the_log():
    h_ellipsoid_m = np.full(10, 1048.0)
    h_ellipsoid_m[-1] = np.nan
    roles = {"height": gnss(h_msl_m=1000.0, h_ellipsoid_m=h_ellipsoid_m)}
    for stated_m, undulation_m in ((None, 48.0), (47.0, 47.0)):
        system, _ = height_system(roles, stated_m)
        assert system.undulation_m == undulation_m


@pytest.mark.parametrize(
    ("stated_m", "kinds"),
    [
        (45.1, []),
        (44.9, ["warning"]),
        (38.1, ["warning"]),
        (37.9, ["finding"]),
        (-48.0, ["finding"]),
    ],
)
def test_an_undulation_that_the_log_contradicts_is_reported(stated_m, kinds):
    """By more than 3 m, and by more than 10 m."""
    both = gnss(h_msl_m=1000.0, h_ellipsoid_m=1048.0)
    _, notes = height_system({"height": both}, stated_m)
    assert [note.kind for note in with_code(notes, "HEIGHT-GEOID")] == kinds


@pytest.mark.parametrize(
    ("apart_m", "stated_m", "h_ellipsoid_m", "messages"),
    [
        (0.0, 48.0, 653.0, 1),
        (0.001, None, 605.001, 0),
    ],
    ids=["one", "two"],
)
def test_two_heights_that_are_one_are_reported_and_one_is_not_used(
    apart_m,
    stated_m,
    h_ellipsoid_m,
    messages,
):
    h_msl_m = 600.0 + SECONDS
    height = gnss(h_msl_m=h_msl_m, h_ellipsoid_m=h_msl_m + apart_m)

    system, notes = height_system({"height": height}, stated_m)

    heights_m = heights_at(height, instants(5.0), system, 1.0)
    np.testing.assert_allclose(heights_m, [[605.0], [h_ellipsoid_m]], rtol=1e-6)
    same = with_code(notes, "HEIGHT-SAME")
    assert len(same) == messages
    for note in same:
        assert "the undulation of 48.0 m" in note.what


LONG_S = np.arange(100.0)


@pytest.mark.parametrize(
    ("h_msl_m", "above_home_m", "home_m", "says"),
    [
        (
            np.where(LONG_S < 50, 510.0, 517.0),
            10.0,
            None,
            "changes between",
        ),
        (
            510.0,
            np.where(LONG_S < 70, 510.0, 10.0),
            500.0,
            "take-off height 500.00 m above mean sea level",
        ),
    ],
    ids=["two flights", "set late"],
)
def test_a_take_off_height_counts_if_it_is_one(h_msl_m, above_home_m, home_m, says):
    position = channel("POS", LONG_S, h_msl_m=h_msl_m, h_home_m=above_home_m)
    system, notes = height_system({"position": position}, None)
    assert system.home_h_msl_m == home_m
    assert located(notes) == [("note", "HEIGHT-HOME", "POS")]
    assert says in notes[0].what


def station(h_ellipsoid_m):
    """A usable station 1000 m above the sea."""
    made = usable_stations(instants(0), "image")
    made.h_msl_m[:] = 1000.0
    made.h_ellipsoid_m[:] = h_ellipsoid_m
    return made


@pytest.mark.parametrize(
    ("reference", "offset_m"),
    [
        ("msl", 0.0),
        ("ellipsoid", -48.0),
        ("relative", 430.0),
    ],
)
def test_what_makes_a_ground_height_one_above_the_sea(reference, offset_m):
    heights = HeightSystem(home_h_msl_m=430.0)
    assert ground_offsets(reference, station(1048.0), heights).tolist() == [offset_m]


@pytest.mark.parametrize(
    ("reference", "unknown"), [("relative", "take-off"), ("ellipsoid", "undulation")]
)
def test_ground_heights_above_what_is_unknown_are_refused(reference, unknown):
    with refused("HEIGHT-REFERENCE", MissionError, says=unknown):
        ground_offsets(reference, station(np.nan), HeightSystem())


def test_local_positions_get_a_place():
    pose = channel(
        "/pose",
        [0.0, 1.0],
        east_m=[0, 100],
        north_m=[0, 200],
        up_m=[0, 10],
    )

    placed = to_geodetic(pose, GeodeticOrigin(LATITUDE, LONGITUDE, 500.0))

    assert placed["h_ellipsoid_m"][0] == pytest.approx(500.0, abs=1e-6)
    # By PROJ: east, north and up of the first place.
    enu_of_place = (
        "+proj=pipeline +step +proj=cart +ellps=WGS84 "
        "+step +proj=topocentric +lon_0=8 +lat_0=47 +h_0=500 +ellps=WGS84"
    )
    to_enu = pyproj.Transformer.from_pipeline(enu_of_place)
    enu_m = to_enu.transform(
        placed["lon_rad"],
        placed["lat_rad"],
        placed["h_ellipsoid_m"],
        radians=True,
    )
    moved_m = np.transpose(enu_m)
    assert moved_m == pytest.approx(np.array([[0, 0, 0], [100, 200, 10]]), abs=1e-6)
