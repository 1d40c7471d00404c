"""Radians that were read as degrees, found by the directions of the flight lines alone."""

import numpy as np
import pytest

from unbend.block.angle_unit import are_radians

LATITUDE_RAD = 0.8
HEADING_RAD = 0.5
SPACING_RAD = 1e-5
IMAGES_OF_LINE = 8


class Flight:
    """Places and headings [rad] of images, all usable, with stated angles that a test sets."""

    def __init__(self, north, east, heading):
        self.lat_rad = LATITUDE_RAD + north
        self.lon_rad = 0.1 + east / np.cos(LATITUDE_RAD)
        self.heading = heading
        self.usable = np.full(heading.size, True)

    def is_in_radians(self, stated_heading, heading_sign=1.0, tilt=0.01):
        tilts = np.full(self.heading.size, tilt)
        stated = np.stack([tilts, tilts, stated_heading], axis=1)
        return are_radians(
            stated,
            heading_sign,
            self.lat_rad,
            self.lon_rad,
            self.usable,
        )


def lines(*directions):
    """Flight lines to the north-east (1) and back (-1)."""
    along = np.arange(IMAGES_OF_LINE) * SPACING_RAD
    north = []
    east = []
    heading = []
    for line, direction in enumerate(directions):
        run = along[::direction]
        across = line * SPACING_RAD
        north.append(run * np.cos(HEADING_RAD) - across * np.sin(HEADING_RAD))
        east.append(run * np.sin(HEADING_RAD) + across * np.cos(HEADING_RAD))
        turn_rad = 0.0 if direction == 1 else np.pi
        heading.append(np.full(IMAGES_OF_LINE, HEADING_RAD - turn_rad))
    return Flight(
        np.concatenate(north),
        np.concatenate(east),
        np.concatenate(heading),
    )


@pytest.fixture
def flight():
    return lines(1, -1, 1, -1)


@pytest.mark.parametrize("crab_rad", [0.0, 0.2])
@pytest.mark.parametrize("mount_rad", [0.0, np.pi / 2])
def test_yaw_in_radians_is_noticed(flight, crab_rad, mount_rad):
    draw = np.random.default_rng(5)
    crab = draw.normal(0.0, crab_rad, flight.heading.size)

    assert flight.is_in_radians(flight.heading + crab + mount_rad)


def test_kappa_turns_the_other_way():
    azimuth = np.linspace(-3.0, 3.0, 30)
    circle = Flight(
        1e-4 * np.sin(azimuth),
        -1e-4 * np.cos(azimuth),
        azimuth,
    )
    kappa = np.pi / 2 - azimuth

    assert circle.is_in_radians(kappa, heading_sign=-1.0)
    assert not circle.is_in_radians(kappa, heading_sign=1.0)


def test_degrees_are_not_radians(flight):
    heading_deg = np.degrees(flight.heading)

    assert not flight.is_in_radians(heading_deg)


def test_a_copter_that_keeps_its_heading_is_not_in_radians(flight):
    draw = np.random.default_rng(6)
    heading_deg = draw.normal(0.0, 2.0, flight.heading.size)

    assert not flight.is_in_radians(heading_deg)


@pytest.mark.parametrize(("tilt", "possible"), [(1.5, True), (1.7, False), (-1.7, False)])
def test_a_copter_that_leans_along_its_lines_is_not_in_radians(flight, tilt, possible):
    assert flight.is_in_radians(flight.heading, tilt=tilt) == possible


@pytest.mark.parametrize("directions", [(1,), (1, 1, 1)])
def test_lines_of_one_direction_fit_both_units(directions):
    one_way = lines(*directions)

    assert not one_way.is_in_radians(one_way.heading)


def test_images_that_are_not_usable_do_not_count(flight):
    heading = flight.heading.copy()
    heading[3] = 400.0
    assert not flight.is_in_radians(heading)

    flight.usable[3] = False
    assert flight.is_in_radians(heading)
