"""What the fitted structure function has of what public ascents show."""

import numpy as np
import pytest

from unbend.atmosphere.air_variation import (
    changes,
    covariance_of,
    larger_part,
    sigma_of,
    variation_parts,
)

VIENNA_RAD = np.radians(48.2)
JANUARY = 1.0
JULY = 7.0
FINE_STRUCTURE = {
    "kinked",
    "smooth",
}


def correlation_of_changes(hours, low_m, high_m):
    h = np.array([low_m, high_m])
    parts = variation_parts(VIENNA_RAD, JANUARY, 0.0)
    covariance = covariance_of(changes(parts, hours), h, h)
    variance = np.diag(covariance)
    return covariance[0, 1] / np.sqrt(variance.prod())


@pytest.mark.parametrize("hours", [12.0, 48.0])
def test_warm_air_below_the_tropopause_goes_with_cold_air_above(hours):
    """Changes over Vienna at 5 km and above 11 km are anti-correlated, -0.4 to -0.8."""
    assert -0.9 < correlation_of_changes(hours, 5000.0, 12_000.0) < -0.3
    assert correlation_of_changes(hours, 3000.0, 6000.0) > 0.2


def test_the_air_is_mixed_by_a_summers_day_alone():
    def sigma_k(month, hour):
        parts = variation_parts(VIENNA_RAD, month, 0.0, hour)
        return sigma_of(parts, np.array([300.0]))

    of_july_night = sigma_k(JULY, 3.0)
    of_winter_night = sigma_k(JANUARY, 3.0)
    assert of_july_night > 1.02 * sigma_k(JULY, 15.0)
    assert of_july_night == sigma_k(JULY, None)
    assert sigma_k(JANUARY, 15.0) == pytest.approx(of_winter_night, rel=5e-3)


def of_fine_structure(degrees, month, h):
    parts = variation_parts(np.radians(degrees), month, 0.0)
    kinked_and_smooth = tuple(part for part in parts if part.name in FINE_STRUCTURE)
    return sigma_of(kinked_and_smooth, np.array([h]))


@pytest.mark.parametrize(
    ("degrees", "h", "ratio"),
    [
        (48.2, 1000.0, 1.35),
        (48.2, 250.0, 1.0),
        (48.2, 3100.0, 1.0),
        (12.0, 1000.0, 1.0),
        (71.0, 1000.0, 1.0),
    ],
)
def test_inversions_vary_more_in_the_winter_of_middle_latitudes(degrees, h, ratio):
    """By 1.35 from 0.75 to 1.5 km; not aloft, in summer, the tropics or the Arctic."""
    january = of_fine_structure(degrees, JANUARY, h)
    july = of_fine_structure(degrees, JULY, h)
    assert january / july == pytest.approx(ratio, rel=0.01)
    assert of_fine_structure(-degrees, JULY, h) == pytest.approx(january)


def test_changes_grow_with_time_and_distance_to_twice_the_variance():
    parts = variation_parts(VIENNA_RAD, JULY, 0.0)
    h = np.array([0.0, 1000.0, 5000.0])

    def sigma_k(hours, metres):
        return sigma_of(changes(parts, hours, metres), h)

    grown = [
        sigma_k(0.0, 0.0),
        sigma_k(6.0, 0.0),
        sigma_k(6.0, 1e5),
        sigma_k(48.0, 1e6),
    ]
    assert np.all(grown[0] == 0.0)
    assert np.all(np.diff(grown, axis=0) > 0.1)
    unrelated = np.sqrt(2.0) * sigma_of(parts, h)
    assert sigma_k(1e6, 1e9) == pytest.approx(unrelated)


def test_of_two_parts_the_larger_amplitude_keeps_its_sign():
    july, *_ = variation_parts(VIENNA_RAD, JULY, 0.0)
    january, *_ = variation_parts(VIENNA_RAD, JANUARY, 0.0)
    larger = larger_part(july, january).sigma_k
    in_january = np.interp(july.h_m, january.h_m, january.sigma_k)
    amplitude = np.abs([july.sigma_k, in_january]).max(axis=0)
    assert np.all(np.abs(larger) == amplitude)
    assert larger.min() < -2.0
