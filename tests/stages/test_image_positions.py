"""Positions in the images as evidence of their assignment to events."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from unbend.block.alignment import LOG_RATIO_NEEDED
from unbend.flight.stations import STATION_OK, empty_stations
from unbend.geodesy import wrapped
from unbend.stages.multi_image.assignment_likelihoods import position_likelihood
from unbend.stages.multi_image.camera_images import CameraImages
from unbend.tables.imports.exif import NO_TIME, ImageTimes

A = 6.37e6
SPEED = 20.0
INTERVAL = 1.5
FIRST = 5
"""The number of the event of the first image."""


def flown(lines: int, per_line: int = 30, *, lon_rad: float = 0.1):
    """North of exposures on lines to and fro, 60 m apart, 30 m from one to the next."""
    along = np.arange(per_line) * SPEED * INTERVAL
    north = np.concatenate([along if k % 2 == 0 else along[::-1] for k in range(lines)])
    east = np.repeat(np.arange(lines) * 60.0, per_line)
    n = north.size
    stations = empty_stations(np.full(n, "", object), np.full(n, "cam", object), STATION_OK)
    stations = replace(
        stations,
        time_ns=(np.arange(n) * INTERVAL * 1e9).astype(np.int64),
        lat_rad=0.8 + north / A,
        lon_rad=wrapped(lon_rad + east / A / np.cos(0.8)),
    )
    return stations, north, east


def likelihood(lines: int, *, known: float = 1.0, lon_rad: float = 0.1):
    """Of images of the events from the sixth on, their positions by fixes 0.7 s old."""
    stations, north, east = flown(lines, lon_rad=lon_rad)
    rng = np.random.default_rng(3)
    images = north.size - FIRST
    heading = np.sign(np.gradient(north))[FIRST:]
    written_north = north[FIRST:] - heading * SPEED * 0.7 + rng.normal(0, 4, images)
    written_east = east[FIRST:] + 3.0 + rng.normal(0, 4, images)
    latitude = 0.8 + written_north / A
    longitude = wrapped(lon_rad + written_east / A / np.cos(0.8))
    written = np.stack([latitude, longitude, np.zeros(images)], axis=1)
    written[rng.random(images) >= known] = np.nan
    written[2] += 1.0  # one image of another continent
    names = np.array([f"i{k}" for k in range(images)], object)
    row = np.arange(images)
    files = ImageTimes(names, np.full(images, NO_TIME), np.full(images, np.nan), False, written)
    return position_likelihood(CameraImages(names, row, "sequence", row), files, stations), row


@pytest.mark.parametrize("shift", [-2, -1, 1, 2])
def test_lines_to_and_fro_decide_though_the_fixes_are_stale(shift):
    function, row = likelihood(4)
    assert function(row + 5) > function(np.minimum(row + 5 + shift, 119)) + LOG_RATIO_NEEDED


def test_across_180_degrees_they_say_the_same():
    function, row = likelihood(4)
    across, _ = likelihood(4, lon_rad=np.pi - 5e-6)  # 32 m before it at the equator
    for shift in (0, 1):
        assert across(row + 5 - shift) == pytest.approx(function(row + 5 - shift), rel=1e-4)


def test_one_line_decides_nothing_that_a_delay_explains():
    function, row = likelihood(1)
    assert function(row + 5) < function(row + 4) + LOG_RATIO_NEEDED


def test_images_without_an_event_are_no_gain():
    function, row = likelihood(4)
    event = row + 5
    assert function(np.where(row < 10, -1, event)) < function(event) - LOG_RATIO_NEEDED


def test_few_positions_say_nothing():
    assert likelihood(4, known=0.3)[0] is None
    stations, _, _ = flown(2)
    row = np.arange(3)
    assert position_likelihood(CameraImages(row, row, "sequence", row), None, stations) is None
