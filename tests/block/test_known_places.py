"""A block's frame against positions of its images that other files know.

Truth is a block of 24 images in three lines, whose stations are turned, tilted, scaled or moved
here by plain arithmetic in east, north, up; known positions have the noise of receivers.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from unbend.block.known_places import (
    KnownPlaces,
    PlaceComparison,
    compared_places,
    frame_notes,
)
from unbend.flight.stations import STATION_OK, empty_stations

PLACE = np.radians([47.0, 8.5])
A = 6378137.0
E2 = 0.00669437999014


def geodetic(enu: np.ndarray) -> np.ndarray:
    """(n, 3) latitude, longitude, height of east, north, up near one place, to centimetres."""
    sine = np.sin(PLACE[0])
    meridian = A * (1 - E2) / (1 - E2 * sine**2) ** 1.5
    prime = A / np.sqrt(1 - E2 * sine**2)
    lat = PLACE[0] + enu[:, 1] / meridian
    lon = PLACE[1] + enu[:, 0] / (prime * np.cos(PLACE[0]))
    return np.stack([lat, lon, enu[:, 2]], axis=1)


def block(spacing_m: float = 120.0) -> np.ndarray:
    """(24, 3) east, north, up of images in three lines."""
    line, image = np.divmod(np.arange(24), 8)
    return np.stack([spacing_m * image, 2 * spacing_m * line, 900.0 + 0.0 * line], axis=1)


def moved(east: float, north: float, up: float) -> np.ndarray:
    return block() + np.array([east, north, up])


def stations_at(enu: np.ndarray):
    lat, lon, h = geodetic(enu).T
    names = np.array([f"{k:02d}.jpg" for k in range(len(enu))], object)
    stations = empty_stations(names, np.full(len(enu), "c", object), STATION_OK)
    return replace(stations, lat_rad=lat, lon_rad=lon, h_ellipsoid_m=h, h_msl_m=h - 47.0)


def codes(enu: np.ndarray, known: np.ndarray, *, must_be_tested: bool = True) -> dict[str, str]:
    notes = frame_notes(
        stations_at(enu), [("pose priors", known)], must_be_tested=must_be_tested, where="sparse"
    )
    return {note.code: note.what for note in notes}


def about_middle(enu: np.ndarray, rotation: Rotation, scale: float = 1.0) -> np.ndarray:
    middle = enu.mean(axis=0)
    return middle + scale * rotation.apply(enu - middle)


def noisy(enu: np.ndarray, seed: int) -> np.ndarray:
    """Known positions with 2 m across and 4 m in height, and a height that counts otherwise."""
    draw = np.random.default_rng(seed)
    sigma = np.array([1.5, 1.5, 4.0])
    return geodetic(enu + draw.normal(0.0, sigma, enu.shape) + [0.0, 0.0, -47.0])


@pytest.mark.parametrize("seed", range(8))
def test_a_right_frame_is_confirmed(seed):
    told = codes(block(), noisy(block(), seed))
    assert [*told] == ["FRAME-CONFIRMED"]
    assert "24 images" in told["FRAME-CONFIRMED"]


@pytest.mark.parametrize(
    ("rotation", "scale", "words"),
    [
        (Rotation.from_euler("z", 3.0, degrees=True), 1.0, "turned by "),
        (Rotation.from_euler("x", 4.0, degrees=True), 1.0, "tilted by"),
        (Rotation.from_euler("y", -4.0, degrees=True), 1.0, "tilted by"),
        (Rotation.identity(), 1.0 / 0.3048, "multiplied by 0.30"),
        (Rotation.identity(), 0.01, "multiplied by"),
        (Rotation.from_euler("x", 90.0, degrees=True), 1.0, "no turn, scale and shift"),
    ],
)
def test_a_wrong_frame_is_a_finding(rotation, scale, words):
    told = codes(about_middle(block(), rotation, scale), noisy(block(), 3))
    assert [*told] == ["FRAME-PLACES"]
    assert words in told["FRAME-PLACES"]


def test_another_datum_or_zero_of_heights_is_a_finding():
    told = codes(moved(95.0, 0.0, 0.0), noisy(block(), 4))
    assert "m away" in told["FRAME-PLACES"]
    told = codes(moved(0.0, 0.0, 400.0), noisy(block(), 4))
    assert "heights differ by -4" in told["FRAME-PLACES"]
    assert [*codes(moved(5.0, 0.0, 60.0), noisy(block(), 4))] == ["FRAME-CONFIRMED"]


def test_drift_of_a_receiver_is_no_turn():
    """Two metres across, six in height, from the first line to the last."""
    drift = np.linspace(0.0, 1.0, 24)[:, None] * [2.0, 1.0, 6.0]
    known = geodetic(block() + drift + np.random.default_rng(1).normal(0.0, 1.0, (24, 3)))
    assert [*codes(block(), known)] == ["FRAME-CONFIRMED"]


def test_one_position_of_another_image_does_not_matter():
    known = noisy(block(), 5)
    known[7, :2] += 1e-4
    assert [*codes(block(), known)] == ["FRAME-CONFIRMED"]


def test_heights_need_not_be_known():
    known = noisy(block(), 6)
    known[:, 2] = np.nan
    comparison = compared_places(stations_at(block()), known)
    assert np.isnan([comparison.tilt_rad, comparison.height_m]).all()
    assert [*codes(block(), known)] == ["FRAME-CONFIRMED"]


def test_one_line_tells_no_tilt_across_it():
    line = block()[:8]
    assert np.isnan(compared_places(stations_at(line), noisy(line, 2)).tilt_rad)


def test_a_frame_that_nothing_confirms_says_so():
    nothing = np.full((24, 3), np.nan)
    told = codes(block(), nothing)
    assert [*told] == ["FRAME-UNVERIFIED"]
    assert "are within 968 m, 853 to 853 m" in told["FRAME-UNVERIFIED"]
    assert codes(block(), nothing, must_be_tested=False) == {}
    few = noisy(block(), 7)
    few[3:] = np.nan
    assert [*codes(block(), few)] == ["FRAME-CONFIRMED", "FRAME-UNVERIFIED"]


def test_positions_belong_to_images_by_name():
    places = KnownPlaces("x", np.array(["b", "a"], object), np.arange(6.0).reshape(2, 3))
    rows = places.rows_of(np.array(["a", "c", "b"], object))
    np.testing.assert_array_equal(rows[[0, 2]], [[3, 4, 5], [0, 1, 2]])
    assert np.isnan(rows[1]).all()


@pytest.mark.parametrize(
    ("values", "contradictions"),
    [
        ({}, []),
        # a turn counts beyond 0.3 deg, five sigma, and 2 m or three residuals at the edge
        ({"turn_rad": np.radians(0.29)}, []),
        ({"turn_rad": np.radians(-0.31)}, ["it is turned by 0.31 deg about the vertical"]),
        ({"turn_rad": 0.05, "sigma_turn": 0.0101}, []),
        ({"turn_rad": 0.05, "sigma_turn": 0.0099}, ["it is turned by 2.86 deg about the vertical"]),
        ({"turn_rad": 0.01, "extent_m": 590.0, "residual_m": 1.0}, []),
        (
            {"turn_rad": 0.01, "extent_m": 610.0, "residual_m": 1.0},
            ["it is turned by 0.57 deg about the vertical"],
        ),
        ({"turn_rad": 0.01, "extent_m": 390.0}, []),
        ({"turn_rad": 0.01, "extent_m": 410.0}, ["it is turned by 0.57 deg about the vertical"]),
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
    sound = {
        "count": 20,
        "extent_m": 2000.0,
        "offset_m": 0.0,
        "height_m": 0.0,
        "residual_m": 0.1,
        "turn_rad": 0.0,
        "scale": 1.0,
        "sigma_turn": 1e-5,
        "tilt_rad": 0.0,
        "sigma_tilt_rad": 1e-5,
        "rise_residual_m": 0.1,
    }
    comparison = PlaceComparison(**(sound | values))
    assert comparison.contradictions == contradictions
