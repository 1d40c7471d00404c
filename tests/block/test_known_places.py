"""A block's frame against positions of its images that other files know.

Truth is a block of 24 images in three lines, whose stations are turned, tilted, scaled or moved
here by plain arithmetic in east, north, up; known positions have the noise of receivers.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.flight.made_channels import image_names
from unbend.block.known_places import (
    KnownPlaces,
    PlaceComparison,
    compared_places,
    frame_notes,
)
from unbend.flight.stations import STATION_OK, empty_stations

LAT = np.radians(47.0)
LON = np.radians(8.5)
# In a radian of latitude and of longitude there, of WGS84.
MERIDIAN_M = 6_369_620.0
PARALLEL_M = 4_357_687.7
LINE, PLACE = np.divmod(np.arange(24), 8)
BLOCK = np.stack([120.0 * PLACE, 240.0 * LINE, np.full(24, 900.0)], axis=1)
"""(24, 3) east, north, up of images in three lines."""


def geodetic(enu):
    """(n, 3) latitude, longitude, height of east, north, up near one place, to centimetres."""
    east, north, up = enu.T
    return np.stack([LAT + north / MERIDIAN_M, LON + east / PARALLEL_M, up], axis=1)


def stations_at(enu):
    lat, lon, h = geodetic(enu).T
    names = image_names(*(f"{number:02d}.jpg" for number in range(len(enu))))
    made = empty_stations(names, names, STATION_OK)
    return replace(
        made,
        lat_rad=lat,
        lon_rad=lon,
        h_ellipsoid_m=h,
        h_msl_m=h - 47.0,
    )


def messages(enu, places, *, must_be_tested=True):
    """What is said of a block at these places, beside known ones."""
    return frame_notes(
        stations_at(enu),
        [("pose priors", places)],
        must_be_tested=must_be_tested,
        where="sparse",
    )


def codes(enu, places):
    return [note.code for note in messages(enu, places)]


def noisy(seed, enu=BLOCK):
    """Known positions with 2 m across and 4 m in height, and a height that counts otherwise."""
    noise_m = np.random.default_rng(seed).normal(0.0, [1.5, 1.5, 4.0], enu.shape)
    return geodetic(enu + noise_m - [0.0, 0.0, 47.0])


def moved(*east_north_up):
    return BLOCK + np.array(east_north_up)


def turned(axis, angle_deg, scale=1.0):
    """The block turned and scaled about its middle."""
    rotation = Rotation.from_euler(axis, angle_deg, degrees=True)
    middle = BLOCK.mean(axis=0)
    return middle + scale * rotation.apply(BLOCK - middle)


@pytest.mark.parametrize("seed", range(8))
def test_a_right_frame_is_confirmed(seed):
    (note,) = messages(BLOCK, noisy(seed))
    assert note.code == "FRAME-CONFIRMED"
    assert "24 images" in note.what


@pytest.mark.parametrize(
    ("enu", "says"),
    [
        (turned("z", 3.0), "turned by "),
        (turned("x", 4.0), "tilted by"),
        (turned("y", -4.0), "tilted by"),
        (turned("z", 0.0, 1.0 / 0.3048), "multiplied by 0.30"),
        (turned("z", 0.0, 0.01), "multiplied by"),
        (turned("x", 90.0), "no turn, scale and shift"),
        (moved(95.0, 0.0, 0.0), "m away"),
        (moved(0.0, 0.0, 400.0), "heights differ by -4"),
    ],
)
def test_a_wrong_frame_is_a_finding(enu, says):
    (note,) = messages(enu, noisy(3))
    assert note.code == "FRAME-PLACES"
    assert says in note.what


DRIFT_M = np.outer(np.linspace(0.0, 1.0, 24), [2.0, 1.0, 6.0])  # from the first line to the last
JITTER_M = np.random.default_rng(1).normal(0.0, 1.0, (24, 3))
OF_ANOTHER_IMAGE = noisy(5) + np.outer(np.arange(24) == 7, [1e-4, 1e-4, 0.0])
NO_HEIGHTS = noisy(6) * [1.0, 1.0, np.nan]


@pytest.mark.parametrize(
    ("enu", "places"),
    [
        (moved(5.0, 0.0, 60.0), noisy(4)),
        (BLOCK, geodetic(BLOCK + DRIFT_M + JITTER_M)),
        (BLOCK, OF_ANOTHER_IMAGE),
        (BLOCK, NO_HEIGHTS),
    ],
    ids=["5 m and 60 m of height", "drift of a receiver", "a position of another image", "level"],
)
def test_what_does_not_make_a_frame_wrong(enu, places):
    assert codes(enu, places) == ["FRAME-CONFIRMED"]


def test_heights_that_are_not_known_show_no_tilt():
    comparison = compared_places(stations_at(BLOCK), NO_HEIGHTS)
    assert np.isnan(comparison.tilt_rad)
    assert np.isnan(comparison.height_m)


def test_one_line_shows_no_tilt_across_it():
    line = BLOCK[:8]
    assert np.isnan(compared_places(stations_at(line), noisy(2, line)).tilt_rad)


def test_a_frame_that_nothing_confirms_says_so():
    nothing = np.full((24, 3), np.nan)
    (note,) = messages(BLOCK, nothing)
    assert note.code == "FRAME-UNVERIFIED"
    assert "are within 968 m, 853 to 853 m" in note.what
    latitude_deg, longitude_deg = np.degrees(geodetic(BLOCK).mean(axis=0)[:2])
    middle = f"at latitude {latitude_deg:.2f}, longitude {longitude_deg:.2f}"
    assert f"above sea level, {middle}; compare" in note.what
    stations = stations_at(BLOCK)
    (named,) = frame_notes(stations, [], must_be_tested=True, where="x", system="UTM zone 33N")
    assert f"{middle} by UTM zone 33N" in named.what
    assert "Not tested: zone, datum and offsets of the map, a turn about" in named.what
    assert "Not tested: the place, a turn about the vertical, a tilt, the scale" in note.what
    assert "stations.orientation.known_positions: {path: positions.csv}" in note.what
    assert not messages(BLOCK, nothing, must_be_tested=False)
    few = np.where(np.arange(24)[:, None] < 3, noisy(7), np.nan)
    assert codes(BLOCK, few) == ["FRAME-CONFIRMED", "FRAME-UNVERIFIED"]


@pytest.mark.parametrize(
    ("system", "last"),
    [
        ("UTM zone 33N", "a tilt of a degree"),
        ("", "a tilt of a degree, a scale about the height of the ground"),
    ],
    ids=["map", "local"],
)
def test_heights_of_tie_points_test_the_unit(system, last):
    (note,) = frame_notes(
        stations_at(BLOCK),
        [],
        must_be_tested=True,
        where="x",
        system=system,
        has_tested_heights=True,
    )
    assert f"a turn about the vertical, {last}. The 24 images" in note.what
    assert "unit" not in note.what


def test_positions_belong_to_images_by_name():
    places = KnownPlaces(
        "x",
        image_names("b", "a"),
        np.arange(6.0).reshape(2, 3),
    )
    rows = places.rows_of(image_names("a", "c", "b"))
    np.testing.assert_array_equal(
        rows,
        [
            [3, 4, 5],
            [np.nan] * 3,
            [0, 1, 2],
        ],
    )


SOUND = PlaceComparison(
    count=20,
    extent_m=2000.0,
    offset_m=0.0,
    height_m=0.0,
    residual_m=0.1,
    turn_rad=0.0,
    scale=1.0,
    sigma_turn=1e-5,
    tilt_rad=0.0,
    sigma_tilt_rad=1e-5,
    rise_residual_m=0.1,
)
A_TURN = "it is turned by 0.57 deg about the vertical"


@pytest.mark.parametrize(
    ("values", "contradictions"),
    [
        ({}, []),
        # a turn counts beyond 0.3 deg, five sigma, and 2 m or three residuals at the edge
        ({"turn_rad": np.radians(0.29)}, []),
        ({"turn_rad": np.radians(-0.31)}, ["it is turned by 0.31 deg about the vertical"]),
        ({"turn_rad": 0.01, "sigma_turn": 0.00201}, []),
        ({"turn_rad": 0.01, "sigma_turn": 0.00199}, [A_TURN]),
        ({"turn_rad": 0.01, "extent_m": 590.0, "residual_m": 1.0}, []),
        ({"turn_rad": 0.01, "extent_m": 610.0, "residual_m": 1.0}, [A_TURN]),
        ({"turn_rad": 0.01, "extent_m": 390.0}, []),
        ({"turn_rad": 0.01, "extent_m": 410.0}, [A_TURN]),
        ({"scale": 1.0049}, []),
        ({"scale": 0.9949}, ["its lengths must be multiplied by 0.9949"]),
        ({"scale": 1.1, "sigma_turn": 0.019}, []),
        # a tilt likewise, and 5 m in height
        ({"tilt_rad": np.radians(0.29)}, []),
        ({"tilt_rad": 0.01, "extent_m": 990.0}, []),
        ({"tilt_rad": 0.01, "extent_m": 1010.0}, ["it is tilted by 0.57 deg"]),
        ({"tilt_rad": 0.01, "sigma_tilt_rad": 0.0021}, []),
        ({"offset_m": 19.9, "height_m": -149.0}, []),
        ({"offset_m": 20.1}, ["it is 20 m away"]),
        ({"height_m": -151.0}, ["its heights differ by -151 m"]),
        ({"residual_m": 39.0}, []),
        ({"residual_m": 41.0}, ["no turn, scale and shift leaves less than 41 m"]),
    ],
)
def test_contradictions_are_what_no_noise_and_no_drift_makes(values, contradictions):
    assert replace(SOUND, **values).contradictions == contradictions
