"""Positions in the images as evidence of their assignment to events."""

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
LAT_RAD = 0.8
LON_RAD = 0.1
SPEED = 20.0
INTERVAL = 1.5
FIRST = 5
"""The number of the event of the first image."""


def flown(lines, per_line=30, *, lon_rad=LON_RAD):
    """North and east of exposures on lines to and fro, 60 m apart, 30 m from one to the next."""
    there = np.arange(per_line) * SPEED * INTERVAL
    to_and_fro = np.append(there, there[::-1])
    north = np.resize(to_and_fro, lines * per_line)
    east = np.repeat(np.arange(lines) * 60.0, per_line)
    n = north.size
    no_names = np.full(n, "", object)
    stations = empty_stations(no_names, np.full(n, "cam", object), STATION_OK)
    time_s = np.arange(n) * INTERVAL
    lat, lon = place_of(north, east, lon_rad)
    stations = replace(
        stations,
        time_ns=(time_s * 1e9).astype(np.int64),
        lat_rad=lat,
        lon_rad=lon,
    )
    return stations, north, east


def place_of(north, east, lon_rad):
    """Latitude and longitude of a place in metres from a corner of the block."""
    lon = lon_rad + east / A / np.cos(LAT_RAD)
    return LAT_RAD + north / A, wrapped(lon)


def likelihood(lines, *, share=1.0, lon_rad=LON_RAD):
    """Of images of the events from the sixth on, their positions by fixes 0.7 s old."""
    stations, north, east = flown(lines, lon_rad=lon_rad)
    rng = np.random.default_rng(3)
    count = north.size - FIRST
    heading = np.sign(np.gradient(north))
    north -= heading * SPEED * 0.7
    north = north[FIRST:] + rng.normal(0, 4, count)
    east = east[FIRST:] + 3.0 + rng.normal(0, 4, count)
    lat, lon = place_of(north, east, lon_rad)
    written = np.stack([lat, lon, np.zeros(count)], axis=1)
    written[rng.random(count) >= share] = np.nan
    written[2] += 1.0  # one image of another continent
    row = np.arange(count)
    unknown = np.full(count, np.nan)
    names = np.array([f"i{k}" for k in row], object)
    files = ImageTimes(
        names,
        np.full(count, NO_TIME),
        unknown,
        False,
        written,
    )
    images = CameraImages(names, row, "sequence", row)
    return position_likelihood(images, files, stations)


FOUR_LINES = np.arange(FIRST, 120)
"""Numbers of the events of the images on four lines."""


@pytest.mark.parametrize("shift", [-2, -1, 1, 2])
def test_lines_to_and_fro_decide_though_the_fixes_are_stale(shift):
    function = likelihood(4)
    shifted = np.minimum(FOUR_LINES + shift, 119)
    assert function(FOUR_LINES) > function(shifted) + LOG_RATIO_NEEDED


@pytest.mark.parametrize("shift", [0, 1])
def test_across_180_degrees_they_say_the_same(shift):
    function = likelihood(4)
    across = likelihood(4, lon_rad=np.pi - 5e-6)  # 32 m before it at the equator
    event = FOUR_LINES - shift
    assert across(event) == pytest.approx(function(event), rel=1e-4)


def test_one_line_decides_nothing_that_a_delay_explains():
    function = likelihood(1)
    event = np.arange(FIRST, 30)
    assert function(event) < function(event - 1) + LOG_RATIO_NEEDED


def test_images_without_an_event_are_no_gain():
    function = likelihood(4)
    event = FOUR_LINES.copy()
    event[:10] = -1
    assert function(event) < function(FOUR_LINES) - LOG_RATIO_NEEDED


def test_few_positions_say_nothing():
    assert likelihood(4, share=0.3) is None


def test_no_files_say_nothing():
    stations, _, _ = flown(2)
    row = np.arange(3)
    images = CameraImages(row, row, "sequence", row)
    assert position_likelihood(images, None, stations) is None
