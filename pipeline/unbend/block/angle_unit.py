"""Check whether headings of images were stated in degrees or gon, but are radians.

The check needs no tie points. On the next flight line, flown the other way, the heading differs by
180 degrees, or by 3.14 where a file of radians was read as degrees.
"""

import math

import numpy as np

from unbend.geodesy import wrapped
from unbend.units import Array, Mask

FEWEST_IMAGES = 6  # inside flight lines: fewer could follow them in the wrong unit by chance
FULL_TURN_RAD = math.tau + 1e-3  # no heading in a file of radians is larger, even if rounded
FOLLOWED = 0.9  # least concentration of course minus heading, if the headings follow the course
LARGEST_TURN_RAD = math.pi / 4.0  # at an image that is inside a flight line
LEVEL_RAD = math.pi / 2.0  # no tilt of a camera that looks down is larger
UNRELATED = 0.5  # largest concentration of course minus heading, if they do not follow it


def courses(lat_rad: Array, lon_rad: Array) -> Array:
    """(n,) direction of flight at each image, clockwise from north [rad]; NaN in turns.

    The images are in the order of the flight. The direction is that from the image before to the
    image after. It is unknown at the ends of the block, and where the flight turns by more than
    45 degrees at the image: there the next flight line begins.

    >>> lat_rad = np.array([0.0, 0.0, 0.0, 1e-5])
    >>> lon_rad = np.array([0.0, 1e-5, 2e-5, 2e-5])
    >>> courses(lat_rad, lon_rad).round(2).tolist()
    [nan, 1.57, nan, nan]
    """
    step_north = np.diff(lat_rad)
    step_east = wrapped(np.diff(lon_rad)) * np.cos(lat_rad[1:])
    before_rad = np.arctan2(step_east[:-1], step_north[:-1])
    after_rad = np.arctan2(step_east[1:], step_north[1:])
    turn_rad = wrapped(after_rad - before_rad)
    is_on_line = np.abs(turn_rad) < LARGEST_TURN_RAD
    course_rad = np.full(lat_rad.size, np.nan)
    course_rad[1:-1][is_on_line] = (before_rad + turn_rad / 2.0)[is_on_line]
    return course_rad


def concentration(angle_rad: Array) -> float:
    """Length of the mean of the unit vectors at some angles: 1 if all are equal, 0 if scattered.

    >>> concentration(np.array([3.1, 3.1])), round(concentration(np.array([0.0, np.pi])), 9)
    (1.0, 0.0)
    """
    unit_vectors = np.exp(1j * angle_rad)
    return float(np.abs(np.mean(unit_vectors)))


def _can_be_radians(stated: Array) -> bool:
    """Whether (n, 3) angles, those of the heading last, could be angles of images in radians."""
    largest_tilt = np.abs(stated[:, :2]).max()
    largest_heading = np.abs(stated[:, 2]).max()
    return bool(largest_tilt < LEVEL_RAD and largest_heading <= FULL_TURN_RAD)


def are_radians(
    stated: Array,
    heading_sign: float,
    lat_rad: Array,
    lon_rad: Array,
    usable: Mask,
) -> bool:
    """Whether angles that are stated in degrees or gon follow the flight lines only as radians.

    False for tilts that a camera that looks down cannot have in radians (1.57 or more), and for
    fewer than six images inside flight lines. False too where most flight lines have similar
    directions (three quarters of the images one direction, or two less than 120 degrees apart):
    then both units are possible. Gon count as degrees: numbers this small hardly differ.

    Parameters
    ----------
    stated : (n, 3) the numbers of the file, those of the heading (yaw or kappa) last.
    heading_sign : 1 for a heading that is positive clockwise (yaw), -1 for kappa.
    lat_rad, lon_rad : (n,) positions of the images of one camera, in the order of the flight.
    usable : (n,) whether an image is compared.
    """
    if not usable.any() or not _can_be_radians(stated[usable]):
        return False
    course_rad = courses(lat_rad[usable], lon_rad[usable])
    is_on_line = np.isfinite(course_rad)
    if is_on_line.sum() < FEWEST_IMAGES:
        return False
    heading = heading_sign * stated[usable, 2]
    difference_if_radians = (course_rad - heading)[is_on_line]
    difference_if_degrees = (course_rad - np.radians(heading))[is_on_line]
    follows_as_radians = concentration(difference_if_radians) > FOLLOWED
    follows_as_degrees = concentration(difference_if_degrees) > UNRELATED
    return follows_as_radians and not follows_as_degrees
