"""Noise, biases and lever arms of the simulated sensors, against numbers computed another way."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from unbend.simulate.block import observation_columns, stations
from unbend.simulate.flight import FIELD_LAT_RAD, UNDULATION_M, fly
from unbend.simulate.optics import cameras
from unbend.simulate.sensors import GnssSamples, navigation_samples, sample
from unbend.simulate.true_air import relative_humidity, temperature_k, true_air

EQUATOR_M = 6_378_137.0
E2 = 0.00669437999014  # WGS84
AIR = true_air(FIELD_LAT_RAD)


@pytest.fixture(scope="module")
def flight():
    return fly(1500.0, 1, 6)


@pytest.fixture(scope="module")
def logged(flight):
    return sample(
        flight,
        AIR,
        5,
        ("a",),
    )


@pytest.mark.parametrize(
    "draw",
    [GnssSamples.draw, navigation_samples],
)
def test_positions_scatter_alike_to_the_north_and_to_the_east(flight, draw):
    """3 cm each; in radians of longitude that is more than in latitude, by 1/cos(47.4 deg)."""
    errors = []
    for seed in range(12):
        drawn = draw(flight, np.random.default_rng(seed))
        truth = flight.at(drawn.time_s)
        north = EQUATOR_M * (drawn.lat_rad - truth.lat_rad)
        east = EQUATOR_M * np.cos(truth.lat_rad) * (drawn.lon_rad - truth.lon_rad)
        errors.append([north, east, drawn.h_msl_m - truth.h_msl_m])
    scatter = np.std(
        np.concatenate(errors, axis=1),
        axis=1,
    )
    assert scatter == pytest.approx([0.03, 0.03, 0.05], rel=0.15)


def test_air_outside(flight, logged):
    """The thermometer is 0.5 K too warm; pressure and humidity have no bias."""
    box = logged.outside
    height = flight.at(box.time_s).h_msl_m
    pressure_height = flight.at(box.pressure_time_s).h_msl_m
    warmer = box.temperature_k - temperature_k(height)
    wetter = box.humidity - relative_humidity(height)
    over = box.pressure_pa - AIR.pressure_pa(pressure_height)
    assert (warmer.mean(), warmer.std()) == pytest.approx((0.5, 0.2), abs=0.03)
    assert (wetter.mean(), wetter.std()) == pytest.approx((0.0, 0.02), abs=0.003)
    assert (over.mean(), over.std()) == pytest.approx((0.0, 20.0), abs=1.5)
    board = box.board_k - temperature_k(pressure_height)
    assert_allclose(board, 15.0, atol=0.0051)


def test_the_cabin_is_held_at_1800_m_and_warm(flight, logged):
    """Below, the pressure is that outside; above, at most 350 Pa from that of 1800 m."""
    box = logged.cabin
    height = flight.at(box.pressure_time_s).h_msl_m
    low = height < 1300.0
    high = height > 1900.0
    assert low.sum() > 1000
    assert high.sum() > 500
    outside = AIR.pressure_pa(height)
    assert np.abs(box.pressure_pa - outside)[low].max() < 120.0
    assert np.abs(box.pressure_pa - AIR.pressure_pa(np.array(1800.0)))[high].max() < 430.0
    assert box.temperature_k.min() == pytest.approx(293.0, abs=1.0)
    assert box.temperature_k.max() == pytest.approx(297.0, abs=1.0)
    assert np.abs(box.humidity - 0.30).max() < 0.13


@pytest.mark.parametrize("number", [0, 1])
def test_the_lever_arm_is_along_the_body(flight, number):
    """By Euler angles and the radii of curvature, to 0.01 mm."""
    pair = cameras(20_000.0)
    block = stations(flight, AIR, pair)
    truth = flight.at(flight.exposure_s)
    angles = np.stack(
        [truth.yaw_rad, truth.pitch_rad, truth.roll_rad],
        axis=-1,
    )
    north, east, down = Rotation.from_euler("ZYX", angles).apply(pair[number].lever_arm_m).T
    height = truth.h_msl_m + UNDULATION_M
    w = 1.0 - E2 * np.sin(truth.lat_rad) ** 2
    meridian = EQUATOR_M * (1.0 - E2) / w**1.5 + height
    parallel = (EQUATOR_M / np.sqrt(w) + height) * np.cos(truth.lat_rad)
    rows = block.camera == number
    moved_lat = block.lat_rad[rows] - truth.lat_rad
    moved_lon = block.lon_rad[rows] - truth.lon_rad
    assert_allclose(moved_lat * meridian, north, atol=1e-5)
    assert_allclose(
        moved_lon * parallel,
        east,
        atol=1e-5,
    )
    assert_allclose(
        block.h_ellipsoid_m[rows] - height,
        -down,
        atol=1e-5,
    )


def test_the_noise_of_x_and_y_is_drawn_for_each():
    count = 2000
    zeros = np.zeros(count, np.int64)
    block = SimpleNamespace(image=("a",))
    points = SimpleNamespace(
        name=("p",),
        h_msl_m=np.array([450.0]),
    )
    names = ("x_px", "y_px", "x_true_px", "y_true_px", "zeta_c_rad", "r_c_rad", "r_cc_rad")
    true = {name: np.full(count, 100.0 * k) for k, name in enumerate(names, 1)}
    seen = SimpleNamespace(
        station=zeros,
        point=zeros,
        **true,
    )
    measured, truth = observation_columns(
        block,
        points,
        seen,
        0.3,
        np.random.default_rng(2),
    )
    error = np.stack([measured[name] - true[name] for name in ("x_px", "y_px")])
    assert_allclose(
        error.mean(axis=1),
        0.0,
        atol=0.03,
    )
    assert_allclose(
        np.cov(error),
        0.09 * np.eye(2),
        atol=0.01,
    )
    for name in names:
        assert_array_equal(truth[name], true[name])
