"""Checks of an estimate, of soundings, and of a hygrometer, by physics and climatology."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from unbend.atmosphere import refractive_index
from unbend.atmosphere.air_samples import part_of
from unbend.atmosphere.climatology import Climatology
from unbend.atmosphere.covariance import RAY_STEPS, ProfileCovariance, plane_rule
from unbend.atmosphere.estimate import external_readings, messages
from unbend.atmosphere.estimate.sensors import Barometer, Humidities, Readings, Thermometer
from unbend.atmosphere.estimate.solver import Estimate, layout_of, solve
from unbend.atmosphere.estimate.state import AirAtKnots, air_of, prior_of
from unbend.atmosphere.hypsometry import (
    ADIABATIC_K_PER_M,
    COLDEST_K,
    WARMEST_K,
    interpolation_weights,
)
from unbend.atmosphere.profile import Profile
from unbend.atmosphere.soundings import Sounding
from unbend.atmosphere.soundings.level_checks import DRIEST_RH
from unbend.units import HECTOPASCAL, ZERO_CELSIUS_K, Array

OVERTURNING_M = 500.0  # a steeper fall over less height may be a lag [m']
SUNNY_M = 100.0  # so near to the ground it may be a sunny field [m']

CERTAIN = 3.0  # sigmas by which a lapse rate must exceed the adiabatic one

FARTHEST = 5.0
"""Sigmas of the climatology that no air of the real soundings comes near (2.9 at most)."""

UNCHANGED = 0.95  # share of the prior sigma: with a larger sigma readings have no information
LEAST_RAY_M = 100.0  # height over which sigmas of R are compared where less was flown [m]

HARMLESS_K = 1.0
HARMLESS_LOG_P = 1e-3
"""Held-out residuals up to these do not fail an estimate: a sharp inversion has such residuals."""

HIGHEST_DEW_POINT_K = 308.15  # the highest ever reported near the ground, 35 C on the Persian Gulf

WETTEST_SIGMAS = 4.0
"""Sigmas above the climatology's dew point that no air of the real soundings comes near."""

CLOUD_RH = 0.97
CLOUD_SHARE = 0.9
CLOUD_M = 1000.0
CLOUD_EXCESS_K_PER_M = 3e-3
"""Air whose readings are saturated, nine of ten over so much height [m'], does not cool by 3 K/km
more than the saturated adiabat."""

DRY_BELOW_M = 3000.0  # air below is not as dry as `DRIEST_RH` throughout [m]

UNLIKELY_COLUMN = 4.0  # sigmas of the climatology; one of pressure is 10 hPa, or 90 m of height

LEAST_COMMON_M = 300.0  # heights that a column must share with the flight's sensors [m']
CONTRADICTED_K = 2.0  # they contradict it if they differ by more than this
CONTRADICTED = 4.5  # and by more than so many sigmas

MISFIT = 5.0  # readings with a larger sigma inflation factor disagree with the others

_STEP_M = 50.0  # between heights at which an estimate is checked [m']
_COLUMN_M = 3000.0  # thickness of the lowest part of a column that is compared with the climatology
_COMPARED_HEIGHTS = 30  # at which a column is compared with the flight's own sensors
_SIGMA_OF_MEDIAN = 1.4826  # one sigma over the median distance from the median
_LEAST_RH = 0.01  # divisor of a sigma of relative humidity
_SATURATION_K = 5400.0  # d ln e_s / dT is about this over T^2


@dataclass(frozen=True)
class Check:
    """Result of a check: true if it is passed; else ``reason`` states in words why it failed."""

    reason: str = ""

    def __bool__(self) -> bool:
        return not self.reason


PASSED = Check()


def is_plausible(made: Estimate, background: Climatology) -> Check:
    """Whether an estimate is possible air, between the lowest and the highest measurement.

    Temperatures must be 180 to 335 K and within 5 sigma of the climatology. Above the lowest 100 m
    they must not fall faster than the dry adiabat over 500 m, by more than 3 sigma.
    """
    edge = made.profile.layers.edge
    # A balloon may reach higher than the background.
    background_edge = background.profile.layers.edge
    low = max(made.readings.low, float(edge[0]), float(background_edge[0]))
    high = min(made.readings.high, float(edge[-1]), float(background_edge[-1]))
    height = np.arange(low, max(high, low + 1.0), _STEP_M)
    h = background.profile.gravity.height(height)
    t = made.profile.temperature(h)
    if not bool(np.all((t > COLDEST_K) & (t < WARMEST_K))):
        return Check(messages.not_temperatures_of_air(lowest_k=t.min(), highest_k=t.max()))
    spread = background.spread.sigma_temperature(made.profile.break_heights_m)
    sigma = np.interp(height, edge, spread)
    departure = (t - background.profile.temperature(h)) / sigma
    worst = int(np.argmax(np.abs(departure)))
    if abs(departure[worst]) > FARTHEST:
        reason = messages.far_from_climatology(
            kelvin=t[worst],
            height_m=h[worst],
            sigmas=abs(departure[worst]),
        )
        return Check(reason)
    above_ground = round(SUNNY_M / _STEP_M)
    return _does_not_overturn(made, height[above_ground:])


def _does_not_overturn(made: Estimate, height: Array) -> Check:
    """Whether air is stable: over 500 m' its temperature falls at most as the dry adiabat.

    More is allowed up to 3 sigma. ``height`` (n,): geopotential heights [m'], 50 m' apart, from the
    ground up.
    """
    steps = round(OVERTURNING_M / _STEP_M)
    if height.size <= steps:
        return PASSED
    h = made.profile.gravity.height(height)
    t = made.profile.temperature(h)
    edge = made.profile.layers.edge
    # Sigma [K] of T_M(H) - T_M(H + 500 m'), used for that of T, which is nearly the same.
    weights = interpolation_weights(edge, height[:-steps]) - interpolation_weights(
        edge, height[steps:]
    )
    matrix = made.covariance.matrix[: edge.size, : edge.size]
    sigma = np.sqrt(np.einsum("ij,ij->i", weights @ matrix, weights))
    fall = t[:-steps] - t[steps:]
    excess = fall - ADIABATIC_K_PER_M * OVERTURNING_M - CERTAIN * sigma
    steepest = int(np.argmax(excess))
    if excess[steepest] > 0.0:
        lapse = fall[steepest] / OVERTURNING_M * 1000.0
        return Check(messages.air_overturns(lapse=lapse, height_m=h[steepest]))
    return PASSED


def reasons_against(
    columns: Sequence[Sounding],
    own: Estimate | None,
    background: Climatology,
    flight: external_readings.TimeAndPlace,
) -> dict[str, str]:
    """Why soundings and model columns are not used, by name; those that pass are left out.

    The climatology contradicts them, or the flight's own sensors: ``own`` is the estimate from
    these alone, None without one.
    """
    reasons = {}
    for column in columns:
        check = column_is_plausible(column, background)
        if check and own is not None:
            check = column_agrees(column, own, background, flight)
        if not check:
            reasons[column.name] = check.reason
    return reasons


def column_is_plausible(column: Sounding, background: Climatology) -> Check:
    """Whether lowest pressure and temperatures of a column are within 4 sigma of the climatology.

    This finds heights above ground or in feet, and columns of another season.
    """
    profile = background.profile
    lowest_m = float(column.h_m[0])
    expected_pa = float(profile.pressure(lowest_m))
    log_ratio = float(np.log(column.pressure_pa[0] / expected_pa))
    sigmas = log_ratio / background.sigma_log_pressure(lowest_m)
    if abs(sigmas) > UNLIKELY_COLUMN:
        reason = messages.level_far_from_climatology(
            hpa=column.pressure_pa[0] / HECTOPASCAL,
            height_m=lowest_m,
            sigmas=abs(sigmas),
            expected_hpa=expected_pa / HECTOPASCAL,
        )
        return Check(reason)
    heights: Array = column.h_m[column.h_m < lowest_m + _COLUMN_M]
    departure_k = column.temperature_k[: heights.size] - profile.temperature(heights)
    sigma_k = background.spread.sigma_temperature(heights)
    sigmas = float(np.mean(departure_k / sigma_k))
    if abs(sigmas) > UNLIKELY_COLUMN:
        reason = messages.column_far_from_climatology(
            kelvin=departure_k.mean(),
            sigmas=abs(sigmas),
        )
        return Check(reason)
    return PASSED


def column_agrees(
    column: Sounding,
    own: Estimate,
    background: Climatology,
    flight: external_readings.TimeAndPlace,
) -> Check:
    """Whether temperatures of a column agree with ``own``, the estimate from the flight's sensors.

    Compared is the mean over common heights, within the uncertainty of the estimate and of the
    change of the air over time and distance. Passed with less than 300 m of common heights.
    """
    gravity = background.profile.gravity
    levels = gravity.geopotential_height(column.h_m)
    low = max(own.readings.low, levels[0])
    high = min(own.readings.high, levels[-1])
    departures = external_readings.sounding_departures((column,), background, flight)
    if high - low < LEAST_COMMON_M or not departures:
        return PASSED
    departure = departures[0]
    height = np.linspace(low, high, _COMPARED_HEIGHTS)
    measured = np.interp(height, levels, column.temperature_k)
    in_flight = own.profile.temperature(gravity.height(height))
    in_flight += np.interp(height, departure.knot, departure.expected_k)
    mean = float(np.mean(measured - in_flight))

    # The variance of the mean of T(h); that of T_M is nearly the same.
    edge = own.profile.layers.edge
    flight_weights = interpolation_weights(edge, height).mean(axis=0)
    matrix = own.covariance.matrix[: edge.size, : edge.size]
    departure_weights = interpolation_weights(departure.knot, height).mean(axis=0)
    variance = flight_weights @ matrix @ flight_weights
    variance += departure_weights @ departure.covariance(background) @ departure_weights
    sigma = float(np.sqrt(variance + external_readings.LEVEL_K**2))
    if abs(mean) <= max(CONTRADICTED_K, CONTRADICTED * sigma):
        return PASSED
    reason = messages.column_contradicts_flight(
        kelvin=mean,
        sigmas=abs(mean) / sigma,
        extent_m=high - low,
    )
    return Check(reason)


def has_information(
    made: Estimate,
    background: Climatology,
    moisture: Climatology,
) -> Check:
    """Whether the flight's thermometer and barometer reduce the sigma of the refraction R.

    Compared is R from the highest to the lowest measurement, by ``made`` and by an estimate without
    these sensors; the sigma must fall below 95 %. A barometer with drifting GNSS heights reaches
    this from some 200 m of climb.
    """
    profile = background.profile
    layout = layout_of(made.readings, background)
    prior = prior_of(layout, background, moisture)
    other_sets = []
    for readings in made.readings.sets:
        if not isinstance(readings, Thermometer | Barometer):
            other_sets.append(readings)
    _, covariance_without = solve(layout, prior, other_sets, profile).profile(profile)
    low_m = float(profile.gravity.height(made.readings.low))
    high_m = float(profile.gravity.height(made.readings.high))
    high_m = max(high_m, low_m + LEAST_RAY_M)
    sigma = _sigma_of_refraction(made.covariance, high_m, low_m)
    sigma_without = _sigma_of_refraction(covariance_without, high_m, low_m)
    if sigma < UNCHANGED * sigma_without:
        return PASSED
    percent_left = 100.0 * sigma / sigma_without
    return Check(messages.no_information(percent=percent_left))


def _sigma_of_refraction(covariance: ProfileCovariance, h_c: float, h_g: float) -> float:
    """One sigma of R/tan zeta in the plane.

    From a camera at ``h_c`` to the ground at ``h_g`` [m above sea level].
    """
    h, weight = plane_rule(h_c, h_g, RAY_STEPS)
    gradient = weight[None] @ covariance.refractivity_gradient(h)
    return float(covariance.sigma_of(gradient)[0])


def is_better_than_background(
    made: Estimate,
    background: Climatology,
    moisture: Climatology,
    name: str = "the climatology",
) -> Check:
    """Whether an estimate predicts held-out readings better than its background does.

    Held out is every other bin of thermometer and barometer. Compared is the scatter of their
    residuals about the median. So consistent readings pass, even if all of them have the same
    error; unrelated noise does not. ``name``: of the background, for a message.
    """
    layout = made.layout
    prior = prior_of(layout, background, moisture)
    used, held_out = _hold_out_half(made.readings.sets)
    if not held_out:
        return PASSED
    profile = background.profile
    air = solve(layout, prior, used, profile, made.state).air
    pressure = profile.pressure(profile.gravity.height(layout.knot))
    expected = air_of(layout, prior.mean, pressure, profile.constant)
    for readings in held_out:
        by_estimate = _scatter_about(readings, air)
        by_background = _scatter_about(readings, expected)
        is_pressure = isinstance(readings, Barometer)
        harmless = HARMLESS_LOG_P if is_pressure else HARMLESS_K
        if by_estimate > max(by_background, harmless):
            factor = 100.0 if is_pressure else 1.0
            reason = messages.held_out_readings_differ(
                sensor=readings.name,
                unit="%" if is_pressure else "K",
                name=name,
                by_estimate=factor * by_estimate,
                by_background=factor * by_background,
            )
            return Check(reason)
    return PASSED


def _hold_out_half(sets: Sequence[Readings]) -> tuple[list[Readings], list[Readings]]:
    """The used readings, and the held-out ones: every other bin of thermometer and barometer."""
    used: list[Readings] = []
    held_out: list[Readings] = []
    for readings in sets:
        is_odd = np.arange(readings.height.size) % 2 == 1
        if isinstance(readings, Thermometer | Barometer) and bool(is_odd.any()):
            used.append(part_of(readings, ~is_odd))
            held_out.append(part_of(readings, is_odd))
        else:
            used.append(readings)
    return used, held_out


def _scatter_about(readings: Readings, air: AirAtKnots) -> float:
    """One sigma of the residuals of readings in an air, by the median absolute deviation."""
    predicted, _ = readings.predict(air)
    residuals = readings.value - predicted
    distance = np.abs(residuals - np.median(residuals))
    return float(_SIGMA_OF_MEDIAN * np.median(distance))


def hygrometer_is_outside(made: Estimate, moisture: Climatology) -> Check:
    """Whether a flight's hygrometer reads humidities that air of the estimate can have.

    Near the ground it must once read more than 1.1 %. Dew points must be at most 35 C, and within
    4 sigma of the climatology. Temperature must not fall faster than in a cloud over 1 km or more
    in which the air is saturated. Passed without a hygrometer.
    """
    for readings in made.readings.sets:
        if not isinstance(readings, Humidities) or readings.fault is None:
            continue
        lowest_m = made.profile.gravity.height(readings.height).min()
        wettest = readings.value.max()
        if lowest_m < DRY_BELOW_M and wettest <= DRIEST_RH:
            return Check(messages.hygrometer_too_dry(percent=100.0 * wettest))
        check = _has_usual_dew_points(readings, made.profile, moisture)
        if check:
            check = _can_be_cloud(readings, made.profile)
        if not check:
            return check
    return PASSED


def _has_usual_dew_points(
    readings: Humidities,
    profile: Profile,
    moisture: Climatology,
) -> Check:
    """Whether dew points of a hygrometer are at most 35 C and within 4 sigma of a climatology."""
    h = profile.gravity.height(readings.height)
    saturated = refractive_index.saturation_vapour_pressure(profile.temperature(h))
    dew_k = refractive_index.dew_point(readings.value * saturated)
    usual_k = refractive_index.dew_point(moisture.profile.vapour_pressure(h))
    usual_rh = np.maximum(moisture.relative_humidity(h), _LEAST_RH)
    relative_sigma_rh = moisture.spread.sigma_relative_humidity(h) / usual_rh
    sigma_by_rh_k = usual_k**2 / _SATURATION_K * relative_sigma_rh
    sigma_k = np.hypot(moisture.spread.sigma_temperature(h), sigma_by_rh_k)
    limit_k = np.minimum(usual_k + WETTEST_SIGMAS * sigma_k, HIGHEST_DEW_POINT_K)
    # A dew point is NaN where noise made a mean relative humidity negative: there the air is dry.
    excess_k = np.nan_to_num(dew_k - limit_k, nan=-np.inf)
    worst = int(np.argmax(excess_k))
    if excess_k[worst] <= 0.0:
        return PASSED
    reason = messages.hygrometer_too_wet(
        percent=100.0 * readings.value[worst],
        height_m=h[worst],
        dew_c=dew_k[worst] - ZERO_CELSIUS_K,
        limit_c=limit_k[worst] - ZERO_CELSIUS_K,
    )
    return Check(reason)


def _can_be_cloud(readings: Humidities, profile: Profile) -> Check:
    """Whether temperature falls at most as in a cloud where a hygrometer is saturated.

    Passed if it is saturated over less than 1 km, or for less than nine of ten readings between.
    """
    wet = readings.height[readings.value >= CLOUD_RH]
    if wet.size == 0 or np.ptp(wet) < CLOUD_M:
        return PASSED
    ends = np.array([wet.min(), wet.max()])
    is_inside = (readings.height >= ends[0]) & (readings.height <= ends[1])
    h = profile.gravity.height(ends)
    t = profile.temperature(h)
    lapse = float(t[0] - t[1]) / float(np.ptp(ends))
    adiabats = refractive_index.saturated_lapse(t, profile.pressure(h))
    adiabat = float(adiabats.mean())
    is_saturated = wet.size >= CLOUD_SHARE * is_inside.sum()
    if is_saturated and lapse > adiabat + CLOUD_EXCESS_K_PER_M:
        reason = messages.hygrometer_in_no_cloud(
            percent=100.0 * CLOUD_RH,
            low_m=ends[0],
            high_m=ends[1],
            lapse=1e3 * lapse,
            adiabat=1e3 * adiabat,
        )
        return Check(reason)
    return PASSED
