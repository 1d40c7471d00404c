"""Radians that were read as degrees, found by the directions of the flight lines alone."""

import numpy as np
import pytest

from unbend.block.angle_unit import are_radians

IMAGES_OF_LINE = 8
LINES = 4


@pytest.fixture
def flown():
    """Latitude, longitude and yaw [rad] of four lines, flown to the north-east and back."""
    along_rad = np.radians(30.0)
    lines = []
    for line in range(LINES):
        run = np.arange(IMAGES_OF_LINE) * 1e-5
        yaw_rad = along_rad
        if line % 2:
            run = run[::-1]
            yaw_rad = along_rad - np.pi
        north = run * np.cos(along_rad) - line * 1e-5 * np.sin(along_rad)
        east = run * np.sin(along_rad) + line * 1e-5 * np.cos(along_rad)
        lines.append(np.stack([0.8 + north, 0.1 + east / np.cos(0.8), np.full_like(run, yaw_rad)]))
    return np.concatenate(lines, axis=1)


def judged(flown, heading, heading_sign=1.0, first=None):
    """Whether roll and pitch of 0.01 and a heading are radians, of the first images or of all."""
    lat_rad, lon_rad, _ = flown[:, :first]
    level = np.full(lat_rad.size, 0.01)
    stated = np.stack([level, level, heading[:first]], axis=1)
    usable = np.ones(lat_rad.size, bool)
    return are_radians(stated, heading_sign, lat_rad, lon_rad, usable)


@pytest.mark.parametrize("crab_rad", [0.0, 0.2], ids=["straight", "crab"])
@pytest.mark.parametrize("mount_rad", [0.0, np.pi / 2], ids=["forward", "turned camera"])
def test_yaw_in_radians_is_noticed(flown, crab_rad, mount_rad):
    crab = np.random.default_rng(5).normal(0.0, crab_rad, flown.shape[1])

    assert judged(flown, flown[2] + crab + mount_rad)


def test_kappa_turns_the_other_way():
    azimuth_rad = np.linspace(-3.0, 3.0, 30)  # on a circle each direction is flown once
    lat_rad = 0.8 + 1e-4 * np.sin(azimuth_rad)
    lon_rad = -1e-4 * np.cos(azimuth_rad) / np.cos(0.8)
    circle = np.stack([lat_rad, lon_rad, azimuth_rad])
    kappa = np.pi / 2 - azimuth_rad

    assert judged(circle, kappa, heading_sign=-1.0)
    assert not judged(circle, kappa, heading_sign=1.0)


def test_degrees_are_not_radians(flown):
    assert not judged(flown, np.degrees(flown[2]))


def test_a_copter_that_keeps_its_heading_is_not_in_radians(flown):
    heading_deg = np.random.default_rng(6).normal(0.0, 2.0, flown.shape[1])

    assert not judged(flown, heading_deg)


def test_one_line_fits_both_units(flown):
    assert not judged(flown, flown[2], first=IMAGES_OF_LINE)
    assert not judged(flown[:, np.r_[0:8, 16:24]], flown[2, np.r_[0:8, 16:24]])


def test_images_that_are_not_usable_do_not_count(flown):
    lat_rad, lon_rad, yaw = flown
    level = np.zeros(yaw.size)
    stated = np.stack([level, level, yaw], axis=1)
    stated[3] = 400.0
    usable = np.ones(yaw.size, bool)

    assert not are_radians(stated, 1.0, lat_rad, lon_rad, usable)
    usable[3] = False
    assert are_radians(stated, 1.0, lat_rad, lon_rad, usable)
